defmodule Situ.Studio.BatchRuns.Form do
  @moduledoc false
  # Builds a form from a task's option schema, and parses the options that a page submits.
  alias Situ.{Error, Options}

  @type field :: %{
          name: String.t(),
          kind: :text | :number | :check | :choice,
          value: term(),
          choices: [String.t()],
          doc: String.t() | nil,
          required: boolean()
        }

  @doc """
  Builds the form fields with the values of a configuration or their defaults. Hidden options have
  no field.

      iex> stream = [type: :string, default: "Audio", doc: "The sound."]
      iex> schema = [stream: stream, exact: [type: :boolean, default: false]]
      iex> for f <- Situ.Studio.BatchRuns.Form.build_fields(schema, %{}), do: {f.name, f.kind, f.value}
      [{"stream", :text, "Audio"}, {"exact", :check, false}]
      iex> Situ.Studio.BatchRuns.Form.parse_config(schema, %{"stream" => "Mic", "exact" => "true"})
      {:ok, %{"exact" => true, "stream" => "Mic"}}
      iex> {:error, error} = Situ.Studio.BatchRuns.Form.parse_config([rate: [type: :pos_integer]], %{"rate" => "fast"})
      iex> error.what
      "rate must be a whole number, not \\"fast\\""
  """
  @spec build_fields(Options.schema(), map()) :: [field()]
  def build_fields(schema, config) do
    for {key, spec} <- schema, spec[:doc] != false do
      name = Atom.to_string(key)
      type = unwrap_optional(spec[:type] || :any)
      value = Map.get(config, name, spec[:default])

      %{
        name: name,
        kind: field_kind(type),
        value: format_value(value),
        choices: list_choices(type),
        doc: spec[:doc],
        required: spec[:required] == true
      }
    end
  end

  defp unwrap_optional({:optional, type}), do: unwrap_optional(type)
  defp unwrap_optional(type), do: type

  defp field_kind(:boolean), do: :check
  defp field_kind({:in, _}), do: :choice
  defp field_kind({range, _, _}) when range in [:range, :integer], do: :number

  defp field_kind(type) when type in [:integer, :pos_integer, :non_neg_integer, :number, :float],
    do: :number

  defp field_kind(_), do: :text

  defp list_choices({:in, values}), do: Enum.map(values, &to_string/1)
  defp list_choices(_), do: []

  defp format_value(value) when is_list(value), do: Enum.map_join(value, ", ", &to_string/1)
  defp format_value(value) when is_map(value) or is_tuple(value), do: inspect(value)

  defp format_value(value) when is_atom(value) and not is_boolean(value) and value != nil,
    do: to_string(value)

  defp format_value(value), do: value

  @doc """
  Parses submitted fields into a configuration for `Situ.Options.parse/2`. Empty fields are left out.
  """
  @spec parse_config(Options.schema(), map()) :: {:ok, map()} | {:error, Error.t()}
  def parse_config(schema, params) do
    Enum.reduce_while(schema, {:ok, %{}}, fn {key, spec}, {:ok, config} ->
      name = Atom.to_string(key)

      case parse_value(unwrap_optional(spec[:type] || :any), params[name]) do
        :absent -> {:cont, {:ok, config}}
        {:ok, value} -> {:cont, {:ok, Map.put(config, name, value)}}
        {:error, wanted} -> {:halt, {:error, option_error(name, wanted, params[name])}}
      end
    end)
  end

  # Browsers send nothing for an unchecked box.
  defp parse_value(:boolean, value), do: {:ok, value in ["true", "on"]}
  defp parse_value(_type, value) when value in [nil, ""], do: :absent
  defp parse_value(_type, value) when not is_binary(value), do: {:error, "a string"}

  defp parse_value(type, text)
       when type in [:integer, :pos_integer, :non_neg_integer] or elem(type, 0) == :integer do
    case Integer.parse(String.trim(text)) do
      {n, ""} -> {:ok, n}
      _ -> {:error, "a whole number"}
    end
  end

  defp parse_value(type, text) when type in [:number, :float] or elem(type, 0) == :range do
    case {Integer.parse(String.trim(text)), Float.parse(String.trim(text))} do
      {{n, ""}, _} -> {:ok, n}
      {_, {x, ""}} -> {:ok, x}
      _ -> {:error, "a number"}
    end
  end

  defp parse_value({:list, type}, text) do
    parts = text |> String.split(",") |> Enum.map(&String.trim/1) |> Enum.reject(&(&1 == ""))

    Enum.reduce_while(parts, {:ok, []}, fn part, {:ok, read} ->
      case parse_value(unwrap_optional(type), part) do
        {:ok, value} -> {:cont, {:ok, read ++ [value]}}
        error -> {:halt, error}
      end
    end)
  end

  defp parse_value(type, text) when type in [:map, :any, :list] or elem(type, 0) == :or do
    case Situ.JSON.decode(text) do
      {:ok, value} -> {:ok, value}
      {:error, _} -> {:ok, text}
    end
  end

  defp parse_value(_type, text), do: {:ok, text}

  defp option_error(name, wanted, got),
    do: Error.new(:bad_option, "#{name} must be #{wanted}, not #{inspect(got)}")
end
