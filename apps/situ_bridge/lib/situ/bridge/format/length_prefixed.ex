defmodule Situ.Bridge.Format.LengthPrefixed do
  @moduledoc false
  # A file of frames, each with a 32-bit length (little-endian) and a message. A length of 0 ends the file.

  @most 64 * 1024 * 1024

  @spec encode_frame(iodata()) :: iodata()
  def encode_frame(message), do: [<<IO.iodata_length(message)::little-32>>, message]

  def end_marker, do: <<0::32>>
  def initial_state, do: :open

  @doc "Splits bytes as in `c:Situ.Bridge.Format.split/4`; `decode` decodes one message."
  def split_frames(_bytes, :ended, _decode), do: {:ok, [], {"", :ended}}
  def split_frames(bytes, :open, decode), do: collect_frames(bytes, decode, [])

  defp collect_frames(<<0::32, _::binary>>, _decode, found),
    do: {:ok, Enum.reverse(found), {"", :ended}}

  defp collect_frames(<<n::little-32, _::binary>>, _decode, []) when n > @most,
    do: {:error, "a frame of #{n} bytes is too large"}

  defp collect_frames(<<n::little-32, _::binary>> = bytes, _decode, found) when n > @most,
    do: {:ok, Enum.reverse(found), {bytes, :open}}

  defp collect_frames(
         <<n::little-32, frame::binary-size(n), rest::binary>> = bytes,
         decode,
         found
       ) do
    case decode.(frame) do
      {:ok, timed} -> collect_frames(rest, decode, [timed | found])
      {:error, why} when found == [] -> {:error, why}
      {:error, _} -> {:ok, Enum.reverse(found), {bytes, :open}}
    end
  end

  defp collect_frames(rest, _decode, found), do: {:ok, Enum.reverse(found), {rest, :open}}
end
