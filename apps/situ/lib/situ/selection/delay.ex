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

  def handle_message(_input, message, context, {duration, held}) do
    due = message.creation_time + duration

    cond do
      not :queue.is_empty(held) -> {[], {duration, :queue.in({due, message}, held)}}
      due <= context.now -> {[output_action(message)], {duration, held}}
      true -> {[{:timer, :due, due}], {duration, :queue.in({due, message}, held)}}
    end
  end

  @impl true
  def handle_info({:timer, :due}, context, {duration, held}) do
    {outputs, held} = release_due(held, context.now, [])
    {outputs, {duration, held}}
  end

  def handle_info({:linger, :end}, _context, {duration, held}),
    do: {output_all(held) ++ [{:linger, false}], {duration, :queue.new()}}

  def handle_info(_other, _context, state), do: {[], state}

  @impl true
  def handle_closed(_input, _time, _context, {_duration, held} = state),
    do: {if(:queue.is_empty(held), do: [], else: [{:linger, true}]), state}

  defp output_all(held),
    do: for({_due, message} <- :queue.to_list(held), do: output_action(message))

  defp release_due(held, now, outputs) do
    case :queue.peek(held) do
      {:value, {due, message}} when due <= now ->
        release_due(:queue.drop(held), now, [output_action(message) | outputs])

      {:value, {due, _message}} ->
        {Enum.reverse([{:timer, :due, due} | outputs]), held}

      :empty ->
        {Enum.reverse([{:linger, false} | outputs]), held}
    end
  end

  defp output_action(message), do: {:out, message.originating_time, message.data}
end
