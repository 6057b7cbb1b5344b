defmodule Situ.ImageOps.Drawing do
  @moduledoc false
  # Draws lines, rectangles, circles and text on a copy of an image. Call these functions through
  # `Situ.ImageOps`. `draw/2` draws several shapes and copies the image once.
  #
  # `Situ.ImageOps.draw/2` documents the shapes and their options.
  alias Situ.{Image, Point2, Rect}
  alias Situ.Image.Color
  alias Situ.ImageOps.Text
  alias Situ.Media.NativeKernel

  @type point :: {number(), number()} | Point2.t()
  @type rect :: Rect.t() | {number(), number(), number(), number()}

  @doc """
  Draws several shapes in order.

      iex> image = Situ.Image.new_filled(5, 5, :gray8)
      iex> {:ok, drawn} = Situ.ImageOps.draw(image, [{:fill_rectangle, {1, 1, 3, 3}, color: 9}])
      iex> for y <- 0..2, do: Situ.Image.fetch_pixel(drawn, 2, y)
      [{:ok, [0]}, {:ok, [9]}, {:ok, [9]}]
  """
  @spec draw(Image.t(), [tuple()]) :: Image.result()
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

  @doc """
  Draws a line between two points.

      iex> Situ.ImageOps.draw_line!(Situ.Image.new_filled(5, 3, :gray8), {1, 1}, {3, 1}, color: 9).data
      <<0, 0, 0, 0, 0, 0, 9, 9, 9, 0, 0, 0, 0, 0, 0>>
  """
  @spec draw_line(Image.t(), point(), point(), keyword()) :: Image.result()
  def draw_line(image, from, to, opts \\ []), do: draw(image, [{:line, from, to, opts}])

  @doc """
  Draws the outline of a rectangle.

      iex> Situ.ImageOps.draw_rectangle!(Situ.Image.new_filled(4, 3, :gray8), {0, 0, 3, 3}, color: 9).data
      <<9, 9, 9, 0, 9, 0, 9, 0, 9, 9, 9, 0>>
  """
  @spec draw_rectangle(Image.t(), rect(), keyword()) :: Image.result()
  def draw_rectangle(image, rect, opts \\ []), do: draw(image, [{:rectangle, rect, opts}])

  @doc """
  Fills a rectangle.

      iex> Situ.ImageOps.fill_rectangle!(Situ.Image.new_filled(4, 3, :gray8), {1, 1, 2, 2}, color: 9).data
      <<0, 0, 0, 0, 0, 9, 9, 0, 0, 9, 9, 0>>
  """
  @spec fill_rectangle(Image.t(), rect(), keyword()) :: Image.result()
  def fill_rectangle(image, rect, opts \\ []), do: draw(image, [{:fill_rectangle, rect, opts}])

  @doc """
  Draws the outline of a circle.

      iex> image = Situ.Image.new_filled(21, 21, :gray8)
      iex> {:ok, image} = Situ.ImageOps.draw_circle(image, {10, 10}, 8, color: 200, width: 3)
      iex> for x <- [10, 18], do: Situ.Image.fetch_pixel(image, x, 10)
      [{:ok, [0]}, {:ok, [200]}]
  """
  @spec draw_circle(Image.t(), point(), number(), keyword()) :: Image.result()
  def draw_circle(image, center, radius, opts \\ []),
    do: draw(image, [{:circle, center, radius, opts}])

  @doc """
  Fills a circle.

      iex> {:ok, image} = Situ.ImageOps.fill_circle(Situ.Image.new_filled(21, 21, :gray8), {10, 10}, 8, color: 200)
      iex> for x <- [10, 20], do: Situ.Image.fetch_pixel(image, x, 10)
      [{:ok, [200]}, {:ok, [0]}]
  """
  @spec fill_circle(Image.t(), point(), number(), keyword()) :: Image.result()
  def fill_circle(image, center, radius, opts \\ []),
    do: draw(image, [{:fill_circle, center, radius, opts}])

  @doc """
  Draws text with the top left corner of its capital letters at a point.

      iex> paper = Situ.Image.new_filled(90, 30, :gray8)
      iex> {:ok, image} = Situ.ImageOps.draw_text(paper, {4, 6}, "Ωmega, ça", size: 14, color: :white)
      iex> {:ok, %{gray: ink}} = Situ.ImageOps.statistics(image)
      iex> ink.max
      254
  """
  @spec draw_text(Image.t(), point(), String.t(), keyword()) :: Image.result()
  def draw_text(image, at, text, opts \\ []), do: draw(image, [{:text, at, text, opts}])

  @doc """
  Returns the width and height of text in pixels: the width of the widest line, and the height from the top of the first
  line's capital letters to the bottom of the last line. Takes the drawing options `size:` and `font:`.

      iex> {:ok, {width, height}} = Situ.ImageOps.text_size("three\\nlines\\nof text", size: 20)
      iex> {width > 60 and width < 110, height > 80 and height < 100}
      {true, true}
  """
  @spec text_size(String.t(), keyword()) :: {:ok, {float(), float()}} | {:error, Situ.Error.t()}
  def text_size(text, opts \\ []), do: Text.measure_size(text, opts)

  @doc """
  Draws boxes for detections, with label and score above them and a separate color for each label. Options: `width:` of
  the lines (2), and `size:` and `font:` of the labels (14, the default font).

      iex> face = Situ.Rect.new!(x: 30, y: 30, width: 20, height: 20, label: "Zoë", score: 0.9)
      iex> {:ok, image} = Situ.ImageOps.draw_detections(Situ.Image.new_filled(80, 60, :bgr24), [face])
      iex> Situ.Image.fetch_pixel(image, 30, 40) == {:ok, [0, 0, 0]}
      false
  """
  @spec draw_detections(Image.t(), [Rect.t()], keyword()) :: Image.result()
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
    raise ArgumentError, "unknown shape #{inspect(other)}; see Situ.ImageOps.Drawing"
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
