defmodule Situ.Studio.Draw.Tracks do
  @moduledoc """
  Builds lanes from a source's summary (`Situ.Store.Summary`). If there are few changes, their exact times are known;
  if there are many, the states in each bin are known. A bin with more than one state has the class `"many"` and shows
  which messages it contains.

      iex> bins = [{0, true, [{true, 4}]}, {8, false, [{true, 1}, {false, 3}]}, {16, false, [{false, 4}]}]
      iex> summary = %{width: 8, counts: [{0, 4}, {8, 4}, {16, 4}], tracks: [{nil, {:states, bins}}]}
      iex> Situ.Studio.Draw.Tracks.segments(summary, nil)
      [{0, 8, "true", "true", ""}, {8, 16, "4 messages: 3 false, 1 true", "many", ""}, {16, nil, "false", "false", ""}]
      iex> summary = %{summary | tracks: [{:door, {:changes, [{0, :open}, {9, :shut}]}}]}
      iex> Situ.Studio.Draw.Tracks.segments(summary, 20)
      [{0, 9, "open", "state", "door"}, {9, 20, "shut", "state", "door"}]

  The lane of a key ends in the first bin whose messages do not have it.

      iex> summary = %{width: 8, counts: [{0, 4}, {8, 4}], tracks: [door: {:states, [{0, :open, [open: 4]}]}]}
      iex> Situ.Studio.Draw.Tracks.segments(summary, 20)
      [{0, 8, "open", "state", "door"}]
  """
  alias Situ.Studio.Draw.{Key, Segments}

  @told 3

  @doc "Returns the segments of all state tracks, lane by lane. The last of each ends at `later`, or is open (`nil`)."
  @spec segments(Situ.Store.Summary.t() | map(), Situ.Time.t() | nil) :: [Segments.t()]
  def segments(%{tracks: tracks, width: width, counts: counts}, later) do
    by_key =
      for {key, {kind, _} = track} <- tracks, kind in [:changes, :states], into: %{} do
        {key, track}
      end

    for key <- Key.sort(Map.keys(by_key)), row <- track(by_key[key], width, counts, later) do
      {from, to, label, class} = row
      {from, to, label, class, if(key == nil, do: "", else: Key.text(key))}
    end
  end

  defp track({:changes, changes}, _, _, later), do: held(changes, later)

  defp track({:states, bins}, width, counts, later) do
    bins
    |> with_absent(counts)
    |> Enum.map(fn
      {start, :absent} -> {start, :absent}
      {start, _, [{state, _}]} -> {start, state}
      {start, last, counts} -> {start, {:many, start + width, Map.new(counts), last}}
    end)
    |> together()
    |> held(later)
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
  defp together([{start, {:many, to, counts, _}}, {to, {:many, next, more, last}} | rest]),
    do:
      together([
        {start, {:many, next, Map.merge(counts, more, fn _, a, b -> a + b end), last}} | rest
      ])

  defp together([{start, {:many, to, _, last} = many} | rest]) do
    # The last state holds until the next bin with messages.
    rest = if match?([{^to, _} | _], rest), do: rest, else: [{to, last} | rest]
    [{start, many} | together(rest)]
  end

  defp together([row | rest]), do: [row | together(rest)]
  defp together([]), do: []

  # A state holds until the next state.
  defp held([{from, same}, {_, same} | rest], later), do: held([{from, same} | rest], later)

  defp held([{from, state}, {to, _} = next | rest], later),
    do: said(from, to, state) ++ held([next | rest], later)

  defp held([{from, state}], later), do: said(from, later, state)
  defp held([], _), do: []

  defp said(from, _, {:many, to, counts, _}), do: [{from, to, counted(counts), "many"}]
  defp said(_, _, nothing) when nothing in [nil, :absent], do: []
  defp said(from, to, state), do: [{from, to, Segments.label(state), Segments.class(state)}]

  defp counted(counts) do
    sorted = Enum.sort_by(counts, fn {state, n} -> {-n, Segments.label(state)} end)
    told = for {state, n} <- Enum.take(sorted, @told), do: "#{n} #{Segments.label(state)}"
    more = if length(sorted) > @told, do: ["..."], else: []
    "#{sorted |> Enum.map(&elem(&1, 1)) |> Enum.sum()} messages: #{Enum.join(told ++ more, ", ")}"
  end
end
