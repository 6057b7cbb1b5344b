defmodule Situ.Infer.Speech.WakeWord.Keyword do
  @moduledoc """
  Hears a name by its sounds: PocketSphinx's search for a keyword. Names of three syllables and more are safer.

  Options: `phrase:`, English words of its dictionary, and `threshold:` as of `Situ.Infer.Speech.PocketSphinx`.
  """
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
  @spec spot(PocketSphinx.t(), Situ.AudioBuffer.t()) ::
          {:ok, [Situ.Infer.Speech.WakeWord.place()]} | {:error, Situ.Error.t()}
  def spot(sphinx, sound) do
    with {:ok, %{words: words}} <- PocketSphinx.transcribe(sphinx, sound),
         do: {:ok, Enum.map(words, &Map.take(&1, [:from, :to, :confidence]))}
  end
end
