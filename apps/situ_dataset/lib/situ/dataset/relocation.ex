defmodule Situ.Dataset.Relocation do
  @moduledoc false
  # Keeps datasets right when recordings move to another folder (`Situ.Store.move/3`).
  alias Situ.{Dataset, Error}
  alias Situ.Dataset.FileFormat

  @typedoc "The old and the new path of everything that moves."
  @type pairs :: [{Path.t(), Path.t()}]

  @doc "Returns the dataset files in these folders, sorted."
  @spec list_dataset_files([Path.t()]) :: [Path.t()]
  def list_dataset_files(folders) do
    files =
      for folder <- Enum.uniq(folders),
          {:ok, names} <- [File.ls(folder)],
          name <- names,
          path = Path.join(folder, name),
          FileFormat.dataset_file?(path),
          do: path

    files |> Enum.uniq() |> Enum.sort()
  end

  @doc "Changes the paths in a dataset file, as one edit, and returns the changed partitions: `[{session, partition}]`."
  @spec relocate_file(Path.t(), pairs()) ::
          {:ok, [{String.t(), String.t()}]} | {:error, Error.t()}
  def relocate_file(file, pairs) do
    paths = Map.new(pairs)

    with {:ok, dataset} <- Dataset.load(file) do
      case list_moved(dataset, paths) do
        [] ->
          {:ok, []}

        moved ->
          with {:ok, _} <-
                 Dataset.update(dataset, &{:ok, move_partitions(&1, paths)}, write: true),
               do: {:ok, moved}
      end
    end
  end

  defp list_moved(dataset, paths) do
    for session <- dataset.sessions,
        partition <- session.partitions,
        is_map_key(paths, partition.path),
        do: {session.name, partition.name}
  end

  defp move_partitions(dataset, paths) do
    sessions =
      for session <- dataset.sessions do
        partitions = for p <- session.partitions, do: %{p | path: Map.get(paths, p.path, p.path)}
        %{session | partitions: partitions}
      end

    %{dataset | sessions: sessions}
  end
end
