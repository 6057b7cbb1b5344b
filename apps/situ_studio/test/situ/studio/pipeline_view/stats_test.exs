defmodule Situ.Studio.PipelineView.StatsTest do
  use ExUnit.Case, async: true
  alias Situ.Diagnostics.{Edge, Node, Process, Snapshot, Window}
  alias Situ.Studio.PipelineView.Stats

  doctest Stats

  defp snapshot(edge, process) do
    %Snapshot{
      nodes: [%Node{id: 1, path: "A", process: 7, errors: 2}],
      edges: [struct!(%Edge{id: 3, from: 1, to: 1, policy: "latest"}, edge)],
      processes: [struct!(%Process{number: 7}, process)]
    }
  end

  test "computes rates and shares between two snapshots" do
    before = snapshot(%{emitted: 100, processed: 80, dropped: 10, busy: 0}, %{reductions: 1_000})

    later =
      snapshot(
        %{
          emitted: 150,
          processed: 110,
          dropped: 20,
          busy: 300_000_000,
          queue: 20,
          latency_mean: 5_000_000,
          created_last: 1_500_000,
          created_mean: 9_000_000,
          size_mean: 70,
          window: %Window{
            span: 2_000_000_000,
            emitted: 50,
            processed: 30,
            dropped: 10,
            created: 1_000_000,
            handling: 10_000_000,
            queue: 1.5
          }
        },
        %{reductions: 3_000, memory: 4_096, mailbox: 2}
      )

    sample = Stats.compute_sample(later, 2_000_000_000, {before, 0})
    edge = sample.edges[3]
    assert edge["emitted_rate"] == 25.0
    assert edge["processed_rate"] == 15.0
    assert edge["dropped_rate"] == 5.0
    assert edge["dropped_now"] == 20.0
    assert edge["processed_now"] == 60.0
    assert edge["processed_recent"] == 30
    assert edge["queue_mean"] == 1.5
    assert edge["created_mean"] == 1.0
    assert edge["created_last"] == 1.5
    # Nothing was measured recently, so the previous values remain.
    assert edge["size_mean"] == 70
    assert edge["busy"] == 15.0
    assert edge["handling"] == 10.0
    assert edge["latency_mean"] == 5.0
    assert_in_delta edge["dropped_share"], 13.33, 0.01

    assert sample.nodes[1] == %{
             "mailbox" => 2,
             "memory" => 4_096,
             "reductions_rate" => 1_000.0,
             "errors" => 2,
             "skipped" => 0,
             "restarts" => 0
           }
  end

  test "rates are 0 without an earlier snapshot or after a restart" do
    now = snapshot(%{emitted: 5, processed: 5}, %{reductions: 10})
    assert Stats.compute_sample(now, 0, nil).edges[3]["emitted_rate"] == 0.0
    before = snapshot(%{emitted: 50, processed: 50}, %{reductions: 1_000})
    sample = Stats.compute_sample(now, 1_000_000_000, {before, 0})
    assert sample.edges[3]["emitted_rate"] == 0.0
    assert sample.nodes[1]["reductions_rate"] == 0.0
  end

  test "merges edges by adding their counts and taking the worst latency" do
    merged =
      Stats.merge_values([
        %{"queue" => 2, "latency_mean" => 5.0},
        %{"queue" => 3, "latency_mean" => 9.0}
      ])

    assert merged == %{"queue" => 5, "latency_mean" => 9.0}
  end

  test "every statistic of an edge and of a node has a value" do
    sample = %{} |> snapshot(%{}) |> Stats.compute_sample(0, nil)

    assert Map.keys(sample.edges[3]) ==
             :edge |> Stats.list_stats() |> Enum.map(& &1.id) |> Enum.sort()

    assert Map.keys(sample.nodes[1]) ==
             :node |> Stats.list_stats() |> Enum.map(& &1.id) |> Enum.sort()
  end

  test "formats every statistic for any size" do
    for %{id: id} <- Stats.list_stats(:edge) ++ Stats.list_stats(:node),
        value <- [0, 0.05, 3, 12.3, 1.0e5, 1.0e9, nil] do
      assert String.length(Stats.format_value(id, value)) in 1..12
    end
  end
end
