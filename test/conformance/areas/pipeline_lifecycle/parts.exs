defmodule Situ.Conformance.PipelineLifecycle.Parts do
  # Pipelines in pipelines, and edges between them.
  import Situ.Conformance.Case, only: [all: 2, duration: 2, told: 2, verdict: 2, timed: 1, ms: 1]
  import Situ.Conformance.PipelineLifecycle.Telling
  alias Situ.Conformance.{Facts, Formula, Text}
  alias Situ.Conformance.PipelineLifecycle.{Source, Ticker}
  alias Situ.Pipeline

  def check(%{"op" => "composite"} = case), do: check(%{case | "op" => "subpipeline"})

  def check(%{"op" => "subpipeline", "params" => %{"timer_ms" => interval}} = case) do
    {tell, tag} = teller()

    {:ok, pid} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.composite("Sub", &Situ.source(&1, Ticker, interval: ms(interval)))
          |> Situ.each(tell)
        end,
        []
      )

    completed? = match?({:ok, _}, Pipeline.await(pid, case["params"]["observe_ms"]))
    stopped = Pipeline.stop(pid)
    values = drain(tag)

    all(case, %{
      "completed_after_#{case["params"]["observe_ms"]}_ms" => completed?,
      "completed_after_dispose" => match?({:ok, _}, stopped),
      "first_values" => Enum.take(values, length(case["expect"]["first_values"]))
    })
  end

  # A source inside, or with functions, a source outside and each function in a part of its own.
  def check(%{"op" => "subpipeline", "params" => params, "expect" => expect} = case) do
    {tell, tag} = teller()
    source = &Situ.source(&1, Source, kind: {:messages, given(case)})
    functions = params["functions"] || List.wrap(params["function"])

    {:ok, pipeline} =
      Pipeline.start(
        fn p ->
          p |> part(source, functions) |> Situ.each(fn v, m -> tell.({m.originating_time, v}) end)
        end,
        pipeline: [replay: [interval: {0, :unbounded}]]
      )

    completed? = match?({:ok, _}, Pipeline.await(pipeline, params["observe_ms"] || 60_000))
    Pipeline.stop(pipeline)
    got = drain(tag)

    if is_map(expect),
      do: all(case, Facts.of(expect, got, ended(expect, completed?))),
      else: verdict({true, values(expect)}, {completed?, Enum.map(got, &elem(&1, 1))})
  end

  def check(%{"op" => "connector", "inputs" => [%{"messages" => messages}]} = case) do
    {tell, tag} = teller()
    script = timed(messages)
    connector = Situ.Connector.new("Between")

    {:ok, target} =
      Pipeline.start(fn p -> p |> Situ.Connector.receive(connector) |> Situ.each(tell) end, [])

    :ok = Situ.Connector.await_open(connector, 30_000)

    {:ok, _} =
      Pipeline.run(
        fn p ->
          p |> Situ.source(Source, kind: {:messages, script}) |> Situ.Connector.send(connector)
        end,
        pipeline: [replay: [interval: {0, :unbounded}]]
      )

    known =
      for {"target_receives" = key, text} <- case["expect"], into: %{} do
        {key,
         told(text, [
           {~r/at least one message within (\d+) ms(?: after .*ended)?/,
            fn [ms | _] -> first(tag, String.to_integer(ms)) == elem(hd(script), 1) end}
         ])}
      end

    got = if known == %{}, do: for(_ <- script, do: {0, first(tag, 5_000)}), else: []
    Pipeline.stop(target)
    all(case, Facts.of(case["expect"], got, known))
  end

  # "completed", "completed_by_itself", "stopped" ...
  defp ended(expect, completed?),
    do:
      for(
        {key, _} <- expect,
        key =~ ~r/^(completed|stopped|ended)/,
        into: %{},
        do: {key, completed?}
      )

  defp part(p, source, []), do: Situ.composite(p, "Sub", source)

  defp part(p, source, functions) do
    for {function, i} <- Enum.with_index(functions), reduce: source.(p) do
      stream -> Situ.composite(stream, "Sub#{i}", &Situ.map(&1, Formula.of_one(function)))
    end
  end

  # The messages of the source: as inputs, as values, as a range in a text, or counted from 0.
  defp given(%{"inputs" => [%{"messages" => messages} | _]}), do: timed(messages)

  defp given(%{"params" => params}) do
    every = duration(params, "interval") || 100
    for {v, i} <- Enum.with_index(numbers(params)), do: {i * every, v}
  end

  defp numbers(%{"values" => values}), do: values
  defp numbers(%{"range" => [from, to]}), do: Enum.to_list(from..to//1)
  defp numbers(%{"finite_source" => n}) when is_integer(n), do: Enum.to_list(0..(n - 1)//1)

  defp numbers(%{"count" => n} = params),
    do: Enum.map(0..(n - 1)//1, &(&1 + (params["start"] || 0)))

  defp numbers(params) do
    texts = for {_, text} when is_binary(text) <- params, do: Regex.run(~r/-?\d+\.\.-?\d+/, text)

    case Enum.reject(texts, &is_nil/1) do
      [[range]] -> Text.range(range)
      _ -> Text.unknown!("the source of a subpipeline", params)
    end
  end

  defp first(tag, ms) do
    receive do
      {^tag, value} -> value
    after
      ms -> :nothing
    end
  end
end
