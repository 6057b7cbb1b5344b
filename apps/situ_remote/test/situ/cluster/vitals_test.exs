defmodule Situ.Cluster.VitalsTest do
  use ExUnit.Case, async: false
  alias Situ.Cluster.Vitals
  import Situ.Remote.Test.Recordings, only: [eventually: 1]

  test "a node knows how busy it is and what it has" do
    assert Vitals.all() == %{}
    start_supervised!({Task, fn -> :ok end})
    {:ok, vitals} = start_supervised(%{id: Vitals, start: {Vitals, :start_link, [["camera0"]]}})
    eventually(fn -> is_map_key(Vitals.all(), node()) end)
    known = Vitals.all()[node()]
    assert known.devices == ["camera0"] and known.cores >= 1 and known.memory > 0
    assert known.busy >= 0 and known.machine >= 0 and known.machine <= 1
    # The vitals of another node appear beside it, and the round trip is measured.
    send(vitals, {:vital, :other@h, %{known | devices: ["x"]}, System.monotonic_time()})
    send(vitals, {:heard, :other@h, System.monotonic_time()})
    eventually(fn -> is_map_key(Vitals.all(), :other@h) end)
    assert Vitals.all()[:other@h].devices == ["x"]
    send(vitals, :beat)
    eventually(fn -> is_map_key(Vitals.all()[node()].trips, :other@h) end)
  end
end
