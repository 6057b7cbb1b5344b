defmodule Situ.Live.TokenRateLimit do
  @moduledoc false
  # Counts invalid tokens by address and minute, for every server of the VM.

  @table __MODULE__
  @max_tokens 20
  @minute_ms 60_000
  # The table is emptied at this size, so that a peer with many addresses cannot fill the memory.
  @max_addresses 10_000

  @doc "Creates the table; called once by the application's supervisor process."
  @spec create_table() :: :ok
  def create_table do
    _ = :ets.new(@table, [:named_table, :public, write_concurrency: true])
    :ok
  end

  @doc "Counts an invalid token."
  @spec count_wrong_token(term(), :inet.ip_address(), integer()) :: :ok
  def count_wrong_token(server, address, now_ms \\ current_ms()) do
    if :ets.info(@table, :size) > @max_addresses, do: :ets.delete_all_objects(@table)
    key = {server, address, div(now_ms, @minute_ms)}
    :ets.update_counter(@table, key, 1, {key, 0})
    :ets.delete(@table, {server, address, div(now_ms, @minute_ms) - 2})
    :ok
  end

  @doc "Returns whether an address has used up its guesses in this minute and the one before."
  @spec too_many?(term(), :inet.ip_address(), integer()) :: boolean()
  def too_many?(server, address, now_ms \\ current_ms()) do
    minute = div(now_ms, @minute_ms)
    Enum.sum(for at <- [minute - 1, minute], do: read_count({server, address, at})) >= @max_tokens
  end

  defp read_count(key) do
    case :ets.lookup(@table, key) do
      [{_, count}] -> count
      [] -> 0
    end
  end

  defp current_ms, do: System.monotonic_time(:millisecond)
end
