defmodule Situ.Selection.Delay do
  @moduledoc false
  # Holds messages until their time has come on the clock.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [duration: [type: :non_neg_integer, required: true]]

  @impl true
  def init(opts), do: {:ok, {opts[:duration], :queue.new(), nil}}

  # Where nothing waits for the clock, nor does this.
  @impl true
  def handle_message(_input, message, %{enforced?: false}, state),
    do: {[{:out, message.originating_time, message.data}], state}

  def handle_message(_input, message, context, {duration, held, closing}) do
    due = message.creation_time + duration

    if due <= context.now and :queue.is_empty(held) do
      {[{:out, message.originating_time, message.data}], {duration, held, closing}}
    else
      timer = if :queue.is_empty(held), do: [{:timer, :due, due}], else: []
      {timer, {duration, :queue.in({due, message}, held), closing}}
    end
  end

  @impl true
  def handle_info({:timer, :due}, context, state), do: release(state, context.now, [])
  def handle_info(_other, _context, state), do: {[], state}

  # Later than the end is too late.
  @impl true
  def handle_closed(_input, time, context, state) do
    {outputs, _rest} = release(state, max(time, context.now), [])
    {Enum.filter(outputs, &match?({:out, _, _}, &1)), {elem(state, 0), :queue.new(), nil}}
  end

  defp release({duration, held, closing}, now, outputs) do
    case :queue.peek(held) do
      {:value, {due, message}} when due <= now ->
        output = {:out, message.originating_time, message.data}
        release({duration, :queue.drop(held), closing}, now, [output | outputs])

      {:value, {due, _message}} ->
        {Enum.reverse([{:timer, :due, due} | outputs]), {duration, held, closing}}

      :empty ->
        {Enum.reverse(outputs), {duration, held, closing}}
    end
  end
end
