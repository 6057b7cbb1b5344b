defmodule Situ.Conformance.Fuse do
  import Situ.Conformance.Case, except: [time: 1]
  alias Situ.Conformance.{Formula, Run}

  Code.require_file("interpolators.exs", __DIR__)

  def check(%{"op" => "pair", "params" => params} = case) do
    initial = Map.fetch(params, "initial_value")
    opts = if match?({:ok, v} when v != nil, initial), do: [initial: elem(initial, 1)], else: []
    build = fn [p, s] -> Situ.pair(p, s, opts ++ creator(params)) end

    if Enum.any?(case["inputs"], & &1["arrives_after_ms"]),
      do: outputs(case, Run.in_turn(case["inputs"], build)),
      else: outputs(case, Run.by_time(case["inputs"], build))
  end

  # "(((a join b) join c)" or "a join (b join c)": the names are those of the inputs.
  def check(%{"op" => op, "params" => params} = case) when op in ["join.chain", "fuse.chain"] do
    interpolator = interpolator(params)
    names = Enum.map(case["inputs"], & &1["stream"])

    outputs(
      case,
      Run.inputs(case, fn streams ->
        named = Map.new(Enum.zip(names, streams))
        join = &operator(String.trim_trailing(op, ".chain"), [&1, &2, interpolator, []])
        chained(params["order"] || Enum.join(names, " join "), named, join)
      end)
    )
  end

  def check(%{"op" => op, "params" => params} = case) when op in ["join.vector", "fuse.vector"] do
    [kind, "vector"] = String.split(op, ".")
    interpolator = interpolator(params)

    if case["inputs"] == [],
      do: outputs(case, attempt(fn -> operator(kind, [[], interpolator, []]) end)),
      else: outputs(case, Run.inputs(case, &operator(kind, [&1, interpolator, []])))
  end

  def check(%{"op" => kind, "params" => params} = case) when kind in ["fuse", "join"] do
    {interpolator, opts} = {interpolator(params), creator(params)}

    build = fn
      [p, s] -> operator(kind, [p, s, interpolator, opts])
      [p | secondaries] -> operator(kind, [p, secondaries, interpolator, opts])
    end

    with :pass <- outputs(case, Run.inputs(case, build)),
         do: any_arrival(case, params, build)
  end

  # A reproducible result is the same for every order of arrival.
  defp any_arrival(
         %{"inputs" => [_, _ | _]} = case,
         %{"interpolator" => %{"kind" => "reproducible." <> _}},
         build
       ) do
    inputs = Enum.map(case["inputs"], &Map.delete(&1, "keep_open"))
    late = fn index -> List.update_at(inputs, index, &Map.put(&1, "arrives_after_ms", 100)) end

    Enum.find_value([late.(0), late.(1)], :pass, fn inputs ->
      with :pass <- outputs(case, Run.in_turn(inputs, build)), do: nil
    end)
  end

  defp any_arrival(_case, _params, _build), do: :pass

  defp operator("fuse", args), do: apply(Situ, :fuse, args)
  defp operator("join", args), do: apply(Situ, :join, args)

  defp interpolator(params),
    do: Situ.Conformance.Interpolators.of_params(params, "reproducible.exact")

  defp chained(order, named, join) do
    words = Regex.scan(~r/[()]|[^\s()]+/, order) |> List.flatten()
    # An extra opening parenthesis is ignored.
    surplus = Enum.count(words, &(&1 == "(")) - Enum.count(words, &(&1 == ")"))
    {stream, _rest} = words |> Enum.drop(max(surplus, 0)) |> pairs(named, join)
    stream
  end

  defp pairs(words, named, join) do
    {left, rest} = operand(words, named, join)
    pairs(left, rest, named, join)
  end

  defp pairs(left, [word | rest], named, join) when word != ")" do
    {right, rest} = operand(rest, named, join)
    pairs(join.(left, right), rest, named, join)
  end

  defp pairs(left, rest, _named, _join), do: {left, rest}

  defp operand(["(" | rest], named, join) do
    {stream, rest} = pairs(rest, named, join)
    {stream, Enum.drop(rest, 1)}
  end

  defp operand([name | rest], named, _join), do: {Map.fetch!(named, name), rest}

  defp creator(params) do
    case params["output"] do
      nil -> []
      "secondary value only" -> [with: fn _p, s -> s end]
      "primary value only" -> [with: fn p, _s -> p end]
      text -> [with: two(Formula.function(text))]
    end
  end

  defp two(fun), do: fn p, s -> fun.(%{"p" => p, "s" => s, "primary" => p, "secondary" => s}) end
end
