defmodule Situ.Dataset.Discovery do
  @moduledoc false
  # Reads a folder of recordings as a dataset: each subfolder is a session, and each recording in a subfolder (at any
  # depth) is a partition. Each recording directly in the folder is a separate session.
  alias Situ.Dataset.{LayersPartition, NameRules, Partition, Session}
  alias Situ.{Error, Store}

  # Unfinished recordings, and the results of experiments over a dataset (`Situ.Experiment`).
  @excluded [".unfinished", ".experiments"]

  @type result :: {:ok, name :: String.t(), [Session.t()]} | {:error, Error.t()}

  @spec from_recording(Path.t()) :: result()
  def from_recording(path) do
    partition = Partition.new(nil, path)

    with {:ok, session} <- partition.name |> Session.new() |> Session.add_partition(partition),
         do: {:ok, partition.name, [session]}
  end

  @spec from_folder(Path.t()) :: result()
  def from_folder(root) do
    sessions =
      root
      |> list_entries()
      |> Enum.map(fn
        {:recording, path} -> {Path.basename(path), [path]}
        {:folder, path} -> {Path.basename(path), list_recordings(path)}
      end)
      |> Enum.reject(fn {_, recordings} -> recordings == [] end)
      |> Enum.map_reduce([], &build_session/2)
      |> elem(0)

    if sessions == [],
      do: {:error, no_recordings_error(root)},
      else: {:ok, Path.basename(root), sessions}
  end

  defp build_session({folder, recordings}, names) do
    name = NameRules.make_unique(sanitize_name(folder), names)

    session =
      Enum.reduce(recordings, Session.new(name), fn path, session ->
        partition = build_partition(path)

        name =
          NameRules.make_unique(
            sanitize_name(partition.name),
            Enum.map(session.partitions, & &1.name)
          )

        {:ok, session} = Session.add_partition(session, %{partition | name: name})
        session
      end)

    {session, [name | names]}
  end

  # The layers of a session are always the newest version of their store.
  defp build_partition(path) do
    if LayersPartition.layers_path?(path),
      do: LayersPartition.build_partition(path),
      else: Partition.new(nil, path)
  end

  # Folder names may contain characters that are not allowed in names.
  defp sanitize_name(name) do
    name
    |> String.chunk(:valid)
    |> Enum.map_join(&if(String.valid?(&1), do: &1, else: "_"))
    |> String.replace(~r/[\x00-\x1f\[\]]/u, "_")
    |> String.slice(0, 200)
    |> String.trim()
    |> then(&if(&1 == "", do: "_", else: &1))
  end

  defp list_recordings(folder) do
    list_entries(folder)
    |> Enum.flat_map(fn
      {:recording, path} -> [LayersPartition.drop_version(path)]
      {:folder, path} -> list_recordings(path)
    end)
    |> Enum.uniq()
  end

  # Stores, files that a reader can open, and subfolders, by name. Links to folders are not followed, because they may
  # form a cycle.
  defp list_entries(folder) do
    stores = MapSet.new(Store.list(folder))
    segments = MapSet.new(Store.list(folder, segments: true)) |> MapSet.difference(stores)
    names = MapSet.new(list_names(folder))
    # The name of a recording in segments is not the name of a folder.
    segmented = for path <- stores, name = Path.basename(path), name not in names, do: name

    for name <- Enum.sort(segmented ++ MapSet.to_list(names)),
        not String.starts_with?(name, "."),
        not String.ends_with?(name, @excluded),
        path = Path.join(folder, name),
        path not in segments,
        kind = entry_kind(path, stores),
        do: {kind, path}
  end

  defp list_names(folder) do
    case File.ls(folder) do
      {:ok, names} -> Enum.sort(names)
      {:error, _} -> []
    end
  end

  defp entry_kind(path, stores) do
    cond do
      path in stores ->
        :recording

      match?({:ok, %{type: :directory}}, File.lstat(path)) ->
        :folder

      File.regular?(path) and Situ.Recording.Formats.for_file(path) != nil and
          recording_file?(path) ->
        :recording

      true ->
        nil
    end
  end

  # A store of \\psi or a JSON store is represented by its catalog file; other JSON files are not recordings.
  defp recording_file?(path) do
    case Path.extname(path) do
      ".psi" -> String.ends_with?(path, ".Catalog_000000.psi")
      ".json" -> String.ends_with?(path, ".Catalog.json")
      _ -> true
    end
  end

  defp no_recordings_error(root) do
    Error.new(:no_recordings, "no recordings in #{root}",
      why:
        "the folder and its subfolders contain neither a store nor a file that a reader can open",
      fix: "choose a folder that contains recordings, or a dataset file"
    )
  end
end
