defmodule Situ.Examples.WhoSpeaksExperiment do
  @moduledoc """
  Tunes `Situ.Infer.who_speaks/3` on the clips of the demo: `bin/demo --experiment`.

  Faces, mouths and the voice are found once for each session (`perceive/2`). Each set of parameters then decides who
  speaks. Detected faces get the names of the true faces that they overlap, which are in the metadata of the sessions.
  """
  use Situ.Experiment

  alias Situ.Annotation.Segmenting
  alias Situ.{Experiment, Metric, Rect, Time}
  alias Situ.Infer.{MouthShape, VoiceActivity}

  @impl true
  def parameters do
    [
      hold: {:time_ns, [Time.ms(80), Time.ms(120), Time.ms(200)]},
      still: {:time_ns, [Time.ms(200), Time.ms(300), Time.ms(400)]},
      lookahead: {:time_ns, [Time.ms(80), Time.ms(160)]}
    ]
  end

  @impl true
  def build(_p, session, parameters) do
    %{mouths: mouths, voice: voice} = Experiment.cached(session, :perceive)
    faces = for face <- Experiment.metadata(session)["faces"], do: {face["id"], face_rect(face)}
    who = Situ.Infer.who_speaks(mouths, voice, Map.to_list(parameters))

    speaking =
      who
      |> Situ.join(mouths)
      |> Situ.map(fn {speaking, mouths} -> name_faces(speaking, mouths, faces) end)
      |> Segmenting.from_keys(fn _face, speaks? -> speaks? && %{"Speech" => "speaks"} end)

    %{"Speaking" => speaking}
  end

  @doc "Finds the mouths and the voice of a session."
  @spec perceive(Experiment.session(), map()) :: %{atom() => Situ.Stream.t()}
  def perceive(session, _options) do
    sound = session |> Experiment.stream("Audio") |> Situ.AudioStream.resample(16_000)
    voice = Situ.via(sound, VoiceActivity, name: "VoiceActivity").voice
    mouths = session |> Experiment.stream("Video") |> MouthShape.detect()
    %{mouths: mouths, voice: voice}
  end

  @impl true
  def metrics do
    [
      speaking: Metric.intervals(truth: "Speaking.Truth", main: :time_f1),
      segments: Metric.intervals(truth: "Speaking.Truth", stream: "Speaking", match: :overlap),
      cost: Metric.cost()
    ]
  end

  @doc "Returns the parameters that `Situ.Infer.ActiveSpeaker` has by default, as results name them."
  @spec default_parameters() :: %{String.t() => number()}
  def default_parameters do
    schema = Situ.Infer.ActiveSpeaker.options()
    for {name, _} <- parameters(), into: %{}, do: {to_string(name), schema[name][:default]}
  end

  defp face_rect(%{"box" => [x, y, width, height]}), do: Rect.new!(x, y, width, height)

  # Several detected faces may overlap one true face; it speaks if any detected face does.
  defp name_faces(speaking, mouths, faces) do
    for {id, speaks?} <- speaking, reduce: %{} do
      named -> Map.update(named, face_name(mouths[id], faces), speaks?, &(&1 or speaks?))
    end
  end

  defp face_name(nil, _faces), do: "stranger"

  defp face_name(mouth, faces) do
    {id, overlap} =
      faces
      |> Enum.map(fn {id, rect} -> {id, Rect.iou(rect, mouth.rect)} end)
      |> Enum.max_by(&elem(&1, 1), fn -> {nil, 0.0} end)

    if overlap > 0.0, do: to_string(id), else: "stranger"
  end
end
