defmodule Situ.Infer.Speech.WakeWord.SpotterRecognizer do
  @moduledoc false
  # Adapts a spotter to the recognizer interface, so that it receives the same intervals of speech.
  @behaviour Situ.Infer.Speech.Recognizer

  @impl true
  def load(opts) do
    {spotter, own} = Keyword.pop!(opts, :spotter)
    with {:ok, model} <- spotter.load(own), do: {:ok, {spotter, model, own[:phrase]}}
  end

  @impl true
  def transcribe({spotter, model, phrase}, sound) do
    with {:ok, spans} <- spotter.spot_phrase(model, sound), do: {:ok, build_result(spans, phrase)}
  end

  defp build_result([], _phrase), do: %{text: "", confidence: 0.0}

  defp build_result(spans, phrase) do
    words = for span <- spans, do: Map.put(span, :text, phrase)
    %{text: phrase, confidence: Enum.max(Enum.map(spans, & &1.confidence)), words: words}
  end
end
