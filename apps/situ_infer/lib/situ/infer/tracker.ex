defmodule Situ.Infer.Tracker do
  @moduledoc """
  Gives the objects of a detector persistent ids (SORT; Bewley et al., 2016). A box is matched with the object whose
  expected position it overlaps most, best pair first.

  Input and output are lists of `Situ.Rect`. Each emitted rectangle has its object's number in `id` (0, 1 ... in order
  of appearance, and from left to right within an image), and the list is in order of the ids. The boxes are unchanged.
  An object that is missing for longer than `max_missing:` gets a new id when it returns. With a Kalman filter, an
  object that is hidden by another one while it moves is found again on the other side.

      found.out |> Situ.via(Situ.Infer.Tracker, min_hits: 3)

  The pure functions also work without a pipeline:

      iex> alias Situ.{Infer.Tracker, Rect}
      iex> boxes = fn xs -> for x <- xs, do: Rect.new!(x, 0, 20, 20) end
      iex> {_, tracker} = Tracker.update_tracks(Tracker.new(), 0, boxes.([50, 0]))
      iex> {rects, _} = Tracker.update_tracks(tracker, 40_000_000, boxes.([4, 46]))
      iex> Enum.map(rects, &{&1.x, &1.id})
      [{4, 0}, {46, 1}]
  """

  @schema [
    motion: [
      type: {:in, [:kalman, :none]},
      default: :kalman,
      doc:
        "Where an object is searched for: where a Kalman filter expects it, or where it was (`:none`)."
    ],
    min_overlap: [
      type: {:range, 0.0, 1.0},
      default: 0.2,
      doc: "The minimum intersection over union of two boxes of the same object."
    ],
    max_missing: [
      type: :time_ns,
      default: 500_000_000,
      doc: "How long an object may be missing and still keep its id, in ns."
    ],
    min_hits: [
      type: :pos_integer,
      default: 1,
      doc: "The number of images in which an object must have been found before it is emitted."
    ],
    labels: [
      type: {:in, [:same, :any]},
      default: :same,
      doc:
        "Whether an object keeps its label (`:same`), or may have a different one in the next image (`:any`)."
    ]
  ]

  use Situ.Component,
    inputs: [in: {:list, Situ.Rect}],
    outputs: [out: {:list, Situ.Rect}],
    options: @schema

  alias Situ.Infer.Track.{Assignment, Motion}
  alias Situ.Rect

  defstruct [:opts, next_id: 0, tracks: []]

  @typep track :: %{
           id: non_neg_integer(),
           rect: Rect.t(),
           motion: Motion.t() | nil,
           at: Situ.Time.t(),
           seen: Situ.Time.t(),
           hits: pos_integer()
         }
  @type t :: %__MODULE__{opts: map(), next_id: non_neg_integer(), tracks: [track()]}

  @doc "Returns a tracker without tracks. See the options above."
  @spec new(keyword()) :: t()
  def new(opts \\ []), do: %__MODULE__{opts: Map.new(Situ.Options.validate!(opts, @schema))}

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: Map.new(opts)}}

  @impl true
  def handle_message(:in, %{data: rects, originating_time: time}, _context, tracker) do
    {rects, tracker} = update_tracks(tracker, time, Enum.map(rects, &Rect.validate!/1))
    {[{:out, time, rects}], tracker}
  end

  @impl true
  def describe(tracker), do: "#{length(tracker.tracks)} tracks, #{tracker.next_id} objects so far"

  @doc "Updates the tracks with the rectangles found at `time` (later than the last), and returns them with their ids."
  @spec update_tracks(t(), Situ.Time.t(), [Rect.t()]) :: {[Rect.t()], t()}
  def update_tracks(%__MODULE__{opts: opts} = tracker, time, rects) do
    tracks =
      for track <- tracker.tracks,
          time - track.seen <= opts.max_missing,
          do: predict_track(track, time)

    {matched, new} =
      Assignment.assign_detections(
        tracks,
        rects,
        &rank_match(&1, &2, opts),
        &update_track(&1, &2, time)
      )

    {born, next_id} =
      new
      |> Enum.sort_by(&{&1.x, &1.y})
      |> Enum.map_reduce(tracker.next_id, fn rect, id ->
        {start_track(rect, id, time, opts), id + 1}
      end)

    tracks = Enum.sort_by(matched ++ born, & &1.id)
    shown = for t <- tracks, t.seen == time, t.hits >= opts.min_hits, do: t.rect
    {shown, %{tracker | tracks: tracks, next_id: next_id}}
  end

  defp start_track(rect, id, time, opts) do
    motion = if opts.motion == :kalman, do: Motion.new(rect)
    %{id: id, rect: %{rect | id: id}, motion: motion, at: time, seen: time, hits: 1}
  end

  defp predict_track(%{motion: nil} = track, time), do: %{track | at: time}

  defp predict_track(track, time),
    do: %{track | motion: Motion.predict(track.motion, (time - track.at) / 1.0e9), at: time}

  defp expected_rect(%{motion: nil, rect: rect}), do: rect
  defp expected_rect(track), do: Motion.expected_rect(track.motion, track.rect)

  defp rank_match(track, rect, opts) do
    overlap = Rect.iou(expected_rect(track), rect)
    same_label? = opts.labels == :any or rect.label == track.rect.label

    if same_label? and overlap >= opts.min_overlap and overlap > 0,
      do: {-overlap, track.id, rect.x, rect.y}
  end

  defp update_track(track, rect, time) do
    motion = track.motion && Motion.correct(track.motion, rect)
    %{track | rect: %{rect | id: track.id}, motion: motion, seen: time, hits: track.hits + 1}
  end
end
