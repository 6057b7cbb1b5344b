defmodule Situ.Examples.ImageCrop do
  @moduledoc """
  A component of one's own: cuts pictures to the last rectangle that came.

  Inputs `:image` (`Situ.Image`) and `:rect` (`Situ.Rect`), output `:out` (`Situ.Image`) at the picture's time.
  Nothing comes out before the first rectangle, nor for one that lies outside of the picture.

      Situ.via([image: pictures, rect: rectangles], Situ.Examples.ImageCrop)

  It takes whatever rectangle arrived before, so the result depends on timing. Where it must not, join the streams
  instead: `pictures |> Situ.join(rectangles, Situ.Reproducible.last())`.
  """
  use Situ.Component,
    inputs: [image: Situ.Image, rect: Situ.Rect],
    outputs: [out: Situ.Image]

  @impl true
  def init(_opts), do: {:ok, nil}

  @impl true
  def handle_message(:rect, message, _context, _rect), do: {[], message.data}
  def handle_message(:image, _message, _context, nil), do: {[], nil}

  def handle_message(:image, message, _context, rect) do
    case Situ.Imaging.crop(message.data, rect, clip: true) do
      {:ok, %Situ.Image{} = part} -> {[{:out, message.originating_time, part}], rect}
      _outside -> {[], rect}
    end
  end
end
