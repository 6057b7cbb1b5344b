defmodule Situ.Infer.Speech.Moonshine do
  @moduledoc """
  Speech to text with Moonshine tiny: English, 27 million parameters, in ONNX Runtime.

      {:ok, moonshine} = Situ.Infer.Speech.Moonshine.load()
      {:ok, %{text: "ten of clubs", confidence: 0.97}} = Situ.Infer.Speech.Moonshine.transcribe(moonshine, buffer)

  The model takes audio without feature extraction and generates one token after another, always the likeliest one. It
  invents words if nobody is speaking, so pass only audio that voice activity detection has marked as speech. It does
  not report the times of words. `bin/lib/fetch-model moonshine-tiny-en` downloads the model. With `alternatives: n`,
  the audio is decoded again for each of the `n` least certain positions, with the second likeliest token there; the
  work grows accordingly.
  """

  @schema [
    folder: [
      type: {:optional, :string},
      default: nil,
      doc: "The folder with the three files of the model; `nil`: where `fetch-model` puts them."
    ],
    alternatives: [
      type: {:range, 0, 10},
      default: 0,
      doc: "The maximum number of alternatives in a result."
    ]
  ]

  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  @behaviour Situ.Infer.Speech.Recognizer

  alias Situ.{AudioBuffer, AudioFormat, Error, AudioOps, Tensor}
  alias Situ.Infer.{Model, ModelStore, SampleCheck}
  alias Situ.Infer.Speech.Tokenizer

  @name "moonshine-tiny-en"
  @rate 16_000
  @begin 1
  @finish 2
  # Nobody speaks faster than this; the limit stops a network that repeats itself.
  @tokens_a_second 6.5
  # The network was not trained with longer audio.
  @longest_s 64
  @shortest 1_600

  @enforce_keys [:encoder, :decoder, :tokenizer]
  defstruct [:encoder, :decoder, :tokenizer, alternatives: 0]

  @type t :: %__MODULE__{
          encoder: Model.t(),
          decoder: Model.t(),
          tokenizer: Tokenizer.t(),
          alternatives: non_neg_integer()
        }
  @type result :: %{
          text: String.t(),
          confidence: float(),
          alternatives: [Situ.Infer.Speech.Recognizer.alternative()]
        }

  @doc "Loads the model. Errors are those of `Situ.Infer.Model`."
  @impl true
  @spec load(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def load(opts \\ []) do
    settings = [warm_up: 0, schedule: :dirty, sessions: 1]

    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, encoder} <- ModelStore.locate_file(opts[:folder], @name, "encoder_model.ort"),
         {:ok, decoder} <-
           ModelStore.locate_file(opts[:folder], @name, "decoder_model_merged.ort"),
         {:ok, vocabulary} <- ModelStore.locate_file(opts[:folder], @name, "tokenizer.bin"),
         {:ok, tokenizer} <- load_tokenizer(vocabulary),
         {:ok, encoder} <- Model.load_shared(encoder, settings),
         {:ok, decoder} <- Model.load_shared(decoder, settings) do
      moonshine = %__MODULE__{encoder: encoder, decoder: decoder, tokenizer: tokenizer}

      # The first recognition is slow, so silence is recognized now, before anybody speaks.
      with {:ok, _} <-
             transcribe(moonshine, AudioBuffer.build_silence(AudioFormat.pcm(@rate), @rate)),
           do: {:ok, %{moonshine | alternatives: round(opts[:alternatives])}}
    end
  end

  defp load_tokenizer(path) do
    with {:ok, bytes} <- File.read(path),
         {:ok, tokenizer} <- Tokenizer.parse(bytes) do
      {:ok, tokenizer}
    else
      _ ->
        {:error,
         Error.new(:bad_model, "invalid vocabulary: #{path}",
           fix: "download the model again with bin/lib/fetch-model #{@name}"
         )}
    end
  end

  @doc """
  Recognizes the words in 0.1 to 64 seconds of audio of any format. `confidence` is the geometric mean of the tokens'
  probabilities. Shorter audio gives an empty text.
  """
  @impl true
  @spec transcribe(t(), AudioBuffer.t()) :: {:ok, result()} | {:error, Error.t()}
  def transcribe(%__MODULE__{} = moonshine, %AudioBuffer{} = buffer) do
    with :ok <- SampleCheck.check_buffer(buffer),
         {:ok, mono} <- AudioOps.reformat(buffer, channels: 1, sample: :f32),
         {:ok, %{data: data} = sound} <- AudioOps.resample(mono, @rate) do
      case AudioBuffer.frame_count(sound) do
        n when n < @shortest -> {:ok, %{text: "", confidence: 0.0, alternatives: []}}
        n when n > @longest_s * @rate -> {:error, too_long(n)}
        n -> decode_audio(moonshine, Tensor.new(data, :f32, {1, n}), n)
      end
    end
  end

  defp too_long(n) do
    Error.new(:too_long, "#{div(n, @rate)} s of audio are too long for one recognition",
      fix: "split it at pauses into chunks of #{@longest_s} s or less"
    )
  end

  defp decode_audio(moonshine, sound, n) do
    inputs = for {name, {:s64, _}} <- moonshine.encoder.inputs, do: {name, ones_tensor(n)}
    [wave] = for {name, {:f32, _}} <- moonshine.encoder.inputs, do: name

    with {:ok, encoded} <- Model.run(moonshine.encoder, Map.new([{wave, sound} | inputs])) do
      [{_, hidden}] = Enum.to_list(encoded)

      constants =
        %{"encoder_hidden_states" => hidden, "encoder_attention_mask" => ones_tensor(n)}
        |> Map.take(Map.keys(moonshine.decoder.inputs))

      past =
        for {"past" <> _ = name, {:f32, shape}} <- moonshine.decoder.inputs,
            do: {name, empty_past(shape)}

      state = %{
        constants: constants,
        past: Map.new(past),
        tokens_left: ceil(n / @rate * @tokens_a_second) + 2
      }

      with {:ok, steps} <- generate_tokens(moonshine, state, @begin, false, [], []),
           {:ok, others} <- decode_alternatives(moonshine, state, steps) do
        best = build_result(moonshine, steps)

        others =
          for(steps <- others, do: build_result(moonshine, steps))
          |> Enum.uniq_by(& &1.text)
          |> Enum.reject(&(&1.text in ["", best.text]))

        {:ok, Map.put(best, :alternatives, Enum.sort_by(others, &(-&1.confidence)))}
      end
    end
  end

  # Decodes again from each of the least certain positions, with the second likeliest token there.
  defp decode_alternatives(%{alternatives: 0}, _state, _steps), do: {:ok, []}

  defp decode_alternatives(moonshine, state, steps) do
    tokens = Enum.map(steps, fn {token, _, _} -> token end)

    steps
    |> Enum.with_index()
    |> Enum.sort_by(fn {{_, _, {_, p}}, _} -> -p end)
    |> Enum.take(moonshine.alternatives)
    |> Error.map_ok(fn {{_, _, {second, _}}, position} ->
      generate_tokens(
        moonshine,
        state,
        @begin,
        false,
        Enum.take(tokens, position) ++ [second],
        []
      )
    end)
  end

  defp ones_tensor(n), do: Tensor.new(:binary.copy(<<1::64-native>>, n), :s64, {1, n})

  # The first step ignores the past, but its tensors must exist.
  defp empty_past(shape) do
    [_, heads, _, width] = Tuple.to_list(shape)
    Tensor.zeros(:f32, {1, heads, 1, width})
  end

  # A step is a token with its probability, and the second likeliest token with its own. `prefix` are the first tokens.
  defp generate_tokens(moonshine, state, token, use_cache?, prefix, steps) do
    inputs =
      state.constants
      |> Map.merge(state.past)
      |> Map.put("input_ids", Tensor.from_list([token], :s64, {1, 1}))
      |> Map.put("use_cache_branch", Tensor.from_list([use_cache?], :bool, {1}))

    with {:ok, %{"logits" => logits} = outputs} <- Model.run(moonshine.decoder, inputs) do
      {{next, _, _} = step, prefix} = choose_token(logits, prefix)
      steps = [step | steps]

      if next == @finish or state.tokens_left <= 1 do
        {:ok, Enum.reverse(steps)}
      else
        state = %{
          state
          | past: update_past(state.past, outputs, use_cache?),
            tokens_left: state.tokens_left - 1
        }

        generate_tokens(moonshine, state, next, true, prefix, steps)
      end
    end
  end

  defp choose_token(logits, prefix) do
    {best, second, of} = top_two_tokens(logits)

    case prefix do
      [] -> {{best, of.(best), {second, of.(second)}}, []}
      [token | prefix] -> {{token, of.(token), {second, of.(second)}}, prefix}
    end
  end

  # The encoder's part of the past does not change after the first step.
  defp update_past(past, outputs, use_cache?) do
    for {"present" <> rest, tensor} <- outputs,
        not use_cache? or not String.contains?(rest, "encoder"),
        into: past,
        do: {"past_key_values" <> rest, tensor}
  end

  # Returns the tokens of the two largest logits and a function for the probability of any token. The vocabulary is
  # traversed once for the logits and once for the sum.
  defp top_two_tokens(%Tensor{data: data, shape: shape}) do
    row = 4 * elem(shape, tuple_size(shape) - 1)
    data = binary_part(data, byte_size(data) - row, row)
    {most, best, _, second, _} = find_largest(data, {-1.0e30, 0, -1.0e30, 0, 0})
    total = sum_exponentials(data, most, 0.0)
    {best, second, fn token -> :math.exp(max(read_logit(data, token) - most, -80.0)) / total end}
  end

  defp read_logit(data, token) do
    case binary_part(data, 4 * token, 4) do
      <<v::float-native-32>> -> v
      _ -> -1.0e30
    end
  end

  defp find_largest(<<v::float-native-32, rest::binary>>, {most, best, _next, _second, i})
       when v > most,
       do: find_largest(rest, {v, i, most, best, i + 1})

  defp find_largest(<<v::float-native-32, rest::binary>>, {most, best, next, _second, i})
       when v > next,
       do: find_largest(rest, {most, best, v, i, i + 1})

  defp find_largest(<<_::32, rest::binary>>, {most, best, next, second, i}),
    do: find_largest(rest, {most, best, next, second, i + 1})

  defp find_largest(<<>>, found), do: found

  defp sum_exponentials(<<v::float-native-32, rest::binary>>, best, sum) when best - v < 20.0,
    do: sum_exponentials(rest, best, sum + :math.exp(v - best))

  defp sum_exponentials(<<_::32, rest::binary>>, best, sum), do: sum_exponentials(rest, best, sum)
  defp sum_exponentials(<<>>, _best, sum), do: max(sum, 1.0)

  defp build_result(moonshine, steps) do
    tokens = for {token, _, _} <- steps, token != @finish, do: token
    log = for {_, p, _} <- steps, reduce: 0.0, do: (log -> log + :math.log(max(p, 1.0e-9)))
    text = Tokenizer.decode_tokens(moonshine.tokenizer, tokens)
    %{text: text, confidence: :math.exp(log / length(steps))}
  end
end
