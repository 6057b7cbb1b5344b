defmodule Situ.Cluster.PlanTest do
  use ExUnit.Case, async: true

  alias Situ.Cluster
  alias Situ.Test.ClusterSums

  test "rules cut the graph, and crossing connections become streams" do
    {:ok, plan} = Cluster.plan(ClusterSums, place: [{"Sum", []}, {"Smooth", []}])
    assert plan.parts == ["Smooth", "Sum", "rest", "rest sources"]

    assert for(s <- plan.streams, do: {s.from, s.to}) |> Enum.sort() == [
             {"Smooth", ["rest"]},
             {"Sum", ["Smooth"]},
             {"rest sources", ["Sum"]},
             {"rest sources", ["Sum"]}
           ]
  end

  test "errors name the mistake and the nearest valid name" do
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

  defmodule Glance do
    use Situ.Pipeline

    @impl true
    def build(p, _opts) do
      steps = Situ.sequence(p, 1, &(&1 + 1), count: 10, every: 1_000, name: "Steps")

      steps
      |> Situ.composite("Seen", &Situ.map(&1, fn n -> n end, policy: Situ.Delivery.latest()))
      |> Situ.map(& &1, name: "Result")
    end
  end

  defp planned(opts) do
    with {:ok, deployment} <- Cluster.Deployment.new(Glance, opts),
         do: Cluster.PartStarter.build_plan(deployment)
  end

  test "a stream with only lossy readers is direct unless it is published" do
    {:ok, plan} = planned(place: [{"Seen", []}])
    assert %{direct: true, policies: %{"Seen" => %{max_queue: 1}}} = plan.streams["Steps"]
    assert Enum.any?(plan.streams, fn {_, s} -> s.part == "Seen" and not s.direct end)
    {:ok, plan} = planned(place: [{"Seen", []}], publish: ["Steps"])
    refute plan.streams["Steps"].direct
  end

  test "non-repeatable is not deterministic, and streams within a part are not direct" do
    {:error, error} = planned(place: [{"Seen", deterministic: true}])

    assert {error.code, error.what} ==
             {:not_deterministic,
              "part Seen is declared deterministic: true, but is not deterministic"}

    assert {:error, %{code: :not_crossing}} = planned(place: [{"Seen", []}], direct: ["Result"])

    assert {:error, %{code: :unknown_stream}} =
             planned(place: [{"Seen", []}], direct: ["Nothing"])
  end
end
