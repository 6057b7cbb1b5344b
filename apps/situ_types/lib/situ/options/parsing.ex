defmodule Situ.Options.Parsing do
  @moduledoc false
  # Converts options that were written as JSON or on a command line, where there are no atoms and no units, to the types
  # of a schema.
  alias Situ.{Error, Options, Time}

  @doc "Returns the options in the schema's names and types, not yet validated."
  @spec parse(%{String.t() => term()}, Options.schema()) ::
          {:ok, keyword()} | {:error, Error.t()}
  def parse(values, schema) do
    Enum.reduce_while(values, {:ok, []}, fn {name, value}, {:ok, opts} ->
      case Enum.find(schema, fn {key, _} -> Atom.to_string(key) == name end) do
        nil -> {:halt, {:error, unknown_option_error(name, schema)}}
        {key, spec} -> {:cont, {:ok, [{key, convert_value(spec[:type], value)} | opts]}}
      end
    end)
  end

  defp unknown_option_error(name, schema) do
    names = for {key, spec} <- schema, spec[:doc] != false, do: Atom.to_string(key)
    Error.new(:unknown_option, "unknown option #{inspect(name)}", fix: suggest_name(name, names))
  end

  defp suggest_name(_name, []), do: "remove it: no options are supported here"

  defp suggest_name(name, names) do
    near = String.valid?(name) && Options.nearest_name(name, names)
    hint = if near, do: "did you mean #{near}? ", else: ""
    hint <> "Known options: " <> Enum.join(names, ", ")
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
