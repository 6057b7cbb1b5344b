defmodule Situ.ImageOps.Drawing do
  @moduledoc false
  # Draws lines, rectangles, circles and text on a copy of an image. `Situ.ImageOps` documents the functions. All of
  # them call `draw/2`, which copies the image once.
  alias Situ.{Image, Point2, Rect}
  alias Situ.Image.Color
  alias Situ.ImageOps.Text
  alias Situ.Media.NativeKernel

  def draw(%Image{} = image, shapes) when is_list(shapes) do
    with {:ok, image} <- Image.validate(image) do
      terms = Enum.map(shapes, &build_shape(&1, image.format))

      with :ok <- Text.check_utf8(terms),
           do: NativeKernel.run_image({:draw, image, terms}, drawing_cost(image, terms))
    end
  end

  defp drawing_cost(image, terms) do
    texts = Enum.count(terms, &(elem(&1, 0) == :text))
    # A line across a 1080p image takes 10 us, and a disc that covers it 10 ms.
    byte_size(image.data) / 8000 + 20 * length(terms) + Text.cost_us() * texts
  end

  def draw_line(image, from, to, opts \\ []), do: draw(image, [{:line, from, to, opts}])

  def draw_rectangle(image, rect, opts \\ []), do: draw(image, [{:rectangle, rect, opts}])

  def fill_rectangle(image, rect, opts \\ []), do: draw(image, [{:fill_rectangle, rect, opts}])

  def draw_circle(image, center, radius, opts \\ []),
    do: draw(image, [{:circle, center, radius, opts}])

  def fill_circle(image, center, radius, opts \\ []),
    do: draw(image, [{:fill_circle, center, radius, opts}])

  def draw_text(image, at, text, opts \\ []), do: draw(image, [{:text, at, text, opts}])

  def text_size(text, opts \\ []), do: Text.measure_size(text, opts)

  def draw_detections(image, rects, opts \\ []) do
    opts = Keyword.validate!(opts, width: 2, size: 14, font: nil)
    draw(image, Enum.flat_map(rects, &detection_shapes(&1, opts)))
  end

  @palette [
    {230, 25, 75},
    {60, 180, 75},
    {0, 130, 200},
    {245, 130, 48},
    {145, 30, 180},
    {70, 240, 240},
    {240, 50, 230},
    {210, 245, 60}
  ]

  defp detection_shapes(%Rect{} = rect, opts) do
    color = Enum.at(@palette, :erlang.phash2(rect.label || rect.id, length(@palette)))
    score = if rect.score, do: :erlang.float_to_binary(rect.score * 1.0, decimals: 2)
    label = [rect.label, score] |> Enum.reject(&is_nil/1) |> Enum.join(" ")
    box = {:rectangle, rect, color: color, width: opts[:width]}
    # Aligns the bottom of the label with the top of the box.
    at = {rect.x + 2, max(rect.y - 1.35 * opts[:size] - 3, 2)}

    text =
      {:text, at, label, color: :white, background: color, size: opts[:size], font: opts[:font]}

    if label == "", do: [box], else: [box, text]
  end

  defp build_shape({:line, from, to, opts}, format) do
    opts = outline_options(opts)
    shape_term({:line, point_term(from), point_term(to), opts[:width]}, opts, format)
  end

  defp build_shape({:rectangle, rect, opts}, format) do
    opts = outline_options(opts)
    shape_term({:rectangle, rect_term(rect), opts[:width]}, opts, format)
  end

  defp build_shape({:fill_rectangle, rect, opts}, format),
    do: shape_term({:rectangle, rect_term(rect), nil}, fill_options(opts), format)

  defp build_shape({:circle, center, radius, opts}, format) do
    opts = outline_options(opts)
    shape_term({:circle, point_term(center), check_radius(radius), opts[:width]}, opts, format)
  end

  defp build_shape({:fill_circle, center, radius, opts}, format),
    do:
      shape_term(
        {:circle, point_term(center), check_radius(radius), nil},
        fill_options(opts),
        format
      )

  defp build_shape({:text, at, text, opts}, format),
    do: Text.text_term(point_term(at), text, opts, format)

  defp build_shape(other, _format) do
    raise ArgumentError, "unknown shape #{inspect(other)}; see Situ.ImageOps.draw/2"
  end

  defp shape_term(shape, opts, format),
    do: {:shape, shape, Color.to_opencv_scalar(format, opts[:color])}

  defp fill_options(opts), do: Keyword.validate!(opts, color: :red)

  defp outline_options(opts) do
    opts
    |> Keyword.validate!(color: :red, width: 1)
    |> Keyword.update!(:width, &(max(&1, 1) * 1.0))
  end

  defp check_radius(radius) when is_number(radius) and radius >= 0, do: radius * 1.0

  defp check_radius(other),
    do: raise(ArgumentError, "radius must be 0 or more, got: #{inspect(other)}")

  defp point_term(%Point2{x: x, y: y}), do: {x * 1.0, y * 1.0}
  defp point_term({x, y}), do: {x * 1.0, y * 1.0}
  defp rect_term(%Rect{} = r), do: {r.x * 1.0, r.y * 1.0, r.width * 1.0, r.height * 1.0}
  defp rect_term({x, y, w, h}), do: {x * 1.0, y * 1.0, w * 1.0, h * 1.0}
end
