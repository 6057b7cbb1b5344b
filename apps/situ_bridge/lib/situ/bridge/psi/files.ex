defmodule Situ.Bridge.Psi.Files do
  @moduledoc false
  # Finds the files of \psi's stores. They are called NAME.KIND_NNNNNN.psi, one for each extent, usually in a folder
  # called NAME.VVVV.

  @catalog ".Catalog_000000.psi"

  @type kind :: :catalog | :data | :large
  @kinds %{catalog: "Catalog", data: "Data", large: "LargeData"}

  @doc "Returns the names of the stores in a folder."
  @spec store_names(Path.t()) :: [String.t()]
  def store_names(folder) do
    case File.ls(folder) do
      {:ok, files} ->
        for file <- Enum.sort(files),
            String.ends_with?(file, @catalog),
            do: String.replace_suffix(file, @catalog, "")

      {:error, _} ->
        []
    end
  end

  @doc """
  Finds the store at `path` and returns its folder and name. `path` is a folder that contains one store, or
  `folder/NAME` for a store in a folder or for the newest version, `folder/NAME.VVVV`.
  """
  @spec find_store(Path.t()) :: {:ok, Path.t(), String.t()} | :error
  def find_store(path) do
    {folder, name} = {Path.dirname(path), Path.basename(path)}

    case store_names(path) do
      [only] ->
        {:ok, path, only}

      _ ->
        if File.regular?(extent_path(folder, name, :catalog, 0)),
          do: {:ok, folder, name},
          else: find_newest_version(folder, name)
    end
  end

  defp find_newest_version(folder, name) do
    versions =
      for entry <- list_folder(folder),
          [_, digits] <- [Regex.run(~r/\A#{Regex.escape(name)}\.(\d{4})\z/, entry)],
          version = Path.join(folder, entry),
          File.regular?(extent_path(version, name, :catalog, 0)),
          do: {digits, version}

    case Enum.max(versions, fn -> nil end) do
      nil -> :error
      {_, version} -> {:ok, version, name}
    end
  end

  defp list_folder(folder) do
    case File.ls(folder) do
      {:ok, entries} -> entries
      {:error, _} -> []
    end
  end

  @doc "Returns the path of the file that contains an extent."
  @spec extent_path(Path.t(), String.t(), kind(), non_neg_integer()) :: Path.t()
  def extent_path(folder, name, kind, extent) do
    number = extent |> Integer.to_string() |> String.pad_leading(6, "0")
    Path.join(folder, "#{name}.#{@kinds[kind]}_#{number}.psi")
  end

  @doc "Returns the sizes of the existing extents in bytes, by extent number."
  @spec extent_sizes(Path.t(), String.t(), kind()) :: %{non_neg_integer() => non_neg_integer()}
  def extent_sizes(folder, name, kind) do
    pattern = ~r/\A#{Regex.escape(name)}\.#{@kinds[kind]}_(\d{6})\.psi\z/

    for entry <- list_folder(folder),
        [_, digits] <- [Regex.run(pattern, entry)],
        {:ok, %{type: :regular, size: size}} <- [File.stat(Path.join(folder, entry))],
        into: %{},
        do: {String.to_integer(digits), size}
  end
end
