defmodule Situ.Expression.Value do
  @moduledoc false
  # The operators on values. All are total: an operation without a result returns nil. Values cannot grow without
  # limit: integers above 256 bits and strings above a megabyte become nil.

  @bound Bitwise.bsl(1, 256)
  @longest 1_048_576

  @spec member(term(), String.t()) :: term()
  def member(%{} = map, name) do
    case map do
      %{^name => value} -> plain(value)
      _ -> by_atom(map, name)
    end
  end

  def member(_, _), do: nil

  # A name must not create an atom; the atoms of struct fields exist already.
  defp by_atom(map, name) do
    key = String.to_existing_atom(name)
    if key == :__struct__, do: nil, else: map |> Map.get(key) |> plain()
  rescue
    ArgumentError -> nil
  end

  @spec index(term(), term()) :: term()
  def index(list, n) when is_list(list) and is_integer(n),
    do: if(proper?(list), do: list |> Enum.at(n) |> plain())

  def index(tuple, n) when is_tuple(tuple) and is_integer(n) and n >= 0 and n < tuple_size(tuple),
    do: plain(elem(tuple, n))

  def index(%{} = map, key) when is_binary(key), do: member(map, key)
  def index(%{} = map, key) when is_integer(key), do: map |> Map.get(key) |> plain()
  def index(_, _), do: nil

  defp proper?(list), do: not List.improper?(list)

  @doc """
  Converts a value of a message to a value of the language: tuples become lists, and atoms other than true, false and
  nil become strings.
  """
  @spec plain(term()) :: term()
  def plain(value) when is_boolean(value) or is_nil(value), do: value
  def plain(value) when is_atom(value), do: Atom.to_string(value)
  def plain(value) when is_tuple(value), do: Tuple.to_list(value)
  def plain(value), do: value

  @spec unary(String.t(), term()) :: term()
  def unary("-", n) when is_number(n), do: -n
  def unary("-", _), do: nil
  def unary("not", value), do: value != true

  @spec binary(String.t(), term(), term()) :: term()
  def binary("==", a, b), do: same?(a, b)
  def binary("!=", a, b), do: not same?(a, b)

  def binary(order, a, b) when order in ["<", "<=", ">", ">="] do
    cond do
      is_number(a) and is_number(b) -> compare(order, a, b)
      is_binary(a) and is_binary(b) -> compare(order, a, b)
      true -> false
    end
  end

  def binary("in", value, list) when is_list(list),
    do: proper?(list) and Enum.any?(list, &same?(plain(&1), value))

  def binary("in", key, %{} = map) when is_binary(key),
    do:
      Map.has_key?(map, key) or
        Enum.any?(Map.keys(map), &(is_atom(&1) and Atom.to_string(&1) == key))

  def binary("in", _, _), do: false

  def binary("+", a, b) when is_binary(a) and is_binary(b),
    do: if(byte_size(a) + byte_size(b) <= @longest, do: a <> b)

  def binary(operator, a, b) when is_number(a) and is_number(b), do: arithmetic(operator, a, b)
  def binary(_, _, _), do: nil

  defp compare("<", a, b), do: a < b
  defp compare("<=", a, b), do: a <= b
  defp compare(">", a, b), do: a > b
  defp compare(">=", a, b), do: a >= b

  # 1 and 1.0 are equal.
  defp same?(a, b) when is_number(a) and is_number(b), do: a == b
  defp same?(a, b), do: a === b

  defp arithmetic("+", a, b), do: bounded(fn -> a + b end)
  defp arithmetic("-", a, b), do: bounded(fn -> a - b end)
  defp arithmetic("*", a, b), do: bounded(fn -> a * b end)
  defp arithmetic("/", _, b) when b == 0, do: nil
  defp arithmetic("/", a, b), do: bounded(fn -> a / b end)

  defp arithmetic("%", a, b) when is_integer(a) and is_integer(b) and b != 0,
    do: Integer.mod(a, b)

  defp arithmetic("%", _, b) when b == 0, do: nil
  defp arithmetic("%", a, b), do: bounded(fn -> a - b * Float.floor(a / b) end)
  defp arithmetic(_, _, _), do: nil

  @doc "Returns the number that `fun` computes, or nil if it is too large or overflows."
  @spec bounded((() -> number())) :: number() | nil
  def bounded(fun) do
    case fun.() do
      n when is_integer(n) and (n >= @bound or n <= -@bound) -> nil
      n -> n
    end
  rescue
    ArithmeticError -> nil
  end
end
