defmodule Situ.Assistant do
  @moduledoc """
  A voice assistant that listens for its name, recognizes a sentence, detects the intent, acts, and replies aloud. The
  user can interrupt a reply.

      microphone = Situ.Media.Microphone.open(p)
      assistant = Situ.Assistant.attach(microphone, wake: "computer")
      Situ.Media.Speaker.play(assistant.sound)

  It understands "what time is it", "what day is it", "set a timer for five minutes", "cancel the timer", "stop", and
  similar sentences. `grammar:` adds commands of the program, and with `chat:`, all other sentences go to a language
  model. `attach/2` returns a map of streams:

  | key | type | content |
  |---|---|---|
  | `:voice` | boolean | whether somebody is speaking |
  | `:heard`, `:partial` | `Situ.Infer.Speech.Utterance` | recognized sentences, and partial results |
  | `:intent` | `Situ.Intent` | detected intents |
  | `:said` | string | the assistant's replies, at the time of the decision |
  | `:chat` | string | the replies of the language model; `nil` without `chat:` |
  | `:sound` | `Situ.AudioBuffer` | the spoken replies, in chunks for playback |
  | `:speaking` | boolean | whether the assistant is speaking |
  | `:stop` | string | the words of a user who interrupts the assistant |

  The microphone may pick up the assistant's own voice. The input is therefore attenuated during playback (`duck:`),
  so that a loudspeaker at some distance does not count as speech, but a person at the microphone does. As a second
  safeguard, words that the assistant has just spoken are neither commands nor interruptions.
  """

  alias Situ.Assistant.{Dialogue, Interruption, Player}

  @dialogue Keyword.delete(Dialogue.options(), :ask)
  @own [
    chat: [
      type: {:optional, :keyword},
      default: nil,
      doc: "Options of `Situ.Chat`, the language model for sentences that no rule matches."
    ],
    pause: [
      type: :time_ns,
      default: 350_000_000,
      doc: "The length of silence that ends a sentence, ns."
    ],
    duck: [
      type: {:range, 0, 40},
      default: 20.0,
      doc:
        "How much the input is attenuated during playback, dB. It hides the assistant's voice but not interruptions."
    ],
    quietest: [
      type: {:range, -120, 0},
      default: -55.0,
      doc:
        "Audio below this level is never treated as voice, dB of full scale; `duck:` applies during playback."
    ],
    recognizer: [type: :keyword, default: [], doc: "Options of `Situ.Infer.SpeechRecognizer`."],
    synthesizer: [type: :keyword, default: [], doc: "Options of `Situ.Infer.SpeechSynthesizer`."]
  ]

  @schema @dialogue ++ @own

  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  alias Situ.Infer.{SpeechRecognizer, SpeechSynthesizer, VoiceActivity}
  alias Situ.AudioStream.Ducker
  alias Situ.{Node, Pipeline, Stream}

  # If the recognizer lags by more than this, it skips partial results.
  @late 700_000_000

  @type streams :: %{atom() => Stream.t() | nil}

  @doc "Attaches an assistant to a stream of 16 kHz mono audio."
  @spec attach(Stream.t(), keyword()) :: streams()
  def attach(%Stream{} = sound, opts \\ []) do
    opts = Situ.Options.validate!(opts, @schema)
    ducker = Pipeline.add(sound.pipeline, Ducker, by: opts[:duck], name: "Ducker")
    Pipeline.connect(sound, ducker, :in)

    # Voice activity detection works at any level, so attenuation alone would not hide the assistant's own voice; the
    # noise gate does. Only the detection uses the ducked audio, so interruptions are recognized at full level.
    loud = ducker |> Node.output(:out) |> Situ.AudioStream.noise_gate(open: opts[:quietest])

    voice =
      Situ.via(loud, VoiceActivity, min_silence: opts[:pause], name: "VoiceActivity").speaking

    heard =
      Situ.via(
        [sound: sound, speaking: voice],
        SpeechRecognizer,
        Keyword.merge([early: div(opts[:pause], 2), late: @late], opts[:recognizer]) ++
          [name: "SpeechRecognizer"]
      )

    settings = Keyword.take(opts, Keyword.keys(@dialogue)) ++ [ask: opts[:chat] != nil]

    dialogue = Situ.via([heard: heard.out], Dialogue, settings ++ [name: "Dialogue"])

    stop =
      Situ.via([partial: heard.partial, heard: heard.out, said: dialogue.said], Interruption,
        name: "Interruption"
      )

    chat = opts[:chat] && build_chat(dialogue.ask, stop, opts[:chat])

    replies = synthesize_text(dialogue.said, opts, "Synthesizer")

    player =
      Situ.via([in: replies, stop: stop] ++ answer_input(chat, opts), Player, name: "Player")

    Pipeline.connect(player.speaking, ducker, :while)

    %{
      voice: voice,
      heard: heard.out,
      partial: heard.partial,
      intent: dialogue.intent,
      said: dialogue.said,
      chat: chat,
      sound: player.out,
      speaking: player.speaking,
      stop: stop
    }
  end

  @system "You are a voice assistant. Answer in one or two short sentences of plain words, without lists or markup."

  defp build_chat(questions, stop, opts) do
    opts = Keyword.merge([system: @system, failures: :emit], opts)
    chat = Situ.via([in: questions, cancel: stop], Situ.Chat, opts ++ [name: "Chat"])
    # Failures are spoken too, because nobody reads a log during a conversation.
    sorry = Situ.map(chat.failed, fn _ -> "I cannot reach the language model." end, type: :string)

    [Situ.map(chat.out, & &1.text, type: :string), sorry]
    |> Situ.merge(name: "Answers")
    |> Situ.map(& &1.data, type: :string)
  end

  defp answer_input(nil, _opts), do: []

  defp answer_input(answers, opts),
    do: [answers: synthesize_text(answers, opts, "AnswerSynthesizer")]

  defp synthesize_text(text, opts, name),
    do: Situ.via(text, SpeechSynthesizer, synthesizer_options(opts) ++ [name: name]).out

  defp synthesizer_options(opts), do: Keyword.put(opts[:synthesizer], :stamp, :text)
end
