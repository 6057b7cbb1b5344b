defmodule Situ.Studio.VideoExport.MasksTest do
  # Draws masks into an image, pixel by pixel.
  use ExUnit.Case, async: true
  doctest Situ.Studio.VideoExport.Masks

  alias Situ.{Image, Rect}
  alias Situ.Studio.VideoExport.Masks

  @palette {{255, 0, 0}, {0, 255, 0}}
  @full Image.new_filled(2, 2, :gray8, [255])

  defp black(w, h), do: Image.new_filled(w, h, :bgr24, [0, 0, 0])
  defp at(image, x, y), do: image |> Image.fetch_pixel(x, y) |> elem(1)

  test "clips a box at the image's edge, and ignores boxes outside and oversized ones" do
    box = fn x, y, w, h -> {%Rect{x: x, y: y, width: w, height: h, id: 0}, @full} end
    objects = [box.(-4, -4, 8, 8), box.(40, 40, 8, 8), box.(0, 0, 1.0e6, 1.0e6)]
    drawn = Masks.draw_masks(black(16, 16), {:objects, objects}, 0, @palette, %{"opacity" => 100})
    assert at(drawn, 3, 3) == [0, 0, 255]
    assert at(drawn, 4, 4) == [0, 0, 0]
    assert at(drawn, 15, 15) == [0, 0, 0]
  end

  test "objects without an id take the colors after the stream's own" do
    objects = for x <- [0, 8], do: {%Rect{x: x, y: 0, width: 8, height: 8}, @full}

    drawn = Masks.draw_masks(black(16, 8), {:objects, objects}, 1, @palette, %{"opacity" => 100})
    assert at(drawn, 0, 0) == [0, 255, 0]
    assert at(drawn, 8, 0) == [0, 0, 255]
  end

  test "classes cover the square that the network saw" do
    rows = for y <- 0..3, into: <<>>, do: :binary.copy(<<if(y == 1, do: 2, else: 0)>>, 4)
    classes = Image.new!(width: 4, height: 4, format: :gray8, data: rows)

    drawn =
      &Masks.draw_masks(black(16, 8), {:classes, classes}, 0, @palette, %{
        "fit" => &1,
        "opacity" => 100
      })

    # Padded around the image: rows of four pixels, the first above it.
    assert {at(drawn.("pad"), 0, 0), at(drawn.("pad"), 0, 4)} == {[0, 255, 0], [0, 0, 0]}
    # Cropped to its center: rows of two pixels.
    assert {at(drawn.("crop"), 0, 3), at(drawn.("crop"), 4, 3)} == {[0, 0, 0], [0, 255, 0]}
    assert {at(drawn.("whole"), 0, 1), at(drawn.("whole"), 0, 2)} == {[0, 0, 0], [0, 255, 0]}
  end

  test "gives different colors to more classes than the palette has" do
    classes = Image.new!(width: 4, height: 1, format: :gray8, data: <<1, 2, 3, 5>>)
    drawn = Masks.draw_masks(black(4, 1), {:classes, classes}, 0, @palette, %{"opacity" => 100})

    assert Enum.map(0..3, &at(drawn, &1, 0)) == [
             [0, 0, 255],
             [0, 255, 0],
             [0, 0, 153],
             [0, 0, 204]
           ]
  end
end
