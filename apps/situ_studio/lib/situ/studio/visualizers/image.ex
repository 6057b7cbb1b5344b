defmodule Situ.Studio.Visualizers.Image do
  @moduledoc "The image at the cursor."
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Draw.Picture, Frame, Visualizer}
  alias Situ.Studio.Visualizers.Option

  @impl true
  def about do
    options = Option.visible() ++ Option.flip() ++ Option.near_cursor()

    %Visualizer{
      id: "image",
      title: "Image",
      panel: :image,
      shapes: [:image],
      options: options,
      asks: Option.requested_keys()
    }
  end

  @impl true
  def instant(channel, data, message) do
    with {:ok, picture} <- Picture.to_browser_image(data),
         do: Frame.image(channel, message.originating_time, picture)
  end
end
