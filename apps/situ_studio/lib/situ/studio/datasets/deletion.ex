defmodule Situ.Studio.Datasets.Deletion do
  @moduledoc """
  Recordings of a dataset deleted from the disk: all that were asked for, or, where one of them is being recorded or is
  used elsewhere in the dataset, none.
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

      live?(partition.path) ->
        {:error,
         Error.new(:live, "it is being recorded: #{partition.path}",
           fix: "delete it when that has ended"
         )}

      true ->
        :ok
    end
  end

  defp live?(path) do
    case Store.open(path) do
      {:ok, store} -> Store.live?(store)
      {:error, _} -> false
    end
  end

  defp delete(path) do
    cond do
      not File.exists?(path) -> :ok
      Store.exists?(path) -> Store.delete(path)
      File.regular?(path) -> removed(File.rm(path), path)
      true -> {:error, Error.new(:no_store, "#{path} is no recording")}
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
