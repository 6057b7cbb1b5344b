defmodule Situ.Studio.Draw.SummaryLanes do
  @moduledoc false
  # Builds lanes from a source's summary (`Situ.Store.Summary`). If there are few changes, their
  # exact times are known; if there are many, the states in each bin are known. A bin with more
  # than one state has the class `"many"` and shows which messages it contains.
  #
  # The lane of a key ends in the first bin whose messages do not have it.
  alias Situ.Studio.Draw.{Key, Segments}

  @told 3

  @doc """
  Returns the segments of all state tracks, lane by lane. The last of each ends at `later`, or is
  open (`nil`).

      iex> bins = [{0, true, [{true, 4}]}, {8, false, [{true, 1}, {false, 3}]}, {16, false, [{false, 4}]}]
      iex> summary = %{width: 8, counts: [{0, 4}, {8, 4}, {16, 4}], tracks: [{nil, {:states, bins}}]}
      iex> Situ.Studio.Draw.SummaryLanes.from_summary(summary, nil)
      [{0, 8, "true", "true", ""}, {8, 16, "4 messages: 3 false, 1 true", "many", ""}, {16, nil, "false", "false", ""}]
      iex> summary = %{summary | tracks: [{:door, {:changes, [{0, :open}, {9, :shut}]}}]}
      iex> Situ.Studio.Draw.SummaryLanes.from_summary(summary, 20)
      [{0, 9, "open", "state", "door"}, {9, 20, "shut", "state", "door"}]

      iex> summary = %{width: 8, counts: [{0, 4}, {8, 4}], tracks: [door: {:states, [{0, :open, [open: 4]}]}]}
      iex> Situ.Studio.Draw.SummaryLanes.from_summary(summary, 20)
      [{0, 8, "open", "state", "door"}]
  """
  @spec from_summary(Situ.Store.Summary.t() | map(), Situ.Time.t() | nil) :: [Segments.t()]
  def from_summary(%{tracks: tracks, width: width, counts: counts}, later) do
    by_key =
      for {key, {kind, _} = track} <- tracks, kind in [:changes, :states], into: %{} do
        {key, track}
      end

    for key <- Key.sort_keys(Map.keys(by_key)),
        row <- track_rows(by_key[key], width, counts, later) do
      {from, to, label, class} = row
      {from, to, label, class, if(key == nil, do: "", else: Key.key_name(key))}
    end
  end

  defp track_rows({:changes, changes}, _, _, later), do: hold_states(changes, later)

  defp track_rows({:states, bins}, width, counts, later) do
    bins
    |> with_absent(counts)
    |> Enum.map(fn
      {start, :absent} -> {start, :absent}
      {start, _, [{state, _}]} -> {start, state}
      {start, last, counts} -> {start, {:many, start + width, Map.new(counts), last}}
    end)
    |> merge_mixed_bins()
    |> hold_states(later)
  end

  # Adds the bins whose messages do not have the key.
  defp with_absent([bin | bins], [{start, _} | _] = counts) when elem(bin, 0) < start,
    do: [bin | with_absent(bins, counts)]

  defp with_absent([bin | bins], [{start, _} | counts]) when elem(bin, 0) == start,
    do: [bin | with_absent(bins, counts)]

  defp with_absent(bins, [{start, _} | counts]),
    do: [{start, :absent} | with_absent(bins, counts)]

  defp with_absent(bins, []), do: bins

  # Merges neighbouring bins of several states.
  defp merge_mixed_bins([{start, {:many, to, counts, _}}, {to, {:many, next, more, last}} | rest]),
    do:
      merge_mixed_bins([
        {start, {:many, next, Map.merge(counts, more, fn _, a, b -> a + b end), last}} | rest
      ])

  defp merge_mixed_bins([{start, {:many, to, _, last} = many} | rest]) do
    # The last state holds until the next bin with messages.
    rest = if match?([{^to, _} | _], rest), do: rest, else: [{to, last} | rest]
    [{start, many} | merge_mixed_bins(rest)]
  end

  defp merge_mixed_bins([row | rest]), do: [row | merge_mixed_bins(rest)]
  defp merge_mixed_bins([]), do: []

  # A state holds until the next state.
  defp hold_states([{from, same}, {_, same} | rest], later),
    do: hold_states([{from, same} | rest], later)

  defp hold_states([{from, state}, {to, _} = next | rest], later),
    do: state_rows(from, to, state) ++ hold_states([next | rest], later)

  defp hold_states([{from, state}], later), do: state_rows(from, later, state)
  defp hold_states([], _), do: []

  defp state_rows(from, _, {:many, to, counts, _}),
    do: [{from, to, format_counts(counts), "many"}]

  defp state_rows(_, _, nothing) when nothing in [nil, :absent], do: []

  defp state_rows(from, to, state),
    do: [{from, to, Segments.value_label(state), Segments.state_class(state)}]

  defp format_counts(counts) do
    sorted = Enum.sort_by(counts, fn {state, n} -> {-n, Segments.value_label(state)} end)
    told = for {state, n} <- Enum.take(sorted, @told), do: "#{n} #{Segments.value_label(state)}"
    more = if length(sorted) > @told, do: ["..."], else: []
    "#{sorted |> Enum.map(&elem(&1, 1)) |> Enum.sum()} messages: #{Enum.join(told ++ more, ", ")}"
  end
end
