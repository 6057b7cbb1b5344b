defmodule Situ.Bridge.Mcap.TopicSizes do
  @moduledoc false
  # Sums the bytes of each topic, chunk by chunk.
  alias Situ.Bridge.Mcap.NativeError
  alias Situ.Bridge.Native

  @spec sum_sizes(struct(), non_neg_integer(), map(), map()) ::
          {:ok, %{String.t() => non_neg_integer()}} | {:error, Situ.Error.t()}
  def sum_sizes(state, chunk, topics, sums) do
    case NativeError.wrap_result(Native.mcap_sizes(state.ref, chunk), state.path) do
      {:ok, nil} ->
        {:ok, sums}

      {:ok, sizes} ->
        sums =
          for {id, bytes} <- sizes, topic = topics[id], reduce: sums do
            sums -> Map.update!(sums, topic, &(&1 + bytes))
          end

        sum_sizes(state, chunk + 1, topics, sums)

      error ->
        error
    end
  end
end
