defmodule Situ.Bridge.Net.Pieces do
  @moduledoc false
  # The bytes of a connection as they come: kept until there are as many as its reader misses, then given as one binary.
  # A message of a megabyte would otherwise be copied once for each of its pieces. Pure.
  defstruct blocks: [], pieces: [], n: 0, size: 0

  # Pieces that are small cost more than their bytes; so many become a block.
  @most 1_024

  # Of a socket whose bytes are gathered: the system's own, of 1.4 kB, makes a thousand pieces of a picture.
  @buffer 262_144

  @type t :: %__MODULE__{
          blocks: [binary()],
          pieces: [binary()],
          n: non_neg_integer(),
          size: non_neg_integer()
        }

  @doc "The option `buffer:` of a socket, bytes."
  @spec buffer() :: pos_integer()
  def buffer, do: @buffer

  @doc """
  Adds a piece; the reader misses `missing` bytes at least.

      iex> alias Situ.Bridge.Net.Pieces
      iex> {:more, pieces} = Pieces.add(%Pieces{}, "ab", 4)
      iex> Pieces.add(pieces, "cde", 4)
      {:ok, "abcde", %Pieces{}}
  """
  @spec add(t(), binary(), missing :: integer()) :: {:ok, binary(), t()} | {:more, t()}
  def add(%__MODULE__{size: 0} = none, bytes, missing) when byte_size(bytes) >= missing,
    do: {:ok, bytes, none}

  def add(pieces, bytes, missing) do
    grown = %{pieces | pieces: [bytes | pieces.pieces], n: pieces.n + 1}
    grown = %{grown | size: pieces.size + byte_size(bytes)}

    cond do
      grown.size >= missing -> {:ok, joined(grown.pieces ++ grown.blocks), %__MODULE__{}}
      grown.n < @most -> {:more, grown}
      true -> {:more, %{grown | n: 0, pieces: [], blocks: [joined(grown.pieces) | grown.blocks]}}
    end
  end

  defp joined(newest_first), do: newest_first |> Enum.reverse() |> IO.iodata_to_binary()
end
