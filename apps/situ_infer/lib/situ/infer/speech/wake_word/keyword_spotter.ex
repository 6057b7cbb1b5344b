defmodule Situ.Infer.Speech.WakeWord.KeywordSpotter do
  @moduledoc false
  # Detects a name by its sound with PocketSphinx's keyword search (`Situ.Infer.wake_word/2`).
  @behaviour Situ.Infer.Speech.WakeWord
  alias Situ.Infer.Speech.PocketSphinx

  @schema [
    phrase: [type: :string, required: true, doc: false],
    threshold: [
      type: {:range, 1.0e-50, 1.0},
      default: 1.0e-20,
      doc: "The detection threshold, see `Situ.Infer.Speech.PocketSphinx`."
    ]
  ]

  @doc "Returns the schema of the options."
  @spec option_schema() :: Situ.Options.schema()
  def option_schema, do: @schema

  @impl true
  @spec load(keyword()) :: {:ok, PocketSphinx.t()} | {:error, Situ.Error.t()}
  def load(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         do:
           PocketSphinx.load(keyword: String.downcase(opts[:phrase]), threshold: opts[:threshold])
  end

  @impl true
  @spec spot_phrase(PocketSphinx.t(), Situ.AudioBuffer.t()) ::
          {:ok, [Situ.Infer.Speech.WakeWord.span()]} | {:error, Situ.Error.t()}
  def spot_phrase(sphinx, sound) do
    with {:ok, %{words: words}} <- PocketSphinx.transcribe(sphinx, sound),
         do: {:ok, Enum.map(words, &Map.take(&1, [:from, :to, :confidence]))}
  end
end
