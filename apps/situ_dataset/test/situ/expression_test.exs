defmodule Situ.ExpressionTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Expression

  doctest Situ.Expression

  # The reference evaluates its own trees by the rules of the guide, without the parser or the
  # compiler.
  defp tree, do: sized(fn size -> tree(min(size, 12)) end)

  defp tree(0) do
    one_of([
      map(integer(-20, 20), &{:lit, &1}),
      map(integer(0, 80), &{:lit, &1 / 8}),
      map(one_of(["", "a", "it's", "äb"]), &{:lit, &1}),
      map(one_of([true, false, nil]), &{:lit, &1}),
      map(one_of(["x", "y", "none", "list", "map"]), &{:var, &1})
    ])
  end

  defp tree(n) do
    half = tree(div(n, 2))

    one_of([
      tree(0),
      map({one_of(~w(+ - * / % == != < <= > >= in and or)), half, half}, fn {op, a, b} ->
        {:op, op, a, b}
      end),
      map({one_of(["-", "not"]), half}, fn {op, a} -> {:un, op, a} end),
      map({half, one_of(["k", "z"])}, fn {a, name} -> {:dot, a, name} end),
      map({half, half}, fn {a, i} -> {:at, a, i} end),
      map({half, half, half}, fn {a, b, c} -> {:call, "if", [a, b, c]} end),
      map({one_of(["abs", "floor", "len", "text", "number", "sqrt"]), half}, fn {f, a} ->
        {:call, f, [a]}
      end),
      map({one_of(["min", "max", "coalesce", "contains"]), half, half}, fn {f, a, b} ->
        {:call, f, [a, b]}
      end),
      map(list(half, 2), &{:list, &1})
    ])
  end

  defp show({:lit, text}) when is_binary(text), do: "'" <> String.replace(text, "'", "''") <> "'"
  defp show({:lit, nil}), do: "null"
  defp show({:lit, n}) when is_number(n) and n < 0, do: "(#{n})"
  defp show({:lit, value}), do: to_string(value)
  defp show({:var, name}), do: name
  defp show({:op, op, a, b}), do: "(#{show(a)} #{op} #{show(b)})"
  defp show({:un, op, a}), do: "(#{op} #{show(a)})"
  defp show({:dot, a, name}), do: "(#{show(a)}).#{name}"
  defp show({:at, a, i}), do: "(#{show(a)})[#{show(i)}]"
  defp show({:call, f, args}), do: "#{f}(#{Enum.map_join(args, ", ", &show/1)})"
  defp show({:list, items}), do: "[#{Enum.map_join(items, ", ", &show/1)}]"

  @env %{"x" => 3, "y" => -1.5, "list" => [1, "a", nil], "map" => %{"k" => 7, "n" => nil}}

  defp ref({:lit, value}), do: value
  defp ref({:var, name}), do: @env[name]
  defp ref({:list, items}), do: Enum.map(items, &ref/1)
  defp ref({:un, "-", a}), do: with(n when is_number(n) <- ref(a), do: -n) |> number()
  defp ref({:un, "not", a}), do: ref(a) != true
  defp ref({:op, "and", a, b}), do: ref(a) == true and ref(b) == true
  defp ref({:op, "or", a, b}), do: ref(a) == true or ref(b) == true
  defp ref({:op, op, a, b}), do: operator(op, ref(a), ref(b))
  defp ref({:dot, a, name}), do: with(%{} = map <- ref(a), do: map[name]) |> unless_map(ref(a))
  defp ref({:at, a, i}), do: at(ref(a), ref(i))
  defp ref({:call, "if", [c, a, b]}), do: if(ref(c) == true, do: ref(a), else: ref(b))
  defp ref({:call, f, args}), do: function(f, Enum.map(args, &ref/1))

  defp number(n) when is_number(n), do: n
  defp number(_), do: nil
  defp unless_map(value, of), do: if(is_map(of), do: value)
  defp at(list, i) when is_list(list) and is_integer(i), do: Enum.at(list, i)
  defp at(%{} = map, key) when is_binary(key), do: map[key]
  defp at(_, _), do: nil

  defp operator("==", a, b), do: a == b
  defp operator("!=", a, b), do: a != b
  defp operator("in", a, b) when is_list(b), do: Enum.any?(b, &(&1 == a))
  defp operator("in", a, b) when is_map(b) and is_binary(a), do: is_map_key(b, a)
  defp operator("in", _, _), do: false

  defp operator(op, a, b) when op in ~w(< <= > >=) do
    same_kind = (is_number(a) and is_number(b)) or (is_binary(a) and is_binary(b))
    same_kind and apply(Kernel, String.to_atom(op), [a, b])
  end

  defp operator("+", a, b) when is_binary(a) and is_binary(b), do: a <> b
  defp operator(_, a, b) when not (is_number(a) and is_number(b)), do: nil
  defp operator("/", _, b) when b == 0, do: nil
  defp operator("%", _, b) when b == 0, do: nil
  defp operator("%", a, b) when is_integer(a) and is_integer(b), do: Integer.mod(a, b)
  defp operator("%", a, b), do: a - b * Float.floor(a / b)
  defp operator(op, a, b), do: apply(Kernel, String.to_atom(op), [a, b])

  defp function("abs", [n]) when is_number(n), do: abs(n)
  defp function("floor", [n]) when is_number(n), do: floor(n)
  defp function("sqrt", [n]) when is_number(n) and n >= 0, do: :math.sqrt(n)
  defp function("len", [text]) when is_binary(text), do: String.length(text)
  defp function("len", [list]) when is_list(list), do: length(list)
  defp function("len", [%{} = map]), do: map_size(map)
  defp function("text", [text]) when is_binary(text), do: text
  defp function("text", [v]) when is_number(v) or is_boolean(v), do: to_string(v)
  defp function("number", [n]) when is_number(n), do: n

  defp function("number", [text]) when is_binary(text) do
    cond do
      text =~ ~r/\A[+-]?\d+\z/ -> String.to_integer(text)
      text =~ ~r/\A[+-]?\d+\.\d+([eE][+-]?\d+)?\z/ -> String.to_float(text)
      true -> nil
    end
  end

  defp function("min", [a, b]) when is_number(a) and is_number(b), do: min(a, b)
  defp function("max", [a, b]) when is_number(a) and is_number(b), do: max(a, b)
  defp function("coalesce", [a, b]), do: if(a == nil, do: b, else: a)
  defp function("contains", [a, b]) when is_binary(a) and is_binary(b), do: String.contains?(a, b)
  defp function("contains", [a, b]) when is_list(a), do: Enum.any?(a, &(&1 == b))
  defp function(_, _), do: nil

  property "the compiled form returns the result of the reference", numtests: 1_000 do
    forall tree <- tree() do
      source = show(tree)
      {:ok, expression} = Expression.parse(source)
      got = Expression.eval(expression, @env)
      assert got == ref(tree), "#{source}: #{inspect(got)}, expected #{inspect(ref(tree))}"
      true
    end
  end

  property "parses any text without raising", numtests: 500 do
    forall text <-
             one_of([
               binary(),
               ascii_text(),
               map(list(one_of(~w|( ) [ ] m . + - 1 'a' and not in , min `|)), &Enum.join/1)
             ]) do
      case Expression.parse(text) do
        {:ok, expression} -> Expression.eval(expression, %{"m" => 1})
        {:error, %Situ.Error{code: :bad_expression}} -> :ok
      end

      true
    end
  end

  property "evaluates any value without raising", numtests: 300 do
    sources =
      for s <- [
            "m.a[0] + 1",
            "m in m",
            "-m",
            "m == 1",
            "m[0]",
            "len(m)",
            "sum(m)",
            "min(m)",
            "keys(m)",
            "lower(m)",
            "m % 3",
            "contains(m, m)",
            "text(m) + 'x'",
            "m < 'a'"
          ],
          do: Expression.parse!(s)

    forall value <- term() do
      for e <- sources, do: Expression.eval(e, %{"m" => value})
      true
    end
  end

  test "parses precedence, units and quotes" do
    for {source, value} <- [
          {"1 + 2 * 3", 7},
          {"(1 + 2) * 3", 9},
          {"2 - 1 - 1", 0},
          {"not 1 == 2", true},
          {"true or false and false", true},
          {"-2 * -3", 6},
          {"500ms", 500_000_000},
          {"1.5min", 90_000_000_000},
          {"'it''s'", "it's"},
          {"\"a\" + 'b'", "ab"},
          {"1.0 == 1", true},
          {"[1, 2, 3][-1]", 3},
          {"3 in [1, 2, 3]", true},
          {"7 / 0", nil},
          {"1e308 * 10", nil},
          {"`a.b`", nil}
        ],
        do: assert(Expression.eval(Expression.parse!(source), %{}) == value, source)
  end

  test "reads structs, tuples and atoms of messages" do
    message = %Situ.Message{
      data: %{pose: {1.5, :walking}},
      originating_time: 5,
      creation_time: 7,
      sequence_id: 1
    }

    eval = fn source ->
      Expression.eval(Expression.parse!(source), Expression.message_env(message))
    end

    assert eval.("m.pose[0] * 2") == 3.0
    assert eval.("m.pose[1] == 'walking'")
    assert eval.("latency") == 2
    refute eval.("m.__struct__ == 'x'")
    assert eval.("m.an_atom_nobody_has_ever_made_here") == nil
  end

  test "rejects expressions that are too long, too deep or invalid, with the position" do
    for {source, why} <- [
          {"", "character 1"},
          {"1 +", "the end of the expression"},
          {"1 2", "unexpected 2"},
          {"m.", "name of a field"},
          {"foo(1)", "does not exist"},
          {"mim(1)", "did you mean min"},
          {"abs(1, 2)", "takes 1"},
          {"'open", "closing '"},
          {"1km", "not a unit"},
          {"1e999", "too large"},
          {"a & b", "unexpected character"},
          {String.duplicate("(", 200) <> "1" <> String.duplicate(")", 200), "nested"},
          {Enum.join(List.duplicate("1", 600), "+"), "more than 1000 parts"},
          {String.duplicate("1", 20_000), "longer"}
        ] do
      assert {:error, %{code: :bad_expression, why: said}} = Expression.parse(source)
      assert said =~ why, "#{String.slice(source, 0, 40)}: #{said}"
    end
  end

  test "limits the size of numbers and strings" do
    big = Enum.map_join(1..200, "*", fn _ -> "99999999999" end)
    assert Expression.eval(Expression.parse!(big), %{}) == nil
    text = String.duplicate("x", 600_000)
    assert Expression.eval(Expression.parse!("m + m"), %{"m" => text}) == nil
  end
end
