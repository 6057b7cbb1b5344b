defmodule Situ.Infer do
  @moduledoc """
  Models on streams: voices, faces, lips, and who is speaking.

      voice = clip.audio |> Situ.Audio.resample(16_000) |> Situ.Infer.voice()
      mouths = clip.video |> Situ.Infer.MouthShape.detect()
      speaking = Situ.Infer.who_speaks(mouths, voice)

  | you have | you want | use |
  |---|---|---|
  | an ONNX file | to run it | `Situ.Infer.OnnxModel` on streams, `Situ.Infer.Model` |
  | pictures, a network | what is in them | `Situ.Infer.Classifier` |
  | pictures, a network | objects, their shapes | `Situ.Infer.ObjectDetector`, `Situ.Infer.Segmentation` |
  | pictures | the person before the camera, as a mask | `Situ.Infer.PersonMask` |
  | pictures | the body of that person: points, a skeleton | `Situ.Infer.BodyPose` |
  | pictures | the text in them | `Situ.Infer.TextReader` |
  | pictures, a service | what it sees | `Situ.Infer.PictureService` |
  | rectangles | the same things through time | `Situ.Infer.Tracker` |
  | 16 kHz sound | probability of speech | `voice/2` |
  | 16 kHz sound | speech or not, segments | `voice_activity/2`, `Situ.Infer.VoiceActivity` |
  | log energy | speech or not, without a model | `Situ.Infer.SimpleVad` |
  | pictures | faces | `Situ.Infer.FaceDetector`, `Situ.Infer.FaceTracker` |
  | pictures and faces | 468 points on each | `Situ.Infer.FaceLandmarks` |
  | pictures | mouths | `Situ.Infer.MouthShape` |
  | 16 kHz sound | the words | `transcribe/2`, `Situ.Infer.SpeechRecognizer` |
  | 16 kHz sound | whether a name is called | `wake_word/2` |
  | words without punctuation | sentences | `punctuate/2` |
  | text | it spoken | `Situ.Infer.SpeechSynthesizer` |
  | text | what somebody wants | `Situ.Intent.Detector` |
  | a question | a language model's answer | `Situ.Chat` |
  | mouths and voice | who speaks | `who_speaks/3`, `Situ.Infer.ActiveSpeaker` |
  | that and speech | utterances of one person each | `turns/3` |

  Models run in ONNX Runtime, which `bin/setup` fetches; without it the components that need it stop the pipeline with
  `:no_onnxruntime`, and the energy detectors go on working.
  """
  alias Situ.Infer.{ActiveSpeaker, SpeakerTurns, SpeechRecognizer, VoiceActivity}
  alias Situ.Stream

  # Voices come every 32 ms, so one lies within 16 ms of any picture; the rest is room for clocks that differ a little.
  @near 40_000_000

  @doc "`Situ.Infer.Voice` every 32 ms: probability of speech, and level. Options: `Situ.Infer.VoiceActivity`."
  @spec voice(Stream.t(), keyword()) :: Stream.t()
  def voice(sound, opts \\ []), do: hear(sound, opts).voice

  @doc "Whether somebody speaks: a boolean every 32 ms, with hysteresis. Options: `Situ.Infer.VoiceActivity`."
  @spec voice_activity(Stream.t(), keyword()) :: Stream.t()
  def voice_activity(sound, opts \\ []), do: hear(sound, opts).speaking

  @doc """
  `%{face id => speaking?}` for every picture, from the streams of mouths and of voices. Without sound (`nil`) nobody
  speaks. Options: `Situ.Infer.ActiveSpeaker`.
  """
  @spec who_speaks(Stream.t(), Stream.t() | nil, keyword()) :: Stream.t()
  def who_speaks(mouths, voice, opts \\ []),
    do: mouths |> beside(voice) |> Situ.via(ActiveSpeaker, opts)

  @doc """
  Speech or not, with an end where another face takes over without a pause (`Situ.Infer.SpeakerTurns`, whose options it
  takes). `heard` are the outputs of `Situ.Infer.VoiceActivity`, `who` is what `who_speaks/3` gives.
  """
  @spec turns(%{atom() => Stream.t()}, Stream.t(), keyword()) :: Stream.t()
  def turns(%{speaking: speaking, voice: voice}, who, opts \\ []) do
    Situ.via([heard: Situ.join(speaking, voice), who: who], SpeakerTurns, opts)
  end

  @doc """
  Recognises the speech in 16 kHz mono sound: a stream of `Situ.Infer.Speech.Utterance`, each at the time of its end.
  `voice:` are options of `Situ.Infer.VoiceActivity`, the others those of `Situ.Infer.SpeechRecognizer`.
  """
  @spec transcribe(Stream.t(), keyword()) :: Stream.t()
  def transcribe(sound, opts \\ []) do
    {voice, opts} = Keyword.pop(opts, :voice, [])
    inputs = [sound: sound, speaking: voice_activity(sound, voice)]
    Situ.via(inputs, SpeechRecognizer, Keyword.put_new(opts, :name, "SpeechRecognizer")).out
  end

  @wake_word [
    phrase: [type: :string, required: true, doc: "The name."],
    spotter: [
      type: :module,
      default: Situ.Infer.Speech.WakeWord.Spoken,
      doc: "The module that hears it, a `Situ.Infer.Speech.WakeWord`."
    ],
    options: [type: :keyword, default: [], doc: "Further options for its `load/1`."],
    voice: [type: :keyword, default: [], doc: "Options of `Situ.Infer.VoiceActivity`."]
  ]

  @doc """
  Finds a name in 16 kHz mono sound: a `Situ.Infer.Speech.Utterance` with the name for each sentence with it, at
  its end.

  #{Situ.Options.docs(@wake_word)}
  """
  @spec wake_word(Stream.t(), keyword()) :: Stream.t()
  def wake_word(sound, opts) do
    opts = Situ.Options.validate!(opts, @wake_word)
    own = [spotter: opts[:spotter], phrase: opts[:phrase]] ++ opts[:options]

    transcribe(sound,
      recognizer: Situ.Infer.Speech.WakeWord.Spotting,
      recognizer_options: own,
      partial: nil,
      voice: opts[:voice],
      name: "WakeWord"
    )
  end

  @doc "Utterances whose words are made sentences. Options: `Situ.Infer.Punctuator`."
  @spec punctuate(Stream.t(), keyword()) :: Stream.t()
  def punctuate(heard, opts \\ []), do: Situ.via(heard, Situ.Infer.Punctuator, opts)

  defp beside(mouths, nil), do: Situ.map(mouths, &{&1, nil}, type: {:tuple, [mouths.type, :any]})

  defp beside(mouths, voice),
    do: Situ.join(mouths, voice, Situ.Reproducible.nearest(@near, or_default: nil))

  defp hear(sound, opts), do: Situ.via(sound, VoiceActivity, opts)
end
