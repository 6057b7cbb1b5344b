defmodule MeetingRoom do
  @moduledoc """
  Writes the minutes of a meeting from one camera and one microphone: who said what. A person is a face whose lips move
  with the voice; a voice without such a face is outside of the picture.
  """
  use Situ.Pipeline,
    options: [
      input: [
        type: {:optional, :string},
        default: nil,
        doc: "A video with audio, or a camera such as /dev/video0. By default, Situ's demo clip."
      ],
      minutes: [
        type: :string,
        default: "minutes.txt",
        doc: "The file to which the minutes are appended."
      ]
    ]

  alias MeetingRoom.Turns
  alias Situ.Annotation.Spans
  alias Situ.{ImageOps, Infer, Reproducible, Time}
  alias Situ.Infer.{MouthShape, SpeechRecognizer, VoiceActivity}

  @impl true
  def build(p, opts) do
    clip = opts[:input] || Application.app_dir(:situ_examples, "priv/demo/talk1.mp4")
    room = Situ.Media.open(p, clip, audio_format: Situ.AudioFormat.pcm(16_000))

    # Streams with names are recorded by `situ run --record`.
    Situ.name(room.audio, "Audio")
    Situ.map(room.video, &encode/1, type: Situ.EncodedImage, name: "Camera")

    voice = Situ.via(room.audio, VoiceActivity)

    speaking =
      room.video |> MouthShape.detect() |> Infer.who_speaks(voice.voice) |> Situ.name("Speaking")

    # An utterance ends where the voice pauses, or where the speaker changes.
    said =
      [sound: room.audio, speaking: Infer.turns(voice, speaking)]
      |> Situ.via(SpeechRecognizer, partial: nil, turns: true)

    turns = Situ.scan(speaking, Turns.new(), &Turns.add(&3, &2.originating_time, &1))

    said.out
    |> Situ.join(turns, Reproducible.nearest(Time.ms(100)))
    |> Spans.annotate(&span/1, name: "Minutes")
    |> Situ.each(fn annotations -> Enum.each(annotations, &write_line(&1, opts[:minutes])) end)
  end

  defp encode(image), do: image |> ImageOps.encode_jpeg(quality: 80) |> Situ.Error.unwrap!()

  defp span({utterance, turns}) do
    person = Turns.speaker(turns, utterance.from, utterance.to)
    track = if person, do: "person #{person}", else: "outside"
    [{utterance.from, utterance.to, track, %{"Words" => utterance.text}}]
  end

  defp write_line(line, path) do
    text = "#{clock_time(line.from)}  #{line.track}: #{line.values["Words"]}\n"
    IO.write(text)
    File.write!(path, text, [:append])
  end

  # Clips without a date begin at 00:00:00.
  defp clock_time(time), do: time |> Time.to_iso8601() |> String.slice(11, 10)
end
