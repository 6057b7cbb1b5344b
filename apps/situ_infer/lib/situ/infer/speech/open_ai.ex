defmodule Situ.Infer.Speech.OpenAI do
  @moduledoc """
  Speech to text and text to speech with any service that implements OpenAI's protocol (OpenAI or a self-hosted server):
  `/audio/transcriptions` and `/audio/speech`.

      Situ.Infer.transcribe(sound, recognizer: Situ.Infer.Speech.OpenAI, partial: nil)
      Situ.via(text, Situ.Infer.SpeechSynthesizer, synthesizer: Situ.Infer.Speech.OpenAI.Voice).out

  Each partial result is a separate request; `partial: nil` disables partial results. Confidence is computed from the
  mean log probability of the segments, or is 0.5 if the service reports none.

  ## Errors

  `:bad_answer`, #{Situ.Infer.Service.describe_errors()}.
  """

  @own [
    url: [
      type: :string,
      default: "https://api.openai.com/v1",
      doc: "The URL of the service; `/audio/...` is appended."
    ],
    recognizer: [type: :string, default: "whisper-1", doc: "The model that recognizes speech."],
    synthesizer: [type: :string, default: "tts-1", doc: "The model that synthesizes speech."],
    voice: [type: :string, default: "alloy", doc: "The voice."],
    language: [
      type: {:optional, :string},
      default: nil,
      doc: "The spoken language, such as \"en\"; with `nil` the service detects it."
    ],
    rate: [
      type: {:range, 8_000, 48_000},
      default: 24_000,
      doc: "The sample rate of the audio that the service sends, Hz."
    ]
  ]
  @schema @own ++ Situ.Infer.Service.schema("OPENAI_API_KEY")

  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  @behaviour Situ.Infer.Speech.Recognizer

  alias Situ.{AudioBuffer, Error}
  alias Situ.Infer.Service
  alias Situ.Infer.Speech.RequestEncoding

  @enforce_keys [:service, :opts]
  defstruct @enforce_keys
  @type t :: %__MODULE__{service: Service.t(), opts: map()}

  @impl true
  @spec load(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def load(opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, service} <- Service.new(opts[:url], opts),
         do: {:ok, %__MODULE__{service: service, opts: Map.new(opts)}}
  end

  @impl true
  @spec transcribe(t(), AudioBuffer.t()) ::
          {:ok, Situ.Infer.Speech.Recognizer.result()} | {:error, Error.t()}
  def transcribe(%__MODULE__{service: service, opts: opts}, %AudioBuffer{} = sound) do
    with {:ok, wav} <- RequestEncoding.encode_wav(sound) do
      fields = [
        {"model", opts.recognizer},
        {"response_format", "verbose_json"},
        {"timestamp_granularities[]", "word"},
        {"timestamp_granularities[]", "segment"}
        | if(opts.language, do: [{"language", opts.language}], else: [])
      ]

      {type, body} = RequestEncoding.encode_form(fields, {"file", "speech.wav", "audio/wav", wav})

      with {:ok, body} <-
             Service.post(service, "/audio/transcriptions", [{"content-type", type}], body),
           do: parse_result(Situ.JSON.decode(body))
    end
  end

  defp parse_result({:ok, %{"text" => text} = json}) when is_binary(text) do
    words =
      for %{"word" => word, "start" => from, "end" => to} <- list_or_empty(json["words"]),
          is_binary(word) and is_number(from) and is_number(to) and from >= 0 and to >= from,
          do: %{text: String.trim(word), from: round(from * 1.0e9), to: round(to * 1.0e9)}

    {:ok,
     %{
       text: String.trim(text),
       confidence: mean_confidence(text, json),
       words: words,
       alternatives: []
     }}
  end

  defp parse_result(_), do: {:error, Service.bad_answer()}

  defp mean_confidence(text, json) do
    logs = for %{"avg_logprob" => log} <- list_or_empty(json["segments"]), is_number(log), do: log

    cond do
      String.trim(text) == "" ->
        0.0

      logs == [] ->
        0.5

      true ->
        logs |> Enum.sum() |> Kernel./(length(logs)) |> min(0.0) |> max(-50.0) |> :math.exp()
    end
  end

  defp list_or_empty(list) when is_list(list), do: list
  defp list_or_empty(_), do: []
end
