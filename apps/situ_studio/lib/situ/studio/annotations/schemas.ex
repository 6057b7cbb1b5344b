defmodule Situ.Studio.Annotations.Schemas do
  @moduledoc false
  # Saves annotation schemas for reuse in other recordings. Each schema is a JSON file
  # (`priv/schema/annotation.schema.json`) in a folder next to the layouts; users may also add
  # files by hand.
  alias Situ.Annotation.Schema
  alias Situ.Error

  @most 200

  @doc "Returns the names of the saved schemas; files that do not contain a schema are skipped."
  @spec list_names(Path.t()) :: [String.t()]
  def list_names(layouts) do
    layouts
    |> load_all()
    |> Enum.map(fn {_, schema} -> schema.name end)
    |> Enum.uniq()
    |> Enum.sort()
  end

  @doc "Loads the schema with that name. Error: `:no_schema`."
  @spec load(Path.t(), String.t()) :: {:ok, Schema.t()} | {:error, Error.t()}
  def load(layouts, name) do
    case Enum.find(load_all(layouts), fn {_, schema} -> schema.name == name end) do
      {_, schema} -> {:ok, schema}
      nil -> {:error, Error.new(:no_schema, "there is no saved schema named #{inspect(name)}")}
    end
  end

  @doc """
  Saves a schema, and replaces a saved schema with the same name.

      iex> layouts = Path.join(System.tmp_dir!(), "situ-doc-schemas/layouts")
      iex> {:ok, schema} = Situ.Studio.Annotations.parse_schema("Speech", "speaks 1")
      iex> :ok = Situ.Studio.Annotations.Schemas.save_schema(layouts, schema)
      iex> Situ.Studio.Annotations.Schemas.list_names(layouts)
      ["Speech"]
      iex> Situ.Studio.Annotations.Schemas.load(layouts, "Speech") == {:ok, schema}
      true
      iex> File.rm_rf!(Path.dirname(layouts)) != []
      true
  """
  @spec save_schema(Path.t(), Schema.t()) :: :ok | {:error, Error.t()}
  def save_schema(layouts, %Schema{name: name} = schema) do
    path =
      Enum.find_value(load_all(layouts), fn {path, kept} -> if kept.name == name, do: path end) ||
        Path.join(schema_folder(layouts), URI.encode(name, &URI.char_unreserved?/1) <> ".json")

    case File.mkdir_p(schema_folder(layouts)) do
      :ok -> Schema.save(schema, path)
      {:error, reason} -> {:error, save_error(layouts, reason)}
    end
  end

  defp save_error(layouts, reason) do
    Error.new(:not_saved, "the schema cannot be saved in #{schema_folder(layouts)}",
      why: to_string(:file.format_error(reason)),
      fix: "make the folder writable, or start the studio with a different layouts:"
    )
  end

  defp load_all(layouts) do
    for path <-
          layouts |> schema_folder() |> Path.join("*.json") |> Path.wildcard() |> Enum.take(@most),
        {:ok, schema} <- [Schema.load(path)],
        do: {path, schema}
  end

  defp schema_folder(layouts), do: Path.join(Path.dirname(layouts), "schemas")
end
