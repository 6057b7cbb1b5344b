defmodule Situ.Studio.Visualizers.Spans do
  @moduledoc """
  Time intervals in messages, drawn from their start to their end, whatever the message's own time. Accepted are a
  `Situ.Interval` of times, anything with `start` and `stop` (or `end`) in nanoseconds and optionally a `text`, `label`
  or `name` (an utterance), a `text` with `from` and `to` (a recognised sentence), a pair of an interval and its text,
  lists of these, and maps from names of lanes to these. During an utterance, a recogniser sends several drafts of its
  text (`final?: false`), of which only the newest is drawn.

      iex> Situ.Studio.Visualizers.Spans.of(%{"Ada" => [%{start: 10, stop: 20, text: "hello"}]}, 25)
      [{10, 20, "hello", "span", "Ada"}]
      iex> Situ.Studio.Visualizers.Spans.of({Situ.Interval.closed(1, 5), "yes"}, 5)
      [{1, 5, "yes", "span", ""}]
      iex> Situ.Studio.Visualizers.Spans.of(%{text: "ten of clubs", from: 3, to: 9}, 9)
      [{3, 9, "ten of clubs", "span", ""}]
      iex> Situ.Studio.Visualizers.Spans.of(%{"count" => 3}, 5)
      []
  """
  @behaviour Situ.Studio.Visualizer

  alias Situ.Interval
  alias Situ.Studio.Draw.{Key, Messages, Segments}
  alias Situ.Studio.{Path, Source, Visualizer}

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
    with {:ok, messages, all?} <- Messages.within(source, stream, from, to) do
      before = Source.neighbours(source, stream, :before, from, @around)
      later = Source.neighbours(source, stream, :after, to, @around)
      messages = settled(Enum.reverse(before) ++ messages ++ later)

      rows =
        for message <- messages,
            {:ok, value} <- [Path.fetch(message.data, spec.path)],
            {a, b, _, _, _} = row <- of(value, message.originating_time),
            a <= to and b >= from,
            uniq: true,
            do: row

      rows
      |> Enum.sort_by(&{elem(&1, 4), elem(&1, 0)})
      |> Segments.frame(channel, bin, messages, all?)
    end
  end

  # A draft is not drawn if a later message replaces it.
  defp settled([%{data: %{final?: false}} | [_ | _] = rest]), do: settled(rest)
  defp settled([message | rest]), do: [message | settled(rest)]
  defp settled([]), do: []

  @doc "Returns the intervals in a message's data, in order. Intervals without a start begin at `time`."
  @spec of(term(), Situ.Time.t()) :: [Segments.t()]
  def of(data, time) do
    case lanes(data, time) do
      {:ok, spans} ->
        spans |> Enum.take(@limit) |> Enum.sort_by(fn s -> {elem(s, 4), elem(s, 0)} end)

      :error ->
        []
    end
  end

  @doc "Returns whether structs of this module are intervals."
  @spec struct?(module()) :: boolean()
  def struct?(Interval), do: true

  def struct?(module) do
    Situ.KnownModules.load?(module) and function_exported?(module, :__struct__, 0) and
      bounded?(Map.keys(module.__struct__()))
  end

  defp bounded?(keys) do
    (:start in keys and (:stop in keys or :end in keys)) or
      Enum.all?([:text, :from, :to], &(&1 in keys))
  end

  defp lanes(data, time) do
    with :error <- spans(data, "", time), do: by_lane(data, time)
  end

  defp by_lane(map, time) when is_map(map) and not is_struct(map) and map_size(map) > 0 do
    all(Map.to_list(map), fn {key, value} -> spans(value, Key.text(key), time) end)
  end

  defp by_lane(_, _), do: :error

  defp spans([_ | _] = list, lane, time), do: all(list, &span(&1, lane, time))
  defp spans(value, lane, time), do: span(value, lane, time)

  # Either all elements are intervals, or the data is not. An improper list is not, either.
  defp all([], _), do: {:ok, []}

  defp all([head | tail], fun) do
    with {:ok, spans} <- fun.(head), {:ok, more} <- all(tail, fun), do: {:ok, spans ++ more}
  end

  defp all(_, _), do: :error

  defp span({%Interval{} = interval, text}, lane, time) when is_binary(text) or is_atom(text),
    do: bounds(interval, text, lane, time)

  defp span(%Interval{} = interval, lane, time), do: bounds(interval, nil, lane, time)

  defp span(%{interval: %Interval{} = interval} = map, lane, time),
    do: bounds(interval, first(map, @texts), lane, time)

  defp span(map, lane, _time) when is_map(map) do
    case {first(map, @starts), first(map, @stops)} do
      {from, to} when is_integer(from) and is_integer(to) ->
        {:ok, [{from, max(from, to), label(first(map, @texts)), "span", lane}]}

      _ ->
        said(map, lane)
    end
  end

  defp span(_, _, _), do: :error

  # `from` and `to` need a text, because without one they may be positions.
  defp said(%{text: text, from: from, to: to}, lane)
       when is_binary(text) and is_integer(from) and is_integer(to),
       do: {:ok, [{from, max(from, to), label(text), "span", lane}]}

  defp said(_, _), do: :error

  defp bounds(%Interval{left: left, right: right}, text, lane, time) do
    from = if is_number(left), do: round(left), else: time
    to = if is_number(right), do: max(round(right), from)
    {:ok, [{from, to, label(text), "span", lane}]}
  end

  defp first(map, keys), do: Enum.find_value(keys, &Map.get(map, &1))

  defp label(nil), do: ""
  defp label(text), do: Segments.label(text)
end
