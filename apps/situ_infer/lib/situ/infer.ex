defmodule Situ.Infer do
  @moduledoc """
  Runs models on streams to detect voices, faces and lips, and to determine who is speaking.

      voice = clip.audio |> Situ.AudioStream.resample(16_000) |> Situ.Infer.voice()
      mouths = clip.video |> Situ.Infer.MouthShape.detect()
      speaking = Situ.Infer.who_speaks(mouths, voice)

  | you have | you want | use |
  |---|---|---|
  | an ONNX file | to run it | `Situ.Infer.OnnxModel` on streams, `Situ.Infer.Model` |
  | images, a network | to classify them | `Situ.Infer.Classifier` |
  | images, a network | objects, their shapes | `Situ.Infer.ObjectDetector`, `Situ.Infer.Segmentation` |
  | images | the person in front of the camera, as a mask | `Situ.Infer.PersonMask` |
  | images | the body of that person: points, a skeleton | `Situ.Infer.BodyPose` |
  | images | the text in them | `Situ.Infer.TextReader` |
  | images, a service | a description | `Situ.Infer.ImageService` |
  | rectangles | to track them over time | `Situ.Infer.Tracker` |
  | 16 kHz audio | probability of speech | `voice/2` |
  | 16 kHz audio | speech or not, segments | `voice_activity/2`, `Situ.Infer.VoiceActivity` |
  | log energy | speech or not, without a model | `Situ.Infer.SimpleVad` |
  | images | faces | `Situ.Infer.FaceDetector`, `Situ.Infer.FaceTracker` |
  | images and faces | 468 points on each | `Situ.Infer.FaceLandmarks` |
  | images | mouths | `Situ.Infer.MouthShape` |
  | 16 kHz audio | the words | `transcribe/2`, `Situ.Infer.SpeechRecognizer` |
  | 16 kHz audio | to detect a spoken name | `wake_word/2` |
  | words without punctuation | sentences | `punctuate/2` |
  | text | speech | `Situ.Infer.SpeechSynthesizer` |
  | mouths and voice | who is speaking | `who_speaks/3`, `Situ.Infer.ActiveSpeaker` |
  | the speaker and speech | utterances of one person each | `turns/3` |

  In the app `situ_assistant`, `Situ.Intent.Detector` detects the user's intent in a text, and `Situ.Chat` asks a
  language model.

  Models run in ONNX Runtime, which `bin/setup` installs. Without it, components that need it stop the pipeline with
  `:no_onnxruntime`; the energy detectors keep working.
  """
  alias Situ.Infer.{ActiveSpeaker, Punctuator, SpeakerTurns, SpeechRecognizer, VoiceActivity}
  alias Situ.Infer.Speech.WakeWord.{KeywordSpotter, SpotterRecognizer, TranscriptSpotter}
  alias Situ.Stream

  # Voices have an interval of 32 ms, so every image has one within 16 ms; the rest tolerates slightly different clocks.
  @near 40_000_000

  @doc """
  Emits the `probability` of speech and the `level` of the audio every 32 ms. Options: `Situ.Infer.VoiceActivity`.
  """
  @spec voice(Stream.t(), keyword()) :: Stream.t()
  def voice(sound, opts \\ []), do: detect_voice(sound, opts).voice

  @doc "Emits whether somebody is speaking, every 32 ms with hysteresis. Options: `Situ.Infer.VoiceActivity`."
  @spec voice_activity(Stream.t(), keyword()) :: Stream.t()
  def voice_activity(sound, opts \\ []), do: detect_voice(sound, opts).speaking

  @doc """
  Emits `%{face id => speaking?}` for every image, from the streams of mouths and of voices. Without audio (`nil`),
  nobody is reported as speaking. Options: `Situ.Infer.ActiveSpeaker`.
  """
  @spec who_speaks(Stream.t(), Stream.t() | nil, keyword()) :: Stream.t()
  def who_speaks(mouths, voice, opts \\ []),
    do: mouths |> join_voice(voice) |> Situ.via(ActiveSpeaker, opts)

  @doc """
  Emits whether somebody is speaking, and also ends speech when another face takes over without a pause, so that each
  utterance belongs to one person. `heard` contains the outputs of `Situ.Infer.VoiceActivity`, and `who` is the result
  of `who_speaks/3`.

      heard = Situ.via(sound, Situ.Infer.VoiceActivity)
      who = Situ.Infer.who_speaks(mouths, heard.voice)
      inputs = [sound: sound, speaking: Situ.Infer.turns(heard, who)]
      said = Situ.via(inputs, Situ.Infer.SpeechRecognizer, turns: true)

  Near each change of speaker, one value is `false`: where the voice is weakest. A change is known only after it
  happens, so values are held back for 2.2 s.

  #{Situ.Options.docs(SpeakerTurns.options())}
  """
  @spec turns(%{atom() => Stream.t()}, Stream.t(), keyword()) :: Stream.t()
  def turns(%{speaking: speaking, voice: voice}, who, opts \\ []) do
    Situ.via([heard: Situ.join(speaking, voice), who: who], SpeakerTurns, opts)
  end

  @doc """
  Recognizes speech in 16 kHz mono audio: emits `Situ.Infer.Speech.Utterance`s, each at the time of its end. `voice:`
  are options of `Situ.Infer.VoiceActivity`; all other options are passed to `Situ.Infer.SpeechRecognizer`.
  """
  @spec transcribe(Stream.t(), keyword()) :: Stream.t()
  def transcribe(sound, opts \\ []) do
    {voice, opts} = Keyword.pop(opts, :voice, [])
    inputs = [sound: sound, speaking: voice_activity(sound, voice)]
    Situ.via(inputs, SpeechRecognizer, Keyword.put_new(opts, :name, "SpeechRecognizer")).out
  end

  @wake_word [
    phrase: [type: :string, required: true, doc: "The name to detect."],
    spotter: [
      type: {:or, [{:in, [:transcript, :keyword]}, :module]},
      default: :transcript,
      doc: "How the name is detected (see below), or a module, a `Situ.Infer.Speech.WakeWord`."
    ],
    options: [type: :keyword, default: [], doc: "Options of the spotter."],
    voice: [type: :keyword, default: [], doc: "Options of `Situ.Infer.VoiceActivity`."]
  ]

  @doc """
  Detects a name in 16 kHz mono audio: for each sentence with the name, emits a `Situ.Infer.Speech.Utterance` at the end
  of the sentence.

  #{Situ.Options.docs(@wake_word)}

  The spotter `:transcript` searches for the name among recognized words, and tolerates about one wrong letter in six.
  Choose a name that is unlike other words: spelling alone cannot distinguish a misspelled name from a similar word. If
  similar words occur and the recognizer is accurate, set `alike: 1`. Its options:

  #{Situ.Options.docs(TranscriptSpotter.option_schema())}

  The spotter `:keyword` searches for the sound of the name with PocketSphinx, and needs no ONNX Runtime. Names of three
  or more syllables, consisting of English words, are more reliable. Its options:

  #{Situ.Options.docs(KeywordSpotter.option_schema())}
  """
  @spec wake_word(Stream.t(), keyword()) :: Stream.t()
  def wake_word(sound, opts) do
    opts = Situ.Options.validate!(opts, @wake_word)
    own = [spotter: spotter_module(opts[:spotter]), phrase: opts[:phrase]] ++ opts[:options]

    transcribe(sound,
      recognizer: SpotterRecognizer,
      recognizer_options: own,
      partial: nil,
      voice: opts[:voice],
      name: "WakeWord"
    )
  end

  defp spotter_module(:transcript), do: TranscriptSpotter
  defp spotter_module(:keyword), do: KeywordSpotter
  defp spotter_module(module), do: module

  @doc """
  Turns the words of utterances into sentences with capitals, periods and question marks. Some recognizers write only
  words (PocketSphinx, telephone services); Moonshine already writes sentences.

      heard |> Situ.Infer.punctuate()

  #{Situ.Options.docs(Punctuator.options())}
  """
  @spec punctuate(Stream.t(), keyword()) :: Stream.t()
  def punctuate(heard, opts \\ []), do: Situ.via(heard, Punctuator, opts)

  defp join_voice(mouths, nil),
    do: Situ.map(mouths, &{&1, nil}, type: {:tuple, [mouths.type, :any]})

  defp join_voice(mouths, voice),
    do: Situ.join(mouths, voice, Situ.Reproducible.nearest(@near, or_default: nil))

  defp detect_voice(sound, opts), do: Situ.via(sound, VoiceActivity, opts)
end
