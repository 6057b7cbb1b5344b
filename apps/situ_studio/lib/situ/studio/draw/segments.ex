defmodule Situ.Studio.Draw.Segments do
  @moduledoc false
  # Builds lanes of states and labels. The value of a message holds until the next message, and
  # adjacent equal values form one segment. A map has a lane for each of its keys; a lane ends at
  # the first message without its key.
  #
  # Only known values are drawn. Between two messages of a sample there are others that were not
  # read. Such a stretch has the class `"many"` and shows their number.
  alias Situ.Studio.{Frame, Gap, ValuePath, Visualizer}
  alias Situ.Studio.Draw.{Key, WindowMessages, GapDetection}

  @typedoc "The tuple `{from, to, label, class, lane}`: `to` is `nil` if open, and the only lane is `\"\"`."
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
          Situ.Recording.t(),
          Frame.channel(),
          Visualizer.spec(),
          Situ.Time.t(),
          Situ.Time.t(),
          pos_integer()
        ) :: Frame.t() | {:error, Situ.Error.t()}
  def window(source, channel, spec, from, to, bin) do
    with {:ok, numbered, all?} <- WindowMessages.fetch_numbered(source, spec, from, to) do
      within = for {_, m} <- numbered, m.originating_time <= to, do: m

      holes =
        if all?,
          do: GapDetection.find_gaps(for {_, m} <- numbered, do: {m.originating_time, 1}),
          else: []

      numbered
      |> from_messages(spec.path, to, spec.viz.id == "labels")
      |> Enum.filter(fn {_, until, _, _, _} -> until == nil or until > from end)
      |> remove_gaps(holes)
      |> segments_frame(channel, bin, within, all?)
    end
  end

  @doc """
  Removes the parts of segments that are within gaps.

      iex> Situ.Studio.Draw.Segments.remove_gaps([{0, 90, "x", "state", ""}, {90, nil, "y", "state", ""}], [{20, 50}])
      [{0, 20, "x", "state", ""}, {50, 90, "x", "state", ""}, {90, nil, "y", "state", ""}]
  """
  @spec remove_gaps([t()], [{Situ.Time.t(), Situ.Time.t()}]) :: [t()]
  def remove_gaps(rows, []), do: rows

  def remove_gaps(rows, holes) do
    Enum.flat_map(rows, fn {a, b, label, class, lane} ->
      for {from, to} <- ranges_outside(a, b, holes), do: {from, to, label, class, lane}
    end)
  end

  # `nil` is later than every time, because atoms sort after numbers.
  defp ranges_outside(a, b, [{_, to} | holes]) when to <= a, do: ranges_outside(a, b, holes)
  defp ranges_outside(a, b, [{from, _} | _]) when from >= b, do: [{a, b}]
  defp ranges_outside(a, b, []), do: [{a, b}]

  defp ranges_outside(a, b, [{from, to} | holes]) do
    before = if from > a, do: [{a, from}], else: []
    if to < b, do: before ++ ranges_outside(to, b, holes), else: before
  end

  @doc "Builds the frame of segments of `messages`. Merges neighbours if there are too many segments to distinguish."
  @spec segments_frame([t()], Frame.channel(), pos_integer(), [Situ.Message.t()], boolean()) ::
          Frame.t()
  def segments_frame(rows, channel, bin, messages, all?) do
    newest = if messages != [], do: List.last(messages).originating_time
    Frame.segments(channel, merge_short(rows, bin, @rows), newest, sampled: not all?)
  end

  @doc """
  Builds the segments of messages in order, lane by lane. A message after `to` only contributes its time, at which the
  last segment ends; without one the last segment is open. Strings are states, which hold, unless `texts?` is set:
  then they are utterances, and the same text twice is two segments.

      iex> said = [{0, true}, {1, true}, {2, false}]
      iex> messages = for {t, v} <- said, do: {t, %Situ.Message{data: v, originating_time: t}}
      iex> Situ.Studio.Draw.Segments.from_messages(messages, [], 9)
      [{0, 2, "true", "true", ""}, {2, nil, "false", "false", ""}]

      iex> messages = for {n, v} <- [{0, true}, {100, true}], do: {n, %Situ.Message{data: v, originating_time: n}}
      iex> Situ.Studio.Draw.Segments.from_messages(messages, [], 200)
      [{0, 100, "100 messages", "many", ""}, {100, nil, "true", "true", ""}]
  """
  @spec from_messages(
          [WindowMessages.numbered()],
          ValuePath.t(),
          Situ.Time.t(),
          texts? :: boolean()
        ) :: [
          t()
        ]
  def from_messages(messages, path, to, texts? \\ false) do
    by_lane = messages |> lane_rows(path, to, texts?) |> Enum.group_by(&elem(&1, 0), &elem(&1, 1))
    keys = for {:key, key} <- Map.keys(by_lane), do: key

    keyed =
      for key <- Key.sort_keys(keys), do: merge_equal(by_lane[{:key, key}], Key.key_name(key))

    merge_equal(by_lane[:only] || [], "") ++ Enum.concat(keyed)
  end

  @doc "Returns the lane names of one message's data, which are the keys of a map. Other data has none."
  @spec lane_names(term()) :: [String.t()]
  def lane_names(data) do
    for {{:key, key}, _} <- lane_entries(data), do: Key.key_name(key)
  end

  # Returns `{lane, {from, to, label, class}}` for every message.
  defp lane_rows([{n, message} | rest], path, to, texts?) when message.originating_time <= to do
    {until, more} =
      case rest do
        [{next, later} | _] -> {later.originating_time, next - n}
        [] -> {nil, 1}
      end

    rows =
      case ValuePath.fetch(message.data, path) do
        {:ok, value} ->
          for {lane, v} <- lane_entries(value),
              do: {lane, build_row(message.originating_time, until, v, more, texts?)}

        :error ->
          []
      end

    rows ++ lane_rows(rest, path, to, texts?)
  end

  defp lane_rows(_, _, _, _), do: []

  defp build_row(from, until, text, 1, true) when is_binary(text),
    do: {from, until, value_label(text), "text"}

  defp build_row(from, until, value, 1, _),
    do: {from, until, value_label(value), state_class(value)}

  defp build_row(from, until, _, more, _), do: {from, until, {:unread, more}, "many"}

  defp lane_entries(%Gap{}), do: []

  defp lane_entries(map) when is_map(map) and not is_struct(map),
    do: for({key, value} <- map, do: {{:key, key}, value})

  defp lane_entries(value), do: [{:only, value}]

  defp merge_equal([{a, same, label, class}, {same, b, label, class} | rest], lane)
       when class not in ["text", "many"],
       do: merge_equal([{a, b, label, class} | rest], lane)

  defp merge_equal(
         [{a, same, {:unread, n}, class}, {same, b, {:unread, more}, class} | rest],
         lane
       ),
       do: merge_equal([{a, b, {:unread, n + more}, class} | rest], lane)

  defp merge_equal([{a, b, {:unread, n}, class} | rest], lane),
    do: [{a, b, "#{n} messages", class, lane} | merge_equal(rest, lane)]

  defp merge_equal([{_, _, "", _} | rest], lane), do: merge_equal(rest, lane)

  defp merge_equal([{a, b, label, class} | rest], lane),
    do: [{a, b, label, class, lane} | merge_equal(rest, lane)]

  defp merge_equal([], _), do: []

  @doc """
  Merges segments if there are more than `keep`. Adjacent segments that are all shorter than `least`, and therefore
  indistinguishable, become one segment of the class `"many"` that shows the number of changes.

      iex> rows = for t <- 0..9, do: {t, t + 1, "x\#{t}", "state", ""}
      iex> Situ.Studio.Draw.Segments.merge_short(rows ++ [{10, 90, "y", "state", ""}], 5, 3)
      [{0, 10, "10 changes", "many", ""}, {10, 90, "y", "state", ""}]
  """
  @spec merge_short([t()], pos_integer(), pos_integer()) :: [t()]
  def merge_short(rows, least, keep) do
    if length(rows) <= keep,
      do: rows,
      else:
        rows
        |> Enum.reduce([], &thin_one(&1, &2, least))
        |> Enum.map(&label_merged/1)
        |> Enum.reverse()
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

  defp label_merged({a, b, {:many, n}, _, lane}), do: {a, b, "#{n} changes", "many", lane}
  defp label_merged(row), do: row

  @doc "Formats a value in a few words."
  @spec value_label(term()) :: String.t()
  def value_label(value) when is_binary(value) do
    if String.valid?(value), do: String.slice(value, 0, @max_label), else: inspect(value)
  end

  def value_label(nil), do: ""
  def value_label(value) when is_atom(value), do: Atom.to_string(value)

  def value_label(value),
    do: value |> inspect(limit: 10, printable_limit: 80) |> String.slice(0, @max_label)

  @doc "Returns the class of a state, which determines how it is drawn."
  @spec state_class(term()) :: String.t()
  def state_class(true), do: "true"
  def state_class(false), do: "false"
  def state_class(_), do: "state"
end
