defmodule Situ.Fusion.SecondaryQueue do
  @moduledoc false
  # A secondary stream of a fusion: the waiting messages, the last time it has reached, and the time at which it ended.
  # Messages that no later primary can need are dropped with each result.
  alias Situ.{Interpolator, Message}
  alias Situ.Fusion.MessageQueue

  @typedoc "The two parts of a `MessageQueue`, the time of the last message, and the time of the end."
  @type t :: {[Message.t()], [[Message.t()]], Situ.Time.t() | nil, Situ.Time.t() | nil}
  @type answer ::
          {:created, term(), t()}
          | {:does_not_exist, t()}
          | {:given_up, t()}
          | {:wait, Situ.Time.t() | :infinity | nil, t()}

  @spec new() :: t()
  def new, do: {[], [], nil, nil}

  @doc "Adds messages, keeps at most `max` (`nil`: all), and returns the number of dropped messages."
  @spec push(t(), [Message.t(), ...], pos_integer() | nil) :: {t(), non_neg_integer()}
  def push({front, rear, _last, closed}, messages, max) do
    last = MessageQueue.last_message(messages)
    queue = MessageQueue.push({front, rear}, messages)
    dropped = MessageQueue.excess_count(queue, last.sequence_id, max)
    {front, rear} = if dropped == 0, do: queue, else: MessageQueue.drop_first(queue, dropped)
    {{front, rear, last.originating_time, closed}, dropped}
  end

  @doc "Marks the stream as ended at `time`."
  @spec close(t(), Situ.Time.t()) :: t()
  def close(secondary, time), do: put_elem(secondary, 3, time)

  @doc "Marks the stream as open again."
  @spec reopen(t()) :: t()
  def reopen(secondary), do: put_elem(secondary, 3, nil)

  @doc "Returns the time of the last message that arrived."
  @spec reached_time(t()) :: Situ.Time.t() | nil
  def reached_time({_front, _rear, last, _closed}), do: last

  @doc "Returns the queue of waiting messages."
  @spec message_queue(t()) :: MessageQueue.t()
  def message_queue({front, rear, _last, _closed}), do: {front, rear}

  @doc """
  Returns the value at `time`. Before `limit` (a time, or `nil`) it does not wait and uses the messages that have
  arrived.
  """
  # The end of `front` is the end of the queue only when `rear` is empty. An interpolator that does not wait, or any
  # interpolator on a closed stream, must see all messages.
  @spec resolve_value(Interpolator.t(), Situ.Time.t(), t(), Situ.Time.t() | nil) :: answer()
  def resolve_value(interpolator, time, {_front, rear, last, closed} = secondary, limit) do
    closed = closed || if limit != nil and time < limit, do: last || time

    if rear != [] and (closed != nil or not interpolator.reproducible),
      do: interpolate_at(interpolator, time, merge_batches(secondary), closed, limit),
      else: interpolate_at(interpolator, time, secondary, closed, limit)
  end

  defp interpolate_at(interpolator, time, {front, rear, _, _} = secondary, closed, limit) do
    %{module: module, config: config, default: default} = interpolator

    case module.interpolate(time, front, closed, config) do
      {:created, value, obsolete} ->
        {:created, value, drop_obsolete(secondary, obsolete)}

      {:does_not_exist, obsolete} when default != :none ->
        {:created, elem(default, 1), drop_obsolete(secondary, obsolete)}

      {:does_not_exist, obsolete} ->
        no_value_result(secondary, obsolete, closed)

      _undecided when rear != [] ->
        resolve_value(interpolator, time, merge_batches(secondary), limit)

      {:wait, until} ->
        {:wait, until, secondary}

      :insufficient_data ->
        {:wait, nil, secondary}
    end
  end

  # The stream is closed, or is only treated as closed for this primary because it waited too long.
  defp no_value_result({_, _, _, nil} = secondary, obsolete, closed) when closed != nil,
    do: {:given_up, drop_obsolete(secondary, obsolete)}

  defp no_value_result(secondary, obsolete, _closed),
    do: {:does_not_exist, drop_obsolete(secondary, obsolete)}

  defp merge_batches({front, rear, last, closed}) do
    {front, rear} = MessageQueue.merge_batches({front, rear})
    {front, rear, last, closed}
  end

  defp drop_obsolete(secondary, nil), do: secondary

  defp drop_obsolete({front, rear, last, closed}, obsolete),
    do: {drop_before(front, obsolete), rear, last, closed}

  defp drop_before([%{originating_time: time} | rest], obsolete) when time < obsolete,
    do: drop_before(rest, obsolete)

  defp drop_before(front, _obsolete), do: front
end
