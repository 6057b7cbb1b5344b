defmodule Situ.Infer.Speech.WakeWord.Spoken do
  @schema [
    phrase: [type: :string, required: true, doc: "The name, one or more words."],
    recognizer: [
      type: :module,
      default: Situ.Infer.Speech.Moonshine,
      doc: "The module that recognises, a `Situ.Infer.Speech.Recognizer`."
    ],
    recognizer_options: [type: :keyword, default: [], doc: "For its `load/1`."],
    alike: [
      type: {:range, 0, 1},
      default: 0.88,
      doc: "How alike a word must be written to one of the name (Jaro's measure; 1: the same)."
    ]
  ]

  @moduledoc """
  Hears a name among the words that a recogniser writes; one letter of it may be wrong in six.

      iex> Situ.Infer.Speech.WakeWord.Spoken.among("Hey, Komputer, stop!", ["computer"], 0.88)
      {1, 3}
      iex> Situ.Infer.Speech.WakeWord.Spoken.among("My company is open.", ["computer"], 0.88)
      nil

  No measure of letters tells a name written wrongly from another word that is written nearly so: "Komputer" differs
  from "computer" as much as "commuter" does, and "compute" less. Choose a name that is unlike other words, or set
  `alike: 1`, where such words are said and the recogniser is good.

      iex> Situ.Infer.Speech.WakeWord.Spoken.among("The commuter train was late.", ["computer"], 0.88)
      {1, 5}
      iex> Situ.Infer.Speech.WakeWord.Spoken.among("The commuter train was late.", ["computer"], 1)
      nil

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  @behaviour Situ.Infer.Speech.WakeWord
  alias Situ.{AudioBuffer, Error}
  alias Situ.Infer.Speech.Utterance

  @enforce_keys [:recognizer, :model, :name, :alike]
  defstruct @enforce_keys
  @type t :: %__MODULE__{recognizer: module(), model: term(), name: [String.t()], alike: number()}

  @impl true
  @spec load(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def load(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, name} <- name(Utterance.words(opts[:phrase])),
         {:ok, model} <- opts[:recognizer].load(opts[:recognizer_options]) do
      {:ok,
       %__MODULE__{recognizer: opts[:recognizer], model: model, name: name, alike: opts[:alike]}}
    end
  end

  defp name([]), do: {:error, Error.new(:bad_option, "the phrase has no words in it")}
  defp name(words), do: {:ok, words}

  @impl true
  @spec spot(t(), AudioBuffer.t()) ::
          {:ok, [Situ.Infer.Speech.WakeWord.place()]} | {:error, Error.t()}
  def spot(%__MODULE__{} = spoken, sound) do
    with {:ok, %{text: text, confidence: p} = result} <-
           spoken.recognizer.transcribe(spoken.model, sound) do
      case among(text, spoken.name, spoken.alike) do
        nil ->
          {:ok, []}

        {place, _} ->
          {:ok, [Map.put(span(result[:words] || [], place, spoken, sound), :confidence, p)]}
      end
    end
  end

  # Recognisers that know times of words count them as they are written.
  defp span(words, place, spoken, sound) do
    case Enum.slice(words, place, length(spoken.name)) do
      [first | _] = found -> %{from: first.from, to: List.last(found).to}
      [] -> %{from: 0, to: AudioBuffer.duration(sound)}
    end
  end

  @doc "At which word of a text the name begins, and how many words the text has; `nil` when it is not there."
  @spec among(String.t(), [String.t()], number()) :: {non_neg_integer(), pos_integer()} | nil
  def among(text, name, alike) do
    words = Utterance.words(text)

    place =
      words
      |> Enum.chunk_every(length(name), 1, :discard)
      |> Enum.find_index(fn part ->
        part |> Enum.zip(name) |> Enum.all?(fn {a, b} -> String.jaro_distance(a, b) >= alike end)
      end)

    place && {place, length(words)}
  end
end
