defmodule Situ.Image.Drawing do
  @moduledoc """
  Lines, rectangles, circles and text on a copy of a picture. Call them through `Situ.Image`; `draw/2` takes many shapes
  and copies the picture once.

  | shape | drawn |
  |---|---|
  | `{:line, {x, y}, {x, y}, opts}` | from, to |
  | `{:rectangle, rect, opts}` | `Situ.Rect` or `{x, y, width, height}`; outline on its edge |
  | `{:fill_rectangle, rect, opts}` | its inside |
  | `{:circle, {x, y}, radius, opts}` | outline centred on its edge |
  | `{:fill_circle, {x, y}, radius, opts}` | a disc |
  | `{:text, {x, y}, string, opts}` | top left corner; OpenCV's Hershey font: ASCII, the rest becomes `?` |

  Options: `color:` (see `Situ.Image.Color`, default `:red`), `width:` of lines in pixels (default 1), `size:` of text in
  pixels (height of a capital, default 16), `background:` of text (default none).
  """
  alias Situ.{Image, Point2, Rect}
  alias Situ.Image.Color
  alias Situ.Media.Kernel

  @type point :: {number(), number()} | Point2.t()
  @type rect :: Rect.t() | {number(), number(), number(), number()}

  @doc """
  Several shapes at once, in order.

      iex> image = Situ.Image.filled(5, 5, :gray8)
      iex> {:ok, drawn} = Situ.Image.draw(image, [{:fill_rectangle, {1, 1, 3, 3}, color: 9}])
      iex> for y <- 0..2, do: Situ.Image.fetch_pixel(drawn, 2, y)
      [{:ok, [0]}, {:ok, [9]}, {:ok, [9]}]
  """
  @spec draw(Image.t(), [tuple()]) :: Image.result()
  def draw(%Image{} = image, shapes) when is_list(shapes) do
    with {:ok, image} <- Image.validate(image) do
      terms = Enum.flat_map(shapes, &shape(&1, image.format))
      Kernel.opencv({:draw, image, terms}, byte_size(image.data) / 8000 + 20 * length(terms))
    end
  end

  @doc "A line from point to point."
  @spec draw_line(Image.t(), point(), point(), keyword()) :: Image.result()
  def draw_line(image, from, to, opts \\ []), do: draw(image, [{:line, from, to, opts}])

  @doc "The outline of a rectangle."
  @spec draw_rectangle(Image.t(), rect(), keyword()) :: Image.result()
  def draw_rectangle(image, rect, opts \\ []), do: draw(image, [{:rectangle, rect, opts}])

  @doc "A filled rectangle."
  @spec fill_rectangle(Image.t(), rect(), keyword()) :: Image.result()
  def fill_rectangle(image, rect, opts \\ []), do: draw(image, [{:fill_rectangle, rect, opts}])

  @doc "The outline of a circle."
  @spec draw_circle(Image.t(), point(), number(), keyword()) :: Image.result()
  def draw_circle(image, center, radius, opts \\ []),
    do: draw(image, [{:circle, center, radius, opts}])

  @doc "A disc."
  @spec fill_circle(Image.t(), point(), number(), keyword()) :: Image.result()
  def fill_circle(image, center, radius, opts \\ []),
    do: draw(image, [{:fill_circle, center, radius, opts}])

  @doc "Text with its top left corner at a point."
  @spec draw_text(Image.t(), point(), String.t(), keyword()) :: Image.result()
  def draw_text(image, at, text, opts \\ []), do: draw(image, [{:text, at, text, opts}])

  @doc """
  Boxes with label and score above them, each label in a colour of its own: what detectors answer.
  """
  @spec draw_detections(Image.t(), [Rect.t()], keyword()) :: Image.result()
  def draw_detections(image, rects, opts \\ []) do
    opts = Keyword.validate!(opts, width: 2, size: 14)
    draw(image, Enum.flat_map(rects, &detection(&1, opts)))
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

  defp detection(%Rect{} = rect, opts) do
    color = Enum.at(@palette, :erlang.phash2(rect.label || rect.id, length(@palette)))
    score = if rect.score, do: :erlang.float_to_binary(rect.score * 1.0, decimals: 2)
    label = [rect.label, score] |> Enum.reject(&is_nil/1) |> Enum.join(" ")
    box = {:rectangle, rect, color: color, width: opts[:width]}
    at = {rect.x, max(rect.y - opts[:size] - 6, 0)}
    text = {:text, at, label, color: :white, background: color, size: opts[:size]}
    if label == "", do: [box], else: [box, text]
  end

  defp shape({:line, from, to, opts}, format) do
    {{x1, y1}, {x2, y2}} = {point(from), point(to)}
    [term(0, {x1, y1, x2, y2}, format, opts, width(opts))]
  end

  defp shape({:rectangle, rect, opts}, format),
    do: [term(1, rect(rect), format, opts, width(opts))]

  defp shape({:fill_rectangle, rect, opts}, format), do: [term(1, rect(rect), format, opts, -1)]

  defp shape({:circle, center, radius, opts}, format) do
    {x, y} = point(center)
    [term(2, {x, y, radius(radius), 0.0}, format, opts, width(opts))]
  end

  defp shape({:fill_circle, center, radius, opts}, format) do
    {x, y} = point(center)
    [term(2, {x, y, radius(radius), 0.0}, format, opts, -1)]
  end

  defp shape({:text, at, text, opts}, format) do
    {x, y} = point(at)
    size = Keyword.get(opts, :size, 16) * 1.0
    width = Keyword.get(opts, :width, max(1, round(size / 12)))

    background(opts[:background], {x, y, size, text}, format) ++
      [text_term({x, y, size, 0.0}, format, opts, width, text)]
  end

  defp shape(other, _format) do
    raise ArgumentError, "unknown shape #{inspect(other)}; see Situ.Image.Drawing"
  end

  defp background(nil, _where, _format), do: []

  # Hershey's simplex letters are about 0.87 of a capital's height wide, and hang a third below the line.
  defp background(color, {x, y, size, text}, format) do
    box = {x - 2.0, y - 2.0, String.length(text) * size * 0.87 + 4.0, size * 1.35 + 4.0}
    [term(1, box, format, [color: color], -1)]
  end

  defp term(kind, place, format, opts, thickness) do
    {kind, place, Color.scalar(format, Keyword.get(opts, :color, :red)), thickness, ""}
  end

  defp text_term(place, format, opts, thickness, text) do
    {3, place, Color.scalar(format, Keyword.get(opts, :color, :red)), thickness, text}
  end

  defp point(%Point2{x: x, y: y}), do: {x * 1.0, y * 1.0}
  defp point({x, y}), do: {x * 1.0, y * 1.0}
  defp rect(%Rect{} = r), do: {r.x * 1.0, r.y * 1.0, r.width * 1.0, r.height * 1.0}
  defp rect({x, y, w, h}), do: {x * 1.0, y * 1.0, w * 1.0, h * 1.0}

  defp radius(radius) when is_number(radius) and radius >= 0, do: radius * 1.0

  defp radius(other),
    do: raise(ArgumentError, "a radius is 0 or more, got: #{inspect(other)}")

  defp width(opts), do: opts |> Keyword.get(:width, 1) |> max(1) |> round()
end
