defmodule Situ.Studio.Visualizers.Latency do
  @moduledoc false
  # Draws the latency of each message (from originating to creation time, in milliseconds) as a
  # stem.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Frame, Visualizer, StreamReader}
  alias Situ.Studio.Draw.{Bins, Values}
  alias Situ.Studio.Visualizers.SharedOptions

  @rows 20_000
  @points 1_500

  @impl true
  def about do
    limit = [threshold_ms: [type: {:range, 0, 1.0e6}, title: "Limit, ms", default: 50]]
    options = SharedOptions.visible() ++ SharedOptions.color() ++ limit
    %Visualizer{id: "latency", title: "Latency", panel: :plot, shapes: :any, options: options}
  end

  @impl true
  def window(source, channel, %{stream: stream}, from, to, bin) do
    with {:ok, rows, all} <- StreamReader.read_marks(source, stream, from, to, @rows) do
      points = for {t, latency} <- rows, do: Bins.point(t, latency / 1.0e6)
      {points, raw?} = Bins.fold_points(points, bin, @points)
      Frame.series(channel, points, raw?, sampled: all == :more)
    end
  end

  @impl true
  def value_at(source, channel, spec, time) do
    Values.fetch_at(source, channel, %{spec | path: []}, time, fn _data, message ->
      [{"", Situ.Message.latency(message) / 1.0e6}]
    end)
  end
end
