defmodule Situ.Studio.Visualizers.Waveform do
  @moduledoc "Sound as the band between its extremes."
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Frame, Source, Visualizer}
  alias Situ.Studio.Visualizers.Option

  @impl true
  def about do
    mute = [mute: [type: :boolean, title: "Mute", default: false]]
    options = Option.visible() ++ Option.color() ++ mute

    %Visualizer{
      id: "waveform",
      title: "Waveform",
      panel: :plot,
      shapes: [:audio],
      options: options
    }
  end

  @impl true
  def window(source, channel, %{stream: stream}, from, to, bin) do
    with {:ok, points, raw?} <- Source.call(source, :series, [stream, from, to, bin]),
         do: Frame.series(channel, points, raw?)
  end
end
