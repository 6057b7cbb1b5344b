defmodule Situ.Studio.Visualizers.Spans do
  @moduledoc false
  # Draws time intervals in messages from their start to their end, independent of the message's
  # own time. It accepts a `Situ.Interval` of times, anything with `start` and `stop` (or `end`)
  # in nanoseconds and optionally a `text`, `label` or `name` (an utterance), a `text` with `from`
  # and `to` (a recognised sentence), a pair of an interval and its text, lists of these, and maps
  # from names of lanes to these. The tracks of annotations are lanes, too. During an utterance, a
  # recogniser sends several drafts of its text (`final?: false`), of which only the newest is
  # drawn.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Annotation
  alias Situ.Annotation.Psi
  alias Situ.Interval
  alias Situ.Studio.Draw.{Key, WindowMessages, Segments}
  alias Situ.Studio.{ValuePath, Visualizer, StreamReader}

  @limit 1_000
  @starts [:start, "start"]
  @stops [:stop, :end, "stop", "end"]
  @texts [:text, :label, :name, "text", "label", "name"]

  @impl true
  def about, do: %Visualizer{id: "spans", title: "Intervals", panel: :lanes, shapes: [:spans]}

  # Intervals may begin before the window, or arrive after it, so this many messages on both sides are read as well.
  @around 8

  @impl true
  def window(source, channel, %{stream: stream} = spec, from, to, bin) do
    with {:ok, messages, all?} <- WindowMessages.fetch_within(source, stream, from, to) do
      before = StreamReader.list_neighbours(source, stream, :before, from, @around)
      later = StreamReader.list_neighbours(source, stream, :after, to, @around)
      messages = drop_drafts(Enum.reverse(before) ++ messages ++ later)

      rows =
        for message <- messages,
            {:ok, value} <- [ValuePath.fetch(message.data, spec.path)],
            {a, b, _, _, _} = row <- find_spans(value, message.originating_time),
            a <= to and b >= from,
            uniq: true,
            do: row

      rows
      |> Enum.sort_by(&{elem(&1, 4), elem(&1, 0)})
      |> Segments.segments_frame(channel, bin, messages, all?)
    end
  end

  # A draft is not drawn if a later message replaces it.
  defp drop_drafts([%{data: %{final?: false}} | [_ | _] = rest]), do: drop_drafts(rest)
  defp drop_drafts([message | rest]), do: [message | drop_drafts(rest)]
  defp drop_drafts([]), do: []

  @doc """
  Returns the intervals in a message's data, in order. Intervals without a start begin at `time`.

      iex> Situ.Studio.Visualizers.Spans.find_spans(%{"Ada" => [%{start: 10, stop: 20, text: "hello"}]}, 25)
      [{10, 20, "hello", "span", "Ada"}]
      iex> Situ.Studio.Visualizers.Spans.find_spans({Situ.Interval.closed(1, 5), "yes"}, 5)
      [{1, 5, "yes", "span", ""}]
      iex> Situ.Studio.Visualizers.Spans.find_spans(%{text: "ten of clubs", from: 3, to: 9}, 9)
      [{3, 9, "ten of clubs", "span", ""}]
      iex> Situ.Studio.Visualizers.Spans.find_spans(%{"count" => 3}, 5)
      []
  """
  @spec find_spans(term(), Situ.Time.t()) :: [Segments.t()]
  def find_spans(data, time) do
    case lane_spans(data, time) do
      {:ok, spans} ->
        spans |> Enum.take(@limit) |> Enum.sort_by(fn s -> {elem(s, 4), elem(s, 0)} end)

      :error ->
        []
    end
  end

  @doc "Returns whether structs of this module are intervals."
  @spec interval_struct?(module()) :: boolean()
  def interval_struct?(Interval), do: true

  def interval_struct?(module) do
    Situ.KnownModules.ensure_loaded?(module) and function_exported?(module, :__struct__, 0) and
      bounded_keys?(Map.keys(module.__struct__()))
  end

  defp bounded_keys?(keys) do
    (:start in keys and (:stop in keys or :end in keys)) or
      Enum.all?([:text, :from, :to], &(&1 in keys))
  end

  # A set of annotations of \psi.
  defp lane_spans(%{"data" => %{}} = set, time) do
    case Psi.decode_annotations(set) do
      {:ok, annotations} -> value_spans(annotations, "", time)
      :error -> by_lane(set, time)
    end
  end

  defp lane_spans(data, time) do
    with :error <- value_spans(data, "", time), do: by_lane(data, time)
  end

  defp by_lane(map, time) when is_map(map) and not is_struct(map) and map_size(map) > 0 do
    collect_all(Map.to_list(map), fn {key, value} ->
      value_spans(value, Key.key_name(key), time)
    end)
  end

  defp by_lane(_, _), do: :error

  defp value_spans([_ | _] = list, lane, time), do: collect_all(list, &build_span(&1, lane, time))
  defp value_spans(value, lane, time), do: build_span(value, lane, time)

  # A list is drawn only if all of its elements are intervals. An improper list is not drawn, either.
  defp collect_all([], _), do: {:ok, []}

  defp collect_all([head | tail], fun) do
    with {:ok, spans} <- fun.(head),
         {:ok, more} <- collect_all(tail, fun),
         do: {:ok, spans ++ more}
  end

  defp collect_all(_, _), do: :error

  # The lane of an annotation is its track; it shows its first value.
  defp build_span(%Annotation{} = a, _lane, _time),
    do: {:ok, [{a.from, a.to, annotation_label(a.values), "span", a.track}]}

  defp build_span({%Interval{} = interval, text}, lane, time)
       when is_binary(text) or is_atom(text),
       do: interval_span(interval, text, lane, time)

  defp build_span(%Interval{} = interval, lane, time),
    do: interval_span(interval, nil, lane, time)

  defp build_span(%{interval: %Interval{} = interval} = map, lane, time),
    do: interval_span(interval, first_value(map, @texts), lane, time)

  defp build_span(map, lane, _time) when is_map(map) do
    case {first_value(map, @starts), first_value(map, @stops)} do
      {from, to} when is_integer(from) and is_integer(to) ->
        {:ok, [{from, max(from, to), span_label(first_value(map, @texts)), "span", lane}]}

      _ ->
        text_span(map, lane)
    end
  end

  defp build_span(_, _, _), do: :error

  # `from` and `to` need a text, because without one they may be positions.
  defp text_span(%{text: text, from: from, to: to}, lane)
       when is_binary(text) and is_integer(from) and is_integer(to),
       do: {:ok, [{from, max(from, to), span_label(text), "span", lane}]}

  defp text_span(_, _), do: :error

  defp interval_span(%Interval{left: left, right: right}, text, lane, time) do
    from = if is_number(left), do: round(left), else: time
    to = if is_number(right), do: max(round(right), from)
    {:ok, [{from, to, span_label(text), "span", lane}]}
  end

  defp first_value(map, keys), do: Enum.find_value(keys, &Map.get(map, &1))

  defp annotation_label(values) do
    case Enum.sort(values) do
      [{_, value} | _] -> span_label(value)
      [] -> ""
    end
  end

  defp span_label(nil), do: ""
  defp span_label(text), do: Segments.value_label(text)
end
