defmodule Situ.Conformance.PipelineLifecycle.Parts do
  # Pipelines in pipelines, and edges between them.
  import Situ.Conformance.Case, only: [all: 2, told: 2, verdict: 2, timed: 1, ms: 1]
  import Situ.Conformance.PipelineLifecycle.Telling
  alias Situ.Conformance.Formula
  alias Situ.Conformance.PipelineLifecycle.{Source, Ticker}
  alias Situ.Pipeline

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

  # A source inside, or with a function, a source outside and the function inside.
  def check(%{"op" => "subpipeline", "inputs" => [%{"messages" => messages}]} = case) do
    {tell, tag} = teller()
    source = &Situ.source(&1, Source, kind: {:messages, timed(messages)})
    function = case["params"]["function"]

    {:ok, _} =
      Pipeline.run(
        fn p ->
          if function do
            fun = Formula.of_one(function)
            p |> source.() |> Situ.composite("Sub", &Situ.map(&1, fun)) |> Situ.each(tell)
          else
            p |> Situ.composite("Sub", source) |> Situ.each(tell)
          end
        end,
        pipeline: [replay: [interval: {0, :unbounded}]]
      )

    verdict(values(case["expect"]), drain(tag))
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

    receives =
      told(case["expect"]["target_receives"], [
        {~r/at least one message within (\d+) ms(?: after .*ended)?/,
         fn [ms | _] -> first(tag, String.to_integer(ms)) == elem(hd(script), 1) end}
      ])

    Pipeline.stop(target)
    all(case, %{"target_receives" => receives})
  end

  defp first(tag, ms) do
    receive do
      {^tag, value} -> value
    after
      ms -> :nothing
    end
  end
end
