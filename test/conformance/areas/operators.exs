defmodule Situ.Conformance.Operators do
  import Situ.Conformance.Case
  alias Situ.Conformance.Run

  @comparisons %{"<" => :<, "<=" => :<=, ">" => :>, ">=" => :>=, "==" => :==, "!=" => :!=}

  def check(%{"op" => "to_enumerable", "params" => params, "inputs" => [input]} = case) do
    keep = condition(params)
    items = timed(input["messages"])
    messages = Situ.to_stream(&Situ.from_enumerable(&1, items), messages: true)
    got = for m <- Enum.take_while(messages, &keep.(&1.data)), do: {m.originating_time, m.data}
    outputs(case, {:ok, got})
  end

  def check(%{"op" => "to_observable", "params" => %{"steps" => steps}, "expect" => expect}) do
    me = self()

    test =
      Situ.Test.start([:in], fn %{in: stream} ->
        {stream, tap} = Situ.tap(stream)
        send(me, {:tap, tap})
        stream
      end)

    tap = receive do: ({:tap, tap} -> tap)

    answers =
      for step <- steps, reduce: [] do
        answers ->
          case step do
            "subscribe" -> Situ.Tap.subscribe(tap) && answers
            "unsubscribe" -> Situ.Tap.unsubscribe(tap) && answers
            "has_subscribers" -> [Situ.Tap.subscribed?(tap) | answers]
          end
      end

    Situ.Test.stop(test)
    verdict(expect, %{"has_subscribers" => Enum.reverse(answers)})
  end

  def check(%{"op" => "subpipeline.passthrough", "params" => params} = case) do
    infinite? = params["extra_sources"] =~ "infinite"

    outputs(
      case,
      Run.inputs(case, fn [stream] -> nested(stream, params["depth"], infinite?) end)
    )
  end

  def check(%{"op" => op, "params" => params} = case),
    do: outputs(case, Run.inputs(case, fn [stream] -> build(op, stream, params) end))

  defp nested(stream, 0, _infinite?), do: stream

  defp nested(stream, depth, infinite?) do
    Situ.composite(stream, "Level#{depth}", fn inner ->
      if infinite?, do: Situ.repeat(inner.pipeline, :tick, Situ.Time.ms(1), name: "Endless")
      inner |> Situ.map(& &1) |> nested(depth - 1, infinite?)
    end)
  end

  defp build("aggregate.seedless", stream, params) do
    fun = Run.arithmetic(params["function"], [:x, :y])
    Situ.reduce(stream, fn data, previous -> fun.([previous, data]) end)
  end

  defp build("aggregate" <> _, stream, %{"function" => text} = params) do
    fun = Run.arithmetic(text, [:x, :y])
    Situ.scan(stream, params["seed"] || params["initial"], fn data, acc -> fun.([acc, data]) end)
  end

  defp build("first", stream, params), do: Situ.first(stream, params["count"] || 1)
  defp build("last", stream, params), do: Situ.last(stream, params["count"] || 1)

  defp build("select", stream, %{"function" => "running average" <> _}) do
    Situ.scan(stream, {0, 0}, fn value, {sum, n} -> {sum + value, n + 1} end)
    |> Situ.map(fn {sum, n} -> sum / n end)
  end

  defp build("select", stream, %{"function" => text}) do
    fun = Run.arithmetic(text, [:v])
    Situ.map(stream, &fun.([&1]))
  end

  defp build("where", stream, params), do: Situ.filter(stream, condition(params))

  defp build("edit_stream", stream, params) do
    edits =
      for edit <- params["edits"] do
        if edit["delete"],
          do: {time(edit), :delete},
          else: {time(edit), {:put, value(edit["upsert"])}}
      end

    Situ.edit(stream, edits)
  end

  defp build("time_of", stream, _params), do: Situ.time_of(stream)

  defp build(op, stream, _params) when op in ["to_observable", "do", "name"],
    do: Situ.each(stream, & &1)

  defp condition(params) do
    case params["condition"] || params["predicate"] do
      nil -> fn _ -> true end
      "v is even" -> &(rem(&1, 2) == 0)
      "v is odd" -> &(rem(&1, 2) != 0)
      text -> comparison(text)
    end
  end

  # "v < 5"
  defp comparison(text) do
    [_, operator, bound] = Regex.run(~r/\Av\s*(<|<=|>|>=|==|!=)\s*(-?[0-9.]+)\z/, text)
    {bound, ""} = Float.parse(bound)
    fn v -> apply(Kernel, Map.fetch!(@comparisons, operator), [v, bound]) end
  end
end
