defmodule Situ.Expression.Functions do
  @moduledoc false
  # Implements the functions of the expression language. Like its operators, they return nil instead of failing.
  alias Situ.Expression.Operators

  @arities %{
    "abs" => [1],
    "floor" => [1],
    "ceil" => [1],
    "round" => [1],
    "sqrt" => [1],
    "log" => [1],
    "exp" => [1],
    "sin" => [1],
    "cos" => [1],
    "atan2" => [2],
    "min" => [1, 2, 3, 4],
    "max" => [1, 2, 3, 4],
    "sum" => [1],
    "mean" => [1],
    "len" => [1],
    "keys" => [1],
    "contains" => [2],
    "starts_with" => [2],
    "lower" => [1],
    "text" => [1],
    "number" => [1],
    "if" => [3],
    "coalesce" => [2, 3, 4],
    "latency" => [1],
    "age" => [1]
  }

  @doc "Returns the numbers of arguments that a function accepts, or nil if the function does not exist."
  @spec function_arities(String.t()) :: [pos_integer()] | nil
  def function_arities(name), do: Map.get(@arities, name)

  @spec function_names() :: [String.t()]
  def function_names, do: Map.keys(@arities)

  @spec call(String.t(), [term()]) :: term()
  def call("if", [condition, yes, no]), do: if(condition == true, do: yes, else: no)
  def call("coalesce", values), do: Enum.find(values, &(&1 != nil))
  def call("abs", [n]) when is_number(n), do: abs(n)
  def call("floor", [n]) when is_number(n), do: floor(n)
  def call("ceil", [n]) when is_number(n), do: ceil(n)
  def call("round", [n]) when is_number(n), do: round(n)

  def call("sqrt", [n]) when is_number(n) and n >= 0,
    do: Operators.bound_number(fn -> :math.sqrt(n) end)

  def call("log", [n]) when is_number(n) and n > 0,
    do: Operators.bound_number(fn -> :math.log(n) end)

  def call("exp", [n]) when is_number(n), do: Operators.bound_number(fn -> :math.exp(n) end)
  def call("sin", [n]) when is_number(n), do: Operators.bound_number(fn -> :math.sin(n) end)
  def call("cos", [n]) when is_number(n), do: Operators.bound_number(fn -> :math.cos(n) end)

  def call("atan2", [y, x]) when is_number(y) and is_number(x),
    do: Operators.bound_number(fn -> :math.atan2(y, x) end)

  def call(name, [list]) when name in ["min", "max", "sum", "mean"] and is_list(list) do
    if not List.improper?(list) and list != [] and Enum.all?(list, &is_number/1),
      do: fold_numbers(name, list)
  end

  def call(name, [_, _ | _] = numbers) when name in ["min", "max"],
    do: if(Enum.all?(numbers, &is_number/1), do: fold_numbers(name, numbers))

  def call("len", [text]) when is_binary(text),
    do: if(String.valid?(text), do: String.length(text), else: byte_size(text))

  def call("len", [list]) when is_list(list), do: if(not List.improper?(list), do: length(list))
  def call("len", [%{} = map]), do: map_size(map)

  def call("keys", [%{} = map]) do
    for key <- Map.keys(map),
        is_binary(key) or is_atom(key),
        key != :__struct__,
        do: to_string(key)
  end

  def call("contains", [text, part]) when is_binary(text) and is_binary(part),
    do: part == "" or String.contains?(text, part)

  def call("contains", [list, value]) when is_list(list),
    do: Operators.apply_binary("in", value, list)

  def call("starts_with", [text, part]) when is_binary(text) and is_binary(part),
    do: String.starts_with?(text, part)

  def call("lower", [text]) when is_binary(text),
    do: if(String.valid?(text), do: String.downcase(text))

  def call("text", [text]) when is_binary(text), do: text
  def call("text", [n]) when is_number(n) or is_boolean(n), do: to_string(n)

  def call("number", [text]) when is_binary(text) and byte_size(text) <= 100 do
    case {Integer.parse(text), Float.parse(text)} do
      {{n, ""}, _} -> Operators.bound_number(fn -> n end)
      {_, {x, ""}} -> x
      _ -> nil
    end
  end

  def call("number", [n]) when is_number(n), do: n
  def call(_, _), do: nil

  defp fold_numbers("min", list), do: Enum.min(list)
  defp fold_numbers("max", list), do: Enum.max(list)
  defp fold_numbers("sum", list), do: Operators.bound_number(fn -> Enum.sum(list) end)

  defp fold_numbers("mean", list),
    do: Operators.bound_number(fn -> Enum.sum(list) / length(list) end)
end
