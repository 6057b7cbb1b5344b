defmodule Situ.Infer.Speech.Hibari do
  @moduledoc """
  Text to speech with Hibari: one natural English voice of 8 MB, which runs in ONNX Runtime, several times faster than
  real time on one core.

      {:ok, voice} = Situ.Infer.Speech.Hibari.load(speed: 1.1)
      {:ok, sound} = Situ.Infer.Speech.Hibari.speak(voice, "Go forward ten metres.")

  `bin/lib/fetch-model hibari` downloads it (Apache-2.0). espeak-ng determines the pronunciation of the words, the
  network computes spectra, and a vocoder converts them to audio: 24 kHz, one channel. The same text always gives the
  same audio.

  ## Errors

  `:no_espeak`, `:bad_text`, `:synthesis_failed`, and the errors of `Situ.Infer.Model`.
  """

  @schema [
    speed: [
      type: {:range, 0.5, 2.0},
      default: 1.0,
      doc: "The speed; 1.0 is the voice's normal speed."
    ],
    folder: [
      type: {:optional, :string},
      default: nil,
      doc: "The folder with `hibari.onnx` and `vocab.json`; `nil`: where `fetch-model` puts them."
    ]
  ]

  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  @behaviour Situ.Infer.Speech.Synthesizer

  alias Situ.{AudioBuffer, AudioFormat, Error, Tensor}
  alias Situ.Infer.{Model, ModelStore}
  alias Situ.Infer.Speech.Hibari.{Phonemes, Vocoder}
  alias Situ.Infer.Speech.{Program, TextCheck}

  @name "hibari"
  @bins 601
  @longest 20_000
  # The network was not trained with longer sentences.
  @most_phonemes 400
  @pause 0.12

  @enforce_keys [:model, :vocoder, :vocabulary, :speed]
  defstruct @enforce_keys

  @type t :: %__MODULE__{
          model: Model.t(),
          vocoder: Vocoder.t(),
          vocabulary: %{String.t() => non_neg_integer()},
          speed: float()
        }

  @impl true
  @spec load(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def load(opts \\ []) do
    settings = [
      inputs: %{"ids" => {:s64, {nil, nil}}, "speed" => {:f32, {nil}}},
      outputs: Map.new(~w(lh theta ln lr phi), &{&1, {:f32, {nil, @bins, nil}}}),
      warm_up: 0,
      schedule: :dirty,
      sessions: 1
    ]

    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, _} <- Program.find_espeak(),
         {:ok, path} <- ModelStore.locate_file(opts[:folder], @name, "hibari.onnx"),
         {:ok, vocabulary} <- load_vocabulary(opts[:folder]),
         {:ok, model} <- Model.load_shared(path, settings),
         {:ok, vocoder} <- Vocoder.load() do
      {:ok,
       %__MODULE__{
         model: model,
         vocoder: vocoder,
         vocabulary: vocabulary,
         speed: opts[:speed] / 1
       }}
    end
  end

  defp load_vocabulary(folder) do
    with {:ok, path} <- ModelStore.locate_file(folder, @name, "vocab.json"),
         {:read, {:ok, text}} <- {:read, File.read(path)},
         {:json, {:ok, %{} = vocabulary}} <- {:json, Situ.JSON.decode(text)},
         true <- Enum.all?(vocabulary, fn {_, id} -> is_integer(id) and id >= 0 end) do
      {:ok, vocabulary}
    else
      {:error, _} = error ->
        error

      _ ->
        {:error, Error.new(:bad_model, "invalid vocabulary of #{@name}", fix: download_hint())}
    end
  end

  defp download_hint, do: "download the model again with bin/lib/fetch-model #{@name}"

  @impl true
  @spec speak(t(), String.t()) :: AudioBuffer.result()
  def speak(%__MODULE__{} = voice, text) do
    with :ok <- TextCheck.check_text(text, @longest),
         {:ok, sentences} <- Phonemes.sentence_phonemes(text) do
      speak_sentences(voice, sentences)
    else
      :nothing -> join_audio([])
      error -> error
    end
  end

  defp speak_sentences(voice, sentences) do
    ids = Enum.flat_map(sentences, &Enum.chunk_every(phoneme_ids(voice, &1), @most_phonemes))
    with {:ok, sounds} <- Error.map_ok(ids, &speak_ids(voice, &1)), do: join_audio(sounds)
  end

  # Unknown symbols are skipped.
  defp phoneme_ids(voice, phonemes) do
    for sign <- String.codepoints(phonemes), id = voice.vocabulary[sign], do: id
  end

  defp speak_ids(voice, ids) do
    inputs = %{
      "ids" => Tensor.from_list([0 | ids] ++ [0], :s64, {1, length(ids) + 2}),
      "speed" => Tensor.from_list([voice.speed], :f32, {1})
    }

    with {:ok, spectrum} <- Model.run(voice.model, inputs),
         do: Vocoder.synthesize_audio(voice.vocoder, spectrum)
  end

  defp join_audio(sounds) do
    rate = Vocoder.sample_rate()
    pause = :binary.copy(<<0::32>>, round(@pause * rate))
    data = sounds |> Enum.intersperse(pause) |> IO.iodata_to_binary()
    AudioBuffer.new(format: %AudioFormat{rate: rate, channels: 1, sample: :f32}, data: data)
  end
end
