defmodule Situ.Store.S3.RecentListings do
  @moduledoc false
  # Remembers the recordings in folders of buckets for some seconds, because each listing is a request that costs more
  # than reading.
  alias Situ.Error

  @fresh_ms 5_000
  @most 1_000

  @doc "Creates the table. The calling process owns it."
  @spec create_table() :: :ets.table()
  def create_table, do: :ets.new(__MODULE__, [:named_table, :public, :set])

  @doc "Returns a recent result for the address, or the result of the function."
  @spec fetch(String.t(), (() -> {:ok, [String.t()]} | {:error, Error.t()}), integer()) ::
          {:ok, [String.t()]} | {:error, Error.t()}
  def fetch(address, list, now \\ System.monotonic_time(:millisecond)) do
    case :ets.whereis(__MODULE__) != :undefined && :ets.lookup(__MODULE__, address) do
      [{_, until, addresses}] when now < until -> {:ok, addresses}
      _ -> list_again(address, list, now)
    end
  end

  defp list_again(address, list, now) do
    with {:ok, addresses} <- list.() do
      if :ets.whereis(__MODULE__) != :undefined do
        if :ets.info(__MODULE__, :size) >= @most, do: :ets.delete_all_objects(__MODULE__)
        :ets.insert(__MODULE__, {address, now + @fresh_ms, addresses})
      end

      {:ok, addresses}
    end
  end
end
