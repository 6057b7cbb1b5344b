defmodule Situ.Infer.FaceTracker do
  @moduledoc """
  Gives faces persistent ids: `0`, `1`, `2` ... in order of appearance, and from left to right among faces that appear
  together.

  Input and output are lists of `Situ.Infer.Face`; each emitted face has its track's id in `rect.id`. A face is matched
  with the face of the previous image that it overlaps most, or else with one within half its width. A face that is
  missing for longer than `:max_missing` gets a new id when it returns.

  The pure functions also work without a pipeline:

      iex> face = fn x -> %Situ.Infer.Face{rect: Situ.Rect.new!(x, 0, 10, 10), eyes: {{0, 0}, {1, 0}}} end
      iex> tracker = Situ.Infer.FaceTracker.new()
      iex> {_, tracker} = Situ.Infer.FaceTracker.update_tracks(tracker, 0, [face.(50), face.(0)])
      iex> {faces, _} = Situ.Infer.FaceTracker.update_tracks(tracker, 40_000_000, [face.(3), face.(52)])
      iex> Enum.map(faces, &{&1.rect.x, &1.rect.id})
      [{3, 0}, {52, 1}]
  """

  @schema [
    max_missing: [
      type: :time_ns,
      default: 500_000_000,
      doc: "How long a face may be missing and still keep its id, in ns."
    ],
    min_hits: [
      type: :pos_integer,
      default: 1,
      doc: "The number of images in which a face must have been found before it is emitted."
    ]
  ]

  use Situ.Component,
    inputs: [in: {:list, Situ.Infer.Face}],
    outputs: [out: {:list, Situ.Infer.Face}],
    options: @schema

  alias Situ.Infer.Face
  alias Situ.Infer.Track.Assignment
  alias Situ.Rect

  @min_iou 0.2

  defstruct opts: [], next_id: 0, tracks: []

  @typep track :: %{
           id: non_neg_integer(),
           face: Face.t(),
           seen: Situ.Time.t(),
           hits: pos_integer()
         }
  @type t :: %__MODULE__{opts: keyword(), next_id: non_neg_integer(), tracks: [track()]}

  @doc "Returns a tracker without tracks. See the options above."
  @spec new(keyword()) :: t()
  def new(opts \\ []), do: %__MODULE__{opts: Situ.Options.validate!(opts, @schema)}

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: opts}}

  @impl true
  def handle_message(:in, message, _context, tracker) do
    faces = Enum.map(message.data, &Face.check!/1)
    {faces, tracker} = update_tracks(tracker, message.originating_time, faces)
    {[{:out, message.originating_time, faces}], tracker}
  end

  @impl true
  def describe(tracker), do: "#{length(tracker.tracks)} tracks, #{tracker.next_id} faces so far"

  @doc "Updates the tracks with the faces found at `time`, and returns those faces with their ids, in order of the ids."
  @spec update_tracks(t(), Situ.Time.t(), [Face.t()]) :: {[Face.t()], t()}
  def update_tracks(%__MODULE__{} = tracker, time, faces) do
    alive = Enum.filter(tracker.tracks, &(time - &1.seen <= tracker.opts[:max_missing]))

    {tracks, new} =
      Assignment.assign_detections(alive, faces, &rank_match/2, &update_track(&1, &2, time))

    {born, next_id} =
      new
      |> Enum.sort_by(&{&1.rect.x, &1.rect.y})
      |> Enum.map_reduce(tracker.next_id, fn face, id ->
        {%{id: id, face: with_id(face, id), seen: time, hits: 1}, id + 1}
      end)

    tracks = Enum.sort_by(tracks ++ born, & &1.id)
    shown = for t <- tracks, t.seen == time, t.hits >= tracker.opts[:min_hits], do: t.face
    {shown, %{tracker | tracks: tracks, next_id: next_id}}
  end

  defp rank_match(track, face) do
    score = match_score(track.face, face)
    if score > 0, do: {-score, track.id, face.rect.x}
  end

  defp update_track(track, face, time),
    do: %{track | face: with_id(face, track.id), seen: time, hits: track.hits + 1}

  defp with_id(face, id), do: %{face | rect: %{face.rect | id: id}}

  # Returns 1..2 for faces that overlap, 0..1 for faces of similar size near each other, and 0 otherwise.
  defp match_score(a, b) do
    iou = Rect.iou(a.rect, b.rect)
    if iou >= @min_iou, do: 1.0 + iou, else: proximity_score(a.rect, b.rect)
  end

  defp proximity_score(a, b) do
    size = max(max(a.width, b.width), 1.0e-6)
    distance = Situ.Point2.distance(Rect.center_point(a), Rect.center_point(b)) / size
    ratio = min(a.width, b.width) / size
    if distance < 0.5 and ratio > 0.5, do: 1.0 - distance, else: 0.0
  end
end
