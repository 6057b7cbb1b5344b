defmodule Situ.CLI.Setting do
  @moduledoc false
  # Parses `--set NAME=VALUE`, where a value is JSON or text, and lists the options that can be set.
  alias Situ.{Options, Time}

  @doc """
  Returns names and values in order. Throws `{:usage, text}` for a setting without a name or
  value.

      iex> Situ.CLI.Setting.parse_settings(["count=3", "names=[\\"a\\"]", "mode=a=b"])
      [{"count", 3}, {"names", ["a"]}, {"mode", "a=b"}]
  """
  @spec parse_settings([String.t()]) :: [{String.t(), term()}]
  def parse_settings(texts), do: Enum.map(texts, &parse_pair/1)

  defp parse_pair(text) do
    case String.split(text, "=", parts: 2) do
      [name, value] when name != "" -> {name, parse_value(value)}
      _ -> throw({:usage, "--set takes NAME=VALUE, not #{inspect(text)}"})
    end
  end

  defp parse_value(text) do
    case Situ.JSON.decode(text) do
      {:ok, value} -> value
      {:error, :bad_json} -> text
    end
  end

  @doc """
  Describes the options of a schema, one line each.

      iex> Situ.CLI.Setting.describe_options(gap: [type: :time_ns, default: 50_000_000, doc: "The gap."])
      ["gap: The gap. (default 50.0 ms)"]
  """
  @spec describe_options(Options.schema()) :: [String.t()]
  def describe_options(schema) do
    for {name, spec} <- schema, spec[:doc] != false do
      ["#{name}:", spec[:doc], describe_presence(spec)]
      |> Enum.reject(&is_nil/1)
      |> Enum.join(" ")
    end
  end

  defp describe_presence(spec) do
    cond do
      spec[:required] -> "(required)"
      spec[:default] == nil -> nil
      spec[:type] == :time_ns -> "(default #{Time.format_duration(spec[:default])})"
      true -> "(default #{inspect(spec[:default])})"
    end
  end
end
