defmodule Situ.Delivery.Queue do
  @moduledoc """
  The queue in front of one input, under its policy; pure.

  Entries are messages and, last, `{:closed, time}`.

      iex> alias Situ.Delivery.Queue
      iex> m = fn v, t -> %Situ.Message{data: v, originating_time: t} end
      iex> queue = Queue.new(Situ.Delivery.latest())
      iex> {queue, []} = Queue.push(queue, m.(1, 10))
      iex> {queue, [dropped]} = Queue.push(queue, m.(2, 20))
      iex> {%{data: 2}, _queue, []} = Queue.pop(queue, 30)
      iex> dropped.data
      1

  A full queue drops its oldest entry for a newcomer; with a guarantee the oldest that is not protected, and the newcomer
  itself when all waiting ones are protected and it is not; the closing mark never costs a message its place.
  """
  alias Situ.{Delivery, Message}

  @enforce_keys [:policy]
  defstruct [:policy, front: [], rear: [], size: 0]

  @type closed :: {:closed, Situ.Time.t()}
  @type entry :: Message.t() | closed()
  @type t :: %__MODULE__{
          policy: Delivery.t(),
          front: [entry()],
          rear: [entry()],
          size: non_neg_integer()
        }

  @doc "An empty queue under `policy`."
  @spec new(Delivery.t()) :: t()
  def new(%Delivery{} = policy), do: %__MODULE__{policy: policy}

  @doc "Appends an entry; returns the queue and what it dropped for it, oldest first."
  @spec push(t(), entry()) :: {t(), [Message.t()]}
  def push(%__MODULE__{} = queue, {:closed, time} = closed) do
    {late, rest} = queue |> to_list() |> Enum.split_while(&later?(&1, time))
    rest = rest ++ [closed]
    {%{queue | front: rest, rear: [], size: length(rest)}, late}
  end

  def push(%__MODULE__{policy: policy, size: size} = queue, message) do
    if size < policy.max_queue, do: {append(queue, message), []}, else: make_room(queue, message)
  end

  @doc "Takes the first entry that is not too old at clock time `now`; also returns what was too old."
  @spec pop(t(), Situ.Time.t()) :: {entry() | nil, t(), [Message.t()]}
  def pop(%__MODULE__{} = queue, now), do: pop(queue, now, [])

  @doc "The first entry, without looking at its age."
  @spec peek(t()) :: entry() | nil
  def peek(%__MODULE__{size: 0}), do: nil
  def peek(%__MODULE__{front: [entry | _]}), do: entry
  def peek(%__MODULE__{rear: rear}), do: List.last(rear)

  @doc "Everything waiting, oldest first."
  @spec to_list(t()) :: [entry()]
  def to_list(%__MODULE__{front: front, rear: []}), do: front
  def to_list(%__MODULE__{front: front, rear: rear}), do: front ++ Enum.reverse(rear)

  defp pop(%{size: 0} = queue, _now, dropped), do: {nil, queue, Enum.reverse(dropped)}

  defp pop(%{front: []} = queue, now, dropped),
    do: pop(%{queue | front: Enum.reverse(queue.rear), rear: []}, now, dropped)

  defp pop(%{front: [entry | front], policy: policy} = queue, now, dropped) do
    queue = %{queue | front: front, size: queue.size - 1}

    if too_old?(entry, now, policy) and not protected?(entry, policy),
      do: pop(queue, now, [entry | dropped]),
      else: {entry, queue, Enum.reverse(dropped)}
  end

  defp append(queue, entry), do: %{queue | rear: [entry | queue.rear], size: queue.size + 1}

  defp make_room(%{policy: %{guarantee: nil}} = queue, message) do
    case to_list(queue) do
      [{:closed, _} | _] -> {queue, [message]}
      [oldest | rest] -> {append(put(queue, rest), message), [oldest]}
    end
  end

  defp make_room(%{policy: policy, size: size} = queue, message) do
    keep? = protected?(message, policy)
    waiting = to_list(queue)

    victim =
      if size == policy.max_queue, do: Enum.find_index(waiting, &(not protected?(&1, policy)))

    cond do
      victim ->
        {oldest, rest} = List.pop_at(waiting, victim)
        {append(put(queue, rest), message), [oldest]}

      keep? ->
        {append(queue, message), []}

      true ->
        {queue, [message]}
    end
  end

  defp put(queue, entries), do: %{queue | front: entries, rear: [], size: length(entries)}

  defp too_old?({:closed, _}, _now, _policy), do: false
  defp too_old?(_message, _now, %{max_latency: :infinity}), do: false
  defp too_old?(message, now, policy), do: now - message.originating_time > policy.max_latency

  defp protected?({:closed, _}, _policy), do: true
  defp protected?(_message, %{guarantee: nil}), do: false
  defp protected?(message, %{guarantee: keep?}), do: keep?.(message.data) == true

  defp later?({:closed, _}, _time), do: false
  defp later?(message, time), do: message.originating_time > time
end
