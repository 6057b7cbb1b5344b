defmodule Situ.Studio.Stores do
  @moduledoc false
  # Finds recordings and datasets at or below a path by the names that addresses contain. Symbolic links are not
  # followed, because they may form a cycle or lead out of the folder.

  alias Situ.Dataset.FileFormat
  alias Situ.Recording.Formats
  alias Situ.Studio.Annotations.Files
  alias Situ.Studio.NaturalOrder

  @most 5_000
  @depth 8
  @entries 200_000

  @type name :: String.t()

  @doc "Returns the recordings at or below a path: at most 5,000, at most eight folders deep."
  @spec list_recordings(Path.t() | nil) :: [{name(), Path.t()}]
  def list_recordings(path), do: path |> list_all() |> elem(0)

  @doc "Returns the recordings and the datasets at or below a path."
  @spec list_all(Path.t() | nil) :: {[{name(), Path.t()}], [{name(), Path.t()}]}
  def list_all(nil), do: {[], []}

  def list_all(path) do
    root = Formats.expand_path(path)

    cond do
      Formats.for_address(path) ->
        {for(address <- Formats.list_recordings(path), do: {address_name(address), address}), []}

      FileFormat.dataset_file?(root) ->
        {[], [{Path.basename(root), root}]}

      recording?(root) ->
        {[{Path.basename(root), root}], []}

      File.dir?(root) ->
        root |> scan_folder() |> Enum.split_with(fn {_, p} -> not FileFormat.dataset_file?(p) end)

      true ->
        {[], []}
    end
  end

  @doc "Returns the recording with that name, without scanning the others."
  @spec fetch_recording(Path.t() | nil, name()) :: {:ok, Path.t()} | :error
  def fetch_recording(path, name),
    do: fetch_path(path, name, &(recording?(&1) and not FileFormat.dataset_file?(&1)))

  @doc "Returns the dataset with that name."
  @spec fetch_dataset(Path.t() | nil, name()) :: {:ok, Path.t()} | :error
  def fetch_dataset(path, name), do: fetch_path(path, name, &FileFormat.dataset_file?/1)

  defp fetch_path(nil, _name, _kind?), do: :error

  defp fetch_path(path, name, kind?) do
    root = Formats.expand_path(path)

    cond do
      Formats.for_address(path) ->
        if(kind?.(root), do: fetch_remote_address(path, name), else: :error)

      kind?.(root) ->
        if name == Path.basename(root), do: {:ok, root}, else: :error

      safe_name?(root, name) and kind?.(Path.join(root, name)) ->
        {:ok, Path.join(root, name)}

      true ->
        :error
    end
  end

  # A server has a flat list of names.
  defp fetch_remote_address(path, name) do
    case Enum.find(Formats.list_recordings(path), &(address_name(&1) == name)) do
      nil -> :error
      address -> {:ok, address}
    end
  end

  @doc """
  Returns the name of a recording on another machine, from its address.

      iex> Situ.Studio.Stores.address_name("situ://lab1:4000/lobby")
      "lobby"
  """
  @spec address_name(String.t()) :: name()
  def address_name(address) do
    uri = URI.parse(address)
    name = if uri.scheme == "situ+unix", do: uri.query || "", else: Path.basename(uri.path || "")
    if name == "", do: uri.host || "recording", else: URI.decode(name)
  end

  defp recording?(path), do: Situ.Store.exists?(path) or known_file?(path)

  defp known_file?(path), do: Formats.for_file(path) != nil and File.regular?(path)

  # Every segment of the name must be a plain path segment, and must not be a symbolic link.
  defp safe_name?(root, name) do
    parts = String.split(name, "/")

    String.valid?(name) and not String.contains?(name, <<0>>) and length(parts) <= @depth + 1 and
      Enum.all?(parts, &(&1 not in ["", ".", ".."])) and
      parts
      |> Enum.scan(&Path.join(&2, &1))
      |> Enum.all?(&(file_type(Path.join(root, &1)) != :symlink))
  end

  defp scan_folder(root) do
    {found, _budget} = walk_folder(root, @depth, {[], @entries})

    found
    |> keep_newest_versions()
    |> Enum.take(@most)
    |> Enum.map(&{Path.relative_to(&1, root), &1})
    |> Enum.sort_by(fn {name, _} -> NaturalOrder.sort_key(name) end)
  end

  # Every save of annotations creates a version; the list contains only the latest, but an address can name any.
  defp keep_newest_versions(paths) do
    {annotations, others} = Enum.split_with(paths, &Files.layer_store?/1)

    last =
      annotations
      |> Enum.group_by(&Path.rootname/1)
      |> Enum.map(fn {_, versions} -> Enum.max_by(versions, &{String.length(&1), &1}) end)

    others ++ last
  end

  defp walk_folder(_folder, _depth, {found, budget}) when budget <= 0 or length(found) >= @most,
    do: {found, 0}

  defp walk_folder(folder, depth, {found, budget}) do
    names = with {:ok, names} <- File.ls(folder), do: Enum.sort(names), else: (_ -> [])

    entries =
      for name <- Enum.take(names, budget),
          path = Path.join(folder, name),
          do: {file_type(path), path}

    stores = folder |> Situ.Store.list() |> Enum.reject(&(file_type(&1) == :symlink))
    files = for {:regular, path} <- entries, known_ending?(path), do: path

    folders =
      for {:directory, path} <- entries,
          depth > 0,
          not store?(path, stores),
          not unfinished_upload?(path),
          do: path

    Enum.reduce(
      folders,
      {Enum.uniq(stores ++ files) ++ found, budget - length(entries)},
      &walk_folder(&1, depth - 1, &2)
    )
  end

  # `Situ.Studio.Upload` creates these folders.
  defp unfinished_upload?(path), do: String.starts_with?(Path.basename(path), "situ-upload-")

  # Segments are listed as one recording.
  defp store?(path, stores), do: path in stores or Situ.Store.Folder.store_folder?(path)

  defp known_ending?(path),
    do:
      (Formats.for_file(path) != nil and recording_file?(path)) or FileFormat.dataset_file?(path)

  # A JSON store is listed by its catalog; other JSON files (statistics, settings) are not recordings.
  defp recording_file?(path),
    do: Path.extname(path) != ".json" or String.ends_with?(path, ".Catalog.json")

  defp file_type(path) do
    case File.lstat(path) do
      {:ok, %{type: type}} -> type
      {:error, _} -> :none
    end
  end
end
