defmodule Situ.Studio.Draw.Segments do
  @moduledoc """
  Builds lanes of states and labels. The value of a message holds until the next message, and adjacent equal values form
  one segment. A map has a lane for each of its keys; a lane ends at the first message without its key.

      iex> said = [{0, true}, {1, true}, {2, false}]
      iex> messages = for {t, v} <- said, do: {t, %Situ.Message{data: v, originating_time: t}}
      iex> Situ.Studio.Draw.Segments.of(messages, [], 9)
      [{0, 2, "true", "true", ""}, {2, nil, "false", "false", ""}]

  Only known values are drawn. Between two messages of a sample there are others that were not read. Such a stretch has
  the class `"many"` and shows their number.

      iex> messages = for {n, v} <- [{0, true}, {100, true}], do: {n, %Situ.Message{data: v, originating_time: n}}
      iex> Situ.Studio.Draw.Segments.of(messages, [], 200)
      [{0, 100, "100 messages", "many", ""}, {100, nil, "true", "true", ""}]
  """
  alias Situ.Studio.{Frame, Hole, Path, Source, Visualizer}
  alias Situ.Studio.Draw.{Key, Messages, Rhythm}

  @typedoc "From, to (`nil`: open), label, class (how it is drawn), and the name of its lane (`\"\"`: the only lane)."
  @type t ::
          {Situ.Time.t(), Situ.Time.t() | nil, label :: String.t(), class :: String.t(),
           lane :: String.t()}
  @max_label 200
  @rows 3_000

  @doc """
  Builds the frame of a window from messages, for a visualizer's `window`. Nothing is drawn in gaps, where messages were
  expected but are missing.
  """
  @spec window(
          Source.t(),
          Frame.channel(),
          Visualizer.spec(),
          Situ.Time.t(),
          Situ.Time.t(),
          pos_integer()
        ) :: Frame.t() | {:error, Situ.Error.t()}
  def window(source, channel, spec, from, to, bin) do
    with {:ok, numbered, all?} <- Messages.numbered(source, spec, from, to) do
      within = for {_, m} <- numbered, m.originating_time <= to, do: m

      holes =
        if all?, do: Rhythm.holes(for {_, m} <- numbered, do: {m.originating_time, 1}), else: []

      numbered
      |> of(spec.path, to, spec.viz.id == "labels")
      |> Enum.filter(fn {_, until, _, _, _} -> until == nil or until > from end)
      |> cut(holes)
      |> frame(channel, bin, within, all?)
    end
  end

  @doc """
  Removes the parts of segments that are within gaps.

      iex> Situ.Studio.Draw.Segments.cut([{0, 90, "x", "state", ""}, {90, nil, "y", "state", ""}], [{20, 50}])
      [{0, 20, "x", "state", ""}, {50, 90, "x", "state", ""}, {90, nil, "y", "state", ""}]
  """
  @spec cut([t()], [{Situ.Time.t(), Situ.Time.t()}]) :: [t()]
  def cut(rows, []), do: rows

  def cut(rows, holes) do
    Enum.flat_map(rows, fn {a, b, label, class, lane} ->
      for {from, to} <- outside(a, b, holes), do: {from, to, label, class, lane}
    end)
  end

  # `nil` is later than every time, because atoms sort after numbers.
  defp outside(a, b, [{_, to} | holes]) when to <= a, do: outside(a, b, holes)
  defp outside(a, b, [{from, _} | _]) when from >= b, do: [{a, b}]
  defp outside(a, b, []), do: [{a, b}]

  defp outside(a, b, [{from, to} | holes]) do
    before = if from > a, do: [{a, from}], else: []
    if to < b, do: before ++ outside(to, b, holes), else: before
  end

  @doc "Builds the frame of segments of `messages`. Merges neighbours if there are too many segments to distinguish."
  @spec frame([t()], Frame.channel(), pos_integer(), [Situ.Message.t()], boolean()) :: Frame.t()
  def frame(rows, channel, bin, messages, all?) do
    newest = if messages != [], do: List.last(messages).originating_time
    Frame.segments(channel, thin(rows, bin, @rows), newest, sampled: not all?)
  end

  @doc """
  Builds the segments of messages in order, lane by lane. A message after `to` only contributes its time, at which the
  last segment ends; without one the last segment is open. Strings are states, which hold, unless `texts?` is set:
  then they are utterances, and the same text twice is two segments.
  """
  @spec of([Messages.numbered()], Path.t(), Situ.Time.t(), texts? :: boolean()) :: [t()]
  def of(messages, path, to, texts? \\ false) do
    by_lane = messages |> spread(path, to, texts?) |> Enum.group_by(&elem(&1, 0), &elem(&1, 1))
    keys = for {:key, key} <- Map.keys(by_lane), do: key

    keyed = for key <- Key.sort(keys), do: merge(by_lane[{:key, key}], Key.text(key))
    merge(by_lane[:only] || [], "") ++ Enum.concat(keyed)
  end

  @doc "Returns the lane names of one message's data, which are the keys of a map. Other data has none."
  @spec lanes(term()) :: [String.t()]
  def lanes(data) do
    for {{:key, key}, _} <- entries(data), do: Key.text(key)
  end

  # Returns `{lane, {from, to, label, class}}` for every message.
  defp spread([{n, message} | rest], path, to, texts?) when message.originating_time <= to do
    {until, more} =
      case rest do
        [{next, later} | _] -> {later.originating_time, next - n}
        [] -> {nil, 1}
      end

    rows =
      case Path.fetch(message.data, path) do
        {:ok, value} ->
          for {lane, v} <- entries(value),
              do: {lane, row(message.originating_time, until, v, more, texts?)}

        :error ->
          []
      end

    rows ++ spread(rest, path, to, texts?)
  end

  defp spread(_, _, _, _), do: []

  defp row(from, until, text, 1, true) when is_binary(text),
    do: {from, until, label(text), "text"}

  defp row(from, until, value, 1, _), do: {from, until, label(value), class(value)}
  defp row(from, until, _, more, _), do: {from, until, {:unread, more}, "many"}

  defp entries(%Hole{}), do: []

  defp entries(map) when is_map(map) and not is_struct(map),
    do: for({key, value} <- map, do: {{:key, key}, value})

  defp entries(value), do: [{:only, value}]

  defp merge([{a, same, label, class}, {same, b, label, class} | rest], lane)
       when class not in ["text", "many"],
       do: merge([{a, b, label, class} | rest], lane)

  defp merge([{a, same, {:unread, n}, class}, {same, b, {:unread, more}, class} | rest], lane),
    do: merge([{a, b, {:unread, n + more}, class} | rest], lane)

  defp merge([{a, b, {:unread, n}, class} | rest], lane),
    do: [{a, b, "#{n} messages", class, lane} | merge(rest, lane)]

  defp merge([{_, _, "", _} | rest], lane), do: merge(rest, lane)

  defp merge([{a, b, label, class} | rest], lane),
    do: [{a, b, label, class, lane} | merge(rest, lane)]

  defp merge([], _), do: []

  @doc """
  Merges segments if there are more than `keep`. Adjacent segments that are all shorter than `least`, and therefore
  indistinguishable, become one segment of the class `"many"` that shows the number of changes.

      iex> rows = for t <- 0..9, do: {t, t + 1, "x\#{t}", "state", ""}
      iex> Situ.Studio.Draw.Segments.thin(rows ++ [{10, 90, "y", "state", ""}], 5, 3)
      [{0, 10, "10 changes", "many", ""}, {10, 90, "y", "state", ""}]
  """
  @spec thin([t()], pos_integer(), pos_integer()) :: [t()]
  def thin(rows, least, keep) do
    if length(rows) <= keep,
      do: rows,
      else:
        rows |> Enum.reduce([], &thin_one(&1, &2, least)) |> Enum.map(&many/1) |> Enum.reverse()
  end

  # While segments are being merged, `{:many, n}` replaces the label and counts them.
  defp thin_one({a, b, label, class, lane} = row, [{from, a, held, _, lane} = last | rest], least)
       when is_integer(b) and b - a < least and class not in ["many", "text", "span"] do
    case held do
      {:many, n} -> [{from, b, {:many, n + 1}, class, lane} | rest]
      ^label -> [row, last | rest]
      _ when a - from < least -> [{from, b, {:many, 2}, class, lane} | rest]
      _ -> [row, last | rest]
    end
  end

  defp thin_one(row, rows, _), do: [row | rows]

  defp many({a, b, {:many, n}, _, lane}), do: {a, b, "#{n} changes", "many", lane}
  defp many(row), do: row

  @doc "Formats a value in a few words."
  @spec label(term()) :: String.t()
  def label(value) when is_binary(value) do
    if String.valid?(value), do: String.slice(value, 0, @max_label), else: inspect(value)
  end

  def label(nil), do: ""
  def label(value) when is_atom(value), do: Atom.to_string(value)

  def label(value),
    do: value |> inspect(limit: 10, printable_limit: 80) |> String.slice(0, @max_label)

  @doc "Returns the class of a state, which determines how it is drawn."
  @spec class(term()) :: String.t()
  def class(true), do: "true"
  def class(false), do: "false"
  def class(_), do: "state"
end
