defmodule Situ.Examples.ImageCrop do
  @moduledoc """
  A custom component that crops images to the most recent rectangle.

  Inputs are `:image` (`Situ.Image`) and `:rect` (`Situ.Rect`); the output `:out` (`Situ.Image`) has the image's time.
  Nothing is emitted before the first rectangle, or while the rectangle is outside the image.

      Situ.via([image: pictures, rect: rectangles], Situ.Examples.ImageCrop)

  It uses the rectangle that arrived last, so the result depends on timing. For reproducible results, join the streams
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
    case Situ.ImageOps.crop(message.data, rect, clip: true) do
      {:ok, %Situ.Image{} = part} -> {[{:out, message.originating_time, part}], rect}
      _outside -> {[], rect}
    end
  end
end
