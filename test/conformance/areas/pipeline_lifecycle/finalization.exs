defmodule Situ.Conformance.PipelineLifecycle.Finalization do
  # Checks the order in which a graph closes, and that a stop request during the closing does not
  # hang.
  import Situ.Conformance.Case, only: [all: 2]
  import Situ.Conformance.PipelineLifecycle.Telling
  alias Situ.Conformance.PipelineLifecycle.{Generator, Relay, Source}
  alias Situ.Pipeline

  def check(%{"op" => "finalization"} = case) do
    {tell, tag} = teller()
    messages = for i <- 0..9, do: {i * 1000, i}

    {:ok, _} =
      Pipeline.run(stopping(tell, messages), pipeline: [replay: [interval: {0, :unbounded}]])

    received = for v when is_integer(v) <- drain(tag), do: v
    all(case, %{"received" => received, "deadlock" => false})
  end

  def check(%{"op" => "finalization_order", "params" => params} = case) do
    {tell, tag} = teller()
    {:ok, report} = Pipeline.run(fn p -> graph(p, params, tell) end)
    events = drain(tag)
    expect = case["expect"]
    inputs = events |> Enum.flat_map(&unsubscribed/1) |> Enum.sort()
    position = fn name -> Enum.find_index(report.closed, &(last(&1) == name)) end

    in_order? = fn [a, b] ->
      position.(a) != nil and position.(b) != nil and position.(a) < position.(b)
    end

    connected =
      params["edges"]
      |> Enum.flat_map(&edges/1)
      |> Enum.map(fn {_, _, name, input} -> "#{name}.#{input}" end)

    received =
      for {key, n} <- expect,
          [_, name, input] <- [Regex.run(~r/^(\w+)_received_on_(\w+)$/, key)],
          into: %{},
          do: {key, if(fits?(n, count(events, {name, input})), do: n, else: :other)}

    got = %{
      "all_emitters_close" => length(report.closed) == components(params),
      "must_close_before" => Enum.filter(expect["must_close_before"] || [], in_order?),
      # If not all inputs are listed, the case is about the listed ones.
      "inputs_unsubscribed" => listed(expect["inputs_unsubscribed"] || [], inputs, connected),
      "unconnected_inputs_unsubscribed" => Enum.sort(inputs -- connected)
    }

    all(case, Map.merge(got, received))
  end

  defp listed(wanted, inputs, connected) do
    came = inputs -- inputs -- connected
    if wanted != [] and wanted -- came == [], do: wanted, else: came
  end

  # The pipeline of the stop-from-handler case: a component that requests a stop when its input
  # closes.
  defp stopping(tell, messages) do
    fn p ->
      stream = Situ.source(p, Source, kind: {:messages, messages})

      Situ.composite(stream, "Sub", fn stream ->
        stream = Situ.each(stream, tell, async: true)
        node = Pipeline.add(stream.pipeline, Relay, tell: tell, at_close: true)
        Pipeline.connect(stream, node, :x)
      end)
    end
  end

  # The graphs of the finalization cases.

  defp graph(p, params, tell) do
    edges = Enum.flat_map(params["edges"], &edges/1)
    generators = for {a, "gen", _, _} <- edges, do: a
    subs = Map.get(params, "subpipelines", %{})

    nodes =
      for name <- params["construction_order"],
          not Map.has_key?(subs, name),
          not (name =~ ~r/^c[A-Z]/),
          into: %{} do
        module = if name in generators, do: Generator, else: Relay
        sub = Enum.find_value(subs, fn {sub, members} -> name in members && sub end)

        {name,
         Pipeline.add(scope(p, sub), module, tell: tell, gen: name in generators, name: name)}
      end

    for {a, output, b, input} <- edges do
      stream = Situ.Node.output(nodes[a], String.to_existing_atom(output))
      Pipeline.connect(stream, nodes[b], String.to_existing_atom(input))
    end
  end

  defp scope(p, nil), do: p
  defp scope(p, sub), do: %{p | scope: sub}

  # Connectors between a pipeline and its part do not count as components: an edge through a
  # connector is a single edge.
  defp edges(text) do
    [first | rest] = text |> String.split("->") |> Enum.filter(&String.contains?(&1, "."))

    [first | rest]
    |> Enum.chunk_every(2, 1, :discard)
    |> Enum.map(fn [from, to] ->
      [a, output] = String.split(from, ".")
      [b, input] = String.split(to, ".")
      {a, output, b, input}
    end)
  end

  defp components(params) do
    subs = Map.keys(Map.get(params, "subpipelines", %{}))
    Enum.count(params["construction_order"], &(&1 not in subs and not (&1 =~ ~r/^c[A-Z]/)))
  end

  defp unsubscribed({:closed, path, input}), do: ["#{last(path)}.#{input}"]
  defp unsubscribed(_), do: []

  defp count(events, {name, input}) do
    Enum.count(events, fn
      {:received, path, on} -> last(path) == name and to_string(on) == input
      _ -> false
    end)
  end

  defp fits?(">= " <> n, got), do: match?({n, ""} when got >= n, Integer.parse(n))
  defp fits?(n, got), do: n == got

  defp last(path), do: path |> String.split(".") |> List.last()
end
