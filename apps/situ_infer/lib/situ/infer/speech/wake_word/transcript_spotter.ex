defmodule Situ.Infer.Speech.WakeWord.TranscriptSpotter do
  @moduledoc false
  # Detects a name among recognized words (`Situ.Infer.wake_word/2`).
  #
  # Spelling alone cannot distinguish a misspelled name from a similar word: "Komputer" differs
  # from "computer" as much as "commuter" does, and "compute" differs less. Choose a name that is
  # unlike other words.

  @schema [
    phrase: [type: :string, required: true, doc: false],
    recognizer: [
      type: :module,
      default: Situ.Infer.Speech.Moonshine,
      doc: "The module that recognizes speech, a `Situ.Infer.Speech.Recognizer`."
    ],
    recognizer_options: [type: :keyword, default: [], doc: "Options for its `load/1`."],
    alike: [
      type: {:range, 0, 1},
      default: 0.88,
      doc: "The minimum Jaro similarity of a word to a word of the name; 1 requires equality."
    ]
  ]

  @doc "Returns the schema of the options."
  @spec option_schema() :: Situ.Options.schema()
  def option_schema, do: @schema

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
         {:ok, name} <- check_name(Utterance.normalize_words(opts[:phrase])),
         {:ok, model} <- opts[:recognizer].load(opts[:recognizer_options]) do
      {:ok,
       %__MODULE__{recognizer: opts[:recognizer], model: model, name: name, alike: opts[:alike]}}
    end
  end

  defp check_name([]), do: {:error, Error.new(:bad_option, "the phrase contains no words")}
  defp check_name(words), do: {:ok, words}

  @impl true
  @spec spot_phrase(t(), AudioBuffer.t()) ::
          {:ok, [Situ.Infer.Speech.WakeWord.span()]} | {:error, Error.t()}
  def spot_phrase(%__MODULE__{} = spotter, sound) do
    with {:ok, %{text: text, confidence: p} = result} <-
           spotter.recognizer.transcribe(spotter.model, sound) do
      case find_name(text, spotter.name, spotter.alike) do
        nil ->
          {:ok, []}

        {position, _} ->
          {:ok,
           [Map.put(name_span(result[:words] || [], position, spotter, sound), :confidence, p)]}
      end
    end
  end

  # Recognizers that report word times list the words in the order of the text.
  defp name_span(words, position, spotter, sound) do
    case Enum.slice(words, position, length(spotter.name)) do
      [first | _] = found -> %{from: first.from, to: List.last(found).to}
      [] -> %{from: 0, to: AudioBuffer.duration_ns(sound)}
    end
  end

  @doc """
  Returns the position of the name in a text, in words, and the number of words; `nil` if it is
  not found.

      iex> Situ.Infer.Speech.WakeWord.TranscriptSpotter.find_name("Hey, Komputer, stop!", ["computer"], 0.88)
      {1, 3}
      iex> Situ.Infer.Speech.WakeWord.TranscriptSpotter.find_name("My company is open.", ["computer"], 0.88)
      nil

      iex> Situ.Infer.Speech.WakeWord.TranscriptSpotter.find_name("The commuter train was late.", ["computer"], 0.88)
      {1, 5}
      iex> Situ.Infer.Speech.WakeWord.TranscriptSpotter.find_name("The commuter train was late.", ["computer"], 1)
      nil
  """
  @spec find_name(String.t(), [String.t()], number()) :: {non_neg_integer(), pos_integer()} | nil
  def find_name(text, name, alike) do
    words = Utterance.normalize_words(text)

    position =
      words
      |> Enum.chunk_every(length(name), 1, :discard)
      |> Enum.find_index(&Utterance.similar_words?(&1, name, alike))

    position && {position, length(words)}
  end
end
