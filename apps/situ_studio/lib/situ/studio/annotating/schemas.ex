defmodule Situ.Studio.Annotating.Schemas do
  @moduledoc """
  Schemas kept for the next recording: a JSON file each (`priv/schema/annotation.schema.json`) in a folder beside the
  layouts, which people may fill by hand, too.

      iex> layouts = Path.join(System.tmp_dir!(), "situ-doc-schemas/layouts")
      iex> {:ok, schema} = Situ.Studio.Annotating.schema("Speech", "speaks 1")
      iex> :ok = Situ.Studio.Annotating.Schemas.keep(layouts, schema)
      iex> Situ.Studio.Annotating.Schemas.names(layouts)
      ["Speech"]
      iex> Situ.Studio.Annotating.Schemas.load(layouts, "Speech") == {:ok, schema}
      true
      iex> File.rm_rf!(Path.dirname(layouts)) != []
      true
  """
  alias Situ.Annotation.Schema
  alias Situ.Error

  @most 200

  @doc "The names of the schemas that are kept; files that are none are passed over."
  @spec names(Path.t()) :: [String.t()]
  def names(layouts) do
    layouts |> all() |> Enum.map(fn {_, schema} -> schema.name end) |> Enum.uniq() |> Enum.sort()
  end

  @doc "The schema of that name. Error: `:no_schema`."
  @spec load(Path.t(), String.t()) :: {:ok, Schema.t()} | {:error, Error.t()}
  def load(layouts, name) do
    case Enum.find(all(layouts), fn {_, schema} -> schema.name == name end) do
      {_, schema} -> {:ok, schema}
      nil -> {:error, Error.new(:no_schema, "no schema called #{inspect(name)} is kept")}
    end
  end

  @doc "Keeps a schema, in the place of one of its name."
  @spec keep(Path.t(), Schema.t()) :: :ok | {:error, Error.t()}
  def keep(layouts, %Schema{name: name} = schema) do
    path =
      Enum.find_value(all(layouts), fn {path, kept} -> if kept.name == name, do: path end) ||
        Path.join(folder(layouts), URI.encode(name, &URI.char_unreserved?/1) <> ".json")

    case File.mkdir_p(folder(layouts)) do
      :ok -> Schema.save(schema, path)
      {:error, reason} -> {:error, failed(layouts, reason)}
    end
  end

  defp failed(layouts, reason) do
    Error.new(:not_saved, "the schema cannot be kept in #{folder(layouts)}",
      why: to_string(:file.format_error(reason)),
      fix: "make the folder writable, or start the studio with another layouts:"
    )
  end

  defp all(layouts) do
    for path <- layouts |> folder() |> Path.join("*.json") |> Path.wildcard() |> Enum.take(@most),
        {:ok, schema} <- [Schema.load(path)],
        do: {path, schema}
  end

  defp folder(layouts), do: Path.join(Path.dirname(layouts), "schemas")
end
