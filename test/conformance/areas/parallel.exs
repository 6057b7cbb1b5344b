defmodule Situ.Conformance.Parallel do
  import Situ.Conformance.Case
  alias Situ.Conformance.Run

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
        do: [or_default: value(params["default"] || 0)],
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

  defp form("fixed", params), do: [size: params["size"]]
  defp form("variable", _params), do: [of: :lists]
  defp form("sparse", _params), do: [of: :maps]

  # Branches as the files tell them.
  defp branch("aggregate from 0: " <> text, stream) do
    fun = Run.arithmetic(text, [:v, :previous])
    Situ.scan(stream, 0, fn v, previous -> fun.([v, previous]) end)
  end

  defp branch("keep even values only", stream), do: Situ.filter(stream, &(rem(&1, 2) == 0))
  defp branch("keep odd values only", stream), do: Situ.filter(stream, &(rem(&1, 2) != 0))

  defp branch("keep v where v != 3 and v <= 4", stream),
    do: Situ.filter(stream, &(&1 != 3 and &1 <= 4))

  defp branch("keep v where " <> text, stream) do
    true = text =~ ~r/\A[v0-9 .+\-*\/()!=<>andor]+\z/
    {:ok, ast} = Code.string_to_quoted(text)
    Situ.filter(stream, fn v -> ast |> Code.eval_quoted(v: v) |> elem(0) end)
  end

  defp branch(text, stream) when text in [nil, "identity", "v"], do: stream

  defp branch(text, stream) do
    fun = Run.arithmetic(text, [:v])
    Situ.map(stream, &fun.([&1]))
  end
end
