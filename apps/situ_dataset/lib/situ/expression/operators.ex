defmodule Situ.Expression.Operators do
  @moduledoc false
  # Implements the operators of the expression language. They never fail: an operation without a result returns nil.
  # Values cannot grow without limit: integers above 256 bits and strings above a megabyte become nil.

  @bound Bitwise.bsl(1, 256)
  @longest 1_048_576

  @spec get_member(term(), String.t()) :: term()
  def get_member(%{} = map, name) do
    case map do
      %{^name => value} -> to_plain(value)
      _ -> get_by_atom(map, name)
    end
  end

  def get_member(_, _), do: nil

  # A name must not create an atom; the atoms of struct fields exist already.
  defp get_by_atom(map, name) do
    key = String.to_existing_atom(name)
    if key == :__struct__, do: nil, else: map |> Map.get(key) |> to_plain()
  rescue
    ArgumentError -> nil
  end

  @spec get_element(term(), term()) :: term()
  def get_element(list, n) when is_list(list) and is_integer(n),
    do: if(proper_list?(list), do: list |> Enum.at(n) |> to_plain())

  def get_element(tuple, n)
      when is_tuple(tuple) and is_integer(n) and n >= 0 and n < tuple_size(tuple),
      do: to_plain(elem(tuple, n))

  def get_element(%{} = map, key) when is_binary(key), do: get_member(map, key)
  def get_element(%{} = map, key) when is_integer(key), do: map |> Map.get(key) |> to_plain()
  def get_element(_, _), do: nil

  defp proper_list?(list), do: not List.improper?(list)

  @doc """
  Converts a value of a message to a value of the language: tuples become lists, and atoms other than true, false and
  nil become strings.
  """
  @spec to_plain(term()) :: term()
  def to_plain(value) when is_boolean(value) or is_nil(value), do: value
  def to_plain(value) when is_atom(value), do: Atom.to_string(value)
  def to_plain(value) when is_tuple(value), do: Tuple.to_list(value)
  def to_plain(value), do: value

  @spec apply_unary(String.t(), term()) :: term()
  def apply_unary("-", n) when is_number(n), do: -n
  def apply_unary("-", _), do: nil
  def apply_unary("not", value), do: value != true

  @spec apply_binary(String.t(), term(), term()) :: term()
  def apply_binary("==", a, b), do: equal_values?(a, b)
  def apply_binary("!=", a, b), do: not equal_values?(a, b)

  def apply_binary(order, a, b) when order in ["<", "<=", ">", ">="] do
    cond do
      is_number(a) and is_number(b) -> compare_order(order, a, b)
      is_binary(a) and is_binary(b) -> compare_order(order, a, b)
      true -> false
    end
  end

  def apply_binary("in", value, list) when is_list(list),
    do: proper_list?(list) and Enum.any?(list, &equal_values?(to_plain(&1), value))

  def apply_binary("in", key, %{} = map) when is_binary(key),
    do:
      Map.has_key?(map, key) or
        Enum.any?(Map.keys(map), &(is_atom(&1) and Atom.to_string(&1) == key))

  def apply_binary("in", _, _), do: false

  def apply_binary("+", a, b) when is_binary(a) and is_binary(b),
    do: if(byte_size(a) + byte_size(b) <= @longest, do: a <> b)

  def apply_binary(operator, a, b) when is_number(a) and is_number(b),
    do: compute_arithmetic(operator, a, b)

  def apply_binary(_, _, _), do: nil

  defp compare_order("<", a, b), do: a < b
  defp compare_order("<=", a, b), do: a <= b
  defp compare_order(">", a, b), do: a > b
  defp compare_order(">=", a, b), do: a >= b

  # 1 and 1.0 are equal.
  defp equal_values?(a, b) when is_number(a) and is_number(b), do: a == b
  defp equal_values?(a, b), do: a === b

  defp compute_arithmetic("+", a, b), do: bound_number(fn -> a + b end)
  defp compute_arithmetic("-", a, b), do: bound_number(fn -> a - b end)
  defp compute_arithmetic("*", a, b), do: bound_number(fn -> a * b end)
  defp compute_arithmetic("/", _, b) when b == 0, do: nil
  defp compute_arithmetic("/", a, b), do: bound_number(fn -> a / b end)

  defp compute_arithmetic("%", a, b) when is_integer(a) and is_integer(b) and b != 0,
    do: Integer.mod(a, b)

  defp compute_arithmetic("%", _, b) when b == 0, do: nil
  defp compute_arithmetic("%", a, b), do: bound_number(fn -> a - b * Float.floor(a / b) end)
  defp compute_arithmetic(_, _, _), do: nil

  @doc "Returns the number that `fun` computes, or nil if it is too large or overflows."
  @spec bound_number((() -> number())) :: number() | nil
  def bound_number(fun) do
    case fun.() do
      n when is_integer(n) and (n >= @bound or n <= -@bound) -> nil
      n -> n
    end
  rescue
    ArithmeticError -> nil
  end
end
