defmodule Situ.Infer.Speech.WakeWord.KeywordSpotter do
  @moduledoc false
  # Detects a name by its sound with PocketSphinx's keyword search. Names of three or more
  # syllables are more reliable.
  #
  # Options: `phrase:` (English words of its dictionary) and `threshold:` (see
  # `Situ.Infer.Speech.PocketSphinx`).
  @behaviour Situ.Infer.Speech.WakeWord
  alias Situ.Infer.Speech.PocketSphinx

  @schema [
    phrase: [type: :string, required: true],
    threshold: [type: {:range, 1.0e-50, 1.0}, default: 1.0e-20]
  ]

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
