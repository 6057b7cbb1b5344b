defmodule Situ.Cluster.BalancerTest do
  # A node has only one agent.
  use ExUnit.Case, async: false

  alias Situ.Cluster
  alias Situ.Cluster.Balancer
  alias Situ.Test.ClusterFan

  @moduletag :tmp_dir

  # A call that times out would end the balancer, and with it the node.
  test "the balancer does not wait for a busy agent", %{tmp_dir: dir} do
    start_supervised!({Cluster, log: dir})
    me = self()

    {:ok, %{name: name} = deployment} =
      Cluster.deploy(ClusterFan,
        opts: [parts: 1],
        place: [{"P1", on: "nowhere", only: true}],
        balance: Situ.Time.ms(100)
      )

    :sys.suspend(Cluster.Agent)

    start_supervised!(%{
      id: Balancer,
      start: {Balancer, :start_link, [&send(me, {:balance, &1.name})]}
    })

    assert_receive {:balance, ^name}, 20_000
    :sys.resume(Cluster.Agent)
    assert :ok = Cluster.forget(deployment)
    assert Cluster.Member.list_deployments() == []
  end
end
