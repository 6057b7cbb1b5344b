defmodule Situ.Ports.Dispatcher.Demand do
  @moduledoc false
  # Sends every message to one consumer: the consumer with the largest demand, and among equals the one that has waited
  # longest.
  @behaviour Situ.Ports.Dispatcher

  # `consumers` is sorted by demand.
  defstruct consumers: [], waiting: [], count: 0

  @impl true
  def new([]), do: {:ok, %__MODULE__{}}

  @impl true
  def subscribe(%{consumers: consumers} = state, key, _opts),
    do: {:ok, %{state | consumers: consumers ++ [{key, 0}]}}

  @impl true
  def cancel(%{consumers: consumers} = state, key),
    do: %{state | consumers: List.keydelete(consumers, key, 0)}

  @impl true
  def add_demand(%{consumers: consumers} = state, key, n) do
    {{^key, demand}, others} = List.keytake(consumers, key, 0)
    %{state | consumers: insert(others, key, demand + n)}
  end

  defp insert([{_, most} = first | rest], key, demand) when demand <= most,
    do: [first | insert(rest, key, demand)]

  defp insert(rest, key, demand), do: [{key, demand} | rest]

  @impl true
  def push(%{waiting: waiting, count: count} = state, messages),
    do: {[], %{state | waiting: waiting ++ messages, count: count + length(messages)}}

  @impl true
  def take(state), do: take(state, [])

  defp take(%{count: count, consumers: [{key, demand} | rest]} = state, parts)
       when count > 0 and demand > 0 do
    n = min(count, demand)
    {messages, waiting} = Enum.split(state.waiting, n)
    consumers = insert(rest, key, demand - n)
    state = %{state | consumers: consumers, waiting: waiting, count: count - n}
    take(state, [{key, messages} | parts])
  end

  defp take(state, parts), do: {Enum.reverse(parts), [], state}

  @impl true
  def available_room(%{consumers: consumers, count: count}),
    do: Enum.reduce(consumers, -count, fn {_key, demand}, room -> room + demand end)

  @impl true
  def waiting_count(%{count: count}), do: count
  @impl true
  def waiting_count(%{count: count}, _key), do: count

  @impl true
  def drop_unclaimed(%{consumers: []} = state), do: %{state | waiting: [], count: 0}
  def drop_unclaimed(state), do: state
end
