defmodule Situ.Bridge.Format.LengthPrefixed do
  @moduledoc false
  # A file of frames, each with a 32-bit length (little-endian) and a message. A length of 0 ends the file.

  @max_frame 64 * 1024 * 1024

  @spec encode_frame(iodata()) :: iodata()
  def encode_frame(message), do: [<<IO.iodata_length(message)::little-32>>, message]

  def end_marker, do: <<0::32>>
  def initial_state, do: :open

  @doc "Splits bytes as in `c:Situ.Bridge.Format.split/4`; `decode` decodes one message."
  def split_frames(_bytes, :ended, _decode), do: {:ok, [], {"", :ended}}
  def split_frames(bytes, :open, decode), do: collect_frames(bytes, decode, [])

  defp collect_frames(<<0::32, _::binary>>, _decode, messages),
    do: {:ok, Enum.reverse(messages), {"", :ended}}

  defp collect_frames(<<n::little-32, _::binary>>, _decode, []) when n > @max_frame,
    do: {:error, "a frame of #{n} bytes is too large"}

  defp collect_frames(<<n::little-32, _::binary>> = bytes, _decode, messages) when n > @max_frame,
    do: {:ok, Enum.reverse(messages), {bytes, :open}}

  defp collect_frames(
         <<n::little-32, frame::binary-size(n), rest::binary>> = bytes,
         decode,
         messages
       ) do
    case decode.(frame) do
      {:ok, message} -> collect_frames(rest, decode, [message | messages])
      {:error, why} when messages == [] -> {:error, why}
      {:error, _} -> {:ok, Enum.reverse(messages), {bytes, :open}}
    end
  end

  defp collect_frames(rest, _decode, messages), do: {:ok, Enum.reverse(messages), {rest, :open}}
end
