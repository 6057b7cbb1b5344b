defmodule Situ.Studio.Layouts do
  @moduledoc false
  # Saves named layouts in a folder, one JSON file each. The file contains the name; the file name
  # is derived from the letters and digits of the name.
  alias Situ.EditLog.{JsonFormat, Merging}
  alias Situ.Error
  alias Situ.Studio.Layout

  @max_name 60
  @max_bytes 1_000_000

  @doc "Returns the default folder, `$XDG_CONFIG_HOME/situ/layouts`."
  @spec default_dir() :: Path.t()
  def default_dir do
    config = System.get_env("XDG_CONFIG_HOME") || Path.join(System.user_home() || ".", ".config")
    Path.join([config, "situ", "layouts"])
  end

  @doc "Returns the names of the layouts in `dir`; files that do not contain a layout are skipped."
  @spec list_names(Path.t()) :: [String.t()]
  def list_names(dir) do
    dir |> load_all() |> Enum.map(& &1.name) |> Enum.uniq() |> Enum.sort()
  end

  @doc "Loads the layout `name`. Errors: `:no_layout`, and `:bad_layout` if the file with that name is invalid."
  @spec load(Path.t(), String.t()) :: {:ok, Layout.t()} | {:error, Error.t()}
  def load(dir, name) do
    with nil <- Enum.find(load_all(dir), &(&1.name == name)),
         nil <-
           Enum.find_value(list_broken_files(dir), fn {_, title, e} -> if title == name, do: e end) do
      {:error,
       Error.new(:no_layout, "there is no layout named #{inspect(name)}",
         fix: "choose a layout from the list"
       )}
    else
      %Layout{} = layout -> {:ok, layout}
      %Error{} = error -> {:error, error}
    end
  end

  @doc "Returns the files in `dir` that are not valid layouts, with the error, such as an unknown version."
  @spec list_problems(Path.t()) :: [{Path.t(), Error.t()}]
  def list_problems(dir), do: for({path, _, error} <- list_broken_files(dir), do: {path, error})

  defp list_broken_files(dir) do
    for {path, json} <- read_files(dir), {:error, error} <- [Layout.Json.parse_json(json)] do
      name =
        case Situ.JSON.decode(json) do
          {:ok, %{"name" => name}} -> name
          _ -> nil
        end

      {path, name, error}
    end
  end

  @doc """
  Saves a layout and returns it. `base` is the layout that the caller has changed: changes that others have saved since
  then are merged, and the error `:conflict` reports a panel that both have changed. Without a base, the layout replaces
  a layout with the same name. The replaced one remains in the log of the file.
  """
  @spec save(Path.t(), Layout.t(), Layout.t() | nil) :: {:ok, Layout.t()} | {:error, Error.t()}
  def save(dir, %Layout{name: name} = layout, base \\ nil) do
    path = Path.join(dir, file_name(name))
    base = if base && base.name == name, do: encode_layout(base)

    with :ok <- check_name(name),
         {:ok, document} <- Merging.save(path, JsonFormat, {base, encode_layout(layout)}),
         do: document.content |> Situ.JSON.encode() |> Layout.Json.parse_json()
  end

  defp encode_layout(layout) do
    {:ok, json} = layout |> Layout.Json.to_json() |> Situ.JSON.decode()
    json
  end

  @doc "Deletes the layout `name`."
  @spec delete(Path.t(), String.t()) :: :ok
  def delete(dir, name) do
    for {path, layout} <- load_files(dir), layout.name == name, do: File.rm(path)
    :ok
  end

  defp check_name(name) do
    if String.valid?(name) and String.trim(name) != "" and String.length(name) <= @max_name do
      :ok
    else
      {:error, Error.new(:bad_name, "the name of a layout has 1 to #{@max_name} characters")}
    end
  end

  # A hash keeps file names distinct when layout names differ only in characters that are not valid in file names.
  defp file_name(name) do
    plain = name |> String.downcase() |> String.replace(~r/[^a-z0-9]+/, "-") |> String.trim("-")
    hash = name |> :erlang.phash2() |> Integer.to_string(36) |> String.downcase()
    "#{String.slice(plain, 0, 40)}-#{hash}.json"
  end

  defp load_all(dir), do: for({_, layout} <- load_files(dir), do: layout)

  defp load_files(dir),
    do:
      for(
        {path, json} <- read_files(dir),
        {:ok, layout} <- [Layout.Json.parse_json(json)],
        do: {path, layout}
      )

  defp read_files(dir) do
    for path <- dir |> Path.join("*.json") |> Path.wildcard() |> Enum.sort() |> Enum.take(500),
        {:ok, %{size: size}} when size <= @max_bytes <- [File.stat(path)],
        {:ok, json} <- [File.read(path)],
        do: {path, json}
  end
end
