defmodule Situ.Selection.Delay do
  @moduledoc false
  # Holds messages until their time has come on the clock, even if the stream has ended by then. When the pipeline is
  # stopped, all held messages are emitted. The clock only affects when a message is emitted, never whether it is.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [duration: [type: :non_neg_integer, required: true]]

  @impl true
  def init(opts), do: {:ok, {opts[:duration], :queue.new()}}

  # If the clock is not enforced, messages pass immediately.
  @impl true
  def handle_message(_input, message, %{enforced?: false}, state),
    do: {[output_action(message)], state}

  def handle_message(_input, message, context, {duration, queue}) do
    due = message.creation_time + duration

    cond do
      not :queue.is_empty(queue) -> {[], {duration, :queue.in({due, message}, queue)}}
      due <= context.now -> {[output_action(message)], {duration, queue}}
      true -> {[{:timer, :due, due}], {duration, :queue.in({due, message}, queue)}}
    end
  end

  @impl true
  def handle_info({:timer, :due}, context, {duration, queue}) do
    {outputs, queue} = release_due(queue, context.now, [])
    {outputs, {duration, queue}}
  end

  def handle_info({:linger, :end}, _context, {duration, queue}),
    do: {output_all(queue) ++ [{:linger, false}], {duration, :queue.new()}}

  def handle_info(_other, _context, state), do: {[], state}

  @impl true
  def handle_closed(_input, _time, _context, {_duration, queue} = state),
    do: {if(:queue.is_empty(queue), do: [], else: [{:linger, true}]), state}

  defp output_all(queue),
    do: for({_due, message} <- :queue.to_list(queue), do: output_action(message))

  defp release_due(queue, now, outputs) do
    case :queue.peek(queue) do
      {:value, {due, message}} when due <= now ->
        release_due(:queue.drop(queue), now, [output_action(message) | outputs])

      {:value, {due, _message}} ->
        {Enum.reverse([{:timer, :due, due} | outputs]), queue}

      :empty ->
        {Enum.reverse([{:linger, false} | outputs]), queue}
    end
  end

  defp output_action(message), do: {:out, message.originating_time, message.data}
end
