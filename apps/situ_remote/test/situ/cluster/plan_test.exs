defmodule Situ.Cluster.PlanTest do
  use ExUnit.Case, async: true

  alias Situ.Cluster
  alias Situ.Test.ClusterSums

  test "rules cut the graph; what crosses is a stream" do
    {:ok, plan} = Cluster.plan(ClusterSums, place: [{"Sum", []}, {"Smooth", []}])
    assert plan.parts == ["Smooth", "Sum", "rest", "rest sources"]

    assert for(s <- plan.streams, do: {s.from, s.to}) |> Enum.sort() == [
             {"Smooth", ["rest"]},
             {"Sum", ["Smooth"]},
             {"rest sources", ["Sum"]},
             {"rest sources", ["Sum"]}
           ]
  end

  test "what is wrong is named, with the nearest name" do
    {:error, error} = Cluster.plan(ClusterSums, place: [{"Smoth", []}])
    assert error.code == :unknown_component
    assert error.fix =~ ~s("Smooth")
    assert {:error, %{code: :unknown_stream}} = Cluster.plan(ClusterSums, publish: ["Nothing"])
    assert {:error, %{code: :not_a_pipeline}} = Cluster.plan(Enum)
    assert {:error, %{code: :bad_place}} = Cluster.plan(ClusterSums, place: [:b])

    assert {:error, %{code: :unknown_option}} =
             Cluster.plan(ClusterSums, place: [{"Sum", onn: :b}])

    assert {:error, %{code: :no_cluster}} = Cluster.deploy(ClusterSums)
  end
end
