defmodule Situ.Generator.Events do
  @moduledoc false
  # The push source behind event_source: what other processes post, stamped with the pipeline's clock when they post it.
  use Situ.Component,
    inputs: [],
    outputs: [out: :any],
    options: [
      subscribe: [type: {:fun, 1}, required: true],
      unsubscribe: [type: {:fun, 1}]
    ]

  defstruct [:opts, :ref, :handle, :last, active: false]

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: opts, ref: make_ref()}}

  @impl true
  def handle_start(context, state) do
    {stage, ref, clock} = {self(), state.ref, Situ.Pipeline.clock(context.pipeline)}

    post = fn data ->
      send(stage, {:situ_event, ref, Situ.Clock.now(clock), data})
      :ok
    end

    handle = state.opts[:subscribe].(post)
    {[{:complete, :infinity}], %{state | handle: handle, active: true}}
  end

  @impl true
  # Two processes may post at once: what comes later is not earlier.
  def handle_info({:situ_event, ref, time, data}, _context, %{ref: ref, active: true} = state) do
    time = max(time, state.last || time)
    {[{:out, time, data}], %{state | last: time}}
  end

  def handle_info(_other, _context, state), do: {[], state}

  @impl true
  def handle_stop(_final, _context, state), do: {[], release(state)}

  @impl true
  def terminate(_reason, state), do: release(state)

  defp release(%{active: false} = state), do: state

  defp release(state) do
    if unsubscribe = state.opts[:unsubscribe], do: unsubscribe.(state.handle)
    %{state | active: false}
  end
end
