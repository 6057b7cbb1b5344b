defmodule Situ.Bridge.Tcp.Frames do
  @moduledoc false
  # Frames of a 32-bit little-endian length and as many bytes. Pure.

  @doc "A payload as a frame."
  @spec write(iodata()) :: iodata()
  def write(payload), do: [<<IO.iodata_length(payload)::little-32>>, payload]

  @doc """
  The whole payloads in `bytes`, and what is left of a last one.

      iex> Situ.Bridge.Tcp.Frames.read(<<2, 0, 0, 0, "ab", 9>>, 100)
      {:ok, ["ab"], <<9>>}
      iex> Situ.Bridge.Tcp.Frames.read(<<200, 0, 0, 0>>, 100)
      {:error, "a frame of 200 bytes; the most are 100"}
  """
  @spec read(binary(), pos_integer()) :: {:ok, [binary()], binary()} | {:error, String.t()}
  def read(bytes, most), do: read(bytes, most, [])

  defp read(<<n::little-32, _::binary>>, most, _found) when n > most,
    do: {:error, "a frame of #{n} bytes; the most are #{most}"}

  defp read(<<n::little-32, payload::binary-size(n), rest::binary>>, most, found),
    do: read(rest, most, [:binary.copy(payload) | found])

  defp read(rest, _most, found), do: {:ok, Enum.reverse(found), rest}
end
