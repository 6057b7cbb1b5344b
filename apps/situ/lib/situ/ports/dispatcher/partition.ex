defmodule Situ.Ports.Dispatcher.Partition do
  @moduledoc false
  # Sends every message to the consumer of its partition. All demand counts together, so the messages of a partition
  # that receives more than its share wait for their consumer here, as do messages of a partition without a consumer.
  @behaviour Situ.Ports.Dispatcher

  alias Situ.{Error, Options}

  # `slots` maps each partition to its consumer, the consumer's demand, and the waiting messages with their number.
  defstruct [:hash, :slots]

  @options [
    partitions: [type: :any, required: true],
    hash: [type: {:fun, 1}]
  ]

  @impl true
  def new(opts) do
    with {:ok, opts} <- Options.validate(opts, @options),
         {:ok, names} <- list_partitions(opts[:partitions], opts[:hash]) do
      size = length(names)
      hash = opts[:hash] || (&{&1, :erlang.phash2(&1.data, size)})
      {:ok, %__MODULE__{hash: hash, slots: Map.new(names, &{&1, {nil, 0, :queue.new(), 0}})}}
    end
  end

  defp list_partitions(n, _hash) when is_integer(n) and n > 0, do: {:ok, Enum.to_list(0..(n - 1))}

  defp list_partitions(names, hash) when is_list(names) or is_struct(names, Range) do
    names = Enum.to_list(names)

    cond do
      names == [] or Enum.uniq(names) != names -> {:error, partitions_error(names)}
      hash == nil and Enum.sort(names) != Enum.to_list(0..(length(names) - 1)) -> no_hash(names)
      true -> {:ok, names}
    end
  end

  defp list_partitions(other, _hash), do: {:error, partitions_error(other)}

  defp partitions_error(partitions) do
    Error.new(:bad_dispatcher, "partitions: is #{inspect(partitions, limit: 8)}",
      fix: "use a number of partitions, or a list of different names"
    )
  end

  defp no_hash(names) do
    {:error,
     Error.new(
       :bad_dispatcher,
       "the partitions #{inspect(names, limit: 8)} need the option hash:",
       why: "without it, the partitions are numbered from 0",
       fix: "add hash: fn message -> {message, partition} end"
     )}
  end

  @impl true
  def subscribe(%{slots: slots} = state, key, opts) do
    partition = opts[:partition]

    case slots do
      %{^partition => {nil, 0, queue, n}} -> {:ok, put_slot(state, partition, {key, 0, queue, n})}
      %{^partition => {{pid, _}, _, _, _}} -> {:error, taken_error(partition, pid)}
      _ -> {:error, unknown_error(partition, slots)}
    end
  end

  defp put_slot(%{slots: slots} = state, partition, slot),
    do: %{state | slots: Map.put(slots, partition, slot)}

  defp taken_error(partition, pid) do
    what = "the partition #{inspect(partition)} is already taken by #{inspect(pid)}"
    Error.new(:bad_subscription, what, fix: "subscribe one consumer to each partition")
  end

  defp unknown_error(partition, slots) do
    what =
      if partition == nil,
        do: "the option partition: is missing",
        else: "#{inspect(partition)} is not a partition"

    names = slots |> Map.keys() |> Enum.map_join(", ", &inspect/1)
    Error.new(:bad_subscription, what, fix: "subscribe with partition: one of #{names}")
  end

  @impl true
  def cancel(%{slots: slots} = state, key) do
    {partition, {_key, _demand, queue, n}} = find_slot(slots, key)
    put_slot(state, partition, {nil, 0, queue, n})
  end

  defp find_slot(slots, key), do: Enum.find(slots, &match?({_, {^key, _, _, _}}, &1))

  @impl true
  def add_demand(%{slots: slots} = state, key, n) do
    {partition, {_key, demand, queue, count}} = find_slot(slots, key)
    put_slot(state, partition, {key, demand + n, queue, count})
  end

  @impl true
  def push(state, messages) do
    {failures, state} = Enum.reduce(messages, {[], state}, &push_message/2)
    {Enum.reverse(failures), state}
  end

  defp push_message(message, {failures, %{hash: hash, slots: slots} = state}) do
    case hash.(message) do
      :none -> {failures, state}
      {event, name} when is_map_key(slots, name) -> {failures, enqueue(state, name, event)}
      other -> {[{:dispatcher, bad_hash_error(other, slots)} | failures], state}
    end
  rescue
    error ->
      what = "the function hash: of a dispatcher raised: #{Exception.message(error)}"
      {[{:dispatcher, Error.new(:bad_partition, what)} | failures], state}
  end

  defp enqueue(%{slots: slots} = state, name, event) do
    {key, demand, queue, n} = Map.fetch!(slots, name)
    put_slot(state, name, {key, demand, :queue.in(event, queue), n + 1})
  end

  defp bad_hash_error(returned, slots) do
    names = slots |> Map.keys() |> Enum.map_join(", ", &inspect/1)

    Error.new(
      :bad_partition,
      "the function hash: of a dispatcher returned #{inspect(returned, limit: 8, printable_limit: 80)}",
      why: "the message belongs to no partition, so it is dropped",
      fix: "return {message, partition} with one of #{names}, or :none"
    )
  end

  @impl true
  def take(%{slots: slots} = state) do
    {slots, parts} = Enum.map_reduce(slots, [], &take_slot/2)
    {Enum.reverse(parts), [], %{state | slots: Map.new(slots)}}
  end

  defp take_slot({name, {key, demand, queue, n}}, parts) when demand > 0 and n > 0 do
    taken = min(demand, n)
    {now, later} = :queue.split(taken, queue)
    slot = {name, {key, demand - taken, later, n - taken}}
    {slot, [{key, :queue.to_list(now)} | parts]}
  end

  defp take_slot(slot, parts), do: {slot, parts}

  @impl true
  def available_room(%{slots: slots}),
    do: Enum.reduce(slots, 0, fn {_, {_, demand, _, n}}, room -> room + demand - n end)

  @impl true
  def waiting_count(%{slots: slots}),
    do: Enum.reduce(slots, 0, fn {_, {_, _, _, n}}, count -> count + n end)

  @impl true
  def waiting_count(%{slots: slots}, key) do
    {_name, {_key, _demand, _queue, n}} = find_slot(slots, key)
    n
  end

  @impl true
  def drop_unclaimed(%{slots: slots} = state) do
    drop = fn
      {name, {nil, 0, _queue, _n}} -> {name, {nil, 0, :queue.new(), 0}}
      slot -> slot
    end

    %{state | slots: Map.new(slots, drop)}
  end
end
