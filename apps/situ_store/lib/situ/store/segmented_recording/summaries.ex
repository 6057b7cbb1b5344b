defmodule Situ.Store.SegmentedRecording.Summaries do
  @moduledoc false
  # Merges the summaries of the segments of a recording. Bins of neighbouring segments may be the same bin.
  import Bitwise
  alias Situ.Recording
  alias Situ.Store.{Native, NativeFormat, StreamInfo, Summary}
  alias Situ.Store.SegmentedRecording.{Index, PartReading, Visible}
  alias Situ.Store.Summary.{Bins, Fold}

  @doc "Works like `c:Situ.Recording.summary/5`."
  @spec read_numbers(map(), StreamInfo.t(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
          {:ok, pos_integer(), [Summary.bin()]} | {:error, Situ.Error.t()}
  def read_numbers(state, info, from, to, pixels) do
    {from, to} = {NativeFormat.clamp_time(from), NativeFormat.clamp_time(to)}
    level = Native.summary_level(from, to, pixels)

    with {:ok, parts} <- list_parts(state, info, {from, to}, level),
         {:ok, bins} <- Situ.Error.map_ok(parts, &read_signal(&1, from, to, level)),
         do: {:ok, bsl(1, level), merge_bins(Enum.concat(bins))}
  end

  # Parts with hidden messages are read message by message.
  defp read_signal({_part, {reader, info}, nil}, from, to, level),
    do: NativeFormat.read_signal(reader, info, from, to, level)

  defp read_signal({_part, {reader, info}, until}, from, to, level) do
    with {:ok, _, bins} <-
           Fold.fold_numbers(as_recording(reader), info, from, min(to, until - 1), level),
         do: {:ok, bins}
  end

  defp as_recording(reader),
    do: %Recording{path: reader.path, module: NativeFormat, state: reader}

  # Returns the parts that have messages in the bins of a span.
  defp list_parts(state, info, {from, to}, level) do
    :ok = Index.call(state.key, :refresh)
    {from, to} = {Bins.bin_start(from, level), Bins.bin_start(to, level) + bsl(1, level) - 1}

    with {:ok, table} <- PartReading.open_table(state) do
      parts =
        for part <- Tuple.to_list(Index.fetch_parts(table, info.name)),
            part.first <= to and part.last >= from,
            opened = PartReading.open_part(state, table, info, part),
            opened != :deleted,
            do: {part, opened}

      Situ.Error.map_ok(parts, fn
        {part, {:ok, source}} -> {:ok, {part, source, part.until}}
        {_part, error} -> error
      end)
    end
  end

  defp merge_bins(bins), do: bins |> Enum.reduce([], &merge_bin/2) |> Enum.reverse()

  defp merge_bin({start, low, high, last, n}, [{start, min, max, _, count} | rest]),
    do: [{start, min(min, low), max(max, high), last, count + n} | rest]

  defp merge_bin(bin, bins), do: [bin | bins]

  @doc "Works like `c:Situ.Recording.tracks/6`."
  @spec read_tracks(
          map(),
          StreamInfo.t(),
          {Situ.Time.t(), Situ.Time.t()},
          non_neg_integer(),
          non_neg_integer()
        ) ::
          {:ok, [{Situ.Time.t(), pos_integer()}], [{term(), Summary.track()}]}
          | {:error, Situ.Error.t()}
  def read_tracks(state, info, {from, to}, level, most) do
    {from, to} = {NativeFormat.clamp_time(from), NativeFormat.clamp_time(to)}

    with {:ok, parts} <- list_parts(state, info, {from, to}, level) do
      case parts do
        [{_part, {reader, part_info}, nil}] when elem(hd(parts), 0).first <= from ->
          NativeFormat.tracks(reader, part_info, from, to, level, most)

        _ ->
          merge_tracks(state, info, parts, {from, to, level, most})
      end
    end
  end

  defp merge_tracks(state, info, parts, {from, to, level, most} = span) do
    with {:ok, found} <- Situ.Error.map_ok(parts, &read_part(&1, span, most)),
         {:ok, before} <- PartReading.latest_at(state, info, from) do
      keys =
        for({_, tracks} <- found, {key, track} <- tracks, do: {key, kind(track)}) |> Enum.uniq()

      counts = found |> Enum.flat_map(&elem(&1, 0)) |> merge_counts()

      tracks =
        for {key, kind} <- keys,
            do: merge_track({key, kind}, Enum.zip(parts, found), before, {from, to, level, most})

      {:ok, counts, drop_mixed_numbers(tracks)}
    end
  rescue
    error in Situ.Error -> {:error, error}
  end

  defp read_part({_part, {reader, info}, nil}, {from, to, level, _}, most) do
    with {:ok, counts, tracks} <- NativeFormat.tracks(reader, info, from, to, level, most),
         do: {:ok, {counts, tracks}}
  end

  defp read_part({_part, {reader, info}, until}, {from, to, level, _}, most) do
    store = %{as_recording(reader) | module: Visible, state: {reader, until}}

    with {:ok, counts, tracks} <- Fold.fold_tracks(store, info, from, to, level, most),
         do: {:ok, {counts, tracks}}
  end

  defp kind({:numbers, _}), do: :numbers
  defp kind(_states), do: :states

  defp merge_counts(counts) do
    counts
    |> Enum.reduce([], fn
      {start, n}, [{start, m} | rest] -> [{start, n + m} | rest]
      count, counts -> [count | counts]
    end)
    |> Enum.reverse()
  end

  defp merge_track({key, :numbers}, found, _before, _span) do
    bins = for {_, {_, tracks}} <- found, {^key, {:numbers, bins}} <- tracks, bin <- bins, do: bin
    {key, {:numbers, merge_bins(bins)}}
  end

  defp merge_track({key, :states}, found, before, {from, _, _, most} = span) do
    tracks =
      for {part, {_, tracks}} <- found,
          {^key, track} <- tracks,
          kind(track) == :states,
          do: {part, track}

    changes = for {_, {:changes, changes}} <- tracks, change <- changes, do: change
    changes = Enum.dedup_by(seed(key, before, changes, from) ++ changes, &elem(&1, 1))
    seeds = Enum.count(changes, fn {time, _} -> time <= from end)

    if Enum.all?(tracks, &match?({_, {:changes, _}}, &1)) and length(changes) - seeds <= most,
      do: {key, {:changes, changes}},
      else:
        {key, {:states, tracks |> Enum.flat_map(&part_states(&1, key, span)) |> merge_states()}}
  end

  # The state in force at the beginning may be in an earlier segment.
  defp seed(_key, nil, _changes, _from), do: []
  defp seed(_key, _before, [{time, _} | _], from) when time <= from, do: []

  defp seed(key, before, _changes, _from) do
    for {{^key, :state}, state} <- Fold.message_parts(before.data),
        do: {before.originating_time, state}
  end

  defp part_states({_part, {:states, states}}, _key, _span), do: states

  # Few changes are listed individually, so their messages are counted here.
  defp part_states({{_, {reader, info}, until}, {:changes, _}}, key, {from, to, level, _}) do
    store =
      if until,
        do: %{as_recording(reader) | module: Visible, state: {reader, until}},
        else: as_recording(reader)

    {:ok, _counts, tracks} = Fold.fold_tracks(store, info, from, to, level, -1)
    for {^key, {:states, states}} <- tracks, state <- states, do: state
  end

  defp merge_states(states) do
    states
    |> Enum.reduce([], fn
      {start, last, counts}, [{start, _, before} | rest] ->
        [{start, last, add_counts(before, counts)} | rest]

      bin, bins ->
        [bin | bins]
    end)
    |> Enum.reverse()
  end

  defp add_counts(before, counts) do
    Enum.reduce(counts, before, fn {state, n}, sum ->
      case List.keyfind(sum, state, 0) do
        nil -> sum ++ [{state, n}]
        {_, m} -> List.keyreplace(sum, state, 0, {state, n + m})
      end
    end)
    |> Enum.sort_by(&(-elem(&1, 1)))
  end

  # As in a single store, a stream with booleans has no track of numbers.
  defp drop_mixed_numbers(tracks) do
    booleans? = Enum.any?(tracks, fn {key, track} -> key == nil and booleans?(track) end)
    if booleans?, do: Enum.reject(tracks, &match?({nil, {:numbers, _}}, &1)), else: tracks
  end

  defp booleans?({:changes, changes}),
    do: Enum.any?(changes, fn {_, state} -> is_boolean(state) end)

  defp booleans?({:states, states}),
    do: Enum.any?(states, fn {_, _, counts} -> Enum.any?(counts, &is_boolean(elem(&1, 0))) end)

  defp booleans?(_numbers), do: false
end
