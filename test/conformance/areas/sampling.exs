defmodule Situ.Conformance.Sampling do
  import Situ.Conformance.Case, except: [time: 1]
  alias Situ.Conformance.{Interpolators, Run, Text}

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
    close = duration(p, "pipeline_ends_at") || last
    align = align(p)
    interval = duration(p, "interval") || Text.unknown!("the interval of a clock", p)
    build = fn [source] -> Situ.sample(source, interval, interpolator, align) end

    Run.waiting(inputs, build, 0, fn test ->
      Situ.Test.feed(test, 0, messages)
      Situ.Test.advance(test, max(close, last))
      Situ.Test.close(test, 0, close)
    end)
  end

  defp align(params), do: if(align = duration(params, "align_to"), do: [align: align], else: [])
end
