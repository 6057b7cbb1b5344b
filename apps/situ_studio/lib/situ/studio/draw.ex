defmodule Situ.Studio.Draw do
  @moduledoc """
  From messages to what the page draws: one function per drawing primitive, named as in `Situ.Studio.Visualizers`.

  On the time axis: `line`, `waveform`, `latency` (series), `segments`, `marks`. At the cursor: `image`, `shapes`,
  `value`, `bars`, `text`.
  """
  alias Situ.Studio.{Frame, Path, Source, ValueTree}
  alias Situ.Studio.Draw.{Bars, Bins, Picture, Segments, Shapes}

  @typedoc "What a channel of the page shows."
  @type spec :: %{stream: String.t(), draw: String.t(), path: Path.t()}

  @interval ~w(line waveform latency segments marks)
  @instant ~w(image shapes value bars text)
  @scan 200_000
  @lane_rows 3_000
  @mark_rows 20_000
  @max_text 20_000

  @doc "Whether a primitive is drawn over an interval or at the cursor."
  @spec kind(String.t()) :: :interval | :instant | :unknown
  def kind(draw) when draw in @interval, do: :interval
  def kind(draw) when draw in @instant, do: :instant
  def kind(_), do: :unknown

  @doc "The frame of a window `from..to` with bins of `bin` nanoseconds."
  @spec window(
          Source.t(),
          Frame.channel(),
          spec(),
          Situ.Time.t(),
          Situ.Time.t(),
          pos_integer()
        ) :: Frame.t()
  def window(source, channel, %{draw: draw, stream: stream} = spec, from, to, bin) do
    case draw do
      d when d in ["line", "waveform"] and spec.path == [] ->
        with_ok(channel, Source.call(source, :series, [stream, from, to, bin]), fn points, raw? ->
          Frame.series(channel, points, raw?)
        end)

      "line" ->
        with_ok(channel, scan(source, spec, from, to), fn points, _ ->
          {points, raw?} = Bins.fold(points, bin, 1_500)
          Frame.series(channel, points, raw?)
        end)

      "latency" ->
        with_ok(channel, Source.call(source, :marks, [stream, from, to, @mark_rows]), fn rows,
                                                                                         _ ->
          points = for {t, latency} <- rows, do: Bins.point(t, latency / 1.0e6)
          {points, raw?} = Bins.fold(points, bin, 1_500)
          Frame.series(channel, points, raw?)
        end)

      "marks" ->
        with_ok(channel, Source.call(source, :marks, [stream, from, to, @mark_rows]), fn rows,
                                                                                         all ->
          Frame.marks(channel, rows, all == :all)
        end)

      "segments" ->
        segments(source, channel, spec, from, to)

      _ ->
        Frame.error(channel, "#{inspect(draw)} is not drawn over time")
    end
  end

  # The message in force at the window's beginning belongs to it.
  defp segments(source, channel, %{stream: stream, path: path}, from, to) do
    before =
      case Source.call(source, :latest_at, [stream, from - 1]) do
        {:ok, message} -> [message]
        _ -> []
      end

    result = Source.call(source, :messages, [stream, from, to, @lane_rows])

    with_ok(channel, result, fn messages, more ->
      later =
        if more == :all do
          case Source.call(source, :next_after, [stream, to]) do
            {:ok, next} -> next.originating_time
            _ -> nil
          end
        end

      Frame.segments(channel, Segments.of(before ++ messages, path, later, more))
    end)
  end

  @doc "The frame of the message at the cursor; `last` is what this channel was sent before."
  @spec instant(Source.t(), Frame.channel(), spec(), Situ.Time.t(), term()) ::
          {Frame.t(), last :: term()}
  def instant(source, channel, %{stream: stream} = spec, time, last) do
    case Source.call(source, :latest_at, [stream, time]) do
      {:ok, message} ->
        mark = {message.originating_time, message.sequence_id}

        if mark == last,
          do: {Frame.same(channel), last},
          else: {draw(channel, spec, message), mark}

      :none ->
        {if(last == :none, do: Frame.same(channel), else: Frame.none(channel)), :none}

      {:error, error} ->
        {Frame.error(channel, error.what), nil}
    end
  end

  defp draw(channel, %{draw: draw, path: path}, message) do
    time = message.originating_time

    case Path.fetch(message.data, path) do
      {:ok, data} -> draw(draw, channel, time, data, message)
      :error -> Frame.error(channel, "this message has nothing at this path")
    end
  rescue
    # Messages come from files and foreign programs: one that is not what its type says is shown as such, and the
    # page goes on.
    error -> Frame.error(channel, "this message cannot be drawn: #{Exception.message(error)}")
  end

  defp draw("image", channel, time, data, _) do
    case Picture.of(data) do
      {:ok, picture} -> Frame.image(channel, time, picture)
      {:error, what} -> Frame.error(channel, what)
    end
  end

  defp draw("shapes", channel, time, data, _), do: Frame.json(channel, time, Shapes.of(data))

  defp draw("bars", channel, time, data, _),
    do: Frame.json(channel, time, %{"bars" => Bars.of(data)})

  defp draw("text", channel, time, data, _),
    do: Frame.json(channel, time, %{"text" => text(data)})

  defp draw("value", channel, time, data, message) do
    Frame.json(channel, time, %{
      "tree" => ValueTree.of(data),
      "time" => Integer.to_string(time),
      "sequence" => message.sequence_id,
      "latency" => Situ.Message.latency(message),
      "type" => type(data)
    })
  end

  defp draw(draw, channel, _, _, _),
    do: Frame.error(channel, "#{inspect(draw)} is not drawn at the cursor")

  defp text(data) when is_binary(data) do
    if String.valid?(data), do: String.slice(data, 0, @max_text), else: inspect(data)
  end

  defp text(data), do: inspect(data, pretty: true, limit: 200, printable_limit: 4_000)

  defp type(%module{}), do: inspect(module)
  defp type(data) when is_binary(data), do: if(String.valid?(data), do: "string", else: "binary")
  defp type(data) when is_boolean(data), do: "boolean"
  defp type(data) when is_atom(data), do: "atom"
  defp type(data) when is_integer(data), do: "integer"
  defp type(data) when is_float(data), do: "float"
  defp type(data) when is_list(data), do: "list"
  defp type(data) when is_tuple(data), do: "tuple"
  defp type(data) when is_map(data), do: "map"
  defp type(_), do: "term"

  # A part of a message has no pyramid: its messages are read, as many as can be read at once.
  defp scan(source, %{stream: stream, path: path}, from, to) do
    with {:ok, messages, more} <- Source.call(source, :messages, [stream, from, to, @scan]) do
      points =
        for message <- messages,
            {:ok, value} <- [Path.fetch(message.data, path)],
            {:ok, number} <- [Bins.number(value)],
            do: Bins.point(message.originating_time, number)

      {:ok, points, more}
    end
  end

  defp with_ok(_channel, {:ok, a, b}, fun), do: fun.(a, b)
  defp with_ok(channel, {:error, error}, _fun), do: Frame.error(channel, error.what)
end
