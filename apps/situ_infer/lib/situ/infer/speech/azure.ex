defmodule Situ.Infer.Speech.Azure do
  @moduledoc """
  Speech to text and text to speech with Azure's speech service. It uses the requests for short audio (up to 60 s) and
  for synthesis.

      azure = [recognizer: Situ.Infer.Speech.Azure, recognizer_options: [region: "westeurope"], partial: nil]
      Situ.Infer.transcribe(sound, azure)

  Text to speech is `Situ.Infer.Speech.Azure.Voice`, with the same options.

  Results have alternatives, confidence, and words with times. Each partial result is a separate request; `partial: nil`
  disables partial results.

  ## Errors

  `:bad_answer`, #{Situ.Infer.Service.describe_errors()}.
  """

  @own [
    region: [
      type: {:optional, :string},
      default: nil,
      doc: "The region of the resource, such as \"westeurope\"."
    ],
    url: [
      type: {:optional, :string},
      default: nil,
      doc: "The URL of the service if it has no region, such as a self-hosted container."
    ],
    language: [type: :string, default: "en-US", doc: "The spoken language."],
    voice: [type: :string, default: "en-US-JennyNeural", doc: "The voice."],
    ssml: [type: :boolean, default: false, doc: "Texts are complete SSML documents."]
  ]
  @schema @own ++ Situ.Infer.Service.schema("AZURE_SPEECH_KEY")

  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  @behaviour Situ.Infer.Speech.Recognizer

  alias Situ.{AudioBuffer, Error}
  alias Situ.Infer.Service
  alias Situ.Infer.Speech.RequestEncoding

  @key_header "ocp-apim-subscription-key"
  @longest 60_000_000_000
  # The service reports times in units of 100 ns.
  @tick 100

  @enforce_keys [:recognizer, :synthesizer, :opts]
  defstruct @enforce_keys
  @type t :: %__MODULE__{recognizer: Service.t(), synthesizer: Service.t(), opts: map()}

  @impl true
  @spec load(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def load(opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, stt, tts} <- service_urls(opts[:region], opts[:url]),
         {:ok, recognizer} <- Service.new(stt, opts, @key_header),
         {:ok, synthesizer} <- Service.new(tts, opts, @key_header),
         do:
           {:ok,
            %__MODULE__{recognizer: recognizer, synthesizer: synthesizer, opts: Map.new(opts)}}
  end

  defp service_urls(nil, nil),
    do: {:error, Error.new(:bad_option, "neither region: nor url: is given", fix: "set either")}

  defp service_urls(nil, url), do: {:ok, url, url}

  defp service_urls(region, _url) do
    if region =~ ~r/^[a-z0-9]+$/,
      do:
        {:ok, "https://#{region}.stt.speech.microsoft.com",
         "https://#{region}.tts.speech.microsoft.com"},
      else:
        {:error,
         Error.new(:bad_option, "invalid region #{inspect(region)}", fix: "try \"westeurope\"")}
  end

  @impl true
  @spec transcribe(t(), AudioBuffer.t()) ::
          {:ok, Situ.Infer.Speech.Recognizer.result()} | {:error, Error.t()}
  def transcribe(%__MODULE__{} = azure, %AudioBuffer{} = sound) do
    query =
      URI.encode_query(
        language: azure.opts.language,
        format: "detailed",
        wordLevelTimestamps: true
      )

    path = "/speech/recognition/conversation/cognitiveservices/v1?" <> query
    type = "audio/wav; codecs=audio/pcm; samplerate=16000"

    with :ok <- check_duration(sound),
         {:ok, wav} <- RequestEncoding.encode_wav(sound),
         headers = [{"content-type", type}, {"accept", "application/json"}],
         {:ok, body} <- Service.post(azure.recognizer, path, headers, wav),
         do: parse_result(Situ.JSON.decode(body))
  end

  defp check_duration(sound) do
    if AudioBuffer.duration_ns(sound) <= @longest,
      do: :ok,
      else: {:error, Error.new(:too_long, "the audio exceeds 60 s", fix: "split it at a pause")}
  end

  defp parse_result({:ok, %{"RecognitionStatus" => "Success", "NBest" => [best | others]}}) do
    with {:ok, best} <- parse_candidate(best) do
      alternatives =
        for other <- others,
            {:ok, other} <- [parse_candidate(other)],
            do: Map.take(other, [:text, :confidence])

      {:ok, Map.put(best, :alternatives, alternatives)}
    end
  end

  # The service recognized no speech.
  defp parse_result({:ok, %{"RecognitionStatus" => status}})
       when status in ["NoMatch", "InitialSilenceTimeout", "BabbleTimeout", "Success"],
       do: {:ok, %{text: "", confidence: 0.0, words: [], alternatives: []}}

  defp parse_result({:ok, %{"RecognitionStatus" => status}}) when is_binary(status),
    do:
      {:error,
       Error.new(
         :service_failed,
         "the service could not recognize the speech: #{String.slice(status, 0, 40)}"
       )}

  defp parse_result(_), do: {:error, Service.bad_answer()}

  defp parse_candidate(%{"Confidence" => p, "Display" => text} = json)
       when is_number(p) and is_binary(text) do
    words =
      for %{"Word" => word, "Offset" => at, "Duration" => length} <- List.wrap(json["Words"]),
          is_binary(word) and is_integer(at) and is_integer(length) and at >= 0 and length >= 0,
          do: %{text: word, from: at * @tick, to: (at + length) * @tick}

    {:ok, %{text: text, confidence: p |> max(0) |> min(1) |> Kernel./(1), words: words}}
  end

  defp parse_candidate(_), do: {:error, Service.bad_answer()}
end
