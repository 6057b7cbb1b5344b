defmodule Situ.Studio.Datasets.Deletion do
  @moduledoc """
  Recordings of a dataset deleted from the disk: all that were asked for, or, where one of them is being recorded or is
  used elsewhere in the dataset, none. A dataset's file may come from anyone and name any path: what no reader opens
  and is no store, whole or damaged, stays.
  """
  alias Situ.Dataset
  alias Situ.Dataset.Partition
  alias Situ.{Error, Store}

  @doc "Deletes the recordings of these partitions. One that is not there any more counts as deleted."
  @spec all(Dataset.t(), [{session :: String.t(), Partition.t()}]) :: :ok | {:error, Error.t()}
  def all(dataset, partitions) do
    with :ok <- each(partitions, &allowed(dataset, partitions, &1)),
         do: each(partitions, fn {_, partition} -> delete(partition.path) end)
  end

  defp each(list, fun) do
    Enum.reduce_while(list, :ok, fn one, :ok ->
      case fun.(one) do
        :ok -> {:cont, :ok}
        error -> {:halt, error}
      end
    end)
  end

  defp allowed(dataset, partitions, {session, partition}) do
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
           "#{partition.name} of #{session} is not deleted: other sessions use its recording",
           why: "these do: #{Enum.join(users, ", ")}",
           fix: "remove it there first"
         )}

      true ->
        recording(partition.path)
    end
  end

  defp recording(path) do
    with true <- File.exists?(path),
         {:ok, store} <- Store.open(path),
         true <- Store.live?(store) do
      {:error,
       Error.new(:live, "it is being recorded: #{path}", fix: "delete it when that has ended")}
    else
      false ->
        :ok

      {:error, _} ->
        if Store.exists?(path), do: :ok, else: {:error, no_recording(path)}
    end
  end

  defp no_recording(path),
    do:
      Error.new(:no_store, "#{path} is not deleted: it is no recording",
        fix: "remove it from the dataset, and delete the file by other means"
      )

  defp delete(path) do
    cond do
      not File.exists?(path) -> :ok
      Store.exists?(path) -> Store.delete(path)
      File.regular?(path) -> removed(File.rm(path), path)
      true -> {:error, no_recording(path)}
    end
  end

  defp removed(:ok, _), do: :ok

  defp removed({:error, reason}, path),
    do:
      {:error,
       Error.new(:not_deleted, "#{path} is not deleted",
         why: to_string(:file.format_error(reason))
       )}
end
