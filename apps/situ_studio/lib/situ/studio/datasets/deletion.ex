defmodule Situ.Studio.Datasets.Deletion do
  @moduledoc false
  # Deletes recordings of a dataset from disk. Deletes none of them if one is still being recorded
  # or is used elsewhere in the dataset.
  #
  # A dataset file may come from anyone and name any path. Therefore only stores (intact or
  # damaged) and files that a reader can open are deleted.
  alias Situ.Dataset
  alias Situ.Dataset.{Partition, SessionLayers}
  alias Situ.{Error, Store}

  @doc "Deletes the recordings of these partitions. A recording that no longer exists counts as deleted."
  @spec delete_partitions(Dataset.t(), [{session :: String.t(), Partition.t()}]) ::
          :ok | {:error, Error.t()}
  def delete_partitions(dataset, partitions) do
    with :ok <- each_until_error(partitions, &check_deletable(dataset, partitions, &1)),
         do: each_until_error(partitions, fn {_, partition} -> delete_partition(partition) end)
  end

  defp each_until_error(list, fun) do
    Enum.reduce_while(list, :ok, fn one, :ok ->
      case fun.(one) do
        :ok -> {:cont, :ok}
        error -> {:halt, error}
      end
    end)
  end

  defp check_deletable(dataset, partitions, {session, partition}) do
    going = for {s, p} <- partitions, do: {s, p.name}

    users =
      for s <- dataset.sessions,
          p <- s.partitions,
          p.path == partition.path and {s.name, p.name} not in going,
          uniq: true,
          do: s.name

    cond do
      users != [] ->
        {:error,
         Error.new(
           :in_use,
           "#{partition.name} of #{session} was not deleted because other sessions use its recording",
           why: "it is used by #{Enum.join(users, ", ")}",
           fix: "remove it from those sessions first"
         )}

      true ->
        check_not_recording(partition.path)
    end
  end

  defp check_not_recording(path) do
    with true <- recorded?(path),
         {:ok, store} <- Store.open(path),
         true <- Store.live?(store) do
      {:error,
       Error.new(:live, "#{path} is still being recorded",
         fix: "delete it after the recording has ended"
       )}
    else
      false ->
        :ok

      {:error, _} ->
        if Store.exists?(path), do: :ok, else: {:error, not_a_recording_error(path)}
    end
  end

  defp not_a_recording_error(path),
    do:
      Error.new(:no_store, "#{path} was not deleted because it is not a recording",
        fix: "remove it from the dataset, and delete the file with another program"
      )

  # The layers of a session are all versions of their store.
  defp delete_partition(%{path: path} = partition) do
    if SessionLayers.layers_partition?(partition),
      do: each_until_error(list_versions(path), &Store.delete/1),
      else: delete_path(path)
  end

  defp list_versions(path) do
    for folder <- Store.list(Path.dirname(path)),
        folder =~ ~r/\.\d{4,}\z/ and Path.rootname(folder) == path,
        do: folder
  end

  # The path of a recording in segments is not a file.
  defp recorded?(path), do: File.exists?(path) or Store.exists?(path)

  defp delete_path(path) do
    cond do
      not recorded?(path) -> :ok
      Store.exists?(path) -> Store.delete(path)
      File.regular?(path) -> removal_result(File.rm(path), path)
      true -> {:error, not_a_recording_error(path)}
    end
  end

  defp removal_result(:ok, _), do: :ok

  defp removal_result({:error, reason}, path),
    do:
      {:error,
       Error.new(:not_deleted, "#{path} could not be deleted",
         why: to_string(:file.format_error(reason))
       )}
end
