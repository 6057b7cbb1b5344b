defmodule Situ.Examples.Demo.Transcript do
  @moduledoc """
  Attributes each utterance to the face that spoke most during it, or to `nil` if the speaker is outside the image.

      iex> alias Situ.Examples.Demo.Transcript
      iex> said = [%Situ.Infer.Speech.Utterance{text: "Go on.", from: 0, to: 1_000_000_000, confidence: 0.9}]
      iex> rect = Situ.Rect.new!(x: 0, y: 0, width: 9, height: 9, id: 3)
      iex> found = for i <- 0..24, do: {i * 40_000_000, [{rect, i > 5}]}
      iex> [line] = Transcript.attribute_utterances(said, found)
      iex> {line.face, line.text}
      {3, "Go on."}
      iex> IO.iodata_to_binary(Transcript.to_webvtt([line]))
      "WEBVTT\\n\\n00:00:00.000 --> 00:00:01.000\\n<v face 3>Go on.\\n"
  """
  alias Situ.Examples.Demo.{Score, GroundTruth}
  alias Situ.Infer.Speech.Utterance

  # A face that speaks in a smaller share of the images is not considered the speaker.
  @share 0.5

  @type line :: %{
          face: term() | nil,
          rect: Situ.Rect.t() | nil,
          from: Situ.Time.t(),
          to: Situ.Time.t(),
          text: String.t()
        }

  @doc "Builds the lines of a transcript. Times of utterances and images must have the same origin."
  @spec attribute_utterances([Utterance.t()], Score.found()) :: [line()]
  def attribute_utterances(utterances, found) do
    for said <- utterances do
      rect = find_speaker(said, found)
      %{face: rect && rect.id, rect: rect, from: said.from, to: said.to, text: said.text}
    end
  end

  @doc "Returns the rectangle of the face that speaks the utterance, or `nil` if the speaker is outside the image."
  @spec find_speaker(Utterance.t(), Score.found()) :: Situ.Rect.t() | nil
  def find_speaker(said, found) do
    pictures = for {time, faces} <- found, time >= said.from, time <= said.to, do: faces
    speaking = for faces <- pictures, {rect, true} <- faces, do: rect

    case speaking
         |> Enum.group_by(& &1.id)
         |> Enum.max_by(fn {_, rects} -> length(rects) end, fn -> nil end) do
      {_, [rect | _] = rects} -> if length(rects) >= @share * length(pictures), do: rect
      nil -> nil
    end
  end

  @doc "Formats the transcript as WebVTT, with one voice per face."
  @spec to_webvtt([line()]) :: iodata()
  def to_webvtt(lines) do
    cues =
      for line <- lines do
        voice = if line.face == nil, do: "outside", else: "face #{line.face}"

        [
          format_timestamp(line.from),
          " --> ",
          format_timestamp(line.to),
          "\n<v ",
          voice,
          ">",
          escape(line.text),
          "\n"
        ]
      end

    ["WEBVTT\n\n" | Enum.intersperse(cues, "\n")]
  end

  defp escape(text) do
    text
    |> String.replace("&", "&amp;")
    |> String.replace("<", "&lt;")
    |> String.replace(">", "&gt;")
  end

  defp format_timestamp(ns) do
    ms = max(div(ns, 1_000_000), 0)
    pad = fn n, width -> n |> Integer.to_string() |> String.pad_leading(width, "0") end

    [pad.(div(ms, 3_600_000), 2), ":", pad.(rem(div(ms, 60_000), 60), 2), ":"] ++
      [pad.(rem(div(ms, 1000), 60), 2), ".", pad.(rem(ms, 1000), 3)]
  end

  @doc """
  Scores a transcript: its word error rate, and the share of reference utterances attributed to the correct face. Both
  are `nil` if the truth contains no words.
  """
  @spec score_lines([line()], GroundTruth.t()) :: %{wer: float() | nil, right_face: float() | nil}
  def score_lines(_lines, %GroundTruth{said: []}), do: %{wer: nil, right_face: nil}

  def score_lines(lines, %GroundTruth{said: said} = truth) do
    spoken =
      said |> Enum.sort_by(fn {_, from, _, _} -> from end) |> Enum.map_join(" ", &elem(&1, 3))

    right = Enum.count(said, &right_face?(&1, lines, truth))

    %{
      wer: Float.round(Utterance.error_rate(spoken, Enum.map_join(lines, " ", & &1.text)), 4),
      right_face: Float.round(right / length(said), 4)
    }
  end

  defp right_face?({face, from, to, _text}, lines, truth) do
    case Enum.max_by(lines, &overlap_s(&1, from, to), fn -> nil end) do
      nil ->
        false

      line ->
        overlap_s(line, from, to) > 0 and
          face == (line.rect && GroundTruth.face_at(truth, line.rect))
    end
  end

  defp overlap_s(line, from, to), do: min(line.to / 1.0e9, to) - max(line.from / 1.0e9, from)
end
