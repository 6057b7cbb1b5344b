defmodule Situ.Cluster.NodeLeaseTest do
  # The processes have registered names.
  use ExUnit.Case, async: false

  alias Situ.Cluster.{Lease, Log, NodeLease, NodeLeaseWatcher, SealedLog, Standby}
  alias Situ.Cluster.Log.Entry

  @moduletag :tmp_dir

  # Passes everything to a folder log, and reports every read.
  defmodule WatchedLog do
    def last({log, test}, subject) do
      send(test, {:read, subject})
      Log.fetch_last(log, subject)
    end
  end

  setup %{tmp_dir: dir} do
    {:ok, log} = Log.connect(dir)
    :ok = NodeLeaseWatcher.create_table()
    %{log: log}
  end

  defp start_lease(log) do
    test = self()
    pid = start_supervised!({NodeLease, {log, &send(test, {:renewed, &1, &2})}})
    %{pid: pid, lease: NodeLease.own_lease()}
  end

  # The lease of another node, renewed once.
  defp renew_other(log, seq) do
    lease = %{key: "node_lease.c.other@host", session: "s1"}
    entry = %Entry{op: "renew.#{seq}", head: %{"Session" => "s1"}}
    {:ok, seq} = Log.append(SealedLog.new(log, ""), {:key, lease.key}, seq, entry)
    {lease, seq}
  end

  defp watched(log), do: %Log{adapter: WatchedLog, conn: {log, self()}}

  test "one lease is renewed for all holders, and only while there is one", %{log: log} do
    %{pid: pid, lease: lease} = start_lease(log)
    refute NodeLease.last_renewal()

    holders =
      for ms <- [60_000, 40_000, 80_000] do
        spawn_link(fn ->
          NodeLease.hold(ms)
          receive(do: (:stop -> :ok))
        end)
      end

    assert_receive {:renewed, ^lease, 1}
    assert is_integer(NodeLease.last_renewal())
    # The timer is due after a quarter of the shortest lease.
    assert %{timer: %{ref: ref}} = eventually_held(pid, 3)
    assert Process.read_timer(ref) in 8_000..10_000
    for holder <- holders, do: send(holder, :stop)
    eventually_held(pid, 0)
    send(pid, :renew)
    assert %{timer: %{due: nil}} = :sys.get_state(pid)
    refute_received {:renewed, _, 2}
  end

  defp eventually_held(pid, n) do
    state = :sys.get_state(pid)
    if map_size(state.holders) == n, do: state, else: eventually_held(pid, n)
  end

  test "a restarted node continues after its last entry, with another session", %{log: log} do
    %{lease: first} = start_lease(log)
    NodeLease.hold(60_000)
    assert_receive {:renewed, ^first, 1}
    stop_supervised!(NodeLease)
    %{lease: second} = start_lease(log)
    assert second.key == first.key and second.session != first.session
    NodeLease.hold(60_000)
    assert_receive {:renewed, ^second, 2}
    start_supervised!({NodeLeaseWatcher, log})
    assert {:ok, 2} = NodeLeaseWatcher.read_renewal(second, 1)
    # The parts of the earlier session are no longer renewed.
    assert {:ok, nil} = NodeLeaseWatcher.read_renewal(first, 1)
  end

  test "all runners of a node read the lease of another node once", %{log: log} do
    {lease, seq} = renew_other(log, 0)
    start_supervised!({NodeLeaseWatcher, watched(log)})
    tasks = for _ <- 1..50, do: Task.async(fn -> NodeLeaseWatcher.read_renewal(lease, 60_000) end)
    assert Enum.uniq(Task.await_many(tasks)) == [{:ok, seq}]
    assert_received {:read, _}
    refute_received {:read, _}
    # A reported renewal needs no read.
    :ok = NodeLeaseWatcher.note_renewal(lease, 9)
    assert {:ok, 9} = NodeLeaseWatcher.read_renewal(lease, 60_000)
    refute_received {:read, _}
  end

  test "a runner does not look at the log while the owner's node is heard from", %{log: log} do
    {lease, seq} = renew_other(log, 0)
    at = System.monotonic_time(:millisecond)
    standby = Standby.new(60_000_000_000)
    reading = {7, "other@host", {lease, seq}, {at, at}}
    {:wait, standby} = Standby.judge_reading(standby, reading, 0)
    assert {false, standby} = Standby.note_node_renewal(standby)
    :ok = NodeLeaseWatcher.note_renewal(lease, seq + 1)
    assert {true, standby} = Standby.note_node_renewal(standby)
    assert standby.lease.renewal == {lease, seq + 1}
    # It looks immediately when the owner releases the part, or its node is lost.
    assert {false, _} = Standby.note_node_renewal(Standby.note_release(standby))
    assert_receive :check
    assert {false, _} = Standby.note_node_renewal(Standby.note_node_down(standby, :other@host))
    assert_receive :check
  end

  test "a lease of this node that nobody here holds is taken; a released one names no node", %{
    log: log
  } do
    %{lease: own} = start_lease(log)
    start_supervised!({NodeLeaseWatcher, log})
    assert {:ok, epoch} = Lease.acquire(log, "lease.d.p", 0, 60_000)
    assert {:ok, reading} = Lease.read_lease(log, "lease.d.p", 100)
    assert {^epoch, _node, {^own, :lost}, _times} = reading
    times = %{lease: 60_000, poll: 6_000, wait: 0}
    assert {:take, _} = Lease.judge_reading(%Lease{}, reading, times)
    {:ok, _} = Lease.release_later(log, "lease.d.p", epoch)
    assert {_seq, "", nil, _times} = eventually_released(log)
    # The runner does not release the lease of a later owner.
    {:ok, last} = Log.fetch_last(log, {:key, "lease.d.p"})
    assert {:ok, next} = Lease.acquire(log, "lease.d.p", last.seq, 60_000)
    assert {:refused, %{seq: ^next}} = Lease.release(log, "lease.d.p", epoch)
  end

  defp eventually_released(log) do
    case Lease.read_lease(log, "lease.d.p", 100) do
      {:ok, {_, "", _, _} = reading} -> reading
      _still_owned -> eventually_released(log)
    end
  end
end
