defmodule Situ.Generator.Events do
  @moduledoc false
  # The push source of event_source. It emits data that other processes post, with the time of the pipeline's clock read
  # by the poster. So a message's time does not depend on when this process handles it, and all data posted before a
  # stop is emitted.
  use Situ.Component,
    inputs: [],
    outputs: [out: :any],
    options: [
      subscribe: [type: {:fun, 1}, required: true],
      unsubscribe: [type: {:fun, 1}]
    ]

  alias Situ.Clock
  alias Situ.Pipeline.Client

  defstruct [:opts, :ref, :handle, :last, active: false]

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: opts, ref: make_ref()}}

  @impl true
  def handle_start(context, state) do
    {stage, ref} = {self(), state.ref}
    %{clock: clock} = Client.call!(context.pipeline, :timing)

    post = fn data ->
      send(stage, {:situ_event, ref, Clock.now(clock), data})
      :ok
    end

    handle = state.opts[:subscribe].(post)
    {[{:complete, :infinity}], %{state | handle: handle, active: true}}
  end

  @impl true
  def handle_info({:situ_event, ref, time, data}, _context, %{ref: ref} = state),
    do: emit_posted(time, data, state)

  def handle_info(_other, _context, state), do: {[], state}

  @impl true
  def handle_stop(_final, _context, state), do: state |> call_unsubscribe() |> drain_posted([])

  @impl true
  def terminate(_reason, state), do: call_unsubscribe(state)

  # All messages in the mailbox were posted before the stop.
  defp drain_posted(%{ref: ref} = state, actions) do
    receive do
      {:situ_event, ^ref, time, data} ->
        {[action], state} = emit_posted(time, data, state)
        drain_posted(state, [action | actions])
    after
      0 -> {Enum.reverse(actions), state}
    end
  end

  # A poster may be interrupted between reading the clock and sending; its message then follows the other poster's.
  defp emit_posted(time, data, %{last: last} = state) do
    time = if last != nil and time < last, do: last + 1, else: time
    {[{:out, time, data}], %{state | last: time}}
  end

  defp call_unsubscribe(%{active: false} = state), do: state

  defp call_unsubscribe(state) do
    if unsubscribe = state.opts[:unsubscribe], do: unsubscribe.(state.handle)
    %{state | active: false}
  end
end
