defmodule Situ.Infer.Speech.Moonshine do
  @moduledoc """
  Moonshine tiny: English speech to text, 27 million parameters, in ONNX Runtime.

      {:ok, moonshine} = Situ.Infer.Speech.Moonshine.load()
      {:ok, %{text: "ten of clubs", confidence: 0.97}} = Situ.Infer.Speech.Moonshine.transcribe(moonshine, buffer)

  It takes sound as it is, without features, and writes one token after another, each the likeliest. It invents words
  where nobody speaks: give it what voice activity has found to be speech. `bin/lib/fetch-model moonshine-tiny-en`
  fetches it.
  """
  @behaviour Situ.Infer.Speech.Recognizer

  alias Situ.{AudioBuffer, Error, Sound, Tensor}
  alias Situ.Infer.{Model, ModelStore}
  alias Situ.Infer.Speech.Tokenizer

  @name "moonshine-tiny-en"
  @rate 16_000
  @begin 1
  @finish 2
  # Nobody says more in a second; a network that goes in circles must end.
  @tokens_a_second 6.5
  # The network has seen nothing longer.
  @longest_s 64
  @shortest 1_600

  @enforce_keys [:encoder, :decoder, :tokenizer]
  defstruct [:encoder, :decoder, :tokenizer]

  @type t :: %__MODULE__{encoder: Model.t(), decoder: Model.t(), tokenizer: Tokenizer.t()}
  @type result :: %{text: String.t(), confidence: float()}

  @doc """
  Loads it; `folder:` where the three files are, else `Situ.Infer.ModelStore`. Errors: those of `Situ.Infer.Model`.
  """
  @impl true
  @spec load(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def load(opts \\ []) do
    opts = Keyword.validate!(opts, folder: nil)
    settings = [warm_up: 0, schedule: :dirty, sessions: 1]

    with {:ok, encoder} <- file(opts[:folder], "encoder_model.ort"),
         {:ok, decoder} <- file(opts[:folder], "decoder_model_merged.ort"),
         {:ok, vocabulary} <- file(opts[:folder], "tokenizer.bin"),
         {:ok, tokenizer} <- tokenizer(vocabulary),
         {:ok, encoder} <- Model.shared(encoder, settings),
         {:ok, decoder} <- Model.shared(decoder, settings) do
      {:ok, %__MODULE__{encoder: encoder, decoder: decoder, tokenizer: tokenizer}}
    end
  end

  defp file(nil, name), do: ModelStore.fetch(@name, name)
  defp file(folder, name), do: {:ok, Path.join(folder, name)}

  defp tokenizer(path) do
    with {:ok, bytes} <- File.read(path),
         {:ok, tokenizer} <- Tokenizer.parse(bytes) do
      {:ok, tokenizer}
    else
      _ ->
        {:error,
         Error.new(:bad_model, "not a usable vocabulary: #{path}",
           fix: "fetch the model again with bin/lib/fetch-model #{@name}"
         )}
    end
  end

  @doc """
  What is said in a piece of sound of 0.1 to 64 seconds, any format. `confidence` is the geometric mean of the tokens'
  probabilities. Shorter sound is no speech: an empty text.
  """
  @impl true
  @spec transcribe(t(), AudioBuffer.t()) :: {:ok, result()} | {:error, Error.t()}
  def transcribe(%__MODULE__{} = moonshine, %AudioBuffer{} = buffer) do
    with {:ok, mono} <- Sound.reformat(buffer, channels: 1, sample: :f32),
         {:ok, %{data: data} = sound} <- Sound.resample(mono, @rate) do
      case AudioBuffer.frames(sound) do
        n when n < @shortest -> {:ok, %{text: "", confidence: 0.0}}
        n when n > @longest_s * @rate -> {:error, too_long(n)}
        n -> decode(moonshine, Tensor.new(data, :f32, {1, n}), n)
      end
    end
  end

  defp too_long(n) do
    Error.new(:too_long, "#{div(n, @rate)} s of sound are too long for one recognition",
      fix: "cut it into pieces of #{@longest_s} s or less, where nobody speaks"
    )
  end

  defp decode(moonshine, sound, n) do
    inputs = for {name, {:s64, _}} <- moonshine.encoder.inputs, do: {name, ones(n)}
    [wave] = for {name, {:f32, _}} <- moonshine.encoder.inputs, do: name

    with {:ok, encoded} <- Model.run(moonshine.encoder, Map.new([{wave, sound} | inputs])) do
      [{_, hidden}] = Enum.to_list(encoded)

      fixed =
        %{"encoder_hidden_states" => hidden, "encoder_attention_mask" => ones(n)}
        |> Map.take(Map.keys(moonshine.decoder.inputs))

      past =
        for {"past" <> _ = name, {:f32, shape}} <- moonshine.decoder.inputs,
            do: {name, nothing(shape)}

      state = %{fixed: fixed, past: Map.new(past), left: ceil(n / @rate * @tokens_a_second) + 2}
      write(moonshine, state, @begin, false, [], 0.0)
    end
  end

  defp ones(n), do: Tensor.new(:binary.copy(<<1::64-native>>, n), :s64, {1, n})

  # The first step looks at no past; its tensors only have to be there.
  defp nothing(shape) do
    [_, heads, _, width] = Tuple.to_list(shape)
    Tensor.zeros(:f32, {1, heads, 1, width})
  end

  defp write(moonshine, state, token, again?, written, log) do
    inputs =
      state.fixed
      |> Map.merge(state.past)
      |> Map.put("input_ids", Tensor.from_list([token], :s64, {1, 1}))
      |> Map.put("use_cache_branch", Tensor.from_list([again?], :bool, {1}))

    with {:ok, %{"logits" => logits} = outputs} <- Model.run(moonshine.decoder, inputs) do
      {next, p} = likeliest(logits)
      log = log + :math.log(max(p, 1.0e-9))

      if next == @finish or state.left <= 1 do
        {:ok, result(moonshine, Enum.reverse(written), log)}
      else
        state = %{state | past: remember(state.past, outputs, again?), left: state.left - 1}
        write(moonshine, state, next, true, [next | written], log)
      end
    end
  end

  # Its encoding of the sound never changes after the first step.
  defp remember(past, outputs, again?) do
    for {"present" <> rest, tensor} <- outputs,
        not again? or not String.contains?(rest, "encoder"),
        into: past,
        do: {"past_key_values" <> rest, tensor}
  end

  # The largest logit and its probability: the vocabulary is walked once for the largest, once for the sum.
  defp likeliest(%Tensor{data: data, shape: shape}) do
    row = 4 * elem(shape, tuple_size(shape) - 1)
    data = binary_part(data, byte_size(data) - row, row)
    {best, index, _} = largest(data, {-1.0e30, 0, 0})
    {index, 1 / total(data, best, 0.0)}
  end

  defp largest(<<v::float-native-32, rest::binary>>, {best, _index, i}) when v > best,
    do: largest(rest, {v, i, i + 1})

  defp largest(<<_::32, rest::binary>>, {best, index, i}), do: largest(rest, {best, index, i + 1})
  defp largest(<<>>, found), do: found

  defp total(<<v::float-native-32, rest::binary>>, best, sum) when best - v < 20.0,
    do: total(rest, best, sum + :math.exp(v - best))

  defp total(<<_::32, rest::binary>>, best, sum), do: total(rest, best, sum)
  defp total(<<>>, _best, sum), do: max(sum, 1.0)

  defp result(moonshine, tokens, log) do
    text = Tokenizer.text(moonshine.tokenizer, tokens)
    %{text: text, confidence: :math.exp(log / (length(tokens) + 1))}
  end
end
