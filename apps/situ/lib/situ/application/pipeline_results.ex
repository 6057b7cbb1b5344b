defmodule Situ.Application.PipelineResults do
  @moduledoc false
  # Keeps the results of the last 256 pipelines that ended, so that a late `await/2` still returns a result. If they
  # take more memory than the limit, the oldest ones are discarded earlier; the newest one is always kept.
  @table __MODULE__
  @kept 256
  @kept_words 8_000_000

  @spec ensure_table() :: :ok
  def ensure_table do
    if :ets.whereis(@table) == :undefined do
      :ets.new(@table, [:named_table, :public, :ordered_set])
    end

    :ok
  end

  @spec put_result(pid(), term()) :: :ok
  def put_result(pid, result) do
    key = {:at, System.unique_integer([:monotonic])}
    :ets.insert(@table, [{key, pid}, {{:pid, pid}, result}])
    prune_oldest(:ets.first(@table), key)
  end

  @spec fetch_result(pid() | nil) :: {:ok, term()} | :error
  def fetch_result(pid) do
    case :ets.lookup(@table, {:pid, pid}) do
      [{_, result}] -> {:ok, result}
      [] -> :error
    end
  end

  defp prune_oldest(key, newest) when key < newest do
    if :ets.info(@table, :size) > 2 * @kept or :ets.info(@table, :memory) > @kept_words do
      for {_, pid} <- :ets.lookup(@table, key), do: :ets.delete(@table, {:pid, pid})
      :ets.delete(@table, key)
      prune_oldest(:ets.first(@table), newest)
    else
      :ok
    end
  end

  defp prune_oldest(_key, _newest), do: :ok
end
