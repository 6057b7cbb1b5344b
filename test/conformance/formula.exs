defmodule Situ.Conformance.Formula do
  # Converts the small formulas in the files ("10*p + s", "v mod 3 == 0 and v > 4", "v is even")
  # to functions of named values. They are parsed and evaluated here, never as code, because a
  # conformance folder may come from anywhere. As in the reference's language, dividing integers
  # gives an integer.

  @accumulators ~w(x a acc accumulator previous prev last state sum total aggregate)

  @functions %{
    {"abs", 1} => &Kernel.abs/1,
    {"min", 2} => &Kernel.min/2,
    {"max", 2} => &Kernel.max/2,
    {"sqrt", 1} => &:math.sqrt/1
  }

  # Returns a function of a map from names to values.
  def function(text) do
    case is_binary(text) and text |> tokens() |> disjunction() do
      {tree, []} -> fn values -> value(tree, values) end
      _ -> Situ.Conformance.Text.unknown!("a formula", text)
    end
  end

  # Returns a function of the only value in a formula, independent of its name.
  def of_one(text) do
    function = function(text)
    names = names(text)
    if length(names) > 1, do: Situ.Conformance.Text.unknown!("a formula of one value", text)
    fn value -> function.(Map.new(names, &{&1, value})) end
  end

  # Returns a function of the previous result and the value: "x + y", "v - previous", "acc * v".
  def of_two(text) do
    function = function(text)
    names = names(text)
    before = Enum.find(@accumulators, &(&1 in names)) || hd(names ++ ["x"])

    fn previous, value ->
      function.(Map.new(names, &{&1, if(&1 == before, do: previous, else: value)}))
    end
  end

  # Returns a condition without the words around it: "keep even values only", "fails when v > 5",
  # "v where v != 3".
  def condition(text) do
    plain = Regex.replace(~r/^.*\b(?:when|where|if)\s+/, text, "")

    plain =
      Regex.replace(
        ~r/^(?:keep |only )*(even|odd)(?: values| numbers)?(?: only)?$/,
        plain,
        "v is \\1"
      )

    function = of_one(plain)
    fn value -> function.(value) == true end
  end

  defp names(text) do
    words =
      ~w(is even odd null not and or mod true false) ++
        Enum.map(Map.keys(@functions), &elem(&1, 0))

    for({:name, name} <- tokens(text), name not in words, do: name) |> Enum.uniq()
  end

  @token ~r/\s*(?:(\d+(?:\.\d+)?(?:e-?\d+)?)|([A-Za-z_]\w*)|('[^']*'|"[^"]*")|(<=|>=|==|!=|<>|&&|\|\||[-+*\/%<>=!(),]))/

  defp tokens(text), do: tokens(String.trim(text), text)
  defp tokens("", _whole), do: []

  defp tokens(text, whole) do
    case Regex.run(@token, text, return: :index) do
      [{0, length} | groups] ->
        {at, size} = List.last(groups)
        token = token(length(groups), binary_part(text, at, size))

        [
          token
          | tokens(
              String.trim_leading(binary_part(text, length, byte_size(text) - length)),
              whole
            )
        ]

      _ ->
        Situ.Conformance.Text.unknown!("a formula", {whole, :at, text})
    end
  end

  defp token(1, number) do
    case Integer.parse(number) do
      {n, ""} -> {:number, n}
      _ -> {:number, number |> Float.parse() |> elem(0)}
    end
  end

  defp token(2, name), do: {:name, name}
  defp token(3, text), do: {:text, String.slice(text, 1, String.length(text) - 2)}
  defp token(4, symbol), do: {:symbol, symbol}

  # One function per level of precedence, weakest first.
  defp disjunction(tokens),
    do: level(tokens, &conjunction/1, [{:name, "or"}, {:symbol, "||"}])

  defp conjunction(tokens),
    do: level(tokens, &comparison/1, [{:name, "and"}, {:symbol, "&&"}])

  defp comparison(tokens),
    do: level(tokens, &sum/1, for(s <- ~w(== = != <> < <= > >=), do: {:symbol, s}))

  defp sum(tokens), do: level(tokens, &product/1, [{:symbol, "+"}, {:symbol, "-"}])

  defp product(tokens),
    do:
      level(tokens, &property/1, [{:symbol, "*"}, {:symbol, "/"}, {:symbol, "%"}, {:name, "mod"}])

  defp level(tokens, below, operators) do
    {left, rest} = below.(tokens)
    level(left, rest, below, operators)
  end

  defp level(left, [{_, operator} = token | rest] = tokens, below, operators) do
    if token in operators do
      {right, rest} = below.(rest)
      level({operator, left, right}, rest, below, operators)
    else
      {left, tokens}
    end
  end

  defp level(left, [], _below, _operators), do: {left, []}

  defp property(tokens) do
    case unary(tokens) do
      {left, [{:name, "is"}, {:name, "not"}, {:name, what} | rest]} ->
        {{:not, {:is, left, what}}, rest}

      {left, [{:name, "is"}, {:name, what} | rest]} ->
        {{:is, left, what}, rest}

      plain ->
        plain
    end
  end

  defp unary([{:symbol, "-"} | rest]) do
    {tree, rest} = unary(rest)
    {{"-", {:number, 0}, tree}, rest}
  end

  defp unary([token | rest]) when token in [{:symbol, "!"}, {:name, "not"}] do
    {tree, rest} = unary(rest)
    {{:not, tree}, rest}
  end

  defp unary([{:symbol, "("} | rest]) do
    {tree, [{:symbol, ")"} | rest]} = disjunction(rest)
    {tree, rest}
  end

  defp unary([{:name, name}, {:symbol, "("} | rest]) do
    {arguments, rest} = arguments(rest)
    {{:call, {name, length(arguments)}, arguments}, rest}
  end

  defp unary([{:name, word} | rest]) when word in ~w(true false null),
    do: {{:text, %{"true" => true, "false" => false, "null" => nil}[word]}, rest}

  defp unary([{kind, _} = leaf | rest]) when kind in [:number, :name, :text], do: {leaf, rest}
  defp unary(tokens), do: Situ.Conformance.Text.unknown!("the end of a formula", tokens)

  defp arguments(tokens) do
    case disjunction(tokens) do
      {tree, [{:symbol, ","} | rest]} ->
        {others, rest} = arguments(rest)
        {[tree | others], rest}

      {tree, [{:symbol, ")"} | rest]} ->
        {[tree], rest}
    end
  end

  defp value({:number, number}, _values), do: number
  defp value({:text, text}, _values), do: text
  defp value({:name, name}, values), do: Map.fetch!(values, name)
  defp value({:not, tree}, values), do: not value(tree, values)
  defp value({:is, tree, "even"}, values), do: parity(value(tree, values)) == 0
  defp value({:is, tree, "odd"}, values), do: parity(value(tree, values)) == 1
  defp value({:is, tree, "null"}, values), do: value(tree, values) == nil

  defp value({:call, function, arguments}, values),
    do: apply(Map.fetch!(@functions, function), Enum.map(arguments, &value(&1, values)))

  defp value({word, a, b}, values) when word in ["and", "&&"],
    do: value(a, values) and value(b, values)

  defp value({word, a, b}, values) when word in ["or", "||"],
    do: value(a, values) or value(b, values)

  defp value({operator, a, b}, values), do: apply_to(operator, value(a, values), value(b, values))

  defp parity(number), do: number |> trunc() |> Integer.mod(2)

  defp apply_to("+", a, b) when is_binary(a) or is_binary(b), do: "#{a}#{b}"
  defp apply_to("+", a, b), do: a + b
  defp apply_to("-", a, b), do: a - b
  defp apply_to("*", a, b), do: a * b
  defp apply_to("/", a, b) when is_integer(a) and is_integer(b), do: div(a, b)
  defp apply_to("/", a, b), do: a / b
  defp apply_to(operator, a, b) when operator in ["%", "mod"], do: rem(trunc(a), trunc(b))
  defp apply_to(operator, a, b) when operator in ["==", "="], do: a == b
  defp apply_to(operator, a, b) when operator in ["!=", "<>"], do: a != b
  defp apply_to("<", a, b), do: a < b
  defp apply_to("<=", a, b), do: a <= b
  defp apply_to(">", a, b), do: a > b
  defp apply_to(">=", a, b), do: a >= b
end
