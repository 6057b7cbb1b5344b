defmodule Situ.Infer.Speech.OpenAI.Voice do
  @moduledoc """
  Text to speech with a service that implements OpenAI's protocol (`/audio/speech`). It has the same options and errors
  as `Situ.Infer.Speech.OpenAI`.

      Situ.via(text, Situ.Infer.SpeechSynthesizer, synthesizer: Situ.Infer.Speech.OpenAI.Voice).out
  """
  @behaviour Situ.Infer.Speech.Synthesizer

  alias Situ.{AudioBuffer, AudioFormat}
  alias Situ.Infer.Service
  alias Situ.Infer.Speech.{OpenAI, RequestEncoding}

  @impl true
  @spec load(keyword()) :: {:ok, OpenAI.t()} | {:error, Situ.Error.t()}
  defdelegate load(opts), to: OpenAI

  @impl true
  @spec speak(OpenAI.t(), String.t()) :: AudioBuffer.result()
  def speak(%OpenAI{service: service, opts: opts}, text) do
    body = %{model: opts.synthesizer, voice: opts.voice, input: text, response_format: "pcm"}
    format = AudioFormat.pcm(round(opts.rate))

    with :ok <- RequestEncoding.check_text(text),
         {:ok, %{body: data}} <-
           Service.post(
             service,
             "/audio/speech",
             [{"content-type", "application/json"}],
             Situ.JSON.encode(body)
           ) do
      # An incomplete sample at the end of the stream is dropped.
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
