defmodule Situ.Media.Nut.Muxer do
  @moduledoc """
  Writes a NUT stream: `header/1` once, then `frame/3` for each image or audio buffer. Both return iodata in which the
  payload is not copied.

  All times are nanoseconds and must not be negative.

      iex> alias Situ.Media.Nut.{Demuxer, Muxer}
      iex> streams = [%{id: 0, class: :video, fourcc: "Y800", width: 2, height: 1}]
      iex> bytes = IO.iodata_to_binary([Muxer.header(streams), Muxer.frame(0, 40_000_000, <<1, 2>>)])
      iex> {:ok, file} = StringIO.open(bytes, encoding: :latin1)
      iex> {:ok, demuxer} = Demuxer.open(fn n -> {:ok, IO.binread(file, n)} end)
      iex> {:ok, frame, _} = Demuxer.next(demuxer)
      iex> {frame.time, frame.data}
      {40_000_000, <<1, 2>>}
  """
  alias Situ.Media.Nut

  # Headers state the maximum distance of a frame from a syncpoint, and frames larger than twice this distance need a
  # checksum. Every frame here has one.
  @max_distance 65_535
  @shift 7
  @key 1
  @frame_flags Enum.sum([@key, _coded_pts = 8, _stream_id = 16, _size_msb = 32, _checksum = 64])
  @frame_code 1

  @type stream ::
          %{
            id: non_neg_integer(),
            class: :video,
            fourcc: binary(),
            width: pos_integer(),
            height: pos_integer()
          }
          | %{
              id: non_neg_integer(),
              class: :audio,
              fourcc: binary(),
              rate: pos_integer(),
              channels: pos_integer()
            }

  @doc "Encodes the file id, the main header and one header per stream. The first frame's syncpoint ends the headers."
  @spec header([stream(), ...]) :: iodata()
  def header(streams) do
    [
      Nut.file_id(),
      packet(:main, main(length(streams))),
      Enum.map(streams, &packet(:stream, stream(&1)))
    ]
  end

  @doc "Encodes one frame of stream `id` at `time` (nanoseconds, 0 or more)."
  @spec frame(non_neg_integer(), non_neg_integer(), binary()) :: iodata()
  def frame(id, time, data) when is_integer(time) and time >= 0 do
    # An offset of 2^shift distinguishes a complete time from its low bits.
    head =
      IO.iodata_to_binary([
        @frame_code,
        v(id),
        v(time + Bitwise.bsl(1, @shift)),
        v(byte_size(data))
      ])

    # A reader requires a syncpoint every 64 KiB; one before each frame costs 30 bytes. Two in a row would make FFmpeg
    # resynchronize, which works in a socket only by chance.
    [packet(:syncpoint, [v(time), v(0)]), head, <<Nut.crc(head)::32>>, data]
  end

  defp main(count) do
    [
      v(3),
      v(count),
      v(@max_distance),
      # All streams share one time base: nanoseconds.
      [v(1), v(1), v(1_000_000_000)],
      # Frame code 0 is invalid; codes 1 to 255 define one kind of frame with all fields written out.
      [v(8192), v(6), v(0), v(1), v(0), v(0), v(0), v(1)],
      [v(@frame_flags), v(6), v(0), v(1), v(0), v(0), v(0), v(254)],
      # No elided headers.
      v(0),
      v(0)
    ]
  end

  defp stream(%{class: class, id: id, fourcc: fourcc} = stream) do
    [
      [v(id), v(if(class == :video, do: 0, else: 1)), v(byte_size(fourcc)), fourcc],
      # time base, shift, max pts distance, decode delay, flags, codec data
      [v(0), v(@shift), v(1_000_000_000), v(0), v(0), v(0)],
      shape(stream)
    ]
  end

  defp shape(%{class: :video} = s), do: [v(s.width), v(s.height), v(0), v(0), v(0)]
  defp shape(%{class: :audio} = s), do: [v(s.rate), v(1), v(s.channels)]

  defp packet(name, body) do
    body = IO.iodata_to_binary(body)
    size = v(byte_size(body) + 4)
    start = Nut.startcode(name)

    guard = if byte_size(body) + 4 > 4096, do: <<Nut.crc(start <> size)::32>>, else: <<>>

    [start, size, guard, body, <<Nut.crc(body)::32>>]
  end

  defp v(value), do: Nut.varint(value)
end
