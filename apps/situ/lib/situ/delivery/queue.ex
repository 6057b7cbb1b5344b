defmodule Situ.Delivery.Queue do
  @moduledoc false
  # The queue of one input, with its delivery policy. Entries are messages, and `{:closed, time}` as the last entry.
  # Pure; every operation takes constant time on average.
  #
  # A full queue drops its oldest entry when a message is pushed. With a guarantee it drops the oldest unprotected
  # entry, or the new message if only that one is unprotected. The `:closed` entry never causes a message to be
  # dropped.

  # See docs/adr/0140-lossy-queues-are-at-the-producer.md.
  alias Situ.{Delivery, Message}

  # Two queues of numbered entries: `droppable` entries may be dropped, `guaranteed` entries may not. Lower numbers
  # are older. Without a guarantee all entries are droppable.
  @enforce_keys [:policy]
  defstruct [:policy, droppable: {[], []}, guaranteed: {[], []}, size: 0, next: 0]

  @type closed :: {:closed, Situ.Time.t()}
  @type entry :: Message.t() | closed()
  @typep numbered_entry :: {non_neg_integer(), entry()}
  @typep fifo :: {[numbered_entry()], [numbered_entry()]}
  @type t :: %__MODULE__{
          policy: Delivery.t(),
          droppable: fifo(),
          guaranteed: fifo(),
          size: non_neg_integer(),
          next: non_neg_integer()
        }

  @doc "Creates an empty queue with `policy`."
  @spec new(Delivery.t()) :: t()
  def new(%Delivery{} = policy), do: %__MODULE__{policy: policy}

  @doc "Replaces the guarantee, the function that decides which data is never dropped."
  @spec put_guarantee(t(), (term() -> boolean())) :: t()
  def put_guarantee(%__MODULE__{policy: policy} = queue, keep?),
    do: %{queue | policy: %{policy | guarantee: keep?}}

  @doc """
  Appends an entry; returns the queue and the messages that were dropped, oldest first.

      iex> alias Situ.Delivery.Queue
      iex> m = fn v, t -> %Situ.Message{data: v, originating_time: t} end
      iex> queue = Queue.new(Situ.Delivery.latest())
      iex> {queue, []} = Queue.push(queue, m.(1, 10))
      iex> {queue, [dropped]} = Queue.push(queue, m.(2, 20))
      iex> {%{data: 2}, _queue, []} = Queue.pop(queue, 30)
      iex> dropped.data
      1
  """
  @spec push(t(), entry()) :: {t(), [Message.t()]}
  def push(%__MODULE__{} = queue, {:closed, time} = closed) do
    {queue, late} = drop_after(queue, time)
    {append_entry(queue, closed, :guaranteed), late}
  end

  def push(%__MODULE__{policy: %{guarantee: nil} = policy} = queue, message) do
    queue = append_entry(queue, message, :droppable)
    if queue.size > policy.max_queue, do: drop_oldest(queue), else: {queue, []}
  end

  def push(%__MODULE__{policy: policy, size: size} = queue, message) do
    class = if policy.guarantee.(message.data) == true, do: :guaranteed, else: :droppable

    cond do
      size < policy.max_queue -> {append_entry(queue, message, class), []}
      size > policy.max_queue and class == :droppable -> {queue, [message]}
      size > policy.max_queue -> {append_entry(queue, message, class), []}
      queue.droppable != {[], []} -> queue |> append_entry(message, class) |> drop_oldest()
      class == :guaranteed -> {append_entry(queue, message, class), []}
      true -> {queue, [message]}
    end
  end

  @doc "Appends messages; returns the queue and the number of dropped messages."
  @spec push_all(t(), [Message.t()]) :: {t(), non_neg_integer()}
  def push_all(%__MODULE__{} = queue, messages), do: push_all(queue, messages, 0)

  defp push_all(queue, [], dropped), do: {queue, dropped}

  defp push_all(queue, [message | rest], dropped) do
    {queue, lost} = push(queue, message)
    push_all(queue, rest, dropped + length(lost))
  end

  @doc "Takes the first entry that has not expired at clock time `now`; also returns the expired messages."
  @spec pop(t(), Situ.Time.t()) :: {entry() | nil, t(), [Message.t()]}
  def pop(%__MODULE__{} = queue, now), do: pop_unexpired(queue, now, [])

  @doc "Takes up to `n` entries regardless of their age; returns `{entries, count, queue}`."
  @spec take(t(), non_neg_integer() | :infinity) :: {[entry()], non_neg_integer(), t()}
  def take(%__MODULE__{} = queue, n), do: take_entries(queue, n, [], 0)

  defp take_entries(queue, n, taken, count) when count < n do
    case shift_oldest(queue) do
      {nil, _class, queue} -> {:lists.reverse(taken), count, queue}
      {entry, _class, queue} -> take_entries(queue, n, [entry | taken], count + 1)
    end
  end

  defp take_entries(queue, _n, taken, count), do: {:lists.reverse(taken), count, queue}

  @doc "Drops messages from the front that have expired at clock time `now`."
  @spec drop_expired(t(), Situ.Time.t()) :: {t(), [Message.t()]}
  def drop_expired(%__MODULE__{policy: %{max_latency: :infinity}} = queue, _now), do: {queue, []}
  def drop_expired(%__MODULE__{} = queue, now), do: drop_expired(queue, now, [])

  defp drop_expired(queue, now, dropped) do
    case shift_oldest(queue) do
      {nil, _class, queue} ->
        {queue, Enum.reverse(dropped)}

      {entry, class, rest} ->
        if class == :droppable and too_old?(entry, now, queue.policy),
          do: drop_expired(rest, now, [entry | dropped]),
          else: {queue, Enum.reverse(dropped)}
    end
  end

  @doc "Drops messages from the front that are later than `time`, at which the stream closes."
  @spec drop_after(t(), Situ.Time.t()) :: {t(), [Message.t()]}
  def drop_after(%__MODULE__{} = queue, time), do: drop_after(queue, time, [])

  defp drop_after(queue, time, late) do
    case shift_oldest(queue) do
      {%Message{originating_time: t} = entry, _class, rest} when t > time ->
        drop_after(rest, time, [entry | late])

      _ ->
        {queue, Enum.reverse(late)}
    end
  end

  @doc "Returns the first entry regardless of its age."
  @spec peek(t()) :: entry() | nil
  def peek(%__MODULE__{size: 0}), do: nil
  def peek(%__MODULE__{} = queue), do: queue |> shift_oldest() |> elem(0)

  @doc "Returns all waiting entries, oldest first."
  @spec to_list(t()) :: [entry()]
  def to_list(%__MODULE__{size: 0}), do: []
  def to_list(%__MODULE__{} = queue), do: queue |> take(:infinity) |> elem(0)

  defp pop_unexpired(queue, now, dropped) do
    case shift_oldest(queue) do
      {nil, _class, queue} ->
        {nil, queue, Enum.reverse(dropped)}

      {entry, class, rest} ->
        if class == :droppable and too_old?(entry, now, queue.policy),
          do: pop_unexpired(rest, now, [entry | dropped]),
          else: {entry, rest, Enum.reverse(dropped)}
    end
  end

  defp drop_oldest(%{droppable: {[{_, oldest} | front], rear}, size: size} = queue),
    do: {%{queue | droppable: balance_fifo(front, rear), size: size - 1}, [oldest]}

  defp append_entry(%{next: next, size: size} = queue, entry, :droppable),
    do: %{
      queue
      | droppable: push_rear(queue.droppable, {next, entry}),
        size: size + 1,
        next: next + 1
    }

  defp append_entry(%{next: next, size: size} = queue, entry, :guaranteed),
    do: %{
      queue
      | guaranteed: push_rear(queue.guaranteed, {next, entry}),
        size: size + 1,
        next: next + 1
    }

  # The front is empty only if the whole queue is empty.
  defp push_rear({[], []}, entry), do: {[entry], []}
  defp push_rear({front, rear}, entry), do: {front, [entry | rear]}

  defp balance_fifo([], rear), do: {:lists.reverse(rear), []}
  defp balance_fifo(front, rear), do: {front, rear}

  # Removes the oldest entry and returns it with its class.
  defp shift_oldest(%{droppable: {[], _}, guaranteed: {[], _}} = queue),
    do: {nil, :droppable, queue}

  defp shift_oldest(
         %{droppable: {[{i, entry} | front], rear}, guaranteed: {[{j, _} | _], _}} = queue
       )
       when i < j,
       do:
         {entry, :droppable,
          %{queue | droppable: balance_fifo(front, rear), size: queue.size - 1}}

  defp shift_oldest(%{droppable: {[{_, entry} | front], rear}, guaranteed: {[], _}} = queue),
    do: {entry, :droppable, %{queue | droppable: balance_fifo(front, rear), size: queue.size - 1}}

  defp shift_oldest(%{guaranteed: {[{_, entry} | front], rear}} = queue),
    do:
      {entry, :guaranteed, %{queue | guaranteed: balance_fifo(front, rear), size: queue.size - 1}}

  defp too_old?({:closed, _}, _now, _policy), do: false
  defp too_old?(_message, _now, %{max_latency: :infinity}), do: false
  defp too_old?(message, now, policy), do: now - message.originating_time > policy.max_latency
end
