defmodule Situ.Conformance.PipelineLifecycle.Finalization do
  # Checks the order in which a graph closes, and that a stop request during the closing does not
  # hang.
  import Situ.Conformance.Case,
    only: [all: 2, meant: 3, ms: 1, outputs: 2, timed: 1, verdict: 2]

  import Situ.Conformance.PipelineLifecycle.Telling
  alias Situ.Conformance.{Facts, Text}
  alias Situ.Conformance.PipelineLifecycle.{Collecting, Generator, Relay, Scopes, Source}
  alias Situ.Pipeline

  @posts ~r/\bposts?\b|^posts?_|_posts?_|collect/

  def check(%{"op" => "finalization", "params" => params} = case) do
    if Enum.any?(params, &posts?/1), do: posted_late(case), else: stopped_early(case)
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
      "all_emitters_close" => length(report.closed) == length(components(params)),
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

  # A component posts from its handler ("handler": "posts the collected messages"), or stops.
  defp posts?({key, value}), do: key =~ @posts or (is_binary(value) and value =~ @posts)

  # Requests a stop when an input closes.
  defp stopped_early(case) do
    {tell, tag} = teller()
    settings = [replay: [interval: {0, :unbounded}]]
    {:ok, _} = Pipeline.run(stopping(tell, given(case, 1_000)), pipeline: settings)
    received = for v when is_integer(v) <- drain(tag), do: {0, v}
    all(case, Facts.of(case["expect"], received))
  end

  # Posts when an input closes, while the pipeline ends.
  defp posted_late(%{"params" => params, "expect" => expect} = case) do
    messages = given(case, ms(10))
    pause = Enum.find_value(params, 0, fn {key, n} -> key =~ ~r/_ms$/ && is_integer(n) && n end)

    build = fn p ->
      p |> Situ.source(Source, kind: {:messages, messages}) |> Situ.via(Collecting, pause: pause)
    end

    replay = [replay: [interval: {0, :unbounded}, speed: :max]]
    got = Situ.to_list(build, times: true, pipeline: replay)

    if is_list(expect),
      do: posted(case, got),
      else: all(case, Facts.of(expect, got, texts(expect, got == messages)))
  end

  defp posted(%{"expect" => [%{} | _]} = case, got), do: outputs(case, {:ok, got})
  defp posted(%{"expect" => values}, got), do: verdict(values, Enum.map(got, &elem(&1, 1)))

  # Everything is posted with its own time: "log": "equals the collected messages".
  defp texts(expect, same?) do
    for {key, text} when is_binary(text) <- expect, Text.compare(text, 0) == nil, into: %{} do
      {key, meant(text, ~r/equal|same|unchanged|identical|every|all|kept|own/, same?)}
    end
  end

  defp given(%{"inputs" => [%{"messages" => messages} | _]}, _interval), do: timed(messages)
  defp given(_case, interval), do: for(i <- 0..9, do: {i * interval, i})

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

    nodes =
      for name <- components(params), into: %{} do
        module = if name in generators, do: Generator, else: Relay
        scoped = %{p | scope: Scopes.scope(name, params) || p.scope}
        {name, Pipeline.add(scoped, module, tell: tell, gen: name in generators, name: name)}
      end

    for {a, output, b, input} <- edges do
      stream = Situ.Node.output(nodes[a], String.to_existing_atom(output))
      Pipeline.connect(stream, nodes[b], String.to_existing_atom(input))
    end
  end

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

  # Names that are neither subpipelines nor connectors, which are written without a port.
  defp components(params) do
    hops = Enum.flat_map(params["edges"], &String.split(&1, "->"))
    connectors = Enum.reject(hops, &String.contains?(&1, "."))
    params["construction_order"] -- (Scopes.names(params) ++ Enum.uniq(connectors))
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
