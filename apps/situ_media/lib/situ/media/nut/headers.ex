defmodule Situ.Media.Nut.Headers do
  @moduledoc false
  # Parses the bodies of NUT's header packets. Pure; the demuxer reads the packets and verifies their checksums.
  alias Situ.Media.Nut

  @flags [
    key: 1,
    eor: 2,
    coded_pts: 8,
    stream_id: 16,
    size_msb: 32,
    checksum: 64,
    reserved: 128,
    side_data: 256,
    header_index: 1024,
    match_time: 2048,
    coded: 4096,
    invalid: 8192
  ]

  @type reason :: {:bad_header, term()}

  @doc "Returns the bits of a frame's flags by name."
  @spec flag_bits() :: keyword(pos_integer())
  def flag_bits, do: @flags

  @doc """
  Parses the main header: the time bases, the meaning of each frame's first byte, the elided prefixes, and the number of
  streams.
  """
  @spec decode_main(binary()) :: {:ok, map()} | {:error, reason()}
  def decode_main(body), do: catch_bad_header(fn -> parse_main(body) end)

  @doc "Parses the header of a stream."
  @spec decode_stream(binary(), pos_integer(), tuple()) ::
          {:ok, Nut.stream()} | {:error, reason()}
  def decode_stream(body, count, time_bases),
    do: catch_bad_header(fn -> parse_stream(body, count, time_bases) end)

  @doc "Parses a syncpoint and returns the time of each stream in its own ticks."
  @spec decode_syncpoint(binary(), tuple(), map()) :: {:ok, map()} | {:error, reason()}
  def decode_syncpoint(body, time_bases, streams),
    do: catch_bad_header(fn -> parse_syncpoint(body, time_bases, streams) end)

  # The parsers below throw at the first invalid number.
  defp catch_bad_header(fun) do
    {:ok, fun.()}
  catch
    {:bad_header, what} -> {:error, {:bad_header, what}}
  end

  defp parse_main(body) do
    {version, body} = read_varint(body)
    if version not in 2..4, do: throw({:bad_header, {:version, version}})
    {_minor, body} = if version > 3, do: read_varint(body), else: {0, body}
    {count, body} = read_varint(body)
    {_max_distance, body} = read_varint(body)
    {bases, body} = read_varint(body)
    if count not in 1..64 or bases not in 1..64, do: throw({:bad_header, :counts})
    {time_bases, body} = read_list(bases, body, &time_base/1)
    {codes, body} = frame_codes([], 0, {0, 1, 0, 0}, body)
    {elided, body} = read_varint(body)
    if elided > 255, do: throw({:bad_header, :elision})
    {elisions, _flags} = read_list(elided, body, &read_bytes/1)

    %{
      time_bases: List.to_tuple(time_bases),
      codes: List.to_tuple(codes),
      elisions: List.to_tuple([<<>> | elisions]),
      count: count
    }
  end

  defp time_base(body) do
    {num, body} = read_varint(body)
    {den, body} = read_varint(body)
    if num == 0 or den == 0, do: throw({:bad_header, :time_base})
    {{num, den}, body}
  end

  # Parses runs of frame codes, which define the flags, stream, time and size for each value of a frame's first byte.
  defp frame_codes(codes, 256, _kept, body), do: {Enum.reverse(codes), body}

  defp frame_codes(codes, n, {pts, mul, stream, index}, body) do
    {flags, body} = read_varint(body)
    {fields, body} = read_varint(body)
    {pts, body} = if fields > 0, do: read_signed(body), else: {pts, body}
    {mul, body} = if fields > 1, do: read_varint(body), else: {mul, body}
    {stream, body} = if fields > 2, do: read_varint(body), else: {stream, body}
    {size, body} = if fields > 3, do: read_varint(body), else: {0, body}
    {reserved, body} = if fields > 4, do: read_varint(body), else: {0, body}
    {run, body} = if fields > 5, do: read_varint(body), else: {mul - size, body}
    {_match, body} = if fields > 6, do: read_signed(body), else: {0, body}
    {index, body} = if fields > 7, do: read_varint(body), else: {index, body}
    if fields > 256 or run < 0, do: throw({:bad_header, :frame_codes})
    {_, body} = read_list(max(fields - 8, 0), body, &read_varint/1)

    code = %{
      flags: flags,
      pts: pts,
      mul: mul,
      stream: stream,
      size: size,
      reserved: reserved,
      index: index
    }

    {codes, next} = fill_codes(codes, n, run, code)
    # An empty run would make the loop endless.
    if next == n, do: throw({:bad_header, :frame_codes})
    frame_codes(codes, next, {pts, mul, stream, index}, body)
  end

  # The byte "N" begins start codes, so it never begins a frame and runs do not count it.
  defp fill_codes(codes, ?N, run, code),
    do: fill_codes([%{code | flags: @flags[:invalid]} | codes], ?N + 1, run, code)

  defp fill_codes(codes, n, run, _code) when run == 0 or n == 256, do: {codes, n}

  defp fill_codes(codes, n, run, code),
    do: fill_codes([code | codes], n + 1, run - 1, %{code | size: code.size + 1})

  defp parse_stream(body, count, time_bases) do
    {id, body} = read_varint(body)
    {class, body} = read_varint(body)
    {fourcc, body} = read_bytes(body)
    {base, body} = read_varint(body)
    {shift, body} = read_varint(body)
    {_max_pts_distance, body} = read_varint(body)
    {_decode_delay, body} = read_varint(body)
    {_flags, body} = read_varint(body)
    {_specific, body} = read_bytes(body)

    if id >= count or base >= tuple_size(time_bases) or shift > 16,
      do: throw({:bad_header, :stream})

    Map.merge(
      %{id: id, fourcc: fourcc, time_base: elem(time_bases, base), shift: shift},
      parse_shape(class, body)
    )
  end

  defp parse_shape(0, body) do
    {width, body} = read_varint(body)
    {height, _body} = read_varint(body)
    if width == 0 or height == 0, do: throw({:bad_header, :size})
    %{class: :video, width: width, height: height}
  end

  defp parse_shape(1, body) do
    {num, body} = read_varint(body)
    {den, body} = read_varint(body)
    {channels, _body} = read_varint(body)
    if num == 0 or den == 0 or channels == 0, do: throw({:bad_header, :audio})
    %{class: :audio, rate: div(num, den), channels: channels}
  end

  defp parse_shape(_class, _body), do: %{class: :other}

  defp parse_syncpoint(body, time_bases, streams) do
    {time, _body} = read_varint(body)
    bases = tuple_size(time_bases)
    if bases == 0, do: throw({:bad_header, :syncpoint})
    base = elem(time_bases, rem(time, bases))

    Map.new(streams, fn {id, s} ->
      {id, Nut.rescale_ticks(div(time, bases), base, s.time_base)}
    end)
  end

  defp read_varint(body) do
    case Nut.take_varint(body) do
      {value, rest} -> {value, rest}
      :error -> throw({:bad_header, :short})
    end
  end

  defp read_signed(body) do
    {value, rest} = read_varint(body)
    {Nut.decode_signed(value), rest}
  end

  defp read_bytes(body) do
    {size, rest} = read_varint(body)

    if size > byte_size(rest), do: throw({:bad_header, :short})
    {binary_part(rest, 0, size), binary_part(rest, size, byte_size(rest) - size)}
  end

  defp read_list(n, body, fun), do: read_items(n, body, fun, [])
  defp read_items(0, body, _fun, acc), do: {Enum.reverse(acc), body}

  defp read_items(n, body, fun, acc) do
    {value, body} = fun.(body)
    read_items(n - 1, body, fun, [value | acc])
  end
end
