defmodule Situ.Studio.PipelineView.FoldedGraphTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Diagnostics.{Edge, Node, Snapshot}
  alias Situ.Studio.PipelineView.FoldedGraph

  defp snapshot do
    %Snapshot{
      scopes: ["A", "A.B", "A.x", "C"],
      nodes: [
        %Node{id: 1, path: "Mic", module: "Mic", kind: :source, outputs: []},
        %Node{id: 2, path: "A.Gate", scope: "A", inputs: [%{}, %{}]},
        %Node{id: 3, path: "A.B.One", scope: "A.B"},
        %Node{id: 4, path: "A.B.Two", scope: "A.B"},
        %Node{id: 5, path: "C.End", scope: "C"}
      ],
      edges: [
        edge(1, 1, 2, "unlimited"),
        edge(2, 2, 3, "unlimited"),
        edge(3, 3, 4, "unlimited"),
        edge(4, 4, 5, "latest"),
        edge(5, 2, 5, "unlimited")
      ]
    }
  end

  defp edge(id, from, to, policy) do
    %Edge{id: id, from: from, from_output: "out", to: to, to_input: "in", policy: policy}
  end

  defp folded(paths), do: FoldedGraph.fold_graph(snapshot(), MapSet.new(paths))
  defp keys(items), do: items |> Enum.map(& &1.key) |> Enum.sort()

  test "shows everything in its boxes when nothing is folded" do
    graph = folded([])
    assert keys(graph.nodes) == ~w[n1 n2 n3 n4 n5]
    assert keys(graph.boxes) == ~w[s:A s:A.B s:A.x s:C]
    assert Enum.find(graph.boxes, &(&1.key == "s:A.B")).parent == "s:A"

    assert %{parent: "s:A", label: "Gate", joins: true} =
             Enum.find(graph.nodes, &(&1.key == "n2"))

    assert %{lossy: true} = Enum.find(graph.edges, &(&1.key == "e4"))
    assert length(graph.edges) == 5
  end

  test "shows a folded composite as one box, and merges its connections" do
    graph = folded(["A"])
    assert keys(graph.nodes) == ~w[n1 n5 s:A]
    assert keys(graph.boxes) == ["s:C"]
    assert %{ids: [2, 3, 4], label: "A (3)"} = Enum.find(graph.nodes, &(&1.key == "s:A"))
    assert keys(graph.edges) == ~w[e1 e4+5]

    assert %{policy: "latest, unlimited", lossy: true} =
             Enum.find(graph.edges, &(&1.key == "e4+5"))
  end

  test "folds an inner composite alone, and hides it in a folded outer one" do
    assert keys(folded(["A.B"]).nodes) == ~w[n1 n2 n5 s:A.B]
    assert keys(folded(["A", "A.B"]).nodes) == ~w[n1 n5 s:A]
  end

  property "keeps every component and connects every edge, however it is folded" do
    forall paths <- list(one_of(["A", "A.B", "A.x", "C", "nope"])) do
      graph = folded(paths)
      assert graph.nodes |> Enum.flat_map(& &1.ids) |> Enum.sort() == [1, 2, 3, 4, 5]
      shown = keys(graph.nodes)

      for edge <- graph.edges do
        assert edge.from in shown and edge.to in shown
        assert edge.from != edge.to
      end

      boxes = keys(graph.boxes)

      for item <- graph.nodes ++ graph.boxes,
          do: assert(item.parent == nil or item.parent in boxes)
    end
  end

  test "folds large pipelines by default" do
    assert FoldedGraph.default_folded(snapshot()) == MapSet.new()
    many = %{snapshot() | nodes: for(i <- 1..50, do: %Node{id: i, path: "n#{i}"})}
    assert FoldedGraph.default_folded(many) == MapSet.new(["A", "C"])
  end
end
