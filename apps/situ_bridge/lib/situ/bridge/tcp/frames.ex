defmodule Situ.Bridge.Tcp.Frames do
  @moduledoc false
  # Frames with a 32-bit little-endian length, followed by the payload. Pure.
  @behaviour Situ.Bridge.Net.Protocol
  alias Situ.Bridge.Net.Protocol

  @doc """
  Splits `bytes` into complete payloads and the remaining bytes.

      iex> Situ.Bridge.Tcp.Frames.split_frames(<<2, 0, 0, 0, "ab", 9>>, 100)
      {:ok, ["ab"], <<9>>}
      iex> Situ.Bridge.Tcp.Frames.split_frames(<<200, 0, 0, 0>>, 100)
      {:error, "a frame of 200 bytes; the limit is 100"}
  """
  @spec split_frames(binary(), pos_integer()) ::
          {:ok, [binary()], binary()} | {:error, String.t()}
  def split_frames(bytes, max), do: collect_payloads(bytes, max, [])

  defp collect_payloads(<<n::little-32, _::binary>>, max, _payloads) when n > max,
    do: {:error, "a frame of #{n} bytes; the limit is #{max}"}

  defp collect_payloads(<<n::little-32, payload::binary-size(n), rest::binary>>, max, payloads),
    do: collect_payloads(rest, max, [copy_payload(payload, rest) | payloads])

  defp collect_payloads(rest, _max, payloads), do: {:ok, Enum.reverse(payloads), rest}

  # Copying a payload releases the received binary. A payload that makes up most of its binary is not copied.
  defp copy_payload(payload, rest) when byte_size(payload) > byte_size(rest) + 65_536, do: payload
  defp copy_payload(payload, _rest), do: :binary.copy(payload)

  @doc "Encodes a payload as a frame."
  @impl Protocol
  def frame(payload, _arg \\ nil), do: [<<IO.iodata_length(payload)::little-32>>, payload]

  @impl Protocol
  def admit(bytes, _arg), do: {:ok, "", bytes}

  # Clients send no messages; their bytes are dropped.
  @impl Protocol
  def handle_bytes(_bytes, _arg), do: {:ok, "", ""}

  @impl Protocol
  def hello(_host, _port, _arg), do: {"", ""}

  @impl Protocol
  def read(bytes, rest, max) do
    with {:ok, payloads, rest} <- split_frames(rest <> bytes, max), do: {:ok, payloads, "", rest}
  end

  # An empty payload needs no further bytes, because it is returned together with its length.
  @impl Protocol
  def missing_bytes(<<n::little-32, bytes::binary>>), do: n - byte_size(bytes)
  def missing_bytes(bytes), do: 4 - byte_size(bytes)
end
