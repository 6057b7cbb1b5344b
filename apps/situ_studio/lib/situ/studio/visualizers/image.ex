defmodule Situ.Studio.Visualizers.Image do
  @moduledoc false
  # Draws the image at the cursor.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Frame, Visualizer}
  alias Situ.Studio.Draw.BrowserImage
  alias Situ.Studio.Visualizers.SharedOptions

  @impl true
  def about do
    options = SharedOptions.visible() ++ SharedOptions.flip() ++ SharedOptions.near_cursor()

    %Visualizer{
      id: "image",
      title: "Image",
      panel: :image,
      shapes: [:image],
      options: options,
      asks: SharedOptions.requested_keys()
    }
  end

  @impl true
  def instant(channel, data, message) do
    with {:ok, picture} <- BrowserImage.to_browser_image(data),
         do: Frame.image(channel, message.originating_time, picture)
  end
end
