defmodule Situ.Bridge.Net.ReceiveBuffer do
  @moduledoc false
  # Collects the bytes of a connection until its reader has enough, and returns them as one binary. Without it, a
  # message of a megabyte would be copied once per received segment. Pure.
  defstruct blocks: [], segments: [], count: 0, size: 0

  # Small segments cost more memory than their bytes, so this many segments are joined to one block.
  @max_segments 1_024

  # The buffer size of a socket. The system default of 1.4 kB would split an image into a thousand segments.
  @buffer 262_144

  @type t :: %__MODULE__{
          blocks: [binary()],
          segments: [binary()],
          count: non_neg_integer(),
          size: non_neg_integer()
        }

  @doc "Returns the value of the socket option `buffer:`, bytes."
  @spec buffer_size() :: pos_integer()
  def buffer_size, do: @buffer

  @doc """
  Adds a received segment; the reader needs at least `missing` more bytes.

      iex> alias Situ.Bridge.Net.ReceiveBuffer
      iex> {:more, pieces} = ReceiveBuffer.add_bytes(%ReceiveBuffer{}, "ab", 4)
      iex> ReceiveBuffer.add_bytes(pieces, "cde", 4)
      {:ok, "abcde", %ReceiveBuffer{}}
  """
  @spec add_bytes(t(), binary(), missing :: integer()) :: {:ok, binary(), t()} | {:more, t()}
  def add_bytes(%__MODULE__{size: 0} = empty, bytes, missing) when byte_size(bytes) >= missing,
    do: {:ok, bytes, empty}

  def add_bytes(buffer, bytes, missing) do
    filled = %{buffer | segments: [bytes | buffer.segments], count: buffer.count + 1}
    filled = %{filled | size: buffer.size + byte_size(bytes)}

    cond do
      filled.size >= missing ->
        {:ok, join_bytes(filled.segments ++ filled.blocks), %__MODULE__{}}

      filled.count < @max_segments ->
        {:more, filled}

      true ->
        {:more,
         %{filled | count: 0, segments: [], blocks: [join_bytes(filled.segments) | filled.blocks]}}
    end
  end

  defp join_bytes(newest_first), do: newest_first |> Enum.reverse() |> IO.iodata_to_binary()
end
