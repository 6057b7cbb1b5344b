defmodule Situ.Infer.Speech.WakeWord.SpotterRecognizer do
  @moduledoc false
  # Adapts a spotter to the recognizer interface, so that it receives the same intervals of speech.
  @behaviour Situ.Infer.Speech.Recognizer

  @impl true
  def load(opts) do
    {spotter, own} = Keyword.pop!(opts, :spotter)
    with {:ok, loaded} <- spotter.load(own), do: {:ok, {spotter, loaded, own[:phrase]}}
  end

  @impl true
  def transcribe({spotter, loaded, phrase}, sound) do
    with {:ok, places} <- spotter.spot(loaded, sound), do: {:ok, build_result(places, phrase)}
  end

  defp build_result([], _phrase), do: %{text: "", confidence: 0.0}

  defp build_result(places, phrase) do
    words = for place <- places, do: Map.put(place, :text, phrase)
    %{text: phrase, confidence: Enum.max(Enum.map(places, & &1.confidence)), words: words}
  end
end
