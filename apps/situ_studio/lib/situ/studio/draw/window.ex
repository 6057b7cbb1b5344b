defmodule Situ.Studio.Draw.Window do
  @moduledoc false
  # What is drawn of one stream over an interval of time, as rows for a frame. Signals come summed up from the source;
  # all else is made from messages, as many as can be read at once, and from a sample where there are more.
  alias Situ.Studio.{Draw, Source}
  alias Draw.{Bins, Lines, Segments, Spans}

  @scan 200_000
  @sample 1_000
  @points 1_500
  @lane_rows 3_000
  @mark_rows 20_000
  # Intervals that began before the window or are told of after it: so many messages on both sides are looked at.
  @around 8

  @type rows ::
          {:series, Lines.line(), raw? :: boolean()}
          | {:lines, [{String.t(), Lines.line()}], raw? :: boolean()}
          | {:segments, [Segments.t()], newest :: Situ.Time.t() | nil}
          | {:marks, [{Situ.Time.t(), Situ.Time.duration()}], raw? :: boolean()}
          | {:error, Situ.Error.t()}

  @spec read(Source.t(), Draw.spec(), Situ.Time.t(), Situ.Time.t(), pos_integer()) :: rows()
  def read(source, %{draw: draw, stream: stream, path: []}, from, to, bin)
      when draw in ["line", "waveform"] do
    with {:ok, points, raw?} <- Source.call(source, :series, [stream, from, to, bin]),
         do: {:series, points, raw?}
  end

  def read(source, %{draw: "line"} = spec, from, to, bin) do
    with {:ok, messages} <- messages(source, spec, from, to) do
      {points, raw?} = messages |> Lines.of(spec.path) |> Bins.fold(bin, @points)
      {:series, points, raw?}
    end
  end

  def read(source, %{draw: "lines"} = spec, from, to, bin) do
    with {:ok, messages} <- messages(source, spec, from, to) do
      lines = Lines.of_maps(messages, spec.path)
      folded = for {name, points} <- lines, do: {name, Bins.fold(points, bin, @points)}
      raw? = Enum.all?(folded, fn {_, {_, raw?}} -> raw? end)
      {:lines, for({name, {points, _}} <- folded, do: {name, points}), raw?}
    end
  end

  def read(source, %{draw: "segments"} = spec, from, to, bin) do
    with {:ok, messages} <- messages(source, spec, from, to) do
      {within, after_it} = Enum.split_while(messages, &(&1.originating_time <= to))
      later = with [next | _] <- after_it, do: next.originating_time, else: ([] -> nil)
      rows = within |> Segments.of(spec.path, later) |> Segments.thin(bin, @lane_rows)
      {:segments, rows, newest(within)}
    end
  end

  def read(source, %{draw: "spans", stream: stream} = spec, from, to, bin) do
    with {:ok, messages} <- within(source, stream, from, to) do
      before = around(source, :latest_at, stream, from, -1)
      later = around(source, :next_after, stream, to, 0)
      messages = Enum.reverse(before) ++ messages ++ later

      rows =
        for message <- messages,
            {:ok, value} <- [Situ.Studio.Path.fetch(message.data, spec.path)],
            {a, b, _, _, _} = row <- Spans.of(value, message.originating_time),
            a <= to and b >= from,
            uniq: true,
            do: row

      sorted = Enum.sort_by(rows, &{elem(&1, 4), elem(&1, 0)})
      {:segments, Segments.thin(sorted, bin, @lane_rows), newest(messages)}
    end
  end

  def read(source, %{draw: "latency", stream: stream}, from, to, bin) do
    with {:ok, rows, _} <- Source.call(source, :marks, [stream, from, to, @mark_rows]) do
      points = for {t, latency} <- rows, do: Bins.point(t, latency / 1.0e6)
      {points, raw?} = Bins.fold(points, bin, @points)
      {:series, points, raw?}
    end
  end

  def read(source, %{draw: "marks", stream: stream}, from, to, _bin) do
    with {:ok, rows, all} <- Source.call(source, :marks, [stream, from, to, @mark_rows]),
         do: {:marks, rows, all == :all}
  end

  defp newest([]), do: nil
  defp newest(messages), do: List.last(messages).originating_time

  # Those within, and one on both sides: what is in force at the beginning, and until when at the end.
  defp messages(source, %{stream: stream}, from, to) do
    with {:ok, messages} <- within(source, stream, from, to) do
      before = one(Source.call(source, :latest_at, [stream, from - 1]))
      {:ok, before ++ messages ++ one(Source.call(source, :next_after, [stream, to]))}
    end
  end

  defp within(source, stream, from, to) do
    case Source.call(source, :messages, [stream, from, to, @scan]) do
      {:ok, messages, :all} -> {:ok, messages}
      {:ok, _, :more} -> {:ok, Source.sample(source, stream, from, to, @sample)}
      error -> error
    end
  end

  defp around(source, side, stream, time, step) do
    time
    |> Stream.unfold(fn time ->
      with {:ok, message} <- Source.call(source, side, [stream, time + step]),
           do: {message, message.originating_time},
           else: (_ -> nil)
    end)
    |> Enum.take(@around)
  end

  defp one({:ok, message}), do: [message]
  defp one(_), do: []
end
