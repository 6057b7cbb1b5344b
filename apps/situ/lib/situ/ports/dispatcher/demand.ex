defmodule Situ.Ports.Dispatcher.Demand do
  @moduledoc false
  # Sends every message to one consumer: the consumer with the largest demand, and among equals the one that has waited
  # longest.
  @behaviour Situ.Ports.Dispatcher
  alias Situ.Ports.Dispatcher.SharedQueue

  # `consumers` is sorted by demand.
  defstruct consumers: [], waiting: [], count: 0

  @impl true
  def new([]), do: {:ok, %__MODULE__{}}

  @impl true
  def subscribe(%{consumers: consumers} = state, key, _opts),
    do: {:ok, %{state | consumers: consumers ++ [{key, 0}]}}

  @impl true
  def add_demand(%{consumers: consumers} = state, key, n) do
    {{^key, demand}, others} = List.keytake(consumers, key, 0)
    %{state | consumers: insert_consumer(others, key, demand + n)}
  end

  defp insert_consumer([{_, most} = first | rest], key, demand) when demand <= most,
    do: [first | insert_consumer(rest, key, demand)]

  defp insert_consumer(rest, key, demand), do: [{key, demand} | rest]

  @impl true
  def take(state), do: take(state, [])

  defp take(%{count: count, consumers: [{key, demand} | rest]} = state, parts)
       when count > 0 and demand > 0 do
    n = min(count, demand)
    {messages, state} = SharedQueue.split(state, n)
    state = %{state | consumers: insert_consumer(rest, key, demand - n)}
    take(state, [{key, messages} | parts])
  end

  defp take(state, parts), do: {Enum.reverse(parts), [], state}

  @impl true
  def available_room(%{consumers: consumers, count: count}),
    do: Enum.reduce(consumers, -count, fn {_key, demand}, room -> room + demand end)

  @impl true
  defdelegate cancel(state, key), to: SharedQueue
  @impl true
  defdelegate push(state, messages), to: SharedQueue
  @impl true
  defdelegate waiting_count(state), to: SharedQueue
  @impl true
  defdelegate waiting_count(state, key), to: SharedQueue
  @impl true
  defdelegate drop_unclaimed(state), to: SharedQueue
end
