defmodule Situ.Infer.Track.Assignment do
  @moduledoc false
  # Assigns the detections of an image to tracks. The assignment is greedy, best pair first. With few objects, it
  # differs from an optimal one only in doubtful cases.

  @doc """
  Updates each track that gets a detection with `update`, and returns all tracks and the detections without a track.
  `rank` returns the rank of a pair (the smallest is the best), or `nil` if the two do not match. Equal ranks are
  decided by the order of the detections.
  """
  @spec assign_detections(
          [track],
          [detection],
          rank :: (track, detection -> term() | nil),
          update :: (track, detection -> track)
        ) :: {[track], [detection]}
        when track: %{:id => term(), optional(atom()) => term()}, detection: term()
  def assign_detections(tracks, detections, rank, update) do
    indexed = Enum.with_index(detections)

    pairs =
      for track <- tracks, {detection, i} <- indexed, rank = rank.(track, detection) do
        {{rank, i}, track, detection}
      end

    {updated, used} =
      pairs
      |> Enum.sort_by(&elem(&1, 0))
      |> Enum.reduce({%{}, MapSet.new()}, fn {{_, i}, track, detection}, {updated, used} ->
        if is_map_key(updated, track.id) or i in used,
          do: {updated, used},
          else: {Map.put(updated, track.id, update.(track, detection)), MapSet.put(used, i)}
      end)

    {Enum.map(tracks, &Map.get(updated, &1.id, &1)),
     for({detection, i} <- indexed, i not in used, do: detection)}
  end
end
