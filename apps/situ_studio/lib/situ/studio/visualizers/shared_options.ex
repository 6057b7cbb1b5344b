defmodule Situ.Studio.Visualizers.SharedOptions do
  @moduledoc false
  # Options that several visualizers share, in the format of `Situ.Studio.Visualizer`.

  @spec visible() :: keyword()
  def visible, do: [visible: [type: :boolean, title: "Visible", default: true]]

  @spec color() :: keyword()
  def color, do: [color: [type: :color, title: "Colour"]]

  @spec flip() :: keyword()
  def flip, do: [flip: [type: :boolean, title: "Mirror", default: false]]

  @ranges [
    {"auto", "the range of each image"},
    {"fixed", "a fixed range"},
    {"all", "all 16 bits"},
    {"nfov_binned", "Azure Kinect, narrow, binned"},
    {"nfov", "Azure Kinect, narrow"},
    {"wfov_binned", "Azure Kinect, wide, binned"},
    {"wfov", "Azure Kinect, wide"}
  ]
  @values {:range, 0, 65_535}

  # Options for the distances that a depth image's colours span: a choice called `name`, and two numbers for "fixed".
  @spec depth_range(atom(), keyword()) :: keyword()
  def depth_range(name, about) do
    fixed = {name, "fixed"}

    [
      {name, [type: {:in, @ranges}, default: "auto"] ++ about},
      min: [type: @values, title: "from", default: 0, only: fixed],
      max: [type: @values, title: "to", default: 65_535, only: fixed]
    ]
  end

  @longest 1.0e6

  # Options for the message that is shown at the cursor: the last one at or before it, or another message near enough.
  @spec near_cursor() :: keyword()
  def near_cursor do
    [
      past: [type: {:range, 0, @longest}, title: "Holds for, s", auto: "until the next"],
      future: [type: {:range, 0, @longest}, title: "Shown before, s", auto: "0"]
    ]
  end

  @doc "Returns the options of `near_cursor/0` that are sent to the server."
  @spec requested_keys() :: [atom()]
  def requested_keys, do: [:past, :future]

  # The number of channels to choose from.
  @channels 8

  @spec channel() :: keyword()
  def channel do
    one = for c <- 1..@channels, do: {Integer.to_string(c), Integer.to_string(c)}
    [channel: [type: {:in, [{"all", "all"} | one]}, title: "Channel", default: "all"]]
  end

  @markers ["circle", "square", "triangle", "diamond", "plus", "cross"]

  @spec line_style() :: keyword()
  def line_style do
    joins = [{"direct", "straight"}, {"step", "steps"}, {"none", "points only"}]

    [
      interpolation: [type: {:in, joins}, title: "Interpolation", default: "direct"],
      width: [type: {:range, 0.5, 6}, title: "Width", default: 1.25],
      markers: [type: :boolean, title: "Markers", default: false],
      marker: [
        type: {:in, @markers},
        title: "Marker shape",
        default: "circle",
        only: {:markers, true}
      ],
      size: [type: {:range, 1, 20}, title: "Marker size", default: 5, only: {:markers, true}],
      digits: [type: {:range, 1, 15}, title: "Digits of values", default: 5],
      unit: [type: :text, title: "Unit"]
    ]
  end
end
