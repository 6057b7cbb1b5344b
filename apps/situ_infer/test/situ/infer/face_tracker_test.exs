defmodule Situ.Infer.FaceTrackerTest do
  use ExUnit.Case, async: true
  import Situ.Test.Property, only: [property: 2]
  alias Situ.Infer.FaceTracker
  alias Situ.Rect
  doctest Situ.Infer.FaceTracker

  test "a face keeps its id if it returns in time, and gets a new id later" do
    face = fn x -> %Situ.Infer.Face{rect: Rect.new!(x, 0, 10, 10), eyes: {{0, 0}, {1, 0}}} end
    tracker = FaceTracker.new(max_missing: 100)
    {[a], tracker} = FaceTracker.update_tracks(tracker, 0, [face.(0)])
    {[], tracker} = FaceTracker.update_tracks(tracker, 50, [])
    {[b], tracker} = FaceTracker.update_tracks(tracker, 90, [face.(2)])
    {[], tracker} = FaceTracker.update_tracks(tracker, 150, [])
    {[c], _} = FaceTracker.update_tracks(tracker, 250, [face.(2)])
    assert [a.rect.id, b.rect.id, c.rect.id] == [0, 0, 1]
  end

  property "gives every face of an image a unique id" do
    picture = :proper_types.list({:proper_types.range(0, 200), :proper_types.range(1, 40)})

    {:proper_types.list(picture),
     fn pictures ->
       {ok, _} =
         pictures
         |> Enum.with_index()
         |> Enum.map_reduce(FaceTracker.new(), fn {faces, i}, tracker ->
           faces =
             for {x, w} <- faces,
                 do: %Situ.Infer.Face{rect: Rect.new!(x, 0, w, w), eyes: {{0, 0}, {1, 0}}}

           {tracked, tracker} = FaceTracker.update_tracks(tracker, i * 40_000_000, faces)
           ids = Enum.map(tracked, & &1.rect.id)
           {length(tracked) == length(faces) and Enum.uniq(ids) == ids, tracker}
         end)

       Enum.all?(ok)
     end}
  end
end
