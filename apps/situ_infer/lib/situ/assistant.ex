defmodule Situ.Assistant do
  @own [
    wake: [
      type: {:optional, :string},
      default: "computer",
      doc: "The name it answers to; `nil`: it answers to everything."
    ],
    attention: [
      type: :time_ns,
      default: 8_000_000_000,
      doc: "How long after its name, or after an answer, it needs no name, ns."
    ],
    grammar: [
      type: {:optional, :string},
      default: nil,
      doc:
        "More that it understands: a grammar (`Situ.Intent.Grammar`) or its file; intents come out on `:intent`."
    ],
    chat: [
      type: {:optional, :keyword},
      default: nil,
      doc: "Who is asked what the rules do not know: options of `Situ.Chat`."
    ],
    local_time: [
      type: {:fun, 1},
      default: &Situ.Assistant.Dialogue.local_time/1,
      doc: "The date and time at a moment (ns), where the assistant stands."
    ],
    pause: [
      type: :time_ns,
      default: 350_000_000,
      doc: "The silence that ends a sentence, ns."
    ],
    duck: [
      type: {:range, 0, 40},
      default: 20.0,
      doc:
        "How much less it hears while it speaks, dB: its own voice is left out, who interrupts it is not."
    ],
    quietest: [
      type: {:range, -120, 0},
      default: -55.0,
      doc:
        "The level below which nothing is a voice, dB of full scale; `duck:` more while it speaks."
    ],
    recognizer: [type: :keyword, default: [], doc: "Options of `Situ.Infer.SpeechRecognizer`."],
    synthesizer: [type: :keyword, default: [], doc: "Options of `Situ.Infer.SpeechSynthesizer`."]
  ]

  @moduledoc """
  A voice assistant: it hears its name, recognises a sentence, finds its intent, acts, and answers aloud; a user who
  interrupts it is heard.

      microphone = Situ.Media.Microphone.open(p)
      assistant = Situ.Assistant.attach(microphone, wake: "computer")
      Situ.Media.Speaker.play(assistant.sound)

  It knows the time, the date and timers (`Situ.Assistant.Skills`); other sentences go to a language model when
  `chat:` names one. The result is a map of streams:

  | key | of | what |
  |---|---|---|
  | `:voice` | boolean | whether somebody speaks |
  | `:heard`, `:partial` | `Situ.Infer.Speech.Utterance` | what was said, and what it is so far |
  | `:intent` | `Situ.Intent` | what was wanted |
  | `:said` | string | what it says, when it decides to |
  | `:sound` | `Situ.AudioBuffer` | that spoken, piece by piece as it is to be played |
  | `:speaking` | boolean | whether it speaks |
  | `:stop` | string | somebody interrupts it: the words |

  Its own voice may reach the microphone. While it speaks it hears less (`duck:`), so that a voice from a loudspeaker
  some way off does not count as speech, while somebody who talks into the microphone does; and where that does not
  help, words that it has just said are no command and no interruption (`Situ.Assistant.Echo`).

  ## Options

  #{Situ.Options.docs(@own)}
  """
  alias Situ.Assistant.{Dialogue, Interruption, Player}
  alias Situ.Infer.{SpeechRecognizer, SpeechSynthesizer, VoiceActivity}
  alias Situ.Audio.Ducker
  alias Situ.{Node, Pipeline, Stream}

  # Whoever cannot follow speech has no time for results on the way.
  @late 700_000_000

  @type streams :: %{atom() => Stream.t() | nil}

  @doc "The assistant on a stream of 16 kHz mono sound."
  @spec attach(Stream.t(), keyword()) :: streams()
  def attach(%Stream{} = sound, opts \\ []) do
    opts = Situ.Options.validate!(opts, @own)
    ducker = Pipeline.add(sound.pipeline, Ducker, by: opts[:duck], name: "Ducker")
    Pipeline.connect(sound, ducker, :in)

    # A voice is found however quiet it is: being quieter alone would not hide the assistant's own. Only the search for
    # voices is ducked: who interrupts it is understood as well as ever.
    loud = ducker |> Node.output(:out) |> Situ.Audio.noise_gate(open: opts[:quietest])

    voice =
      Situ.via(loud, VoiceActivity, min_silence: opts[:pause], name: "VoiceActivity").speaking

    heard =
      Situ.via(
        [sound: sound, speaking: voice],
        SpeechRecognizer,
        Keyword.merge([early: div(opts[:pause], 2), late: @late], opts[:recognizer]) ++
          [name: "SpeechRecognizer"]
      )

    settings =
      Keyword.take(opts, [:wake, :attention, :grammar, :local_time]) ++ [ask: opts[:chat] != nil]

    dialogue = Situ.via([heard: heard.out], Dialogue, settings ++ [name: "Dialogue"])

    stop =
      Situ.via([partial: heard.partial, heard: heard.out, said: dialogue.said], Interruption,
        name: "Interruption"
      )

    chat = opts[:chat] && answers(dialogue.ask, stop, opts[:chat])

    spoken = speak(dialogue.said, opts, "Synthesizer")

    player = Situ.via([in: spoken, stop: stop] ++ chatted(chat, opts), Player, name: "Player")
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

  defp answers(questions, stop, opts) do
    opts = Keyword.merge([system: @system, failures: :emit], opts)
    chat = Situ.via([in: questions, cancel: stop], Situ.Chat, opts ++ [name: "Chat"])
    # It speaks its failures, too: nobody looks at a log while talking.
    sorry = Situ.map(chat.failed, fn _ -> "I cannot reach the language model." end, type: :string)

    [Situ.map(chat.out, & &1.text, type: :string), sorry]
    |> Situ.merge(name: "Answers")
    |> Situ.map(& &1.data, type: :string)
  end

  defp chatted(nil, _opts), do: []

  defp chatted(answers, opts), do: [answers: speak(answers, opts, "AnswerSynthesizer")]

  defp speak(text, opts, name),
    do: Situ.via(text, SpeechSynthesizer, spoken(opts) ++ [name: name]).out

  defp spoken(opts), do: Keyword.put(opts[:synthesizer], :stamp, :text)
end
