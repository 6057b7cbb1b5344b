defmodule Situ.Graph.CycleTest do
  use ExUnit.Case, async: true
  alias Situ.{Error, Graph, Pipeline}
  alias Situ.Graph.Cycle

  defmodule Two do
    use Situ.Component, inputs: [a: :any, b: {:any, optional: true}], outputs: [out: :any]
  end

  # The graph has the cycle In -> A -> Map -> A and the longer cycle A -> B -> C -> A.
  defp graph do
    {graph, _} =
      Graph.build(fn p ->
        a = Pipeline.add(p, Two, name: "A")
        b = Pipeline.add(p, Two, name: "B")
        c = Pipeline.add(p, Two, name: "C")
        out = &Situ.Node.output(&1, :out)
        Pipeline.connect(out.(a), b, :a)
        Pipeline.connect(out.(b), c, :a)
        Pipeline.connect(out.(c), a, :b)
        out.(a) |> Situ.map(& &1) |> Pipeline.connect(a, :a)
        out.(c) |> Situ.each(& &1)
      end)

    graph
  end

  defp id(graph, path), do: Map.fetch!(graph.paths, path)

  test "finds the shortest cycle through a component, or none" do
    graph = graph()
    assert Cycle.find_cycle(graph, id(graph, "A")) == ["A", "Map", "A"]
    assert Cycle.find_cycle(graph, id(graph, "B")) == ["B", "C", "A", "B"]
    assert Cycle.find_cycle(graph, id(graph, "Each")) == nil
  end

  test "a time error on a cycle names the cycle, and other errors are unchanged" do
    graph = graph()
    error = fn code, path -> Error.new(code, "what", why: "because", meta: %{component: path}) end

    assert %{why: why, meta: %{cycle: ["A", "Map", "A"]}} =
             Cycle.explain_error(error.(:time_not_increasing, "A"), graph)

    assert why =~ "because" and why =~ "A -> Map -> A"

    for untouched <- [
          error.(:time_not_increasing, "Each"),
          error.(:component_failed, "A"),
          error.(:time_not_increasing, "Nowhere")
        ] do
      assert Cycle.explain_error(untouched, graph) == untouched
    end
  end
end
