defmodule Situ.Conformance.Parallel do
  import Situ.Conformance.Case
  alias Situ.Conformance.{Formula, Run}

  def check(%{"op" => "parallel.*", "expect" => expect}) do
    me = self()

    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        stream = Situ.return(p, [1])
        out = Situ.parallel(stream, fn s -> Situ.map(s, & &1) end)
        send(me, {:same, out.pipeline.ref == p.ref and out.pipeline.scope == p.scope})
      end)

    same? = receive do: ({:same, same?} -> same?)
    owner = if same?, do: "the pipeline the operator was added to", else: "another"
    verdict(expect, %{"output_stream_belongs_to" => owner})
  end

  def check(%{"op" => "parallel." <> form, "params" => params} = case) do
    build = fn [stream] ->
      Situ.parallel(stream, &branch(params["branch"], &1), options(form, params))
    end

    result = Run.inputs(case, build)

    case case do
      %{"expect" => %{"non_empty_values" => values}} -> verdict({:ok, values}, values(result))
      _ -> outputs(case, result)
    end
  end

  defp values({:ok, outputs}),
    do: {:ok, for({_, map} <- outputs, map != %{}, {_, v} <- map, do: v)}

  defp values(error), do: error

  defp options(form, params) do
    default =
      if params["output_default_if_dropped"],
        do: [or_default: value(Map.get(params, "default", 0))],
        else: []

    until =
      case params["termination"] do
        nil ->
          []

        "when_key_not_present" ->
          [until: :absent]

        "never" ->
          [until: :never]

        "after_key_not_present(" <> n ->
          [until: {:absent, String.to_integer(String.trim(n, ")"))}]
      end

    form(form, params) ++ default ++ until
  end

  defp form("fixed" <> _, params), do: [size: params["size"]]
  defp form("variable" <> _, _params), do: [of: :lists]
  defp form("sparse" <> _, _params), do: [of: :maps]

  # Branches as described in the files: "v / 100", "aggregate from 0: v - previous", "keep even
  # values only", "last".
  defp branch(text, stream) when text in [nil, "identity", "v"], do: stream
  defp branch("last" <> _, stream), do: Situ.last(stream)

  defp branch("aggregate from " <> text, stream) do
    [seed, formula] = String.split(text, ":", parts: 2)
    {seed, ""} = seed |> String.trim() |> Integer.parse()
    fun = Formula.of_two(formula)
    Situ.scan(stream, seed, fn v, previous -> fun.(previous, v) end)
  end

  defp branch("first" <> _, stream), do: Situ.first(stream)
  defp branch("count" <> _, stream), do: Situ.count(stream)
  defp branch("running count" <> _, stream), do: Situ.count(stream)
  defp branch("sum" <> _, stream), do: Situ.sum(stream)
  defp branch("running sum" <> _, stream), do: Situ.sum(stream)
  defp branch("where " <> text, stream), do: Situ.filter(stream, Formula.condition(text))
  defp branch("keep " <> _ = text, stream), do: Situ.filter(stream, Formula.condition(text))
  defp branch(text, stream), do: Situ.map(stream, Formula.of_one(text))
end
