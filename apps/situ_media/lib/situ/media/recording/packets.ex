defmodule Situ.Media.Recording.Packets do
  @moduledoc false
  # Parses the packet list of ffprobe (`-of csv`) as it arrives and stores it compactly: a tick and a flag for every
  # image, the place of every video packet in the file, and the end of the audio. A malicious file can make the list
  # long, but cannot exhaust memory.

  @most 5_000_000

  defstruct [:video, :audio] ++
              [rest: "", pictures: [], count: 0, vague?: false, frames: [], zero: 0, bases: %{}] ++
              [picture_bytes: 0, sound_bytes: 0, sound_end: nil, places: [], placed?: true]

  @type t :: %__MODULE__{}

  @doc "Builds an empty packet list for the streams with these indexes (`nil` if there is none)."
  @spec new(non_neg_integer() | nil, non_neg_integer() | nil) :: t()
  def new(video, audio), do: %__MODULE__{video: index_text(video), audio: index_text(audio)}

  defp index_text(nil), do: nil
  defp index_text(n), do: Integer.to_string(n)

  @doc "Adds the next bytes of the list."
  @spec feed(t(), binary()) :: t()
  def feed(packets, bytes) do
    lines = String.split(packets.rest <> bytes, "\n")
    {whole, [rest]} = Enum.split(lines, -1)
    Enum.reduce(whole, %{packets | rest: rest}, &add_line/2)
  end

  defp add_line(line, packets), do: line |> String.split(",") |> add_row(packets)

  defp add_row(
         ["packet", id, pts, dts, _duration, size, pos, flags | more],
         %{video: id} = packets
       ) do
    packets = %{packets | picture_bytes: packets.picture_bytes + (parse_number(size) || 0)}
    ticks = parse_number(pts)
    place = {ticks, flags, parse_number(pos), parse_number(size), parse_checksum(more)}
    packets = add_place(packets, place)

    cond do
      # Skips packets that are decoded but never shown.
      String.contains?(flags, "D") -> packets
      ticks == nil -> add_image(%{packets | vague?: true}, parse_number(dts), flags)
      true -> add_image(packets, ticks, flags)
    end
  end

  defp add_row(["packet", id, pts, dts, duration, size, _pos, flags | _], %{audio: id} = packets) do
    ticks = parse_number(pts) || parse_number(dts)
    packets = %{packets | sound_bytes: packets.sound_bytes + (parse_number(size) || 0)}

    if ticks && not String.contains?(flags, "D"),
      do: %{
        packets
        | sound_end: max_ticks(ticks + (parse_number(duration) || 0), packets.sound_end)
      },
      else: packets
  end

  defp add_row(["frame", key, ticks | _], packets) do
    case parse_number(ticks) do
      nil -> packets
      ticks -> %{packets | frames: [{ticks, key == "1"} | packets.frames]}
    end
  end

  defp add_row(["stream", id, base | _], packets) do
    case base |> String.split("/") |> Enum.map(&parse_number/1) do
      [num, den] when is_integer(num) and is_integer(den) and num > 0 and den > 0 ->
        %{packets | bases: Map.put(packets.bases, id, {num, den})}

      _ ->
        packets
    end
  end

  defp add_row(["format", start | _], packets) do
    case Float.parse(start) do
      {seconds, ""} when abs(seconds) < 1.0e9 -> %{packets | zero: round(seconds * 1.0e6)}
      _ -> packets
    end
  end

  defp add_row(_, packets), do: packets

  defp add_image(%{count: count} = packets, ticks, _flags) when ticks == nil or count >= @most,
    do: packets

  defp add_image(packets, ticks, flags) do
    entry = {ticks, String.starts_with?(flags, "K")}
    %{packets | pictures: [entry | packets.pictures], count: packets.count + 1}
  end

  # A packet without a place (in MPEG-TS, or where the parameters of the codec change) can be read only by FFmpeg.
  defp add_place(%{placed?: false} = packets, _place), do: packets

  defp add_place(packets, {ticks, flags, pos, size, checksum})
       when is_integer(ticks) and is_integer(checksum) and is_integer(pos) and pos >= 0 and
              size in 1..0xFFFFFFFF do
    key? = String.starts_with?(flags, "K")
    hidden? = String.contains?(flags, "D")
    %{packets | places: [{ticks, key?, hidden?, pos, size, checksum} | packets.places]}
  end

  defp add_place(packets, _place), do: %{packets | placed?: false, places: []}

  defp parse_checksum(["adler32:" <> hex | _]) do
    case Integer.parse(hex, 16) do
      {sum, ""} when sum in 0..0xFFFFFFFF -> sum
      _ -> nil
    end
  end

  defp parse_checksum(_), do: nil

  defp max_ticks(ticks, nil), do: ticks
  defp max_ticks(ticks, last), do: max(ticks, last)

  # Ignores numbers beyond 63 bits, which no valid file contains.
  defp parse_number(text) do
    case Integer.parse(text) do
      {n, ""} when abs(n) < 0x7FFFFFFFFFFFFFFF -> n
      _ -> nil
    end
  end

  defimpl Collectable do
    def into(packets) do
      {packets,
       fn
         packets, {:cont, bytes} -> @for.feed(packets, bytes)
         packets, :done -> @for.feed(packets, "\n")
         _packets, :halt -> :ok
       end}
    end
  end
end
