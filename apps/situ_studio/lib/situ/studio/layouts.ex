defmodule Situ.Studio.Layouts do
  @moduledoc """
  Named layouts in a folder, one JSON file each. The name is in the file; the file is called after its letters and
  digits.
  """
  alias Situ.Error
  alias Situ.Studio.Layout

  @max_name 60
  @max_bytes 1_000_000

  @doc "The folder used when none is named: `$XDG_CONFIG_HOME/situ/layouts`."
  @spec default_dir() :: Path.t()
  def default_dir do
    config = System.get_env("XDG_CONFIG_HOME") || Path.join(System.user_home() || ".", ".config")
    Path.join([config, "situ", "layouts"])
  end

  @doc "The names of the layouts in `dir`; files that are no layouts are passed over."
  @spec names(Path.t()) :: [String.t()]
  def names(dir) do
    dir |> all() |> Enum.map(& &1.name) |> Enum.uniq() |> Enum.sort()
  end

  @doc "The layout called `name`. Errors: `:no_layout`, `:bad_layout` of a file that says it is that, but is none."
  @spec load(Path.t(), String.t()) :: {:ok, Layout.t()} | {:error, Error.t()}
  def load(dir, name) do
    with nil <- Enum.find(all(dir), &(&1.name == name)),
         nil <- Enum.find_value(broken(dir), fn {_, said, e} -> if said == name, do: e end) do
      {:error,
       Error.new(:no_layout, "there is no layout called #{inspect(name)}",
         fix: "choose one from the list of layouts"
       )}
    else
      %Layout{} = layout -> {:ok, layout}
      %Error{} = error -> {:error, error}
    end
  end

  @doc "The files in `dir` that should be layouts and are none, with the reason: of another version, edited by hand ..."
  @spec problems(Path.t()) :: [{Path.t(), Error.t()}]
  def problems(dir), do: for({path, _, error} <- broken(dir), do: {path, error})

  defp broken(dir) do
    for {path, json} <- texts(dir), {:error, error} <- [Layout.Text.read(json)] do
      name =
        case Situ.JSON.decode(json) do
          {:ok, %{"name" => name}} -> name
          _ -> nil
        end

      {path, name, error}
    end
  end

  @doc "Writes a layout whole or not at all, in place of one of the same name."
  @spec save(Path.t(), Layout.t()) :: :ok | {:error, Error.t()}
  def save(dir, %Layout{name: name} = layout) do
    with :ok <- check_name(name) do
      path = Path.join(dir, file(name))
      temporary = path <> ".#{System.unique_integer([:positive])}.tmp"

      with :ok <- File.mkdir_p(dir),
           :ok <- File.write(temporary, Layout.Text.write(layout)),
           :ok <- File.rename(temporary, path) do
        :ok
      else
        {:error, reason} ->
          File.rm(temporary)

          {:error,
           Error.new(:not_saved, "the layout cannot be saved",
             why: "#{dir}: #{:file.format_error(reason)}"
           )}
      end
    end
  end

  @doc "Deletes the layout called `name`."
  @spec delete(Path.t(), String.t()) :: :ok
  def delete(dir, name) do
    for {path, layout} <- files(dir), layout.name == name, do: File.rm(path)
    :ok
  end

  defp check_name(name) do
    if String.valid?(name) and String.trim(name) != "" and String.length(name) <= @max_name do
      :ok
    else
      {:error, Error.new(:bad_name, "a layout's name has 1 to #{@max_name} letters")}
    end
  end

  # Different names give different files, also where they differ in characters a file name cannot have.
  defp file(name) do
    plain = name |> String.downcase() |> String.replace(~r/[^a-z0-9]+/, "-") |> String.trim("-")
    hash = name |> :erlang.phash2() |> Integer.to_string(36) |> String.downcase()
    "#{String.slice(plain, 0, 40)}-#{hash}.json"
  end

  defp all(dir), do: for({_, layout} <- files(dir), do: layout)

  defp files(dir),
    do:
      for(
        {path, json} <- texts(dir),
        {:ok, layout} <- [Layout.Text.read(json)],
        do: {path, layout}
      )

  defp texts(dir) do
    for path <- dir |> Path.join("*.json") |> Path.wildcard() |> Enum.sort() |> Enum.take(500),
        {:ok, %{size: size}} when size <= @max_bytes <- [File.stat(path)],
        {:ok, json} <- [File.read(path)],
        do: {path, json}
  end
end
