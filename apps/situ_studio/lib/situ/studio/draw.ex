defmodule Situ.Studio.Draw do
  @moduledoc """
  From messages to what the page draws: one function per drawing primitive, named as in `Situ.Studio.Visualizers`.

  On the time axis: `line`, `waveform`, `latency` (series), `lines` (a map's), `segments`, `spans`, `marks`. At the cursor: `image`, `depth`,
  `shapes`, `value`, `bars`, `text`.
  """
  alias Situ.Studio.{Frame, Path, Source, ValueTree}
  alias Situ.Studio.Draw.{Bars, Picture, Shapes, Window}

  @typedoc "What a channel of the page shows."
  @type spec :: %{stream: String.t(), draw: String.t(), path: Path.t()}

  @interval ~w(line lines waveform latency segments spans marks)
  @instant ~w(image depth shapes value bars text)
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
  def window(source, channel, %{draw: draw} = spec, from, to, bin) when draw in @interval do
    case Window.read(source, spec, from, to, bin) do
      {:series, points, raw?} -> Frame.series(channel, points, raw?)
      {:lines, lines, raw?} -> Frame.lines(channel, lines, raw?)
      {:segments, rows, newest} -> Frame.segments(channel, rows, newest)
      {:marks, rows, raw?} -> Frame.marks(channel, rows, raw?)
      {:error, error} -> Frame.error(channel, error.what)
    end
  end

  def window(_, channel, %{draw: draw}, _, _, _),
    do: Frame.error(channel, "#{inspect(draw)} is not drawn over time")

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

  defp draw(draw, channel, time, data, _) when draw in ["image", "depth"] do
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
end
