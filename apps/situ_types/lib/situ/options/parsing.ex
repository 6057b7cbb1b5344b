defmodule Situ.Options.Parsing do
  @moduledoc false
  # Converts options from JSON or a command line, which have neither atoms nor units, to the types of a schema.
  alias Situ.Time

  @doc "Returns the options with the names and types of the schema, not yet validated, or the first unknown name."
  @spec parse(%{String.t() => term()}, keyword()) :: {:ok, keyword()} | {:unknown, String.t()}
  def parse(values, schema) do
    Enum.reduce_while(values, {:ok, []}, fn {name, value}, {:ok, opts} ->
      case Enum.find(schema, fn {key, _} -> Atom.to_string(key) == name end) do
        nil -> {:halt, {:unknown, name}}
        {key, spec} -> {:cont, {:ok, [{key, convert_value(spec[:type], value)} | opts]}}
      end
    end)
  end

  # A string selects the choice of that name. An integer is accepted for a float, 90.0 for 90, a single string for a
  # list of strings, and a duration such as "200ms" for a number of nanoseconds.
  defp convert_value({:in, choices}, text) when is_binary(text),
    do: Enum.find(choices, text, &(to_string(&1) == text))

  defp convert_value({:optional, type}, value) when value != nil, do: convert_value(type, value)
  defp convert_value({:list, :string}, text) when is_binary(text), do: [text]
  defp convert_value(:float, n) when is_integer(n), do: n / 1

  defp convert_value(:time_ns, text) when is_binary(text) do
    case Time.parse_duration(text) do
      {:ok, ns} -> ns
      :error -> text
    end
  end

  defp convert_value(type, x) when is_float(x) and x == trunc(x),
    do: if(integer_type?(type), do: trunc(x), else: x)

  defp convert_value(_type, value), do: value

  defp integer_type?({:integer, _, _}), do: true
  defp integer_type?(type), do: type in [:integer, :pos_integer, :non_neg_integer, :time_ns]
end
