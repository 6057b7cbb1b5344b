defmodule Situ.Annotation.TrackTree do
  @moduledoc false
  # Finds the annotations of one track by time. A tree maps `{from, to}` to ids; the annotations of a track do not
  # overlap.

  @doc "Returns the annotations of a layer's track that share time with a span, in the order of time."
  @spec list_between(map(), String.t(), Situ.Time.t(), Situ.Time.t()) :: [Situ.Annotation.t()]
  def list_between(%{by_id: by_id, tracks: tracks}, track, from, to) do
    tree = Map.get(tracks, track, :gb_trees.empty())

    later = take_until(:gb_trees.iterator_from({from, from}, tree), to, by_id)
    earlier = for id <- last_before(tree, from), a = by_id[id], a.to >= from, do: a
    earlier ++ later
  end

  defp take_until(iterator, to, by_id) do
    case :gb_trees.next(iterator) do
      {{from, _}, id, iterator} when from <= to ->
        [Map.fetch!(by_id, id) | take_until(iterator, to, by_id)]

      _ ->
        []
    end
  end

  @doc "Returns the last annotation of a layer's track that begins before `time`, or `nil`."
  @spec find_before(map(), String.t(), Situ.Time.t()) :: Situ.Annotation.t() | nil
  def find_before(%{by_id: by_id, tracks: tracks}, track, time) do
    case last_before(Map.get(tracks, track, :gb_trees.empty()), time) do
      [id] -> Map.fetch!(by_id, id)
      [] -> nil
    end
  end

  @doc "Returns the annotations of a layer's track that could overlap a new one: those next to its start."
  @spec list_nearest(map(), Situ.Annotation.t()) :: [Situ.Annotation.t()]
  def list_nearest(%{by_id: by_id, tracks: tracks}, new) do
    tree = Map.get(tracks, new.track, :gb_trees.empty())
    after_it = take_ids(:gb_trees.iterator_from({new.from, new.from}, tree), 2)
    for id <- last_before(tree, new.from) ++ after_it, do: Map.fetch!(by_id, id)
  end

  defp take_ids(_iterator, 0), do: []

  defp take_ids(iterator, count) do
    case :gb_trees.next(iterator) do
      {_, id, iterator} -> [id | take_ids(iterator, count - 1)]
      :none -> []
    end
  end

  # In the oldest supported OTP release, gb_trees iterates only forward, so this walks down the tree.
  @dialyzer {:no_opaque, last_before: 2, list_between: 4, find_before: 3, list_nearest: 2}
  defp last_before({_size, node}, time), do: descend_before(node, time, [])

  defp descend_before(nil, _time, best), do: best

  defp descend_before({{from, _}, id, smaller, bigger}, time, best) do
    if from < time,
      do: descend_before(bigger, time, [id]),
      else: descend_before(smaller, time, best)
  end
end
