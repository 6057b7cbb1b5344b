defmodule Situ.CLI.Setting do
  @moduledoc false
  # Parses `--set NAME=VALUE`, where a value is JSON or text.

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
end
