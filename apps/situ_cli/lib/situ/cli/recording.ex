defmodule Situ.CLI.Recording do
  @moduledoc false
  # Recordings as arguments: patterns, several at once, and the applications that read foreign files, started when
  # one is met.
  alias Situ.Store
  alias Situ.Store.Formats

  @readers [:situ_media, :situ_bridge, :situ_dataset, :situ_remote]

  @doc "Opens a recording, or raises the error."
  @spec open!(Path.t()) :: Store.Handle.t()
  def open!(path) do
    ready([path])
    Store.open!(path)
  end

  @doc "Makes the readers of all kinds of files known; of what is a file or an address, started."
  @spec ready([Path.t()]) :: :ok
  def ready(paths) do
    for app <- @readers, do: Application.load(app)

    if Enum.any?(paths, &(File.regular?(&1) or Formats.for_address(&1) != nil)),
      do: for(app <- @readers, do: {:ok, _} = Application.ensure_all_started(app))

    :ok
  end

  @doc "Patterns that no shell has expanded (quoted ones) name what they fit; those that fit nothing stay."
  @spec expand([Path.t()]) :: [Path.t()]
  def expand(paths) do
    Enum.flat_map(paths, fn path ->
      if path =~ ~r/[*?\[{]/ and not File.exists?(path) and not String.contains?(path, "://"),
        do: path |> Path.wildcard() |> Enum.sort() |> then(&if(&1 == [], do: [path], else: &1)),
        else: [path]
    end)
  end

  @doc "Bytes on the disk."
  @spec size(Path.t()) :: non_neg_integer()
  def size(path) do
    # Path.wildcard/1 fails on names that are not UTF-8.
    files =
      case File.ls(path) do
        {:ok, names} -> Enum.map(names, &Path.join(path, &1))
        {:error, _} -> [path]
      end

    files
    |> Enum.map(fn file ->
      case File.stat(file) do
        {:ok, %{type: :regular, size: size}} -> size
        _ -> 0
      end
    end)
    |> Enum.sum()
  end
end
