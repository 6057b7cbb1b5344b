defmodule Situ.Examples.Demo.Transcript do
  @moduledoc """
  Attributes each utterance to the face that spoke most during it, or to `nil` if the speaker is outside the image.

      iex> alias Situ.Examples.Demo.Transcript
      iex> said = [%Situ.Infer.Speech.Utterance{text: "Go on.", from: 0, to: 1_000_000_000, confidence: 0.9}]
      iex> rect = Situ.Rect.new!(x: 0, y: 0, width: 9, height: 9, id: 3)
      iex> found = for i <- 0..24, do: {i * 40_000_000, [{rect, i > 5}]}
      iex> [line] = Transcript.of(said, found)
      iex> {line.face, line.text}
      {3, "Go on."}
      iex> IO.iodata_to_binary(Transcript.webvtt([line]))
      "WEBVTT\\n\\n00:00:00.000 --> 00:00:01.000\\n<v face 3>Go on.\\n"
  """
  alias Situ.Examples.Demo.{Score, Truth}
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
  @spec of([Utterance.t()], Score.found()) :: [line()]
  def of(utterances, found) do
    for said <- utterances do
      rect = speaker(said, found)
      %{face: rect && rect.id, rect: rect, from: said.from, to: said.to, text: said.text}
    end
  end

  @doc "Returns the rectangle of the face that speaks the utterance, or `nil` if the speaker is outside the image."
  @spec speaker(Utterance.t(), Score.found()) :: Situ.Rect.t() | nil
  def speaker(said, found) do
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
  @spec webvtt([line()]) :: iodata()
  def webvtt(lines) do
    cues =
      for line <- lines do
        voice = if line.face == nil, do: "outside", else: "face #{line.face}"
        [clock(line.from), " --> ", clock(line.to), "\n<v ", voice, ">", escape(line.text), "\n"]
      end

    ["WEBVTT\n\n" | Enum.intersperse(cues, "\n")]
  end

  defp escape(text) do
    text
    |> String.replace("&", "&amp;")
    |> String.replace("<", "&lt;")
    |> String.replace(">", "&gt;")
  end

  defp clock(ns) do
    ms = max(div(ns, 1_000_000), 0)
    pad = fn n, width -> n |> Integer.to_string() |> String.pad_leading(width, "0") end

    [pad.(div(ms, 3_600_000), 2), ":", pad.(rem(div(ms, 60_000), 60), 2), ":"] ++
      [pad.(rem(div(ms, 1000), 60), 2), ".", pad.(rem(ms, 1000), 3)]
  end

  @doc """
  Scores a transcript: its word error rate, and the share of reference utterances attributed to the correct face. Both
  are `nil` if the truth contains no words.
  """
  @spec score([line()], Truth.t()) :: %{wer: float() | nil, right_face: float() | nil}
  def score(_lines, %Truth{said: []}), do: %{wer: nil, right_face: nil}

  def score(lines, %Truth{said: said} = truth) do
    spoken =
      said |> Enum.sort_by(fn {_, from, _, _} -> from end) |> Enum.map_join(" ", &elem(&1, 3))

    right = Enum.count(said, &right?(&1, lines, truth))

    %{
      wer: Float.round(Utterance.error_rate(spoken, Enum.map_join(lines, " ", & &1.text)), 4),
      right_face: Float.round(right / length(said), 4)
    }
  end

  defp right?({face, from, to, _text}, lines, truth) do
    case Enum.max_by(lines, &common(&1, from, to), fn -> nil end) do
      nil ->
        false

      line ->
        common(line, from, to) > 0 and face == (line.rect && Truth.face_at(truth, line.rect))
    end
  end

  defp common(line, from, to), do: min(line.to / 1.0e9, to) - max(line.from / 1.0e9, from)
end
