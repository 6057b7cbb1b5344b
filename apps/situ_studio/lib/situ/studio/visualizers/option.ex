defmodule Situ.Studio.Visualizers.Option do
  @moduledoc false
  # Options that several visualizers share, as `Situ.Studio.Visualizer` describes them.

  @spec visible() :: keyword()
  def visible, do: [visible: [type: :boolean, title: "Visible", default: true]]

  @spec color() :: keyword()
  def color, do: [color: [type: :color, title: "Colour"]]

  @spec flip() :: keyword()
  def flip, do: [flip: [type: :boolean, title: "Mirror", default: false]]

  # So many channels can be chosen.
  @channels 8

  @spec channel() :: keyword()
  def channel do
    one = for c <- 1..@channels, do: {Integer.to_string(c), Integer.to_string(c)}
    [channel: [type: {:in, [{"all", "all"} | one]}, title: "Channel", default: "all"]]
  end

  @spec line() :: keyword()
  def line do
    joins = [{"direct", "straight"}, {"step", "steps"}, {"none", "points only"}]

    [
      interpolation: [type: {:in, joins}, title: "Joins", default: "direct"],
      width: [type: {:range, 0.5, 6}, title: "Width", default: 1.25],
      markers: [type: :boolean, title: "Markers", default: false],
      unit: [type: :text, title: "Unit"]
    ]
  end
end
