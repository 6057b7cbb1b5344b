defmodule Situ.Cluster.NodeMetrics do
  @moduledoc false
  # Measures the nodes of a cluster: the load and the devices of each, and the round trips between
  # them.
  #
  # Each node measures itself once a second and sends the result to the others. Placement by load
  # and by distance uses the measurements, and the studio's cluster page shows them. A node that
  # has been silent for five seconds is dropped. The others try to reconnect to it for ten
  # minutes.
  #
  #     Situ.Cluster.NodeMetrics.recent_vitals()[node()].busy      # cores that this node's processes used recently
  use GenServer

  @beat_ms 1_000
  @stale_ms 5_000
  # How long to keep reconnecting to a lost node, since the network may have failed.
  @reconnect_ms 600_000
  # The weight of the last second in the moving average.
  @weight 0.4

  defstruct [:table, :devices, :last_sample, busy: 0.0, machine: 0.0, reconnects: %{}]

  @typedoc """
  `busy`: cores used by the node's own VM; `cores`: cores it may use; `machine`: load of the whole machine, 0 to 1;
  `memory`: bytes of the VM; `trips`: round trip to other nodes, ns (the minimum of the latest measurements).
  """
  @type vital :: %{
          busy: float(),
          cores: pos_integer(),
          machine: float(),
          memory: non_neg_integer(),
          devices: [String.t()],
          trips: %{node() => non_neg_integer()}
        }

  @spec start_link([String.t()]) :: GenServer.on_start()
  def start_link(devices), do: GenServer.start_link(__MODULE__, devices, name: __MODULE__)

  @doc "Returns the measurements of this and all other recently active nodes; empty if this node is not a member."
  @spec recent_vitals() :: %{node() => vital()}
  def recent_vitals do
    now = monotonic_ms()
    for {node, at, vital} <- table_entries(), now - at < @stale_ms, into: %{}, do: {node, vital}
  end

  defp table_entries do
    :ets.tab2list(__MODULE__)
  rescue
    ArgumentError -> []
  end

  @impl true
  def init(devices) do
    table = :ets.new(__MODULE__, [:named_table, :protected, read_concurrency: true])
    send(self(), :beat)
    {:ok, %__MODULE__{table: table, devices: devices, last_sample: sample_load()}}
  end

  @impl true
  def handle_info(:beat, state) do
    Process.send_after(self(), :beat, @beat_ms)
    state = update_load(state)
    vital = own_vital(state)
    :ets.insert(state.table, {node(), monotonic_ms(), vital})
    sent = System.monotonic_time()
    for node <- Node.list(), do: send({__MODULE__, node}, {:vital, node(), vital, sent})
    {:noreply, call_lost_nodes(state)}
  end

  def handle_info({:vital, node, vital, sent}, state) do
    :ets.insert(state.table, {node, monotonic_ms(), vital})
    send({__MODULE__, node}, {:heard, node(), sent})
    {:noreply, state}
  end

  def handle_info({:heard, node, sent}, state) do
    trip = System.convert_time_unit(System.monotonic_time() - sent, :native, :nanosecond)

    last =
      with [{_, trips}] <- :ets.lookup(state.table, {:trips, node}), do: trips, else: (_ -> [])

    :ets.insert(state.table, {{:trips, node}, Enum.take([trip | last], 8)})
    {:noreply, state}
  end

  def handle_info(_other, state), do: {:noreply, state}

  # Erlang connects nodes only when one sends a message, and no messages are sent to a lost node. Connecting can take
  # several seconds.
  defp call_lost_nodes(state) do
    reconnects = Map.filter(state.reconnects, fn {_, pid} -> Process.alive?(pid) end)

    lost =
      for {node, at, _} <- table_entries(),
          monotonic_ms() - at < @reconnect_ms,
          node != node(),
          node not in Node.list(),
          not is_map_key(reconnects, node),
          do: node

    started = Map.new(lost, fn node -> {node, spawn(Node, :connect, [node])} end)
    %{state | reconnects: Map.merge(reconnects, started)}
  end

  defp update_load(state) do
    {cpu, at, busy, total} = now = sample_load()
    {cpu0, at0, busy0, total0} = state.last_sample
    wall = max(at - at0, 1)
    machine = if total > total0, do: (busy - busy0) / (total - total0), else: state.machine

    %{
      state
      | last_sample: now,
        busy: smooth_load(state.busy, (cpu - cpu0) / wall),
        machine: smooth_load(state.machine, machine)
    }
  end

  defp smooth_load(before, now), do: before * (1 - @weight) + now * @weight

  defp own_vital(state) do
    %{
      busy: state.busy,
      cores: System.schedulers_online(),
      machine: state.machine,
      memory: :erlang.memory(:total),
      devices: state.devices,
      trips:
        for(
          {{:trips, node}, trips} <- :ets.tab2list(state.table),
          into: %{},
          do: {node, Enum.min(trips)}
        )
    }
  end

  # Returns the CPU time of this VM and the current time (ms), and the busy and total ticks of the machine.
  defp sample_load do
    {busy, total} = parse_machine_ticks(File.read("/proc/stat"))
    {cpu_ms(File.read("/proc/self/stat")), monotonic_ms(), busy, total}
  end

  @doc """
  Returns the CPU time of this VM in milliseconds, from the text of `/proc/self/stat`.

  This is user and system time. On systems without `/proc`, `:erlang.statistics(:runtime)` is used instead. With OTP 25
  it is user time only, without the time for writes, page faults and wake-ups.

      iex> Situ.Cluster.NodeMetrics.cpu_ms({:ok, "7 (a (b) c) S 1 2 3 4 5 6 7 8 9 10 150 50 0 0"})
      2000
  """
  @spec cpu_ms({:ok, String.t()} | {:error, File.posix()}) :: non_neg_integer()
  def cpu_ms({:ok, stat}) do
    # The name of the program may contain spaces and parentheses. Fields 14 (user) and 15 (system) are in ticks of
    # 10 ms.
    [user, system] =
      stat |> String.split(") ") |> List.last() |> String.split() |> Enum.slice(11, 2)

    (String.to_integer(user) + String.to_integer(system)) * 10
  end

  def cpu_ms({:error, _reason}), do: elem(:erlang.statistics(:runtime), 0)

  defp parse_machine_ticks({:ok, "cpu " <> text}) do
    ticks =
      text
      |> String.split("\n", parts: 2)
      |> hd()
      |> String.split()
      |> Enum.map(&String.to_integer/1)

    idle = Enum.at(ticks, 3, 0) + Enum.at(ticks, 4, 0)
    total = ticks |> Enum.take(8) |> Enum.sum()
    {total - idle, total}
  end

  defp parse_machine_ticks(_elsewhere), do: {0, 0}

  defp monotonic_ms, do: System.monotonic_time(:millisecond)
end
