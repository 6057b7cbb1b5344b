defmodule Situ.Infer.Speech.OpenAI.Voice do
  @moduledoc """
  Text to speech by a service that speaks OpenAI's protocol (`/audio/speech`); options and errors are those of
  `Situ.Infer.Speech.OpenAI`.

      Situ.via(text, Situ.Infer.SpeechSynthesizer, synthesizer: Situ.Infer.Speech.OpenAI.Voice).out
  """
  @behaviour Situ.Infer.Speech.Synthesizer

  alias Situ.{AudioBuffer, AudioFormat}
  alias Situ.Infer.Service
  alias Situ.Infer.Speech.{OpenAI, Upload}

  @impl true
  @spec load(keyword()) :: {:ok, OpenAI.t()} | {:error, Situ.Error.t()}
  defdelegate load(opts), to: OpenAI

  @impl true
  @spec speak(OpenAI.t(), String.t()) :: AudioBuffer.result()
  def speak(%OpenAI{service: service, opts: opts}, text) do
    body = %{model: opts.synthesizer, voice: opts.voice, input: text, response_format: "pcm"}
    format = AudioFormat.pcm(round(opts.rate))

    with :ok <- Upload.text(text),
         {:ok, %{body: data}} <-
           Service.post(
             service,
             "/audio/speech",
             [{"content-type", "application/json"}],
             Situ.JSON.encode(body)
           ) do
      # Half a sample at the end of a stream is none.
      AudioBuffer.new(
        format: format,
        data: binary_part(data, 0, byte_size(data) - rem(byte_size(data), 2))
      )
    else
      :nothing -> AudioBuffer.new(format: format, data: "")
      error -> error
    end
  end
end
