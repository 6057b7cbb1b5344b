defmodule Situ.Studio.VideoExport.Masks do
  @moduledoc false
  # Draws masks into the images of a video, semi-transparent and coloured as on the page
  # (`Situ.Studio.Visualizers.Masks`). Masks of objects are drawn in their boxes, and masks of
  # classes over the part of the image that was the network's input.
  alias Situ.{Image, ImageOps}
  alias Situ.Studio.Visualizers

  # A box may claim any size, so larger ones are left out.
  @pixels 16_777_216
  @opacity 45
  @shades {1, 0.6, 0.8, 0.4}

  @doc """
  Draws masks over a `:bgr24` image. `palette` has red, green and blue, 0..255; `own` is the
  stream's index.

      iex> image = Situ.Image.new_filled(2, 1, :bgr24, [0, 0, 0])
      iex> mask = Situ.Image.new!(width: 2, height: 1, format: :gray8, data: <<0, 255>>)
      iex> found = {:objects, [{%Situ.Rect{x: 0, y: 0, width: 2, height: 1, id: 0}, mask}]}
      iex> Situ.Studio.VideoExport.Masks.draw_masks(image, found, 0, {{100, 200, 40}}, %{"opacity" => 50}).data
      <<0, 0, 0, 20, 100, 50>>
  """
  @spec draw_masks(Image.t(), Visualizers.Masks.result(), non_neg_integer(), tuple(), map()) ::
          Image.t()
  def draw_masks(image, {:classes, classes}, _own, palette, props) do
    box = covered_rect(classes, image, props["fit"] || "pad")
    tint_rect(image, classes, box, &class_shade(palette, &1 - 1), mask_opacity(props))
  end

  def draw_masks(image, {:objects, objects}, own, palette, props) do
    objects
    |> Enum.with_index(own)
    |> Enum.reduce(image, fn {{rect, mask}, i}, image ->
      rgb = palette_color(palette, if(is_integer(rect.id), do: rect.id, else: i))
      box = {rect.x, rect.y, rect.width, rect.height}
      tint_rect(image, mask, box, fn _ -> rgb end, mask_opacity(props))
    end)
  end

  # Returns the part of the image that the class numbers cover.
  defp covered_rect(%{width: side, height: side}, %{width: w, height: h}, fit)
       when fit != "whole" do
    side = if fit == "crop", do: min(w, h), else: max(w, h)
    {(w - side) / 2, (h - side) / 2, side, side}
  end

  defp covered_rect(_, %{width: w, height: h}, _fit), do: {0, 0, w, h}

  defp mask_opacity(props), do: props["opacity"] || @opacity

  defp palette_color(palette, i), do: elem(palette, rem(abs(i), tuple_size(palette)))

  # If there are more classes than colours, the rest are darker or lighter, as on the page.
  defp class_shade(palette, i) do
    k = elem(@shades, rem(div(abs(i), tuple_size(palette)), tuple_size(@shades)))
    {r, g, b} = palette_color(palette, i)
    {round(r * k), round(g * k), round(b * k)}
  end

  # Looks up each of the 256 values only once.
  defp tint_rect(image, mask, {x, y, w, h}, color_of, weight) do
    {x, y, w, h} = {round(x), round(y), round(w), round(h)}
    {left, top} = {max(x, 0), max(y, 0)}
    {width, height} = {min(x + w, image.width) - left, min(y + h, image.height) - top}

    with true <- width > 0 and height > 0 and w * h <= @pixels,
         {:ok, mask} <- ImageOps.resize(mask, w, h, filter: :nearest),
         {:ok, mask} <- ImageOps.crop(mask, {left - x, top - y, width, height}),
         {:ok, part} <- ImageOps.crop(image, {left, top, width, height}) do
      mask = Image.pixel_bytes(mask)
      colors = List.to_tuple(for v <- 0..255, do: weighted_channels(color_of.(v), weight))
      data = blend_pixels(mask, Image.pixel_bytes(part), colors, 100 - weight, <<>>)
      part = Image.new!(width: width, height: height, format: :bgr24, data: data)
      {:ok, pasted} = ImageOps.paste(image, part, {left, top})
      pasted
    else
      _ -> image
    end
  end

  defp weighted_channels({r, g, b}, weight), do: {b * weight, g * weight, r * weight}

  defp blend_pixels(<<0, mask::binary>>, <<pixel::24, rest::binary>>, colors, keep, acc),
    do: blend_pixels(mask, rest, colors, keep, <<acc::binary, pixel::24>>)

  defp blend_pixels(<<v, mask::binary>>, <<b, g, r, rest::binary>>, colors, keep, acc) do
    {cb, cg, cr} = elem(colors, v)

    pixel = <<div(b * keep + cb, 100), div(g * keep + cg, 100), div(r * keep + cr, 100)>>

    blend_pixels(mask, rest, colors, keep, <<acc::binary, pixel::binary>>)
  end

  defp blend_pixels(<<>>, <<>>, _colors, _keep, acc), do: acc
end
