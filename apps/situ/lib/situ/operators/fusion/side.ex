defmodule Situ.Fusion.Side do
  @moduledoc false
  # One secondary stream as a fusion sees it: the messages that wait (in order, and batches that came later, newest first), the last
  # time it has reached, and the time at which it ended. Messages that no later primary can need are dropped with each answer.
  alias Situ.{Interpolator, Message}

  @type t :: {[Message.t()], [[Message.t()]], Situ.Time.t() | nil, Situ.Time.t() | nil}
  @type answer ::
          {:created, term(), t()}
          | {:does_not_exist, t()}
          | {:given_up, t()}
          | {:wait, Situ.Time.t() | :infinity | nil, t()}

  @spec new() :: t()
  def new, do: {[], [], nil, nil}

  @doc "Messages arrived."
  @spec push(t(), [Message.t(), ...]) :: t()
  def push({front, rear, _last, closed}, messages),
    do: {front, [messages | rear], last_time(messages), closed}

  @doc "The stream ended at `time`."
  @spec close(t(), Situ.Time.t()) :: t()
  def close(side, time), do: put_elem(side, 3, time)

  @doc "The time of the last message that arrived."
  @spec reached(t()) :: Situ.Time.t() | nil
  def reached({_front, _rear, last, _closed}), do: last

  @doc """
  The value at `time`. Before `limit` (a time, or `nil`) nothing is waited for: it is decided by what is there.
  """
  # The end of the queue is the end of what arrived only when nothing is left in `rear`: an interpolator that does not
  # wait, and any one asked about a closed stream, must see all.
  @spec ask(Interpolator.t(), Situ.Time.t(), t(), Situ.Time.t() | nil) :: answer()
  def ask(interpolator, time, {_front, rear, last, closed} = side, limit) do
    closed = closed || if limit != nil and time < limit, do: last || time

    if rear != [] and (closed != nil or not interpolator.reproducible),
      do: answer(interpolator, time, merged(side), closed, limit),
      else: answer(interpolator, time, side, closed, limit)
  end

  @doc "The sequence id of the first message that waits."
  @spec head(t()) :: non_neg_integer() | nil
  def head({front, rear, _, _}), do: first(front, rear)

  @doc "The sequence id of the first message of a queue and what came later."
  @spec first([Message.t()], [[Message.t()]]) :: non_neg_integer() | nil
  def first([%{sequence_id: id} | _], _rear), do: id
  def first([], []), do: nil
  def first([], rear), do: rear |> List.last() |> hd() |> Map.fetch!(:sequence_id)

  @doc "How many messages wait."
  @spec count(t()) :: non_neg_integer()
  def count({front, rear, _, _}), do: count(front, rear)

  @spec count([Message.t()], [[Message.t()]]) :: non_neg_integer()
  def count(front, rear), do: length(front) + Enum.reduce(rear, 0, &(length(&1) + &2))

  @doc "A queue with what came later behind it."
  @spec merge([Message.t()], [[Message.t()]]) :: [Message.t()]
  def merge([], [messages]), do: messages
  def merge(front, rear), do: front ++ :lists.append(:lists.reverse(rear))

  @doc "The time of the last of some messages."
  @spec last_time([Message.t(), ...]) :: Situ.Time.t()
  def last_time([message]), do: message.originating_time
  def last_time([_ | rest]), do: last_time(rest)

  defp answer(interpolator, time, {front, rear, _, _} = side, closed, limit) do
    %{module: module, config: config, default: default} = interpolator

    case module.interpolate(time, front, closed, config) do
      {:created, value, obsolete} ->
        {:created, value, trim(side, obsolete)}

      {:does_not_exist, obsolete} when default != :none ->
        {:created, elem(default, 1), trim(side, obsolete)}

      {:does_not_exist, obsolete} ->
        gone(side, obsolete, closed)

      _undecided when rear != [] ->
        ask(interpolator, time, merged(side), limit)

      {:wait, until} ->
        {:wait, until, side}

      :insufficient_data ->
        {:wait, nil, side}
    end
  end

  # Closed in earnest, or only for this primary because it waited too long.
  defp gone({_, _, _, nil} = side, obsolete, closed) when closed != nil,
    do: {:given_up, trim(side, obsolete)}

  defp gone(side, obsolete, _closed), do: {:does_not_exist, trim(side, obsolete)}

  defp merged({front, rear, last, closed}), do: {merge(front, rear), [], last, closed}

  defp trim(side, nil), do: side

  defp trim({front, rear, last, closed}, obsolete),
    do: {drop(front, obsolete), rear, last, closed}

  defp drop([%{originating_time: time} | rest], obsolete) when time < obsolete,
    do: drop(rest, obsolete)

  defp drop(front, _obsolete), do: front
end
