defmodule Situ.Bridge.Tcp.Frames do
  @moduledoc false
  # Frames of a 32-bit little-endian length and as many bytes. Pure.
  @behaviour Situ.Bridge.Net.Protocol
  alias Situ.Bridge.Net.Protocol

  @doc """
  The whole payloads in `bytes`, and what is left of a last one.

      iex> Situ.Bridge.Tcp.Frames.split(<<2, 0, 0, 0, "ab", 9>>, 100)
      {:ok, ["ab"], <<9>>}
      iex> Situ.Bridge.Tcp.Frames.split(<<200, 0, 0, 0>>, 100)
      {:error, "a frame of 200 bytes; the most are 100"}
  """
  @spec split(binary(), pos_integer()) :: {:ok, [binary()], binary()} | {:error, String.t()}
  def split(bytes, most), do: split(bytes, most, [])

  defp split(<<n::little-32, _::binary>>, most, _found) when n > most,
    do: {:error, "a frame of #{n} bytes; the most are #{most}"}

  defp split(<<n::little-32, payload::binary-size(n), rest::binary>>, most, found),
    do: split(rest, most, [alone(payload, rest) | found])

  defp split(rest, _most, found), do: {:ok, Enum.reverse(found), rest}

  # A payload must not keep the bytes of many others; those of part of the next one it may.
  defp alone(payload, rest) when byte_size(payload) > byte_size(rest) + 65_536, do: payload
  defp alone(payload, _rest), do: :binary.copy(payload)

  @doc "A payload as a frame."
  @impl Protocol
  def frame(payload, _arg \\ nil), do: [<<IO.iodata_length(payload)::little-32>>, payload]

  @impl Protocol
  def admit(bytes, _arg), do: {:ok, "", bytes}

  # A client has nothing to send; its bytes are dropped.
  @impl Protocol
  def heard(_bytes, _arg), do: {:ok, "", ""}

  @impl Protocol
  def hello(_host, _port, _arg), do: {"", ""}

  @impl Protocol
  def read(bytes, rest, most) do
    with {:ok, payloads, rest} <- split(rest <> bytes, most), do: {:ok, payloads, "", rest}
  end

  # An empty payload misses nothing, and would have been taken.
  @impl Protocol
  def missing(<<n::little-32, begun::binary>>), do: n - byte_size(begun)
  def missing(begun), do: 4 - byte_size(begun)
end
