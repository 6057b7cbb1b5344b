defmodule Situ.Infer.Speech.OpenAI.Voice do
  @moduledoc """
  Text to speech with a service that implements OpenAI's protocol (`/audio/speech`). It has the same options and errors
  as `Situ.Infer.Speech.OpenAI`.

      Situ.via(text, Situ.Infer.SpeechSynthesizer, synthesizer: Situ.Infer.Speech.OpenAI.Voice).out
  """
  @behaviour Situ.Infer.Speech.Synthesizer

  alias Situ.Infer.Service
  alias Situ.Infer.Speech.{OpenAI, RequestEncoding}

  @impl true
  @spec load(keyword()) :: {:ok, OpenAI.t()} | {:error, Situ.Error.t()}
  defdelegate load(opts), to: OpenAI

  @impl true
  @spec speak(OpenAI.t(), String.t()) :: Situ.AudioBuffer.result()
  def speak(%OpenAI{service: service, opts: opts}, text) do
    body = %{model: opts.synthesizer, voice: opts.voice, input: text, response_format: "pcm"}
    headers = [{"content-type", "application/json"}]

    RequestEncoding.speak_text(text, round(opts.rate), fn ->
      Service.post(service, "/audio/speech", headers, Situ.JSON.encode(body))
    end)
  end
end
