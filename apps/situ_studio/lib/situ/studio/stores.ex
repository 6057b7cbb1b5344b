defmodule Situ.Studio.Stores do
  @moduledoc false
  # Finds recordings and datasets at or below a path by name, the name that addresses contain. Symbolic links are not
  # followed, because they may form a cycle or lead out of the folder.

  alias Situ.Dataset.Document
  alias Situ.Store.Formats
  alias Situ.Studio.NaturalOrder

  @most 5_000
  @depth 8
  @entries 200_000

  @type name :: String.t()

  @doc "Returns the recordings at or below a path: at most 5,000, at most eight folders deep."
  @spec discover(Path.t() | nil) :: [{name(), Path.t()}]
  def discover(path), do: path |> all() |> elem(0)

  @doc "Returns the recordings and the datasets at or below a path."
  @spec all(Path.t() | nil) :: {[{name(), Path.t()}], [{name(), Path.t()}]}
  def all(nil), do: {[], []}

  def all(path) do
    root = Formats.expand(path)

    cond do
      Formats.for_address(path) ->
        {for(address <- Formats.within(path), do: {named(address), address}), []}

      Document.dataset?(root) ->
        {[], [{Path.basename(root), root}]}

      recording?(root) ->
        {[{Path.basename(root), root}], []}

      File.dir?(root) ->
        root |> below() |> Enum.split_with(fn {_, p} -> not Document.dataset?(p) end)

      true ->
        {[], []}
    end
  end

  @doc "Returns the recording with that name, without scanning the others."
  @spec find(Path.t() | nil, name()) :: {:ok, Path.t()} | :error
  def find(path, name), do: at(path, name, &(recording?(&1) and not Document.dataset?(&1)))

  @doc "Returns the dataset with that name."
  @spec dataset(Path.t() | nil, name()) :: {:ok, Path.t()} | :error
  def dataset(path, name), do: at(path, name, &Document.dataset?/1)

  defp at(nil, _name, _kind?), do: :error

  defp at(path, name, kind?) do
    root = Formats.expand(path)

    cond do
      Formats.for_address(path) -> if(kind?.(root), do: elsewhere(path, name), else: :error)
      kind?.(root) -> if name == Path.basename(root), do: {:ok, root}, else: :error
      inside?(root, name) and kind?.(Path.join(root, name)) -> {:ok, Path.join(root, name)}
      true -> :error
    end
  end

  # A server has a flat list of names.
  defp elsewhere(path, name) do
    case Enum.find(Formats.within(path), &(named(&1) == name)) do
      nil -> :error
      address -> {:ok, address}
    end
  end

  defp named(address) do
    uri = URI.parse(address)
    name = if uri.scheme == "situ+unix", do: uri.query || "", else: Path.basename(uri.path || "")
    if name == "", do: uri.host || "recording", else: URI.decode(name)
  end

  defp recording?(path), do: Situ.Store.exists?(path) or known_file?(path)

  defp known_file?(path), do: Formats.for_file(path) != nil and File.regular?(path)

  # Every segment of the name must be a plain path segment, and must not be a symbolic link.
  defp inside?(root, name) do
    parts = String.split(name, "/")

    String.valid?(name) and not String.contains?(name, <<0>>) and length(parts) <= @depth + 1 and
      Enum.all?(parts, &(&1 not in ["", ".", ".."])) and
      parts
      |> Enum.scan(&Path.join(&2, &1))
      |> Enum.all?(&(kind(Path.join(root, &1)) != :symlink))
  end

  defp below(root) do
    {found, _budget} = walk(root, @depth, {[], @entries})

    found
    |> newest()
    |> Enum.take(@most)
    |> Enum.map(&{Path.relative_to(&1, root), &1})
    |> Enum.sort_by(fn {name, _} -> NaturalOrder.key(name) end)
  end

  # Every save of annotations creates a version; the list contains only the latest, but an address can name any.
  defp newest(paths) do
    {annotations, others} = Enum.split_with(paths, &(Path.basename(&1) =~ "-annotation-"))

    last =
      annotations
      |> Enum.group_by(&Path.rootname/1)
      |> Enum.map(fn {_, versions} -> Enum.max_by(versions, &{String.length(&1), &1}) end)

    others ++ last
  end

  defp walk(_folder, _depth, {found, budget}) when budget <= 0 or length(found) >= @most,
    do: {found, 0}

  defp walk(folder, depth, {found, budget}) do
    names = with {:ok, names} <- File.ls(folder), do: Enum.sort(names), else: (_ -> [])

    entries =
      for name <- Enum.take(names, budget), path = Path.join(folder, name), do: {kind(path), path}

    stores = folder |> Situ.Store.list() |> Enum.reject(&(kind(&1) == :symlink))
    files = for {:regular, path} <- entries, known_ending?(path), do: path
    folders = for {:directory, path} <- entries, path not in stores, depth > 0, do: path

    Enum.reduce(
      folders,
      {Enum.uniq(stores ++ files) ++ found, budget - length(entries)},
      &walk(&1, depth - 1, &2)
    )
  end

  defp known_ending?(path),
    do: (Formats.for_file(path) != nil and whole?(path)) or Document.dataset?(path)

  # A JSON store is listed by its catalog; other JSON files (statistics, settings) are not recordings.
  defp whole?(path), do: Path.extname(path) != ".json" or String.ends_with?(path, ".Catalog.json")

  defp kind(path) do
    case File.lstat(path) do
      {:ok, %{type: type}} -> type
      {:error, _} -> :none
    end
  end
end
