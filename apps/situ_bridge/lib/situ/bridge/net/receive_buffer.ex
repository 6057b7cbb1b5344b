defmodule Situ.Bridge.Net.ReceiveBuffer do
  @moduledoc false
  # Collects the bytes of a connection until its reader has enough, and returns them as one binary. Without it, a
  # message of a megabyte would be copied once per received segment. Pure.
  defstruct blocks: [], segments: [], n: 0, size: 0

  # Small segments cost more memory than their bytes, so this many segments are joined to one block.
  @most 1_024

  # The buffer size of a socket. The system default of 1.4 kB would split an image into a thousand segments.
  @buffer 262_144

  @type t :: %__MODULE__{
          blocks: [binary()],
          segments: [binary()],
          n: non_neg_integer(),
          size: non_neg_integer()
        }

  @doc "Returns the value of the socket option `buffer:`, bytes."
  @spec buffer_size() :: pos_integer()
  def buffer_size, do: @buffer

  @doc """
  Adds a received segment; the reader needs at least `missing` more bytes.

      iex> alias Situ.Bridge.Net.ReceiveBuffer
      iex> {:more, buffer} = ReceiveBuffer.add_bytes(%ReceiveBuffer{}, "ab", 4)
      iex> ReceiveBuffer.add_bytes(buffer, "cde", 4)
      {:ok, "abcde", %ReceiveBuffer{}}
  """
  @spec add_bytes(t(), binary(), missing :: integer()) :: {:ok, binary(), t()} | {:more, t()}
  def add_bytes(%__MODULE__{size: 0} = none, bytes, missing) when byte_size(bytes) >= missing,
    do: {:ok, bytes, none}

  def add_bytes(buffer, bytes, missing) do
    grown = %{buffer | segments: [bytes | buffer.segments], n: buffer.n + 1}
    grown = %{grown | size: buffer.size + byte_size(bytes)}

    cond do
      grown.size >= missing ->
        {:ok, join_bytes(grown.segments ++ grown.blocks), %__MODULE__{}}

      grown.n < @most ->
        {:more, grown}

      true ->
        {:more,
         %{grown | n: 0, segments: [], blocks: [join_bytes(grown.segments) | grown.blocks]}}
    end
  end

  defp join_bytes(newest_first), do: newest_first |> Enum.reverse() |> IO.iodata_to_binary()
end
