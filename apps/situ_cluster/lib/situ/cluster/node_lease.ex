defmodule Situ.Cluster.NodeLease do
  @moduledoc false
  # Renews one lease for all parts that this node runs. The lease of a part names the lease of its owner's node, and is
  # valid while that one is renewed, so the number of renewals does not depend on the number of parts. Each start of a
  # node has a different session. After a restart, a node therefore does not renew the leases of its previous parts.
  # See docs/adr/0203-one-lease-per-node-renews-all-its-parts.md.
  use GenServer

  alias Situ.Cluster.{Log, Member, SealedLog, SignedEntry}
  alias Situ.Cluster.Log.Entry

  @table __MODULE__
  @retry_ms 20
  @default_timer %{ref: nil, due: nil}

  defstruct [:log, :key, :session, :report, seq: 0, holders: %{}, timer: @default_timer]

  @typedoc "The `key` of a node's lease in the log, and the `session` of the node that renews it."
  @type t :: %{key: String.t(), session: String.t()}

  @doc "Starts the process. `report` receives each number under which the lease was written."
  @spec start_link({Log.t(), (t(), pos_integer() -> term())}) :: GenServer.on_start()
  def start_link(args), do: GenServer.start_link(__MODULE__, args, name: __MODULE__)

  @doc "Reports a renewal to the other members."
  @spec report_renewal(t(), pos_integer()) :: :ok
  def report_renewal(reference, seq), do: Member.report_node_lease(reference, seq)

  @doc "Renews the lease at least every quarter of `ms` until the calling process ends."
  @spec hold(pos_integer()) :: :ok
  def hold(ms), do: GenServer.cast(__MODULE__, {:hold, self(), ms})

  @doc "Returns this node's lease, or `nil` if the process is not running."
  @spec own_lease() :: t() | nil
  def own_lease, do: own_value(:own)

  @doc "Returns when (monotonic ms) the last successful renewal began, or `nil` if there was none."
  @spec last_renewal() :: integer() | nil
  def last_renewal, do: own_value(:renewed_at)

  defp own_value(key) do
    case :ets.whereis(@table) do
      :undefined -> nil
      table -> with [{_, value}] <- :ets.lookup(table, key), do: value, else: ([] -> nil)
    end
  end

  @impl true
  def init({log, report}) do
    # All parts of a busy node depend on this process.
    Process.flag(:priority, :high)
    session = Base.encode16(:crypto.strong_rand_bytes(6), case: :lower)
    key = "node_lease.#{SignedEntry.cluster_name()}.#{node()}"
    :ets.new(@table, [:named_table, :protected, read_concurrency: true])
    :ets.insert(@table, {:own, %{key: key, session: session}})

    {:ok, %__MODULE__{log: SealedLog.new(log, ""), key: key, session: session, report: report}}
  end

  @impl true
  def handle_cast({:hold, pid, ms}, state) do
    state = %{state | holders: Map.put(state.holders, Process.monitor(pid), ms)}
    last = last_renewal()
    due = if last, do: last + interval(state), else: monotonic_ms()
    {:noreply, schedule_renewal(state, due)}
  end

  @impl true
  def handle_info(:renew, state) do
    state = %{state | timer: @default_timer}
    {:noreply, if(state.holders == %{}, do: state, else: renew_lease(state))}
  end

  def handle_info({:DOWN, ref, :process, _pid, _reason}, state),
    do: {:noreply, %{state | holders: Map.delete(state.holders, ref)}}

  # A reply that arrives after its deadline.
  def handle_info(_other, state), do: {:noreply, state}

  # The log may be slow to report that it is unreachable, so the write has a deadline.
  defp renew_lease(state) do
    started = monotonic_ms()

    task =
      Task.async(fn ->
        Process.flag(:priority, :high)
        write_lease(state)
      end)

    case Task.yield(task, max(3 * interval(state), @retry_ms)) ||
           Task.shutdown(task, :brutal_kill) do
      {:ok, {:ok, seq}} ->
        :ets.insert(@table, {:renewed_at, started})
        state.report.(%{key: state.key, session: state.session}, seq)
        schedule_renewal(%{state | seq: seq}, monotonic_ms() + interval(state))

      # An earlier process of this node, or a write whose reply was lost, was the last to write.
      {:ok, {:refused, last}} ->
        schedule_renewal(%{state | seq: if(last, do: last.seq, else: 0)}, monotonic_ms())

      _late_or_error ->
        schedule_renewal(state, monotonic_ms() + @retry_ms)
    end
  end

  defp write_lease(state) do
    nonce = Base.encode16(:crypto.strong_rand_bytes(6), case: :lower)
    head = %{"Node" => Atom.to_string(node()), "Session" => state.session}
    entry = %Entry{op: "renew.#{node()}.#{nonce}", head: head}
    Log.append(state.log, {:key, state.key}, state.seq, entry)
  end

  defp interval(state), do: state.holders |> Map.values() |> Enum.min() |> div(4)

  defp schedule_renewal(%{timer: %{due: earlier}} = state, due)
       when earlier != nil and earlier <= due,
       do: state

  defp schedule_renewal(state, due) do
    _ = state.timer.ref && Process.cancel_timer(state.timer.ref)
    ref = Process.send_after(self(), :renew, max(due - monotonic_ms(), 0))
    %{state | timer: %{ref: ref, due: due}}
  end

  defp monotonic_ms, do: System.monotonic_time(:millisecond)
end
