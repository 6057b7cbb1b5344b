defmodule Situ.Conformance.Fuse do
  import Situ.Conformance.Case, except: [time: 1]
  alias Situ.Conformance.{Facts, Formula, Run, Text}

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
  def check(%{"op" => op, "params" => params} = case)
      when op in ["join.chain", "fuse.chain", "pair.chain"] do
    kind = String.trim_trailing(op, ".chain")
    names = Enum.map(case["inputs"], & &1["stream"])
    defaults = defaults(params, names)

    build = fn streams ->
      named = Map.new(Enum.zip(names, streams))
      join = &link(kind, &1, &2, params, defaults)
      chained(params["order"] || Enum.join(names, " join "), named, join)
    end

    run = if kind == "pair", do: &Run.by_time/2, else: &Run.inputs/2
    chain_outcome(case, run.(if(kind == "pair", do: case["inputs"], else: case), build), defaults)
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

    with :pass <- outputs(case, shaped(Run.inputs(case, build), case)),
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
      with :pass <- outputs(case, shaped(Run.in_turn(inputs, build), case)), do: nil
    end)
  end

  defp any_arrival(_case, _params, _build), do: :pass

  defp operator("fuse", args), do: apply(Situ, :fuse, args)
  defp operator("join", args), do: apply(Situ, :join, args)

  defp interpolator(params),
    do: Situ.Conformance.Interpolators.of_params(params, "reproducible.exact")

  # Several secondaries are a list in Situ and in the reference. A file may write them flat.
  defp shaped({:ok, outputs}, %{"expect" => [%{"v" => [_ | rest]} | _], "inputs" => [_, _, _ | _]}) do
    flat? = not Enum.any?(rest, &is_list/1)

    {:ok,
     for({time, v} <- outputs, do: {time, if(flat?, do: v |> plain() |> List.flatten(), else: v)})}
  end

  defp shaped(result, _case), do: result

  # Values that stand for missing secondaries, by the name of their stream: one for all, a list for
  # all streams but the first, or an object.
  defp defaults(params, [first | others] = names) do
    interpolator = if is_map(params["interpolator"]), do: params["interpolator"], else: %{}
    all = ~w(initial_value initial_values initial default defaults)
    found = Enum.find_value(all, &(params[&1] || interpolator[&1]))

    case found do
      nil ->
        %{}

      %{} = by_name ->
        by_name

      list when is_list(list) and length(list) == length(others) ->
        Map.new(Enum.zip(others, list))

      list when is_list(list) and length(list) == length(names) ->
        Map.new(Enum.zip(names, list))

      list when is_list(list) ->
        Text.unknown!("a value for each of #{Enum.join(names, ", ")}", list)

      value ->
        Map.new([first | others], &{&1, value})
    end
  end

  # Links two operands, each `{stream, names}`.
  defp link("pair", {left, names}, {right, others}, params, defaults) do
    opts = if defaults == %{}, do: [], else: [initial: default(others, defaults)]
    {Situ.pair(left, right, opts ++ creator(params)), names ++ others}
  end

  defp link(kind, {left, names}, {right, others}, params, defaults) do
    params =
      if is_map(params["interpolator"]) and defaults != %{},
        do: put_in(params, ["interpolator", "default"], default(others, defaults)),
        else: params

    {operator(kind, [left, right, interpolator(params), []]), names ++ others}
  end

  defp default([name], defaults), do: Map.fetch!(defaults, name)
  defp default(names, defaults), do: List.to_tuple(Enum.map(names, &Map.fetch!(defaults, &1)))

  defp chain_outcome(%{"expect" => %{} = expect} = case, {:ok, outputs}, defaults) do
    sources =
      for input <- case["inputs"],
          do: [defaults[input["stream"]] | Enum.map(timed(input["messages"]), &elem(&1, 1))]

    values = for {_, v} <- outputs, do: plain(v)
    flat? = Enum.all?(values, &flat?(&1, sources))

    known =
      for {key, wanted} <- expect,
          answer = chain_fact(key, wanted, flat?, sources),
          into: %{},
          do: {key, elem(answer, 0)}

    all(case, Facts.of(expect, outputs, known))
  end

  defp chain_outcome(case, result, _defaults), do: outputs(case, result)

  # An output is flat if it has one value of each stream, in the order of the streams.
  defp flat?(values, sources) do
    is_list(values) and length(values) == length(sources) and
      Enum.all?(Enum.zip(values, sources), fn {v, source} -> v in source end)
  end

  defp chain_fact(key, wanted, flat?, sources) do
    cond do
      key =~ ~r/^(arity|width)$|tuple|item|element/ and is_integer(wanted) ->
        {if(flat?, do: length(sources), else: :not_flat)}

      key =~ ~r/flat|collaps/ and is_boolean(wanted) ->
        {flat?}

      is_binary(wanted) and Text.compare(wanted, 0) == nil ->
        size = Text.word_number(wanted)
        fits? = flat? and (size == nil or size == length(sources))
        {meant(wanted, ~r/flat|collaps|item|element|letter|stream/, fits?)}

      true ->
        nil
    end
  end

  # Reads an order of operations. An operand is `{stream, names of its inputs}`.
  defp chained(order, named, join) do
    # "a.join(b)" is "a join (b)".
    order = Regex.replace(~r/\.(join|fuse|pair)\(/, order, " \\1 (")
    words = Regex.scan(~r/[()]|[^\s()]+/, order) |> List.flatten()
    # An extra opening parenthesis is ignored.
    surplus = Enum.count(words, &(&1 == "(")) - Enum.count(words, &(&1 == ")"))
    {{stream, _names}, _rest} = words |> Enum.drop(max(surplus, 0)) |> pairs(named, join)
    stream
  end

  defp pairs(words, named, join) do
    {left, rest} = operand(words, named, join)
    pairs(left, rest, named, join)
  end

  defp pairs(left, [word | rest], named, join) when word in ~w(join fuse pair with and) do
    {right, rest} = operand(rest, named, join)
    pairs(join.(left, right), rest, named, join)
  end

  defp pairs(left, [")" | _] = rest, _named, _join), do: {left, rest}
  defp pairs(left, [], _named, _join), do: {left, []}

  defp pairs(_left, rest, _named, _join),
    do: Text.unknown!("an order of operations", Enum.join(rest, " "))

  defp operand(["(" | rest], named, join) do
    {operand, rest} = pairs(rest, named, join)
    {operand, Enum.drop(rest, 1)}
  end

  defp operand([name | rest], named, _join) when is_map_key(named, name),
    do: {{named[name], [name]}, rest}

  defp operand(words, _named, _join), do: Text.unknown!("an operand", Enum.join(words, " "))

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
