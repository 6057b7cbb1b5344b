defmodule Situ.Conformance.Sampling do
  import Situ.Conformance.Case, except: [time: 1]
  alias Situ.Conformance.{Interpolators, Run}

  Code.require_file("interpolators.exs", __DIR__)

  def check(%{"op" => op, "params" => p} = case) do
    interpolator = Interpolators.of_params(p, "reproducible.nearest")
    tolerance = p["tolerance"] || 1.0e-12

    result =
      case String.split(op, ".by_") do
        [_, "clock"] ->
          Run.inputs(case, fn [source, clock] -> Situ.sample(source, clock, interpolator) end)

        [_, "interval"] ->
          by_interval(case, interpolator, p)
      end

    outputs(case, result, tolerance)
  end

  # The end of the source is the end of the pipeline, so all ticks up to it are decided.
  defp by_interval(%{"inputs" => [input] = inputs}, interpolator, p) do
    messages = timed(input["messages"])
    {last, _} = List.last(messages) || {0, nil}
    close = closed_at(p) || last
    align = align(p)
    interval = if p["interval_ms"], do: ms(p["interval_ms"]), else: ticks(p["interval_ticks"])
    build = fn [source] -> Situ.sample(source, interval, interpolator, align) end

    Run.waiting(inputs, build, 0, fn test ->
      Situ.Test.feed(test, 0, messages)
      Situ.Test.advance(test, max(close, last))
      Situ.Test.close(test, 0, close)
    end)
  end

  defp closed_at(%{"pipeline_ends_at_ms" => n}), do: ms(n)
  defp closed_at(%{"pipeline_ends_at_ticks" => n}), do: ticks(n)
  defp closed_at(_params), do: nil

  defp align(%{"align_to_ms" => n}), do: [align: ms(n)]
  defp align(%{"align_to_ticks" => n}), do: [align: ticks(n)]
  defp align(_params), do: []
end
