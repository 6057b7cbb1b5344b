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
    with {:ok, tokens} <- Lexer.tokens(text) do
      if length(tokens) > @most,
        do: {:error, 1, "it has more than #{@most} parts"},
        else: whole(tokens)
    end
  catch
    {:refused, at, why} -> {:error, at, why}
  end

  defp whole(tokens) do
    case disjunction(tokens, 0) do
      {tree, [{:end, _, _}]} -> {:ok, tree}
      {_, [token | _]} -> refuse(token, "unexpected #{shown(token)}")
    end
  end

  defp disjunction(tokens, depth), do: left(tokens, depth, ["or"], &conjunction/2)
  defp conjunction(tokens, depth), do: left(tokens, depth, ["and"], &negation/2)

  defp negation([{:operator, "not", at} | tokens], depth) do
    {tree, rest} = negation(tokens, deeper(depth, at))
    {{:unary, "not", tree}, rest}
  end

  defp negation(tokens, depth), do: comparison(tokens, depth)

  # Comparisons cannot be chained: 1 < x < 3 must be written with "and".
  defp comparison(tokens, depth) do
    case sum(tokens, depth) do
      {a, [{:operator, operator, _} | rest]}
      when operator in ["==", "!=", "<", "<=", ">", ">=", "in"] ->
        {b, rest} = sum(rest, depth)
        {{:binary, operator, a, b}, rest}

      other ->
        other
    end
  end

  defp sum(tokens, depth), do: left(tokens, depth, ["+", "-"], &product/2)
  defp product(tokens, depth), do: left(tokens, depth, ["*", "/", "%"], &unary/2)

  defp unary([{:operator, "-", at} | tokens], depth) do
    {tree, rest} = unary(tokens, deeper(depth, at))
    {{:unary, "-", tree}, rest}
  end

  defp unary(tokens, depth) do
    {tree, rest} = primary(tokens, depth)
    postfix(tree, rest, depth)
  end

  defp left(tokens, depth, operators, next) do
    {tree, rest} = next.(tokens, depth)
    more(tree, rest, depth, operators, next)
  end

  defp more(tree, [{:operator, operator, _} | rest] = tokens, depth, operators, next) do
    if operator in operators do
      {right, rest} = next.(rest, depth)
      more({:binary, operator, tree, right}, rest, depth, operators, next)
    else
      {tree, tokens}
    end
  end

  defp more(tree, tokens, _depth, _operators, _next), do: {tree, tokens}

  defp postfix(tree, [{:operator, ".", _}, {:name, name, _} | rest], depth),
    do: postfix({:member, tree, name}, rest, depth)

  defp postfix(_tree, [{:operator, ".", _}, token | _], _depth),
    do: refuse(token, "expected the name of a field after the dot")

  defp postfix(tree, [{:operator, "[", at} | rest], depth) do
    {index, rest} = disjunction(rest, deeper(depth, at))
    postfix({:index, nil, tree, index}, expect(rest, "]"), depth)
  end

  defp postfix(tree, rest, _depth), do: {tree, rest}

  defp primary([{kind, value, _} | rest], _depth) when kind in [:number, :text],
    do: {{:literal, value}, rest}

  defp primary([{:operator, "true", _} | rest], _depth), do: {{:literal, true}, rest}
  defp primary([{:operator, "false", _} | rest], _depth), do: {{:literal, false}, rest}
  defp primary([{:operator, "null", _} | rest], _depth), do: {{:literal, nil}, rest}

  defp primary([{:name, name, at}, {:operator, "(", _} | rest], depth) do
    {arguments, rest} = items(rest, ")", deeper(depth, at))
    {call(name, arguments, at), rest}
  end

  defp primary([{:name, name, _} | rest], _depth), do: {{:name, name}, rest}

  defp primary([{:operator, "(", at} | rest], depth) do
    {tree, rest} = disjunction(rest, deeper(depth, at))
    {tree, expect(rest, ")")}
  end

  defp primary([{:operator, "[", at} | rest], depth) do
    {items, rest} = items(rest, "]", deeper(depth, at))
    {{:list, items}, rest}
  end

  defp primary([{:end, _, at} | _], _depth),
    do: throw({:refused, at, "expected a value, found the end of the expression"})

  defp primary([token | _], _depth),
    do: refuse(token, "expected a value, found #{shown(token)}")

  defp items([{:operator, close, _} | rest], close, _depth), do: {[], rest}

  defp items(tokens, close, depth) do
    case disjunction(tokens, depth) do
      {item, [{:operator, ",", _} | rest]} ->
        {items, rest} = items(rest, close, depth)
        {[item | items], rest}

      {item, rest} ->
        {[item], expect(rest, close)}
    end
  end

  defp call(name, arguments, at) do
    case Functions.arities(name) do
      nil ->
        near = Situ.Options.nearest(name, Functions.names())

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

  defp expect([{:operator, close, _} | rest], close), do: rest

  defp expect([token | _], close),
    do: refuse(token, "expected #{inspect(close)}, found #{shown(token)}")

  defp deeper(depth, at) do
    if depth >= @deepest,
      do: throw({:refused, at, "it is nested more than #{@deepest} levels deep"})

    depth + 1
  end

  @spec refuse(Lexer.token(), String.t()) :: no_return()
  defp refuse({_, _, at}, why), do: throw({:refused, at, why})

  defp shown({:end, _, _}), do: "the end"
  defp shown({_, value, _}), do: inspect(value)
end
