defmodule Situ.Media.Nut.Muxer do
  @moduledoc false
  # Writes a NUT stream: call `encode_header/1` once, then `encode_frame/3` for each image or
  # audio buffer. Both return iodata in which the payload is not copied.
  #
  # All times are nanoseconds and must not be negative. The field `setup` of a stream holds the parameters of its codec.
  alias Situ.Media.Nut

  # Headers state the maximum distance of a frame from a syncpoint, and frames larger than twice this distance need a
  # checksum. Every frame here has one.
  @max_distance 65_535
  @shift 7
  @key 1
  @frame_flags Enum.sum([_coded_pts = 8, _stream_id = 16, _size_msb = 32, _checksum = 64])
  # The first byte of a key frame, and of other frames.
  @key_code 1
  @other_code 2

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

  @doc """
  Encodes the file id, the main header and one header per stream. The first frame's syncpoint ends
  the headers.

      iex> alias Situ.Media.Nut.{Demuxer, Muxer}
      iex> streams = [%{id: 0, class: :video, fourcc: "Y800", width: 2, height: 1}]
      iex> bytes = IO.iodata_to_binary([Muxer.encode_header(streams), Muxer.encode_frame(0, 40_000_000, <<1, 2>>)])
      iex> {:ok, file} = StringIO.open(bytes, encoding: :latin1)
      iex> {:ok, demuxer} = Demuxer.open(fn n -> {:ok, IO.binread(file, n)} end)
      iex> {:ok, frame, _} = Demuxer.next_frame(demuxer)
      iex> {frame.time, frame.data}
      {40_000_000, <<1, 2>>}
  """
  @spec encode_header([stream(), ...]) :: iodata()
  def encode_header(streams) do
    [
      Nut.file_id(),
      build_packet(:main, main_header(length(streams))),
      Enum.map(streams, &build_packet(:stream, stream_header(&1)))
    ]
  end

  @doc "Encodes one frame of stream `id` at `time` (nanoseconds, 0 or more). A raw image is a key frame."
  @spec encode_frame(non_neg_integer(), non_neg_integer(), binary(), boolean()) :: iodata()
  def encode_frame(id, time, data, key? \\ true) when is_integer(time) and time >= 0 do
    # An offset of 2^shift distinguishes a complete time from its low bits.
    head =
      IO.iodata_to_binary([
        if(key?, do: @key_code, else: @other_code),
        encode_varint(id),
        encode_varint(time + Bitwise.bsl(1, @shift)),
        encode_varint(byte_size(data))
      ])

    # A reader requires a syncpoint every 64 KiB; one before each frame costs 30 bytes. Two in a row would make FFmpeg
    # resynchronize, which works in a socket only by chance.
    [
      build_packet(:syncpoint, [encode_varint(time), encode_varint(0)]),
      head,
      <<Nut.header_checksum(head)::32>>,
      data
    ]
  end

  defp main_header(count) do
    [
      encode_varint(3),
      encode_varint(count),
      encode_varint(@max_distance),
      # All streams share one time base: nanoseconds.
      [encode_varint(1), encode_varint(1), encode_varint(1_000_000_000)],
      # Frame code 0 is invalid. Code 1 is a key frame and codes 2 to 255 are others, with all fields written out.
      [
        encode_varint(8192),
        encode_varint(6),
        encode_varint(0),
        encode_varint(1),
        encode_varint(0),
        encode_varint(0),
        encode_varint(0),
        encode_varint(1)
      ],
      frame_codes(@frame_flags + @key, 1),
      frame_codes(@frame_flags, 253),
      # No elided headers.
      encode_varint(0),
      encode_varint(0)
    ]
  end

  defp frame_codes(flags, count),
    do: Enum.map([flags, 6, 0, 1, 0, 0, 0, count], &encode_varint/1)

  defp stream_header(%{class: class, id: id, fourcc: fourcc} = stream) do
    [
      [
        encode_varint(id),
        encode_varint(if(class == :video, do: 0, else: 1)),
        encode_varint(byte_size(fourcc)),
        fourcc
      ],
      # time base, shift, max pts distance, decode delay, flags, codec data
      [
        encode_varint(0),
        encode_varint(@shift),
        encode_varint(1_000_000_000),
        encode_varint(0),
        encode_varint(0),
        encode_setup(stream[:setup] || "")
      ],
      stream_shape(stream)
    ]
  end

  defp encode_setup(setup), do: [encode_varint(byte_size(setup)), setup]

  defp stream_shape(%{class: :video} = s),
    do: [
      encode_varint(s.width),
      encode_varint(s.height),
      encode_varint(0),
      encode_varint(0),
      encode_varint(0)
    ]

  defp stream_shape(%{class: :audio} = s),
    do: [encode_varint(s.rate), encode_varint(1), encode_varint(s.channels)]

  defp build_packet(name, body) do
    body = IO.iodata_to_binary(body)
    size = encode_varint(byte_size(body) + 4)
    start = Nut.startcode(name)

    guard =
      if byte_size(body) + 4 > 4096, do: <<Nut.header_checksum(start <> size)::32>>, else: <<>>

    [start, size, guard, body, <<Nut.header_checksum(body)::32>>]
  end

  defp encode_varint(value), do: Nut.encode_varint(value)
end
