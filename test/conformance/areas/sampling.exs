defmodule Situ.Conformance.Sampling do
  import Situ.Conformance.Case, except: [time: 1]
  alias Situ.Conformance.{Interpolators, Run}

  Code.require_file("interpolators.exs", __DIR__)

  def check(%{"op" => op, "params" => p} = case) do
    interpolator = interpolator(p)
    tolerance = p["tolerance"] || 1.0e-12

    result =
      case String.split(op, ".by_") do
        [_, "clock"] ->
          Run.inputs(case, fn [source, clock] -> Situ.interpolate(source, clock, interpolator) end)

        [_, "interval"] ->
          by_interval(case, interpolator, p)
      end

    outputs(case, result, tolerance)
  end

  # The source's end is the pipeline's: ticks up to it are decided.
  defp by_interval(%{"inputs" => [input] = inputs}, interpolator, p) do
    messages = timed(input["messages"])
    {last, _} = List.last(messages) || {0, nil}
    close = if p["pipeline_ends_at_ms"], do: ms(p["pipeline_ends_at_ms"]), else: last
    align = if p["align_to_ms"], do: [align: ms(p["align_to_ms"])], else: []
    interval = if p["interval_ms"], do: ms(p["interval_ms"]), else: ticks(p["interval_ticks"])
    build = fn [source] -> Situ.interpolate(source, interval, interpolator, align) end

    Run.waiting(inputs, build, 0, fn test ->
      Situ.Test.feed(test, 0, messages)
      Situ.Test.advance(test, max(close, last))
      Situ.Test.close(test, 0, close)
    end)
  end

  defp interpolator(%{"interpolator" => spec}), do: Interpolators.build(spec["kind"], spec)
  defp interpolator(%{"tolerance_ms" => n}), do: Situ.Reproducible.nearest(ms(n))
  defp interpolator(%{"tolerance_ticks" => n}), do: Situ.Reproducible.nearest(ticks(n))

  defp interpolator(p) do
    window = Interpolators.window(p["window"]) || Situ.Interval.infinite()
    Situ.Reproducible.nearest(window)
  end
end
