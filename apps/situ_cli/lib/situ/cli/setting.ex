defmodule Situ.CLI.Setting do
  @moduledoc """
  Parses `--set NAME=VALUE`, where a value is JSON or text.

      iex> Situ.CLI.Setting.read(["count=3", "names=[\\"a\\"]", "mode=a=b"])
      [{"count", 3}, {"names", ["a"]}, {"mode", "a=b"}]
  """

  @doc "Returns names and values in order. Throws `{:usage, text}` for a setting without a name or value."
  @spec read([String.t()]) :: [{String.t(), term()}]
  def read(texts), do: Enum.map(texts, &pair/1)

  defp pair(text) do
    case String.split(text, "=", parts: 2) do
      [name, value] when name != "" -> {name, value(value)}
      _ -> throw({:usage, "--set takes NAME=VALUE, not #{inspect(text)}"})
    end
  end

  defp value(text) do
    case Situ.JSON.decode(text) do
      {:ok, value} -> value
      {:error, :bad_json} -> text
    end
  end
end
