defmodule Situ.Application.PipelineResults do
  @moduledoc false
  # Keeps the results of the last 256 pipelines that ended, so that a late `await/2` still returns a result.
  @table __MODULE__
  @kept 256

  @spec ensure_table() :: :ok
  def ensure_table do
    if :ets.whereis(@table) == :undefined do
      :ets.new(@table, [:named_table, :public, :ordered_set])
    end

    :ok
  end

  @spec put_result(pid(), term()) :: :ok
  def put_result(pid, result) do
    :ets.insert(@table, {{:at, System.unique_integer([:monotonic])}, pid})
    :ets.insert(@table, {{:pid, pid}, result})
    if :ets.info(@table, :size) > 2 * @kept, do: prune_oldest(:ets.first(@table))
    :ok
  end

  @spec fetch_result(pid() | nil) :: {:ok, term()} | :error
  def fetch_result(pid) do
    case :ets.lookup(@table, {:pid, pid}) do
      [{_, result}] -> {:ok, result}
      [] -> :error
    end
  end

  defp prune_oldest({:at, _} = key) do
    for {_, pid} <- :ets.lookup(@table, key), do: :ets.delete(@table, {:pid, pid})
    :ets.delete(@table, key)
  end

  defp prune_oldest(_), do: :ok
end
