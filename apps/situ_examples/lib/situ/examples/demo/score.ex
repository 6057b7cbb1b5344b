defmodule Situ.Examples.Demo.Score do
  @moduledoc """
  Compares the detected speakers with the true speakers, image by image.

  An image is correct if exactly the right faces are detected as speaking. Images within 0.2 s of the start or end of
  a speech segment are not scored. A tracked face counts as the true face whose box it overlaps most, or as a stranger
  if it overlaps none.

  A clip may skip images (a variable frame rate). An image and its decision remain valid until the next image. In an
  image without a decision, and after the last image, nobody is speaking. `false_speech_s` and `missed_speech_s` are
  sums over all faces.

      iex> json = ~s({"fps": 10, "frames": 10, "faces": [{"id": 0, "box": [0, 0, 9, 9]}],
      ...>   "speech": [{"face": 0, "speech_start": 0.0, "speech_end": 1.0}]})
      iex> {:ok, truth} = Situ.Examples.Demo.GroundTruth.parse(json)
      iex> rect = Situ.Rect.new!(1, 1, 9, 9)
      iex> found = for i <- 0..8, do: {i * 100_000_000, [{rect, i != 5}]}
      iex> score = Situ.Examples.Demo.Score.score_decisions(truth, found)
      iex> {score.frames, score.scored_frames, score.frame_accuracy, score.missed_speech_s, score.false_speech_s}
      {10, 5, 0.8, 0.1, 0.0}
  """
  alias Situ.Examples.Demo.GroundTruth

  @enforce_keys [:frames, :scored_frames, :frame_accuracy, :false_speech_s, :missed_speech_s]
  defstruct [
    :frames,
    :scored_frames,
    :frame_accuracy,
    :false_speech_s,
    :missed_speech_s,
    per_face: %{}
  ]

  @type found :: [{Situ.Time.t(), [{Situ.Rect.t(), speaking? :: boolean()}]}]
  @type t :: %__MODULE__{}

  @doc "Returns the score of decisions whose times are relative to the start of the clip."
  @spec score_decisions(GroundTruth.t(), found()) :: t()
  def score_decisions(%GroundTruth{} = truth, found) do
    rows =
      for {i, faces} <- hold_decisions(found, truth),
          not GroundTruth.near_edge?(truth, i / truth.fps) do
        {GroundTruth.speakers_at(truth, i / truth.fps), speaking_ids(truth, faces)}
      end

    per_face =
      Map.new(truth.faces, fn {id, _} -> {to_string(id), score_face(rows, id, truth.fps)} end)

    # Strangers count too: attributing a voice to a picture on the wall is false speech.
    false_frames =
      rows |> Enum.map(fn {true_ids, ids} -> length(ids -- true_ids) end) |> Enum.sum()

    missed = rows |> Enum.map(fn {true_ids, ids} -> length(true_ids -- ids) end) |> Enum.sum()

    %__MODULE__{
      frames: truth.frames,
      scored_frames: length(rows),
      frame_accuracy: share_of(Enum.count(rows, fn {a, b} -> a == b end), length(rows)),
      false_speech_s: frames_to_seconds(false_frames, truth.fps),
      missed_speech_s: frames_to_seconds(missed, truth.fps),
      per_face: per_face
    }
  end

  # Pairs the index of each image of the truth with the decision that is in effect at its time.
  defp hold_decisions(found, truth) do
    shown = for {time, faces} <- found, do: {round(time * truth.fps / 1.0e9), faces}
    # If several images have the same index, the last one counts.
    shown = shown |> Map.new() |> Enum.sort()
    last = truth.frames - 1

    {rows, {shown_at, shown_faces}} =
      Enum.flat_map_reduce(shown, {0, []}, fn {i, faces}, {from, held} ->
        {for(j <- from..min(i - 1, last)//1, do: {j, held}), {i, faces}}
      end)

    rest = for j <- (shown_at + 1)..last//1, do: {j, []}
    rows ++ if(shown_at <= last, do: [{shown_at, shown_faces} | rest], else: [])
  end

  defp speaking_ids(truth, faces) do
    for({rect, true} <- faces, do: GroundTruth.face_at(truth, rect) || :stranger)
    |> Enum.uniq()
    |> Enum.sort()
  end

  defp score_face(rows, id, fps) do
    {spoken, false_frames, missed, right} =
      Enum.reduce(rows, {0, 0, 0, 0}, fn {true_ids, ids}, {s, f, m, r} ->
        case {id in true_ids, id in ids} do
          {true, true} -> {s + 1, f, m, r + 1}
          {true, false} -> {s + 1, f, m + 1, r}
          {false, true} -> {s, f + 1, m, r}
          {false, false} -> {s, f, m, r + 1}
        end
      end)

    %{
      "frame_accuracy" => share_of(right, length(rows)),
      "speech_s" => frames_to_seconds(spoken, fps),
      "false_speech_s" => frames_to_seconds(false_frames, fps),
      "missed_speech_s" => frames_to_seconds(missed, fps)
    }
  end

  # A clip without scored images has no errors.
  defp share_of(_n, 0), do: 1.0
  defp share_of(n, of), do: Float.round(n / of, 4)

  defp frames_to_seconds(frames, fps), do: Float.round(frames / fps, 3)
end
