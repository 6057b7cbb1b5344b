defmodule Situ.Expression.Parser do
  @moduledoc false
  # Parses tokens to a tree by the grammar of docs/guides/expressions.md, with one function per precedence level.
  alias Situ.Expression.{Functions, Lexer}

  @most 1_000
  @deepest 100

  @type tree ::
          {:literal, term()}
          | {:name, String.t()}
          | {:list, [tree()]}
          | {:member, tree(), String.t()}
          | {:index, nil, tree(), tree()}
          | {:unary, String.t(), tree()}
          | {:binary, String.t(), tree(), tree()}
          | {:call, String.t(), [tree()]}

  @spec parse(String.t()) :: {:ok, tree()} | {:error, pos_integer(), String.t()}
  def parse(text) do
    with {:ok, tokens} <- Lexer.tokenize(text) do
      if length(tokens) > @most,
        do: {:error, 1, "it has more than #{@most} parts"},
        else: parse_expression(tokens)
    end
  catch
    {:refused, at, why} -> {:error, at, why}
  end

  defp parse_expression(tokens) do
    case parse_or(tokens, 0) do
      {tree, [{:end, _, _}]} -> {:ok, tree}
      {_, [token | _]} -> reject_token(token, "unexpected #{describe_token(token)}")
    end
  end

  defp parse_or(tokens, depth), do: parse_left_assoc(tokens, depth, ["or"], &parse_and/2)
  defp parse_and(tokens, depth), do: parse_left_assoc(tokens, depth, ["and"], &parse_not/2)

  defp parse_not([{:operator, "not", at} | tokens], depth) do
    {tree, rest} = parse_not(tokens, increase_depth(depth, at))
    {{:unary, "not", tree}, rest}
  end

  defp parse_not(tokens, depth), do: parse_comparison(tokens, depth)

  # Comparisons cannot be chained: 1 < x < 3 must be written with "and".
  defp parse_comparison(tokens, depth) do
    case parse_sum(tokens, depth) do
      {a, [{:operator, operator, _} | rest]}
      when operator in ["==", "!=", "<", "<=", ">", ">=", "in"] ->
        {b, rest} = parse_sum(rest, depth)
        {{:binary, operator, a, b}, rest}

      other ->
        other
    end
  end

  defp parse_sum(tokens, depth), do: parse_left_assoc(tokens, depth, ["+", "-"], &parse_product/2)

  defp parse_product(tokens, depth),
    do: parse_left_assoc(tokens, depth, ["*", "/", "%"], &parse_unary/2)

  defp parse_unary([{:operator, "-", at} | tokens], depth) do
    {tree, rest} = parse_unary(tokens, increase_depth(depth, at))
    {{:unary, "-", tree}, rest}
  end

  defp parse_unary(tokens, depth) do
    {tree, rest} = parse_primary(tokens, depth)
    parse_postfix(tree, rest, depth)
  end

  defp parse_left_assoc(tokens, depth, operators, next) do
    {tree, rest} = next.(tokens, depth)
    continue_left_assoc(tree, rest, depth, operators, next)
  end

  defp continue_left_assoc(
         tree,
         [{:operator, operator, _} | rest] = tokens,
         depth,
         operators,
         next
       ) do
    if operator in operators do
      {right, rest} = next.(rest, depth)
      continue_left_assoc({:binary, operator, tree, right}, rest, depth, operators, next)
    else
      {tree, tokens}
    end
  end

  defp continue_left_assoc(tree, tokens, _depth, _operators, _next), do: {tree, tokens}

  defp parse_postfix(tree, [{:operator, ".", _}, {:name, name, _} | rest], depth),
    do: parse_postfix({:member, tree, name}, rest, depth)

  defp parse_postfix(_tree, [{:operator, ".", _}, token | _], _depth),
    do: reject_token(token, "expected the name of a field after the dot")

  defp parse_postfix(tree, [{:operator, "[", at} | rest], depth) do
    {index, rest} = parse_or(rest, increase_depth(depth, at))
    parse_postfix({:index, nil, tree, index}, expect_operator(rest, "]"), depth)
  end

  defp parse_postfix(tree, rest, _depth), do: {tree, rest}

  defp parse_primary([{kind, value, _} | rest], _depth) when kind in [:number, :text],
    do: {{:literal, value}, rest}

  defp parse_primary([{:operator, "true", _} | rest], _depth), do: {{:literal, true}, rest}
  defp parse_primary([{:operator, "false", _} | rest], _depth), do: {{:literal, false}, rest}
  defp parse_primary([{:operator, "null", _} | rest], _depth), do: {{:literal, nil}, rest}

  defp parse_primary([{:name, name, at}, {:operator, "(", _} | rest], depth) do
    {arguments, rest} = parse_items(rest, ")", increase_depth(depth, at))
    {build_call(name, arguments, at), rest}
  end

  defp parse_primary([{:name, name, _} | rest], _depth), do: {{:name, name}, rest}

  defp parse_primary([{:operator, "(", at} | rest], depth) do
    {tree, rest} = parse_or(rest, increase_depth(depth, at))
    {tree, expect_operator(rest, ")")}
  end

  defp parse_primary([{:operator, "[", at} | rest], depth) do
    {items, rest} = parse_items(rest, "]", increase_depth(depth, at))
    {{:list, items}, rest}
  end

  defp parse_primary([{:end, _, at} | _], _depth),
    do: throw({:refused, at, "expected a value, found the end of the expression"})

  defp parse_primary([token | _], _depth),
    do: reject_token(token, "expected a value, found #{describe_token(token)}")

  defp parse_items([{:operator, close, _} | rest], close, _depth), do: {[], rest}

  defp parse_items(tokens, close, depth) do
    case parse_or(tokens, depth) do
      {item, [{:operator, ",", _} | rest]} ->
        {items, rest} = parse_items(rest, close, depth)
        {[item | items], rest}

      {item, rest} ->
        {[item], expect_operator(rest, close)}
    end
  end

  defp build_call(name, arguments, at) do
    case Functions.function_arities(name) do
      nil ->
        near = Situ.Options.nearest_name(name, Functions.function_names())

        throw(
          {:refused, at,
           "function #{inspect(name)} does not exist" <>
             if(near, do: "; did you mean #{near}?", else: "")}
        )

      arities ->
        if length(arguments) not in arities,
          do:
            throw(
              {:refused, at,
               "#{name} takes #{Enum.join(arities, " or ")} arguments, not #{length(arguments)}"}
            )

        {:call, name, arguments}
    end
  end

  defp expect_operator([{:operator, close, _} | rest], close), do: rest

  defp expect_operator([token | _], close),
    do: reject_token(token, "expected #{inspect(close)}, found #{describe_token(token)}")

  defp increase_depth(depth, at) do
    if depth >= @deepest,
      do: throw({:refused, at, "it is nested more than #{@deepest} levels deep"})

    depth + 1
  end

  @spec reject_token(Lexer.token(), String.t()) :: no_return()
  defp reject_token({_, _, at}, why), do: throw({:refused, at, why})

  defp describe_token({:end, _, _}), do: "the end"
  defp describe_token({_, value, _}), do: inspect(value)
end
