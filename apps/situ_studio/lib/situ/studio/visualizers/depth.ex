defmodule Situ.Studio.Visualizers.Depth do
  @moduledoc "The depth picture at the cursor in false colours; its values go to the page, which colours them."
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.Visualizer
  alias Situ.Studio.Visualizers.{Image, Option}

  @values {:range, 0, 65_535}
  @ranges [
    {"auto", "each picture's own range"},
    {"fixed", "a fixed range"},
    {"all", "all 16 bits"},
    {"nfov_binned", "Azure Kinect, narrow, binned"},
    {"nfov", "Azure Kinect, narrow"},
    {"wfov_binned", "Azure Kinect, wide, binned"},
    {"wfov", "Azure Kinect, wide"}
  ]

  @impl true
  def about do
    fixed = {:range, "fixed"}

    options =
      Option.visible() ++
        Option.flip() ++
        [
          range: [type: {:in, @ranges}, title: "Range", default: "auto"],
          min: [type: @values, title: "from", default: 0, only: fixed],
          max: [type: @values, title: "to", default: 65_535, only: fixed],
          invalid: [type: {:range, -1, 65_535}, title: "No reading is", default: 0],
          invalid_color: [type: :color, title: "drawn in", auto: "see-through"],
          scale: [type: :boolean, title: "Colour scale", default: true]
        ] ++ Option.near()

    %Visualizer{
      id: "depth",
      title: "Depth",
      panel: :image,
      shapes: [:depth],
      options: options,
      asks: Option.asks()
    }
  end

  @impl true
  defdelegate instant(channel, data, message), to: Image
end
