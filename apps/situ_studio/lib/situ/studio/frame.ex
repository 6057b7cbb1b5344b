defmodule Situ.Studio.Frame do
  @moduledoc """
  Encodes the replies of the data socket and of `GET /data/...`: one header, then frames. All values are
  little-endian. Payloads are aligned to 8 bytes, so that a browser can create typed arrays on them without copying.
  `priv/frames.json` defines the headers and codes for the server and the page; after a change, run `npm run frames`.

  Header of a reply:

  #{Situ.Studio.FrameSchema.layout_table(:reply)}

  Header of a frame, before its payload, which is padded to 8 bytes:

  #{Situ.Studio.FrameSchema.layout_table(:frame)}

  | kind | payload |
  |---|---|
  | 1 series | five columns of 64-bit floats: time relative to the base, min, max, last, count |
  | 2 segments | JSON `[[from, to or null, label, class, lane], ...]`, times relative to the base; `lane` is left out if there is only one |
  | 3 marks | two columns: time relative to the base, latency in ns |
  | 4 image | the header below, then the bytes |
  | 5 json | a value tree, shapes, bars or a string |
  | 6 none | there is no message at this time |
  | 7 same | the last message on this channel is still current |
  | 8 error | an error message |
  | 9 pcm | interleaved 32-bit float samples; the channel count follows from the payload size and the number of rows (audio frames) |
  | 10 lines | for each row: the size of its name and the number of points (32 bits each), the name padded to 8, and columns as in a series; a gap is NaN |
  | 11 scene | 3D objects: the size of a JSON text (32 bits, then 32 zero bits), the text, padded to 8, and numbers |
  | 12 sounds | audio chunks of equal length, one per row: their times relative to the base (64-bit floats), then 32-bit float samples |

  Header of an image:

  #{Situ.Studio.FrameSchema.layout_table(:image)}

  The JSON text of a scene is `{"items": [...], "problems": [...]}`. An item has a `kind`, a `count` of elements, and
  `at`, an object that gives the offset and the size of each kind of numbers after the text. `names` contains the names
  that the pointer shows, one per element. Units are metres, with x forward, y left and z up.

  | kind | an item contains | numbers |
  |---|---|---|
  | `points` | a point cloud | `position` 3 floats, optionally `color` 3 bytes, `value` 1 float |
  | `lines` | lines, or arrows if `arrow` is true | `position` 6 floats, optionally `color` 3 bytes |
  | `boxes` | boxes | `matrix` 16 floats in column-major order, of a cube with edges of 1 |
  | `meshes` | one mesh | `position` 3 floats, `index` 3 32-bit integers |
  | `texts` | text that faces the viewer | `position` 3 floats |
  | `quads` | flat surfaces, optionally with an image | `corner` 12 floats, clockwise from the top left |
  | `frusta` | camera frusta | `corner` 15 floats: the apex, and the corners at 1 m |
  | `graphs` | nodes and their edges | `position` 3 floats, `edge` 2 32-bit integers, optionally `confidence` 1 byte |
  | `voxels` | cubes of one size | `position` 3 floats, optionally `value` 1 float |

      iex> frame = Situ.Studio.Frame.no_message(7)
      iex> bytes = IO.iodata_to_binary(Situ.Studio.Frame.encode_reply([frame], %{request: 1, from: 0, to: 9, time: 5}))
      iex> {byte_size(bytes), :binary.at(bytes, 0)}
      {72, 1}
  """

  alias Situ.Studio.Draw.Bins
  alias Situ.Studio.FrameSchema

  @nan <<0, 0, 0, 0, 0, 0, 0xF8, 0x7F>>

  @type t :: iodata()
  @type channel :: 0..4_294_967_295
  @type segment ::
          {Situ.Time.t(), Situ.Time.t() | nil, label :: String.t(), class :: String.t(),
           lane :: String.t()}

  @doc """
  Encodes a reply: the header and its frames. `meta` contains `:request`, `:from`, `:to`, `:time` and optionally
  `:live`, `:gone`, `:replaced` and `:version`.
  """
  @spec encode_reply([t()], map()) :: iodata()
  def encode_reply(frames, %{request: request, from: from, to: to, time: time} = meta) do
    head =
      FrameSchema.encode(:reply, %{
        format: FrameSchema.code(:format, :reply),
        flags: FrameSchema.encode_flags(:reply_flag, meta),
        request: request,
        from: from,
        to: to,
        count: length(frames),
        version: meta[:version] || 0,
        time: time
      })

    [head | frames]
  end

  @doc """
  Encodes a signal: points `{time, min, max, last, count}` in time order. A gap has `nil` as `min`, `max` and `last`.
  With `raw?`, each point is one message.
  """
  @spec series(channel(), [Bins.point() | Bins.gap()], boolean(),
          sampled: boolean(),
          together: boolean()
        ) :: t()
  def series(channel, points, raw?, opts \\ []) do
    base = first_time(points)

    build_frame(
      :series,
      channel,
      encode_columns(points, base),
      length(points),
      base,
      flag_bits(raw?, opts)
    )
  end

  @doc "Encodes several named signals of one stream; `more` is the number of omitted signals."
  @spec lines(channel(), [{String.t(), [Bins.point() | Bins.gap()]}], boolean(),
          sampled: boolean(),
          more: non_neg_integer()
        ) :: t()
  def lines(channel, lines, raw?, opts \\ []) do
    # An empty line has no time. Relative times are exact only near the base.
    times = for {_name, [_ | _] = points} <- lines, do: first_time(points)
    base = Enum.min(times, fn -> 0 end)

    payload =
      for {name, points} <- lines do
        size = byte_size(name)
        head = FrameSchema.encode(:line, %{bytes: size, count: length(points)})
        [head, name, padding_bytes(rem(size, 8)), encode_columns(points, base)]
      end

    build_frame(
      :lines,
      channel,
      payload,
      length(lines),
      base,
      flag_bits(raw?, opts),
      opts[:more] || 0
    )
  end

  defp encode_columns(points, base) do
    [
      for({t, _, _, _, _} <- points, into: <<>>, do: <<t - base::little-float-64>>),
      for({_, min, _, _, _} <- points, into: <<>>, do: encode_float(min)),
      for({_, _, max, _, _} <- points, into: <<>>, do: encode_float(max)),
      for({_, _, _, last, _} <- points, into: <<>>, do: encode_float(last)),
      for({_, _, _, _, count} <- points, into: <<>>, do: <<count::little-float-64>>)
    ]
  end

  defp encode_float(nil), do: @nan
  defp encode_float(x), do: <<x::little-float-64>>

  @doc "Encodes lanes, lane by lane in time order, as segments `{from, to | nil, label, class, lane}` up to `newest`."
  @spec segments(channel(), [segment()], Situ.Time.t() | nil, sampled: boolean()) :: t()
  def segments(channel, rows, newest, opts \\ []) do
    base = first_time(rows)
    own = if newest == nil, do: 0, else: newest - base

    json =
      for {from, to, label, class, lane} <- rows do
        [from - base, to && to - base, label, class | if(lane == "", do: [], else: [lane])]
      end

    build_frame(
      :segments,
      channel,
      encode_json(json),
      length(rows),
      base,
      flag_bits(false, opts),
      own
    )
  end

  @doc "Encodes message marks: `{originating time, latency}`."
  @spec marks(channel(), [{Situ.Time.t(), Situ.Time.duration()}], boolean()) :: t()
  def marks(channel, rows, raw?) do
    base = first_time(rows)

    payload = [
      for({t, _} <- rows, into: <<>>, do: <<t - base::little-float-64>>),
      for({_, latency} <- rows, into: <<>>, do: <<latency::little-float-64>>)
    ]

    build_frame(:marks, channel, payload, length(rows), base, flag_bits(raw?, []))
  end

  @doc """
  Encodes an image `{pixels, width, height, data, unit}`. `pixels` is `:jpeg`, `:png`, `:rgb`, `:rgba`, `:bgr`, `:bgra`,
  `:gray8` or `:gray16`. In a depth image, a value of 1 is `unit` micrometres.
  """
  @spec image(channel(), Situ.Time.t(), Situ.Studio.Draw.BrowserImage.t()) :: t()
  def image(channel, time, {pixels, width, height, data, unit}) do
    code = pixel_code(pixels)
    head = FrameSchema.encode(:image, %{width: width, height: height, pixels: code, unit: unit})
    build_frame(:image, channel, [head, data], 1, time)
  end

  @doc "Encodes 3D objects, and the problems of objects that could not be shown."
  @spec scene(channel(), Situ.Time.t(), [Situ.Studio.Scene.item()], [String.t()]) :: t()
  def scene(channel, time, items, problems),
    do: build_frame(:scene, channel, Situ.Studio.Scene.pack(items, problems), length(items), time)

  @doc "Returns the number of a pixel format in the page's protocol."
  @spec pixel_code(atom()) :: 1..8
  def pixel_code(format), do: FrameSchema.code(:pixels, format)

  @doc "Encodes any term that JSON can represent."
  @spec json(channel(), Situ.Time.t(), term()) :: t()
  def json(channel, time, term), do: build_frame(:json, channel, encode_json(term), 1, time)

  @doc "Encodes audio: interleaved 32-bit float samples."
  @spec pcm(channel(), Situ.Time.t(), pos_integer(), binary(), pos_integer()) :: t()
  def pcm(channel, time, rate, samples, channels \\ 1),
    do: build_frame(:pcm, channel, samples, div(byte_size(samples), 4 * channels), time, 0, rate)

  @doc "Encodes audio chunks of one channel and equal length: `{time, 32-bit float samples}`."
  @spec audio_chunks(channel(), [{Situ.Time.t(), binary()}], pos_integer()) :: t()
  def audio_chunks(channel, chunks, rate) do
    base = first_time(chunks)

    payload = [
      for({t, _} <- chunks, into: <<>>, do: <<t - base::little-float-64>>),
      for({_, samples} <- chunks, do: samples)
    ]

    build_frame(:sounds, channel, payload, length(chunks), base, 0, rate)
  end

  @doc "Encodes the absence of a message at this time."
  @spec no_message(channel()) :: t()
  def no_message(channel), do: build_frame(:none, channel, "", 0, 0)

  @doc "Encodes that the last message on this channel is still current."
  @spec same_message(channel()) :: t()
  def same_message(channel), do: build_frame(:same, channel, "", 0, 0)

  @doc "Encodes an error message for the channel."
  @spec error(channel(), String.t()) :: t()
  def error(channel, text), do: build_frame(:error, channel, text, 0, 0)

  defp build_frame(kind, channel, payload, rows, base, flags \\ 0, own \\ 0) do
    size = IO.iodata_length(payload)

    head =
      FrameSchema.encode(:frame, %{
        kind: FrameSchema.code(:kind, kind),
        flags: flags,
        channel: channel,
        bytes: size,
        count: rows,
        time: base,
        step: own
      })

    [head, payload | padding_bytes(rem(size, 8))]
  end

  defp padding_bytes(0), do: []
  defp padding_bytes(over), do: <<0::size((8 - over) * 8)>>

  defp encode_json(term), do: Situ.JSON.encode(term)

  defp first_time([]), do: 0
  defp first_time([row | _]), do: elem(row, 0)

  defp flag_bits(raw?, opts), do: FrameSchema.encode_flags(:frame_flag, [raw: raw?] ++ opts)
end
