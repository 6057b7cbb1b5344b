defmodule Situ.Conformance.Parallel do
  import Situ.Conformance.Case
  alias Situ.Conformance.{Formula, Operators, Run, Text, Windows}

  for file <- ~w(operators windows), do: Code.require_file("#{file}.exs", __DIR__)

  # "window [-10 ms, 20 ms]", "sum over the window (-10 ms, 20 ms)", "window from -10 to 20 ms as a list".
  @selector "(?:(\\w+) (?:over|of) (?:the |a )?)?"
  @manner " as a list|,? \\(?(?:both |ends )*(?:included|inclusive)\\)?"
  @windowed ~r/^#{@selector}(?:time |relative )?window(?: of)?\s*(?:from )?(.+?)(?:#{@manner})?$/

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
      stream
      |> Situ.parallel(&branch(branch_of(params), &1), options(form, params))
      |> combined(params["output"] || params["then"])
    end

    outputs(case, Run.inputs(case, build))
  end

  # The output as the case lists it: all branches (default), or a number made of them.
  defp combined(stream, nil), do: stream
  defp combined(stream, "sum" <> _), do: Situ.map(stream, &(&1 |> values() |> Enum.sum()))
  defp combined(stream, "count" <> _), do: Situ.map(stream, &(&1 |> values() |> length()))
  defp combined(_stream, text), do: Text.unknown!("an output of parallel branches", text)

  defp values(tuple) when is_tuple(tuple), do: Tuple.to_list(tuple)
  defp values(%{} = map), do: Map.values(map)
  defp values(list), do: list

  defp options(form, params) do
    default =
      if params["output_default_if_dropped"],
        do: [or_default: value(Map.get(params, "default", 0))],
        else: []

    form(form, params) ++ default ++ until(params["termination"])
  end

  # "never", "when_key_not_present", "after_key_not_present(2)" or {"after_key_not_present": 2}.
  defp until(nil), do: []
  defp until("never"), do: [until: :never]
  defp until("when_key_not_present"), do: [until: :absent]
  defp until(%{"after_key_not_present" => n}) when is_integer(n), do: [until: {:absent, n}]

  defp until(text) do
    case is_binary(text) && Regex.run(~r/^after_key_not_present\((\d+)\)$/, text) do
      [_, n] -> [until: {:absent, String.to_integer(n)}]
      _ -> Text.unknown!("the termination of branches", text)
    end
  end

  defp form("fixed" <> _, params), do: [size: params["size"] || params["length"]]
  defp form("variable" <> _, _params), do: [of: :lists]
  defp form("sparse" <> _, _params), do: [of: :maps]
  defp form(other, _params), do: Text.unknown!("a form of parallel", other)

  # A window may have its ends in the parameters of the case.
  defp branch_of(%{"branch" => text} = params) when text in ["window", "time window"],
    do: %{"window" => params}

  defp branch_of(params), do: params["branch"]

  # Branches as described in the files: "v / 100", "aggregate from 0: v - previous", "keep even
  # values only", "last", "window [-10 ms, 20 ms]", or an operation with its parameters.
  defp branch(%{"op" => "window.time"} = window, stream),
    do: branch(%{"window" => window["params"] || %{}}, stream)

  defp branch(%{"window" => %{} = params}, stream) do
    Situ.window(stream, Windows.window(params), Windows.selector(params))
  end

  defp branch(%{"op" => op} = operation, stream),
    do: Operators.build(op, stream, operation["params"] || %{})

  defp branch(text, stream) when text in [nil, "identity", "v"], do: stream

  defp branch("aggregate from " <> text, stream) do
    [seed, formula] = String.split(text, ":", parts: 2)
    {seed, ""} = seed |> String.trim() |> Integer.parse()
    fun = Formula.of_two(formula)
    Situ.scan(stream, seed, fn v, previous -> fun.(previous, v) end)
  end

  defp branch("where " <> text, stream), do: Situ.filter(stream, Formula.condition(text))
  defp branch("keep " <> _ = text, stream), do: Situ.filter(stream, Formula.condition(text))

  defp branch(text, stream) do
    # A call, "window(-10 ms, 20 ms)", includes both ends.
    text = Regex.replace(~r/window\(([^()]*)\)/, text, "window [\\1]")

    case Regex.run(@windowed, text) do
      [_, selector, interval | _] ->
        selector = if selector == "", do: %{}, else: %{"selector" => selector}
        Situ.window(stream, Windows.relative(interval), Windows.selector(selector))

      nil ->
        summary(text, stream)
    end
  end

  defp summary(text, stream) do
    case Regex.run(
           ~r/^(?:the |running )?(first|last|count|sum|min|max|average)(?: value)?(?: (\w+) values)?$/,
           text
         ) do
      [_, "first" | n] -> Situ.first(stream, many(n))
      [_, "last" | n] -> Situ.last(stream, many(n))
      [_, kind] -> apply(Situ, String.to_existing_atom(kind), [stream])
      nil -> Situ.map(stream, formula(text))
    end
  end

  # A single word is the name of something else, and not of a value.
  defp formula(text) do
    if text =~ ~r/^\w{2,}$/ and text not in ["value"],
      do: Text.unknown!("a branch", text),
      else: Formula.of_one(text)
  end

  defp many([]), do: 1
  defp many([word]), do: Text.word_number(word) || Text.unknown!("a number", word)
end
