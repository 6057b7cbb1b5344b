defmodule Situ.Infer.Speech.Azure.Voice do
  @moduledoc """
  Text to speech with Azure's speech service. It has the same options and errors as `Situ.Infer.Speech.Azure`.

      azure = [synthesizer: Situ.Infer.Speech.Azure.Voice, synthesizer_options: [region: "westeurope"]]
      Situ.via(text, Situ.Infer.SpeechSynthesizer, azure).out
  """
  @behaviour Situ.Infer.Speech.Synthesizer

  alias Situ.Infer.Service
  alias Situ.Infer.Speech.{Azure, RequestEncoding}

  @rate 24_000

  @impl true
  @spec load(keyword()) :: {:ok, Azure.t()} | {:error, Situ.Error.t()}
  defdelegate load(opts), to: Azure

  @impl true
  @spec speak(Azure.t(), String.t()) :: Situ.AudioBuffer.result()
  def speak(%Azure{opts: opts} = azure, text) do
    headers = [
      {"content-type", "application/ssml+xml"},
      {"x-microsoft-outputformat", "raw-24khz-16bit-mono-pcm"}
    ]

    RequestEncoding.speak_text(text, @rate, fn ->
      Service.post(azure.synthesizer, "/cognitiveservices/v1", headers, build_ssml(text, opts))
    end)
  end

  defp build_ssml(text, %{ssml: true}), do: text

  defp build_ssml(text, opts) do
    [
      ~s(<speak version="1.0" xmlns="http://www.w3.org/2001/10/synthesis" xml:lang="),
      Situ.Xml.escape(opts.language),
      ~s("><voice name="),
      Situ.Xml.escape(opts.voice),
      ~s(">),
      Situ.Xml.escape(text),
      "</voice></speak>"
    ]
  end
end
