defmodule Situ.Cluster.NodeMetricsTest do
  use ExUnit.Case, async: false
  alias Situ.Cluster.NodeMetrics
  import Situ.Test.LinkRecordings, only: [eventually: 1]

  doctest NodeMetrics

  test "the CPU time of a node includes the time its kernel spends" do
    # The kernel creates zeros, so this is almost only system time.
    {:ok, zeros} = File.open("/dev/zero", [:read, :raw, :binary])
    {user, _} = :erlang.statistics(:runtime)
    before = NodeMetrics.cpu_ms(File.read("/proc/self/stat"))
    read_until_counted(zeros, before)
    {user_after, _} = :erlang.statistics(:runtime)
    assert user_after - user < 300
  end

  # Ends only if system time counts.
  defp read_until_counted(zeros, before) do
    {:ok, _bytes} = :file.read(zeros, 16_000_000)

    if NodeMetrics.cpu_ms(File.read("/proc/self/stat")) - before < 300,
      do: read_until_counted(zeros, before)
  end

  test "a node reports its load and its devices" do
    # The cluster of an earlier test may still be ending.
    eventually(fn -> NodeMetrics.recent_vitals() == %{} end)

    {:ok, vitals} =
      start_supervised(%{id: NodeMetrics, start: {NodeMetrics, :start_link, [["camera0"]]}})

    eventually(fn -> is_map_key(NodeMetrics.recent_vitals(), node()) end)
    known = NodeMetrics.recent_vitals()[node()]
    assert known.devices == ["camera0"] and known.cores >= 1 and known.memory > 0
    assert known.busy >= 0 and known.machine >= 0 and known.machine <= 1
    # The vitals of another node appear next to it, and the round trip is measured.
    send(vitals, {:vital, :other@h, %{known | devices: ["x"]}, System.monotonic_time()})
    send(vitals, {:heard, :other@h, System.monotonic_time()})
    eventually(fn -> is_map_key(NodeMetrics.recent_vitals(), :other@h) end)
    assert NodeMetrics.recent_vitals()[:other@h].devices == ["x"]
    send(vitals, :beat)
    eventually(fn -> is_map_key(NodeMetrics.recent_vitals()[node()].trips, :other@h) end)
  end
end
