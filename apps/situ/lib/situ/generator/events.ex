defmodule Situ.Generator.Events do
  @moduledoc false
  # The push source behind event_source: what other processes post, stamped with the pipeline's clock.
  use Situ.Component,
    inputs: [],
    outputs: [out: :any],
    options: [
      subscribe: [type: {:fun, 1}, required: true],
      unsubscribe: [type: {:fun, 1}, required: true],
      on_same_time: [type: {:in, [:nudge, :drop, :error]}, default: :nudge]
    ]

  defstruct [:opts, :ref, :handle, :last, active: false]

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: opts, ref: make_ref()}}

  @impl true
  def handle_start(_context, state) do
    {stage, ref} = {self(), state.ref}

    post = fn data ->
      send(stage, {:situ_event, ref, data})
      :ok
    end

    handle = state.opts[:subscribe].(post)
    {[{:complete, :infinity}], %{state | handle: handle, active: true}}
  end

  @impl true
  def handle_info({:situ_event, ref, data}, context, %{ref: ref, active: true} = state),
    do: stamp(data, context.now, state)

  def handle_info(_other, _context, state), do: {[], state}

  @impl true
  def handle_stop(_final, _context, state), do: {[], release(state)}

  @impl true
  def terminate(_reason, state), do: release(state)

  defp stamp(data, now, %{last: last} = state) when last == nil or now > last,
    do: {[{:out, now, data}], %{state | last: now}}

  defp stamp(data, now, %{last: last} = state) do
    case state.opts[:on_same_time] do
      :nudge -> {[{:out, last + 1, data}], %{state | last: last + 1}}
      :drop -> {[], state}
      :error -> {[{:out, now, data}], state}
    end
  end

  defp release(%{active: false} = state), do: state

  defp release(state) do
    state.opts[:unsubscribe].(state.handle)
    %{state | active: false}
  end
end
