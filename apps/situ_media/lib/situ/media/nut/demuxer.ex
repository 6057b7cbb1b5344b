defmodule Situ.Media.Nut.Demuxer do
  @moduledoc false
  # Reads a NUT stream frame by frame from a function that returns the exact number of bytes
  # requested.
  #
  # The demuxer reads small headers byte by byte and each payload in one call, so a payload from a
  # socket is the binary that the socket allocated, without copies. Input is not trusted: every
  # length is limited (`:max_frame`, default 512 MiB), and header checksums are verified.
  import Bitwise
  alias Situ.Media.Nut
  alias Situ.Media.Nut.Headers

  @enforce_keys [:read]
  defstruct [
    :read,
    max_frame: 536_870_912,
    time_bases: {},
    codes: {},
    elisions: {<<>>},
    streams: %{},
    last: %{},
    count: 0
  ]

  @type read :: (pos_integer() -> {:ok, binary()} | {:error, term()})
  @typedoc "`time` is in nanoseconds; `ticks` is the same time in the stream's own time base."
  @type frame :: %{
          stream: non_neg_integer(),
          time: integer(),
          ticks: integer(),
          key?: boolean(),
          data: binary()
        }
  @opaque t :: %__MODULE__{}

  @max_header 1_048_576
  @bits Map.new(Headers.flag_bits())

  @doc "Reads the headers. Returns `{:error, :eof}` if the stream ends before the first header."
  @spec open(read(), max_frame: pos_integer()) :: {:ok, t()} | {:error, term()}
  def open(read, opts \\ []) when is_function(read, 1) do
    demuxer = struct!(%__MODULE__{read: read}, opts)

    with {:ok, id} <- read_bytes(demuxer, byte_size(Nut.file_id())),
         :ok <- check_condition(id == Nut.file_id(), :not_nut) do
      read_headers(demuxer)
    end
  end

  @doc "Returns the streams by number. The times of frames are already in nanoseconds."
  @spec list_streams(t()) :: %{non_neg_integer() => Nut.stream()}
  def list_streams(%__MODULE__{streams: streams}), do: streams

  @doc "Returns the next frame, `{:error, :eof}` at the end, or `{:error, reason}` if the stream is malformed."
  @spec next_frame(t()) :: {:ok, frame(), t()} | {:error, term()}
  def next_frame(%__MODULE__{} = demuxer) do
    with {:ok, <<code>>} <- read_bytes(demuxer, 1), do: frame_or_packet(code, demuxer)
  end

  defp frame_or_packet(?N, demuxer) do
    with {:ok, rest} <- read_bytes(demuxer, 7),
         {:ok, demuxer} <- read_packet(<<?N, rest::binary>>, demuxer),
         do: next_frame(demuxer)
  end

  defp frame_or_packet(code, demuxer) do
    case read_frame(elem(demuxer.codes, code), <<code>>, demuxer) do
      {:skip, demuxer} -> next_frame(demuxer)
      result -> result
    end
  end

  # Reads headers up to the first syncpoint, which precedes the first frame.
  defp read_headers(demuxer) do
    with {:ok, startcode} <- read_bytes(demuxer, 8),
         {:ok, demuxer} <- read_packet(startcode, demuxer) do
      cond do
        Nut.startcode_name(startcode) != {:ok, :syncpoint} -> read_headers(demuxer)
        map_size(demuxer.streams) == demuxer.count and demuxer.count > 0 -> {:ok, demuxer}
        true -> {:error, :missing_headers}
      end
    end
  end

  defp read_packet(startcode, demuxer) do
    with {:ok, name} <- packet_name(startcode),
         {:ok, size, size_bytes} <- read_varint(demuxer, <<>>),
         :ok <- check_condition(size in 4..@max_header, {:bad_header_size, size}),
         :ok <- check_header(size, startcode <> size_bytes, demuxer),
         {:ok, bytes} <- read_bytes(demuxer, size),
         body = binary_part(bytes, 0, size - 4),
         <<sum::32>> = binary_part(bytes, size - 4, 4),
         :ok <- check_condition(Nut.header_checksum(body) == sum, {:bad_checksum, name}) do
      parse_packet(name, body, demuxer)
    end
  end

  defp packet_name(startcode) do
    case Nut.startcode_name(startcode) do
      {:ok, name} -> {:ok, name}
      :error -> {:error, :lost_sync}
    end
  end

  defp check_header(size, _bytes, _demuxer) when size <= 4096, do: :ok

  defp check_header(_size, bytes, demuxer) do
    with {:ok, <<sum::32>>} <- read_bytes(demuxer, 4),
         do: check_condition(Nut.header_checksum(bytes) == sum, {:bad_checksum, :header})
  end

  defp parse_packet(:main, body, demuxer) do
    with {:ok, main} <- Headers.decode_main(body), do: {:ok, struct!(demuxer, main)}
  end

  defp parse_packet(:stream, body, demuxer) do
    with {:ok, stream} <- Headers.decode_stream(body, demuxer.count, demuxer.time_bases),
         do: {:ok, put_in(demuxer.streams[stream.id], stream)}
  end

  defp parse_packet(:syncpoint, body, demuxer) do
    with {:ok, last} <- Headers.decode_syncpoint(body, demuxer.time_bases, demuxer.streams),
         do: {:ok, %{demuxer | last: last}}
  end

  defp parse_packet(_info_or_index, _body, demuxer), do: {:ok, demuxer}

  defp read_frame(code, first, demuxer) do
    with :ok <- check_condition(not flag_set?(code.flags, :invalid), :lost_sync),
         {:ok, flags, seen} <- coded_flags(code.flags, first, demuxer),
         {:ok, id, seen} <- read_optional(flags, :stream_id, code.stream, seen, demuxer),
         {:ok, coded, seen} <- read_optional(flags, :coded_pts, nil, seen, demuxer),
         {:ok, msb, seen} <- read_optional(flags, :size_msb, 0, seen, demuxer),
         {:ok, _match, seen} <- read_optional(flags, :match_time, 0, seen, demuxer),
         {:ok, index, seen} <- read_optional(flags, :header_index, code.index, seen, demuxer),
         {:ok, reserved, seen} <- read_optional(flags, :reserved, code.reserved, seen, demuxer),
         {:ok, seen} <- skip_varints(reserved, seen, demuxer),
         :ok <- frame_checksum(flags, seen, demuxer),
         {:ok, stream} <- fetch_stream(id, demuxer) do
      size = code.size + code.mul * msb

      pts =
        if coded,
          do: decode_pts(coded, demuxer.last[id], stream.shift),
          else: demuxer.last[id] + code.pts

      demuxer = put_in(demuxer.last[id], pts)
      read_payload(flags, stream, pts, size, index, demuxer)
    end
  end

  defp coded_flags(flags, seen, demuxer) do
    if flag_set?(flags, :coded) do
      with {:ok, coded, seen} <- read_varint(demuxer, seen), do: {:ok, bxor(flags, coded), seen}
    else
      {:ok, flags, seen}
    end
  end

  defp read_optional(flags, name, default, seen, demuxer) do
    if flag_set?(flags, name), do: read_varint(demuxer, seen), else: {:ok, default, seen}
  end

  defp skip_varints(0, seen, _demuxer), do: {:ok, seen}

  defp skip_varints(n, seen, demuxer) when n <= 256 do
    with {:ok, _, seen} <- read_varint(demuxer, seen), do: skip_varints(n - 1, seen, demuxer)
  end

  defp skip_varints(_n, _seen, _demuxer), do: {:error, :lost_sync}

  defp frame_checksum(flags, seen, demuxer) do
    if flag_set?(flags, :checksum) do
      with {:ok, <<sum::32>>} <- read_bytes(demuxer, 4),
           do: check_condition(Nut.header_checksum(seen) == sum, {:bad_checksum, :frame})
    else
      :ok
    end
  end

  defp fetch_stream(id, demuxer) do
    case demuxer.streams do
      %{^id => stream} when is_map_key(demuxer.last, id) -> {:ok, stream}
      _ -> {:error, :lost_sync}
    end
  end

  # A writer stores only the low bits of a time if they are unambiguous.
  defp decode_pts(coded, _last, shift) when coded >= 1 <<< shift, do: coded - (1 <<< shift)

  defp decode_pts(coded, last, shift) do
    mask = (1 <<< shift) - 1
    delta = last - div(mask, 2)
    (coded - delta &&& mask) + delta
  end

  defp read_payload(flags, stream, pts, size, index, demuxer) do
    prefix =
      if size > 4096 or index >= tuple_size(demuxer.elisions),
        do: <<>>,
        else: elem(demuxer.elisions, index)

    length = size - byte_size(prefix)

    with :ok <- check_condition(size <= demuxer.max_frame, {:frame_too_large, size}),
         :ok <- check_condition(length >= 0 and not flag_set?(flags, :side_data), :lost_sync),
         {:ok, data} <- read_bytes(demuxer, length) do
      frame = %{
        stream: stream.id,
        time: Nut.to_ns(pts, stream.time_base),
        ticks: pts,
        key?: flag_set?(flags, :key),
        data: prepend_elision(prefix, data)
      }

      if flag_set?(flags, :eor), do: {:skip, demuxer}, else: {:ok, frame, demuxer}
    end
  end

  defp prepend_elision(<<>>, data), do: data
  defp prepend_elision(prefix, data), do: prefix <> data

  defp flag_set?(flags, name), do: (flags &&& Map.fetch!(@bits, name)) != 0

  defp read_bytes(_demuxer, 0), do: {:ok, <<>>}

  defp read_bytes(%{read: read}, n) do
    case read.(n) do
      {:ok, bytes} when byte_size(bytes) == n -> {:ok, bytes}
      {:ok, _fewer} -> {:error, :eof}
      {:error, reason} when reason in [:closed, :eof] -> {:error, :eof}
      {:error, reason} -> {:error, reason}
    end
  end

  defp read_varint(demuxer, seen), do: read_varint(demuxer, seen, 0, 0)

  defp read_varint(demuxer, seen, value, n) do
    with {:ok, <<more::1, group::7>> = byte} <- read_bytes(demuxer, 1) do
      value = value <<< 7 ||| group

      cond do
        more == 0 -> {:ok, value, seen <> byte}
        n == 9 -> {:error, :lost_sync}
        true -> read_varint(demuxer, seen <> byte, value, n + 1)
      end
    end
  end

  defp check_condition(true, _reason), do: :ok
  defp check_condition(false, reason), do: {:error, reason}
end
