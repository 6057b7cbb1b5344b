defmodule Situ.Examples.MultimodalVoiceActivity do
  @moduledoc """
  Detects who is speaking from audio **and** lips, and records everything live.

      {:ok, report} = Situ.Pipeline.run(Situ.Examples.MultimodalVoiceActivity, input: "talk1.mp4", path: "recordings")

  `input:` is a file, `"simulated:talk1.mp4"`, or a camera (`"/dev/video0"`). The recording, `path/Talk.NNNN`, contains
  the audio, the images as JPEG, the outputs of the models, who was speaking, and the pipeline's diagnostics. With
  `transcript: true` it also contains the transcript (`Situ.Infer.Speech.Moonshine`) and boxes that show the words at
  the speaker's face. `sound_shift:` (ns) shifts the audio of a file relative to its images if they are not in sync.
  """
  use Situ.Pipeline

  alias Situ.Infer.{Face, MouthShape, SpeechRecognizer, VoiceActivity}
  alias Situ.Media.VideoFile

  @sound Situ.AudioFormat.pcm(16_000)

  @impl true
  def build(p, opts) do
    talk = open_input(p, opts[:input], opts[:sound_shift] || 0)

    hear = talk.audio && Situ.via(talk.audio, VoiceActivity, name: "VoiceActivity")
    voice = hear && hear.voice
    lips = talk.video && MouthShape.detect_stages(talk.video, policy: opts[:policy])
    speaking = lips && Situ.Infer.who_speaks(lips.mouths, voice)

    store = Situ.Store.create(p, "Talk", opts[:path])
    record = &Situ.Store.write(&1, store, "Talk." <> &2)

    record.(talk.audio, "Sound")

    record.(
      talk.video && Situ.map(talk.video, &encode_jpeg/1, type: Situ.EncodedImage, name: "Jpeg"),
      "Pictures"
    )

    record.(voice, "Voice")

    record.(
      voice && Situ.map(voice, & &1.probability, type: :float, name: "Probability"),
      "Voice.Probability"
    )

    record.(hear && hear.segments, "Voice.Segments")

    record.(
      lips && Situ.map(lips.faces, &face_rects/1, type: {:list, Situ.Rect}, name: "Faces"),
      "Faces"
    )

    record.(lips && lips.mouths, "Mouths")

    record.(
      lips &&
        Situ.map(lips.mouths, &mouth_openings/1, type: {:map, :any, :float}, name: "Openings"),
      "Mouths.Opening"
    )

    record.(speaking, "Speaking")
    said = opts[:transcript] && hear && recognize_speech(talk.audio, hear, speaking)
    record.(said, "Transcript")
    record.(said && lips && label_faces(lips.mouths, speaking, said), "Words")
    record.(Situ.Diagnostics.stream(p), "Diagnostics")
    store
  end

  defp open_input(p, input, 0), do: Situ.Media.open(p, input, audio_format: @sound)

  # Images and audio are read separately so that their times can differ. Audio from before the first image is skipped.
  defp open_input(p, file, shift) do
    {:ok, info} = Situ.Media.FileInfo.read(file)
    start = (info.recorded_at || 0) + shift
    span = [start: max(-shift, 0), start_time: start]
    pictures = VideoFile.open(p, file, audio: false)
    sound = VideoFile.open(p, file, [video: false, audio_format: @sound] ++ span)
    %{video: pictures.video, audio: sound.audio}
  end

  defp recognize_speech(sound, hear, who) do
    speaking = if who, do: Situ.Infer.turns(hear, who), else: hear.speaking
    inputs = [sound: sound, speaking: speaking]
    opts = [partial: nil, turns: who != nil, name: "SpeechRecognizer"]
    Situ.via(inputs, SpeechRecognizer, opts).out
  end

  defp label_faces(mouths, speaking, said) do
    inputs = [faces: Situ.join(mouths, speaking), said: said]
    Situ.via(inputs, Situ.Examples.SpeakerLabels, name: "Words")
  end

  defp encode_jpeg(picture) do
    {:ok, jpeg} = Situ.ImageOps.encode_jpeg(picture, quality: 80)
    jpeg
  end

  defp mouth_openings(mouths), do: Map.new(mouths, fn {id, mouth} -> {id, mouth.opening} end)
  defp face_rects(faces), do: Enum.map(faces, fn %Face{rect: rect} -> rect end)
end
