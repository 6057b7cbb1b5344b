defmodule Situ.Studio.Visualizers.Depth do
  @moduledoc false
  # Draws the depth image at the cursor in false colours. The page receives the values and colours
  # them.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.Visualizer
  alias Situ.Studio.Visualizers.{Image, SharedOptions}

  @impl true
  def about do
    options =
      SharedOptions.visible() ++
        SharedOptions.flip() ++
        SharedOptions.depth_range(:range, title: "Range") ++
        [
          invalid: [type: {:range, -1, 65_535}, title: "No reading is", default: 0],
          invalid_color: [type: :color, title: "drawn in", auto: "see-through"],
          scale: [type: :boolean, title: "Colour scale", default: true]
        ] ++ SharedOptions.near_cursor()

    %Visualizer{
      id: "depth",
      title: "Depth",
      panel: :image,
      shapes: [:depth],
      options: options,
      asks: SharedOptions.requested_keys()
    }
  end

  @impl true
  defdelegate instant(channel, data, message), to: Image
end
