defmodule Situ.Dataset.Discovery do
  @moduledoc false
  # Reads a folder of recordings as a dataset: each subfolder is a session, and each recording in a subfolder (at any
  # depth) is a partition. Each recording directly in the folder is a separate session.
  alias Situ.Dataset.{Names, Partition, Session}
  alias Situ.{Error, Store}

  @type found :: {:ok, name :: String.t(), [Session.t()]} | {:error, Error.t()}

  @spec recording(Path.t()) :: found()
  def recording(path) do
    partition = Partition.new(nil, path)

    with {:ok, session} <- partition.name |> Session.new() |> Session.add(partition),
         do: {:ok, partition.name, [session]}
  end

  @spec folder(Path.t()) :: found()
  def folder(root) do
    sessions =
      root
      |> entries()
      |> Enum.map(fn
        {:recording, path} -> {Path.basename(path), [path]}
        {:folder, path} -> {Path.basename(path), recordings(path)}
      end)
      |> Enum.reject(fn {_, recordings} -> recordings == [] end)
      |> Enum.map_reduce([], &session/2)
      |> elem(0)

    if sessions == [],
      do: {:error, none(root)},
      else: {:ok, Path.basename(root), sessions}
  end

  defp session({folder, recordings}, taken) do
    name = Names.unique(legible(folder), taken)

    session =
      Enum.reduce(recordings, Session.new(name), fn path, session ->
        partition = Partition.new(nil, path)
        name = Names.unique(legible(partition.name), Enum.map(session.partitions, & &1.name))
        {:ok, session} = Session.add(session, %{partition | name: name})
        session
      end)

    {session, [name | taken]}
  end

  # Folder names may contain characters that are not allowed in names.
  defp legible(name) do
    name
    |> String.chunk(:valid)
    |> Enum.map_join(&if(String.valid?(&1), do: &1, else: "_"))
    |> String.replace(~r/[\x00-\x1f\[\]]/u, "_")
    |> String.slice(0, 200)
    |> String.trim()
    |> then(&if(&1 == "", do: "_", else: &1))
  end

  defp recordings(folder) do
    Enum.flat_map(entries(folder), fn
      {:recording, path} -> [path]
      {:folder, path} -> recordings(path)
    end)
  end

  # Stores, files that a reader can open, and subfolders, by name. Links to folders are not followed, because they may
  # form a cycle.
  defp entries(folder) do
    stores = MapSet.new(Store.list(folder))

    for name <- names(folder),
        not (String.starts_with?(name, ".") or String.ends_with?(name, ".unfinished")),
        path = Path.join(folder, name),
        kind = kind(path, stores),
        do: {kind, path}
  end

  defp names(folder) do
    case File.ls(folder) do
      {:ok, names} -> Enum.sort(names)
      {:error, _} -> []
    end
  end

  defp kind(path, stores) do
    cond do
      path in stores -> :recording
      match?({:ok, %{type: :directory}}, File.lstat(path)) -> :folder
      File.regular?(path) and Store.Formats.for_file(path) != nil and whole?(path) -> :recording
      true -> nil
    end
  end

  # A store of \\psi or a JSON store is represented by its catalog file; other JSON files are not recordings.
  defp whole?(path) do
    case Path.extname(path) do
      ".psi" -> String.ends_with?(path, ".Catalog_000000.psi")
      ".json" -> String.ends_with?(path, ".Catalog.json")
      _ -> true
    end
  end

  defp none(root) do
    Error.new(:no_recordings, "no recordings in #{root}",
      why:
        "the folder and its subfolders contain neither a store nor a file that a reader can open",
      fix: "choose a folder that contains recordings, or a dataset file"
    )
  end
end
