defmodule Situ.Bridge.Format.Frames do
  @moduledoc false
  # A file of frames, each with a 32-bit length (little-endian) and a message. A length of 0 ends the file.

  @most 64 * 1024 * 1024

  @spec frame(iodata()) :: iodata()
  def frame(message), do: [<<IO.iodata_length(message)::little-32>>, message]

  def finish, do: <<0::32>>
  def start, do: :open

  @doc "Splits bytes as in `c:Situ.Bridge.Format.split/4`; `decode` decodes one message."
  def split(_bytes, :ended, _decode), do: {:ok, [], {"", :ended}}
  def split(bytes, :open, decode), do: frames(bytes, decode, [])

  defp frames(<<0::32, _::binary>>, _decode, found), do: {:ok, Enum.reverse(found), {"", :ended}}

  defp frames(<<n::little-32, _::binary>>, _decode, []) when n > @most,
    do: {:error, "a frame of #{n} bytes is too large"}

  defp frames(<<n::little-32, _::binary>> = bytes, _decode, found) when n > @most,
    do: {:ok, Enum.reverse(found), {bytes, :open}}

  defp frames(<<n::little-32, frame::binary-size(n), rest::binary>> = bytes, decode, found) do
    case decode.(frame) do
      {:ok, timed} -> frames(rest, decode, [timed | found])
      {:error, why} when found == [] -> {:error, why}
      {:error, _} -> {:ok, Enum.reverse(found), {bytes, :open}}
    end
  end

  defp frames(rest, _decode, found), do: {:ok, Enum.reverse(found), {rest, :open}}
end
