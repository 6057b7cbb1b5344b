defmodule Situ.ImageOps do
  @moduledoc """
  Operations on images: resize, crop, convert, filter, draw, measure, and read and write files.

  Every function takes a `Situ.Image` first and returns `{:ok, result}` or `{:error, %Situ.Error{}}`. Nearly all have
  a variant with `!` that returns the result or raises. `Situ.ImageStream` has the same operations for streams, with the
  same names and options.

      iex> image = Situ.Image.new_filled(64, 48, :bgr24, :red)
      iex> {:ok, small} = Situ.ImageOps.resize(image, 32, 24)
      iex> written = Situ.ImageOps.draw_text!(small, {2, 2}, "hello", size: 8)
      iex> {:ok, jpeg} = Situ.ImageOps.encode_jpeg(written, quality: 80)
      iex> {jpeg.format, jpeg.width, jpeg.height}
      {:jpeg, 32, 24}

  | subject | functions |
  |---|---|
  | geometry | `crop` `resize` `scale` `letterbox` `flip` `rotate` `warp_affine` `warp_perspective` `paste` |
  | pixels | `convert` `invert` `threshold` `extract_channel` `absdiff` `convolve` `pseudo_colorize` |
  | neighbourhoods | `blur` `box_blur` `median_blur` `canny` `sobel` `erode` `dilate` `open` `close` `equalize` |
  | drawing | `draw` `draw_line` `draw_rectangle` `draw_circle` `draw_text` `draw_detections` `text_size` ... |
  | measurements | `statistics` `average_color` `histogram` `compare` `to_f32` |
  | files | `read` `write` `parse` `encode_jpeg` `encode_png` `decode_depth` `from_raw` `from_yuv` |

  `:bad_option` is the error of an argument outside its range, `:bad_format` of a pixel format that an operation does
  not support, and `:bad_image` of an image whose data does not match its size.
  """
  alias Situ.{DepthImage, EncodedImage, Error, Image, Point2, Rect}
  alias Situ.ImageOps.{Drawing, Files, Filter, Geometry, Measure, Pixels}

  @typedoc "The center of a pixel."
  @type point :: {number(), number()} | Point2.t()
  @typedoc "A rectangle, or `{x, y, width, height}`."
  @type rect :: Rect.t() | {number(), number(), number(), number()}
  @typedoc "The statistics of one channel."
  @type channel_statistics :: %{
          min: integer(),
          max: integer(),
          mean: float(),
          deviation: float()
        }

  # Geometry
  @doc """
  Returns the part inside `rect` (a `Situ.Rect` or `{x, y, width, height}`; fractions are rounded to complete pixels).

  A rectangle that is not inside the image is an error. With `clip: true` it is clipped to the image first, and the
  result is `{:ok, nil}` if nothing is left.

      iex> image = Situ.Image.new!(width: 3, height: 2, format: :gray8, data: <<1, 2, 3, 4, 5, 6>>)
      iex> {:ok, part} = Situ.ImageOps.crop(image, {1, 0, 2, 2})
      iex> part.data
      <<2, 3, 5, 6>>
      iex> {:error, error} = Situ.ImageOps.crop(image, {2, 0, 2, 2})
      iex> error.code
      :bad_rect
      iex> Situ.ImageOps.crop(image, {5, 5, 1, 1}, clip: true)
      {:ok, nil}

  A depth image is cropped to a depth image of the same semantics and scale.
  """
  @spec crop(Image.t() | DepthImage.t(), rect(), keyword()) ::
          {:ok, Image.t() | DepthImage.t() | nil} | {:error, Error.t()}
  defdelegate crop(image, rect, opts \\ []), to: Geometry

  @doc """
  Resizes an image to exactly `width` by `height` pixels, in the same format.

  `filter:` is `:bilinear` (default; two by two pixels, OpenCV's INTER_LINEAR), `:nearest`, `:bicubic`, `:area`
  (mean of the covered pixels), `:smooth` (bilinear over all covered pixels, which shrinks without jagged edges) or
  `:lanczos`. Filters that overshoot (`:bicubic`, `:lanczos`) are clipped at 0 and 255 after each of their two passes,
  as in Pillow. At hard edges they differ from OpenCV, which clips once.

      iex> {:ok, small} = Situ.ImageOps.resize(Situ.Image.new_filled(64, 48, :bgr24, [1, 2, 3]), 32, 24)
      iex> {small, Situ.Image.fetch_pixel(small, 31, 23)}
      {small, {:ok, [1, 2, 3]}}
  """
  @spec resize(Image.t(), pos_integer(), pos_integer(), keyword()) :: Image.result()
  defdelegate resize(image, width, height, opts \\ []), to: Geometry

  @doc """
  Resizes an image by factors. Sizes are rounded to the nearest pixel and are at least 1.

      iex> {:ok, image} = Situ.ImageOps.scale(Situ.Image.new_filled(10, 10, :gray8), 0.5, 2)
      iex> {image.width, image.height}
      {5, 20}
  """
  @spec scale(Image.t(), number(), number(), keyword()) :: Image.result()
  defdelegate scale(image, sx, sy, opts \\ []), to: Geometry

  @doc """
  Resizes an image to the largest size of the same proportions that fits `width` by `height`, centered, and fills the
  rest with `color:` (default 0). `letterbox_rect/4` returns its position.

      iex> {:ok, image} = Situ.ImageOps.letterbox(Situ.Image.new_filled(4, 2, :gray8, 9), 4, 4)
      iex> image.data
      <<0, 0, 0, 0, 9, 9, 9, 9, 9, 9, 9, 9, 0, 0, 0, 0>>
  """
  @spec letterbox(Image.t(), pos_integer(), pos_integer(), keyword()) :: Image.result()
  defdelegate letterbox(image, width, height, opts \\ []), to: Geometry

  @doc """
  Returns the rectangle of a `from_width` x `from_height` image in its `width` x `height` letterbox.

      iex> Situ.ImageOps.letterbox_rect(1280, 720, 640, 640)
      %Situ.Rect{x: 0, y: 140, width: 640, height: 360}
  """
  @spec letterbox_rect(pos_integer(), pos_integer(), pos_integer(), pos_integer()) :: Rect.t()
  defdelegate letterbox_rect(from_width, from_height, width, height), to: Geometry

  @doc """
  Mirrors an image: `:horizontal` along the horizontal axis (top becomes bottom), `:vertical` along the vertical axis
  (left becomes right), or `:both`.

      iex> image = Situ.Image.new!(width: 2, height: 2, format: :gray8, data: <<1, 2, 3, 4>>)
      iex> for axis <- [:horizontal, :vertical, :both], do: Situ.ImageOps.flip!(image, axis).data
      [<<3, 4, 1, 2>>, <<2, 1, 4, 3>>, <<4, 3, 2, 1>>]
  """
  @spec flip(Image.t(), :horizontal | :vertical | :both) :: Image.result()
  defdelegate flip(image, axis), to: Geometry

  @doc """
  Rotates an image clockwise about its center by `degrees`.

  Multiples of 90 are exact with `fit: :tight`. For other angles pixels are interpolated (`filter:`, `color:`,
  `border:`). `fit:` sets the size of the result: `:tight` (default) is the extent of the rotated corners, `:loose` is a
  square with the side of the diagonal at any angle, and `:same` is the size of the source.

      iex> image = Situ.Image.new_filled(100, 200, :gray8)
      iex> {:ok, tight} = Situ.ImageOps.rotate(image, 10)
      iex> {:ok, loose} = Situ.ImageOps.rotate(image, 10, fit: :loose)
      iex> {tight.width, tight.height, loose.width, loose.height}
      {133, 214, 223, 223}
  """
  @spec rotate(Image.t(), number(), keyword()) :: Image.result()
  defdelegate rotate(image, degrees, opts \\ []), to: Geometry

  @doc """
  Transforms an image by a 2x3 matrix `[a, b, tx, c, d, ty]` that maps a source pixel `{x, y}` to
  `{a x + b y + tx, c x + d y + ty}` (OpenCV's warpAffine). `width:` and `height:` of the result default to the source's
  size.

  #{Situ.Options.docs(Geometry.warp_schema())}

      iex> image = Situ.Image.new!(width: 2, height: 1, format: :gray8, data: <<5, 7>>)
      iex> Situ.ImageOps.warp_affine!(image, [1, 0, 1, 0, 1, 0]).data
      <<0, 5>>
  """
  @spec warp_affine(Image.t(), [number()], keyword()) :: Image.result()
  defdelegate warp_affine(image, matrix, opts \\ []), to: Geometry

  @doc """
  Transforms an image like `warp_affine/3`, but by a 3x3 matrix (nine numbers) in homogeneous coordinates.

      iex> image = Situ.Image.new!(width: 2, height: 1, format: :gray8, data: <<5, 7>>)
      iex> Situ.ImageOps.warp_perspective!(image, [1, 0, 1, 0, 1, 0, 0, 0, 1]).data
      <<0, 5>>
  """
  @spec warp_perspective(Image.t(), [number()], keyword()) :: Image.result()
  defdelegate warp_perspective(image, matrix, opts \\ []), to: Geometry

  @doc """
  Copies `part` over `image` with its top left corner at `{x, y}` and clips parts outside the image. Both need the same
  format. With `mask:`, a `:gray8` image of the size of `part`, only pixels where the mask is not 0 are copied.

      iex> image = Situ.Image.new_filled(3, 1, :gray8, 1)
      iex> {:ok, pasted} = Situ.ImageOps.paste(image, Situ.Image.new_filled(2, 1, :gray8, 8), {2, 0})
      iex> pasted.data
      <<1, 1, 8>>
  """
  @spec paste(Image.t(), Image.t(), {integer(), integer()}, keyword()) :: Image.result()
  defdelegate paste(image, part, place, opts \\ []), to: Geometry

  # Pixels
  @doc """
  Converts an image to another format. Gray is `(4897 R + 9617 G + 1868 B) >> 14`, so white becomes 254. 8 bits are
  widened by `v * 257`, and 16 bits are narrowed by `v >> 8`. A missing alpha channel becomes opaque.

      iex> red = Situ.Image.new_filled(1, 1, :rgb24, [255, 0, 0])
      iex> for format <- [:gray8, :bgr24, :bgra32, :rgba64], do: Situ.ImageOps.convert!(red, format).data
      [<<76>>, <<0, 0, 255>>, <<0, 0, 255, 255>>, <<255, 255, 0, 0, 0, 0, 255, 255>>]
  """
  @spec convert(Image.t(), Image.Format.t()) :: Image.result()
  defdelegate convert(image, format), to: Pixels

  @doc """
  Inverts every channel to 255 - v (65535 - v for 16 bit). Alpha and unused channels are unchanged.

      iex> Situ.ImageOps.invert!(Situ.Image.new_filled(1, 1, :bgra32, [0, 1, 255, 40])).data
      <<255, 254, 0, 40>>
  """
  @spec invert(Image.t()) :: Image.result()
  defdelegate invert(image), to: Pixels

  @doc """
  Compares every channel (including alpha) with `threshold`:
  `:binary` v > t ? max : 0, `:binary_inverted` v > t ? 0 : max, `:truncate` v > t ? t : v, `:to_zero` v > t ? v : 0,
  `:to_zero_inverted` v > t ? 0 : v. `max` defaults to the format's largest value.

      iex> image = Situ.Image.new!(width: 3, height: 1, format: :gray8, data: <<9, 10, 11>>)
      iex> for kind <- [:binary, :binary_inverted, :truncate, :to_zero, :to_zero_inverted],
      ...>     do: Situ.ImageOps.threshold!(image, 10, kind).data
      [<<0, 0, 255>>, <<255, 255, 0>>, <<9, 10, 10>>, <<0, 0, 11>>, <<9, 10, 0>>]
  """
  @spec threshold(Image.t(), non_neg_integer(), atom(), keyword()) :: Image.result()
  defdelegate threshold(image, threshold, kind \\ :binary, opts \\ []), to: Pixels

  @doc """
  Extracts one channel as grayscale of the same depth, by its position in memory (0 is blue in `:bgr24`) or its name.

      iex> Situ.ImageOps.extract_channel!(Situ.Image.new_filled(1, 1, :bgr24, [1, 2, 3]), :red).data
      <<3>>
  """
  @spec extract_channel(Image.t(), non_neg_integer() | atom()) :: Image.result()
  defdelegate extract_channel(image, channel), to: Pixels

  @doc """
  Computes |a - b| for every channel of two images of the same size and format.

      iex> {a, b} = {Situ.Image.new_filled(1, 1, :gray8, 3), Situ.Image.new_filled(1, 1, :gray8, 10)}
      iex> Situ.ImageOps.absdiff!(a, b).data
      <<7>>
  """
  @spec absdiff(Image.t(), Image.t()) :: Image.result()
  defdelegate absdiff(a, b), to: Pixels

  @doc """
  Convolves a grayscale image with a small kernel of integers (a list of rows; kernels of odd size have a center). The
  result is the sum over the taps inside the image, divided by the **number of these taps** (not by their sum),
  truncated and clipped. This is \\\\psi's rule.

      iex> image = Situ.Image.new!(width: 3, height: 1, format: :gray8, data: <<10, 20, 40>>)
      iex> Situ.ImageOps.convolve!(image, [[1, 1, 1]]).data
      <<15, 23, 30>>
  """
  @spec convolve(Image.t(), [[integer()]]) :: Image.result()
  defdelegate convolve(image, kernel), to: Pixels

  @doc """
  Renders depth as color: `near` meters is blue and `far` is red. Pixels outside this range or equal to `invalid:`
  (default 0) are black, or transparent with `transparent: true`. The result is `:bgra32`.

      iex> depth = Situ.DepthImage.new!(width: 3, height: 1, data: <<0::16, 500::little-16, 2000::little-16>>)
      iex> {:ok, colored} = Situ.ImageOps.pseudo_colorize(depth, {0.5, 2.0})
      iex> colored.data
      <<0, 0, 0, 255, 255, 0, 0, 255, 0, 0, 255, 255>>
  """
  @spec pseudo_colorize(DepthImage.t(), {number(), number()}, keyword()) :: Image.result()
  defdelegate pseudo_colorize(depth, range_m, opts \\ []), to: Pixels

  # Filters
  @doc """
  Applies a Gaussian blur. `size` is the odd side of the window; `nil` covers 3 standard deviations on each side
  (sigma 1.4: 9).

      iex> Situ.ImageOps.blur!(Situ.Image.new_filled(8, 8, :gray8, 100), 1.4) |> Situ.Image.fetch_pixel(4, 4)
      {:ok, [100]}
  """
  @spec blur(Image.t(), number(), keyword()) :: Image.result()
  defdelegate blur(image, sigma, opts \\ []), to: Filter

  @doc """
  Replaces each pixel with the mean of a window of `size` x `size` pixels. `size` must be odd.

      iex> dot = Situ.Image.new!(width: 5, height: 1, format: :gray8, data: <<0, 0, 90, 0, 0>>)
      iex> Situ.ImageOps.box_blur!(dot, 3).data
      <<0, 30, 30, 30, 0>>
  """
  @spec box_blur(Image.t(), pos_integer()) :: Image.result()
  defdelegate box_blur(image, size), to: Filter

  @doc """
  Replaces each pixel with the median of a window of `size` x `size` pixels. `size` must be odd. Sizes above 5 need an
  8-bit format.

      iex> dot = Situ.Image.new!(width: 5, height: 1, format: :gray8, data: <<0, 0, 90, 0, 0>>)
      iex> Situ.ImageOps.median_blur!(dot, 3).data
      <<0, 0, 0, 0, 0>>
  """
  @spec median_blur(Image.t(), pos_integer()) :: Image.result()
  defdelegate median_blur(image, size), to: Filter

  @doc """
  Detects Canny edges in a `:gray8` image: 255 on an edge, else 0. `low` and `high` are the hysteresis thresholds.

      iex> step = Situ.ImageOps.fill_rectangle!(Situ.Image.new_filled(8, 8, :gray8), {4, 0, 4, 8}, color: 200)
      iex> step |> Situ.ImageOps.canny!(60, 120) |> Situ.ImageOps.crop!({0, 4, 8, 1}) |> Situ.Image.pixel_bytes()
      <<0, 0, 0, 255, 0, 0, 0, 0>>
  """
  @spec canny(Image.t(), number(), number()) :: Image.result()
  defdelegate canny(image, low, high), to: Filter

  @doc """
  Computes the edge strength of a `:gray8` image as the mean of the two absolute Sobel 3x3 derivatives. Each derivative
  is clipped at 255 first (as with OpenCV's `convertScaleAbs` and `addWeighted` in 8 bits).

      iex> step = Situ.ImageOps.fill_rectangle!(Situ.Image.new_filled(8, 8, :gray8), {4, 0, 4, 8}, color: 200)
      iex> step |> Situ.ImageOps.sobel!() |> Situ.ImageOps.crop!({0, 4, 8, 1}) |> Situ.Image.pixel_bytes()
      <<0, 0, 0, 128, 128, 0, 0, 0>>
  """
  @spec sobel(Image.t()) :: Image.result()
  defdelegate sobel(image), to: Filter

  @doc """
  Replaces each pixel with the minimum of a window of `size` x `size` pixels. `size` must be odd.

      iex> hole = Situ.Image.new!(width: 5, height: 1, format: :gray8, data: <<90, 90, 0, 90, 90>>)
      iex> Situ.ImageOps.erode!(hole, 3).data
      <<90, 0, 0, 0, 90>>
  """
  @spec erode(Image.t(), pos_integer()) :: Image.result()
  defdelegate erode(image, size), to: Filter

  @doc """
  Replaces each pixel with the maximum of a window of `size` x `size` pixels. `size` must be odd.

      iex> dot = Situ.Image.new!(width: 5, height: 1, format: :gray8, data: <<0, 0, 90, 0, 0>>)
      iex> Situ.ImageOps.dilate!(dot, 3).data
      <<0, 90, 90, 90, 0>>
  """
  @spec dilate(Image.t(), pos_integer()) :: Image.result()
  defdelegate dilate(image, size), to: Filter

  @doc """
  Erodes and then dilates the image, which removes specks.

      iex> dot = Situ.Image.new!(width: 5, height: 1, format: :gray8, data: <<0, 0, 90, 0, 0>>)
      iex> Situ.ImageOps.open!(dot, 3).data
      <<0, 0, 0, 0, 0>>
  """
  @spec open(Image.t(), pos_integer()) :: Image.result()
  defdelegate open(image, size), to: Filter

  @doc """
  Dilates and then erodes the image, which fills holes.

      iex> hole = Situ.Image.new!(width: 5, height: 1, format: :gray8, data: <<90, 90, 0, 90, 90>>)
      iex> Situ.ImageOps.close!(hole, 3).data
      <<90, 90, 90, 90, 90>>
  """
  @spec close(Image.t(), pos_integer()) :: Image.result()
  defdelegate close(image, size), to: Filter

  @doc """
  Equalizes the histogram of a `:gray8` image.

      iex> image = Situ.Image.new!(width: 4, height: 1, format: :gray8, data: <<10, 11, 12, 12>>)
      iex> Situ.ImageOps.equalize!(image).data
      <<0, 85, 255, 255>>
  """
  @spec equalize(Image.t()) :: Image.result()
  defdelegate equalize(image), to: Filter

  # Drawing
  @doc """
  Draws several shapes in order on one copy of the image.

  | shape | drawn | options |
  |---|---|---|
  | `{:line, {x, y}, {x, y}, opts}` | a line, both ends included | `color:`, `width:` |
  | `{:rectangle, rect, opts}` | `Situ.Rect` or `{x, y, width, height}`; the outline on its outermost pixels | `color:`, `width:` |
  | `{:fill_rectangle, rect, opts}` | its inside | `color:` |
  | `{:circle, {x, y}, radius, opts}` | outline centred on its edge | `color:`, `width:` |
  | `{:fill_circle, {x, y}, radius, opts}` | a disc, as large as the outline of width 1 | `color:` |
  | `{:text, {x, y}, string, opts}` | top left corner of the first line's capitals | `color:`, `size:`, `font:`, `background:` |

      iex> image = Situ.Image.new_filled(5, 5, :gray8)
      iex> {:ok, drawn} = Situ.ImageOps.draw(image, [{:fill_rectangle, {1, 1, 3, 3}, color: 9}])
      iex> for y <- 0..2, do: Situ.Image.fetch_pixel(drawn, 2, y)
      [{:ok, [0]}, {:ok, [9]}, {:ok, [9]}]

  `{x, y}` is the center of a pixel. `color:` is a color as described in `Situ.Image` (default `:red`), and `width:` is
  the line width in pixels (1 or more, default 1). Lines, circles and text are anti-aliased: straight lines of odd width
  have sharp edges, and lines of even width have half the color in their outer rows. Rectangles are aligned to complete
  pixels. Positions may be outside the image by up to 1,000,000 pixels; parts outside the image are clipped.

  Text may be any Unicode text (with marks, ligatures and right-to-left scripts), in lines separated by `\\n`:

    * `size:` height of a capital letter in pixels, 1 to 2000 (default 16)
    * `font:` the path of a TrueType or OpenType file, or a list of paths. Each character uses the first font that
      covers it. DejaVu Sans, which is included in Situ and is the default, is the fallback; it covers Latin, Greek,
      Cyrillic, Hebrew, Arabic and more, but not Chinese, Japanese or Korean. Characters that no font covers are drawn
      as a box. A file that is not a font is the error `:bad_font`.
    * `background:` color of a box under the text, 2 pixels larger on each side (default none)

  Color fonts (emoji) have no outlines to draw, so only monochrome fonts work.
  """
  @spec draw(Image.t(), [tuple()]) :: Image.result()
  defdelegate draw(image, shapes), to: Drawing

  @doc """
  Draws a line between two points. Takes the options of `:line` (`draw/2`).

      iex> Situ.ImageOps.draw_line!(Situ.Image.new_filled(5, 3, :gray8), {1, 1}, {3, 1}, color: 9).data
      <<0, 0, 0, 0, 0, 0, 9, 9, 9, 0, 0, 0, 0, 0, 0>>
  """
  @spec draw_line(Image.t(), point(), point(), keyword()) :: Image.result()
  defdelegate draw_line(image, from, to, opts \\ []), to: Drawing

  @doc """
  Draws the outline of a rectangle. Takes the options of `:rectangle` (`draw/2`).

      iex> Situ.ImageOps.draw_rectangle!(Situ.Image.new_filled(4, 3, :gray8), {0, 0, 3, 3}, color: 9).data
      <<9, 9, 9, 0, 9, 0, 9, 0, 9, 9, 9, 0>>
  """
  @spec draw_rectangle(Image.t(), rect(), keyword()) :: Image.result()
  defdelegate draw_rectangle(image, rect, opts \\ []), to: Drawing

  @doc """
  Fills a rectangle. Takes the option `color:` (`draw/2`).

      iex> Situ.ImageOps.fill_rectangle!(Situ.Image.new_filled(4, 3, :gray8), {1, 1, 2, 2}, color: 9).data
      <<0, 0, 0, 0, 0, 9, 9, 0, 0, 9, 9, 0>>
  """
  @spec fill_rectangle(Image.t(), rect(), keyword()) :: Image.result()
  defdelegate fill_rectangle(image, rect, opts \\ []), to: Drawing

  @doc """
  Draws the outline of a circle. Takes the options of `:circle` (`draw/2`).

      iex> image = Situ.Image.new_filled(21, 21, :gray8)
      iex> {:ok, image} = Situ.ImageOps.draw_circle(image, {10, 10}, 8, color: 200, width: 3)
      iex> for x <- [10, 18], do: Situ.Image.fetch_pixel(image, x, 10)
      [{:ok, [0]}, {:ok, [200]}]
  """
  @spec draw_circle(Image.t(), point(), number(), keyword()) :: Image.result()
  defdelegate draw_circle(image, center, radius, opts \\ []), to: Drawing

  @doc """
  Fills a circle. Takes the option `color:` (`draw/2`).

      iex> {:ok, image} = Situ.ImageOps.fill_circle(Situ.Image.new_filled(21, 21, :gray8), {10, 10}, 8, color: 200)
      iex> for x <- [10, 20], do: Situ.Image.fetch_pixel(image, x, 10)
      [{:ok, [200]}, {:ok, [0]}]
  """
  @spec fill_circle(Image.t(), point(), number(), keyword()) :: Image.result()
  defdelegate fill_circle(image, center, radius, opts \\ []), to: Drawing

  @doc """
  Draws text with the top left corner of its capital letters at a point. Takes the options of `:text` (`draw/2`).

      iex> paper = Situ.Image.new_filled(90, 30, :gray8)
      iex> {:ok, image} = Situ.ImageOps.draw_text(paper, {4, 6}, "Ωmega, ça", size: 14, color: :white)
      iex> {:ok, %{gray: ink}} = Situ.ImageOps.statistics(image)
      iex> ink.max
      254
  """
  @spec draw_text(Image.t(), point(), String.t(), keyword()) :: Image.result()
  defdelegate draw_text(image, at, text, opts \\ []), to: Drawing

  @doc """
  Draws boxes for detections, with label and score above them and a separate color for each label. Options: `width:` of
  the lines (2), and `size:` and `font:` of the labels (14, the default font).

      iex> face = Situ.Rect.new!(x: 30, y: 30, width: 20, height: 20, label: "Zoë", score: 0.9)
      iex> {:ok, image} = Situ.ImageOps.draw_detections(Situ.Image.new_filled(80, 60, :bgr24), [face])
      iex> Situ.Image.fetch_pixel(image, 30, 40) == {:ok, [0, 0, 0]}
      false
  """
  @spec draw_detections(Image.t(), [Rect.t()], keyword()) :: Image.result()
  defdelegate draw_detections(image, rects, opts \\ []), to: Drawing

  @doc """
  Returns the width and height of text in pixels: the width of the widest line, and the height from the top of the first
  line's capital letters to the bottom of the last line. Takes the drawing options `size:` and `font:`.

      iex> {:ok, {width, height}} = Situ.ImageOps.text_size("three\\nlines\\nof text", size: 20)
      iex> {width > 60 and width < 110, height > 80 and height < 100}
      {true, true}
  """
  @spec text_size(String.t(), keyword()) :: {:ok, {float(), float()}} | {:error, Error.t()}
  defdelegate text_size(text, opts \\ []), to: Drawing

  # Measurements
  @doc """
  Returns the minimum, maximum, mean and standard deviation (of the population) of each channel, by name. `rect:`
  restricts it to a part.

      iex> image = Situ.Image.new!(width: 2, height: 1, format: :gray8, data: <<10, 20>>)
      iex> Situ.ImageOps.statistics(image)
      {:ok, %{gray: %{min: 10, max: 20, mean: 15.0, deviation: 5.0}}}
  """
  @spec statistics(Image.t(), keyword()) ::
          {:ok, %{atom() => channel_statistics()}} | {:error, Error.t()}
  defdelegate statistics(image, opts \\ []), to: Measure

  @doc """
  Returns the mean of each channel, by name. `rect:` restricts it to a part.

      iex> Situ.ImageOps.average_color(Situ.Image.new_filled(2, 2, :bgr24, [1, 2, 3]))
      {:ok, %{blue: 1.0, green: 2.0, red: 3.0}}
  """
  @spec average_color(Image.t(), keyword()) :: {:ok, %{atom() => float()}} | {:error, Error.t()}
  defdelegate average_color(image, opts \\ []), to: Measure

  @doc """
  Counts how often each value occurs, with 256 counts per channel (16-bit values by their high byte). `rect:` restricts
  it to a part.

      iex> {:ok, %{gray: counts}} = Situ.ImageOps.histogram(Situ.Image.new_filled(2, 2, :gray8, 3))
      iex> Enum.take(counts, 5)
      [0, 0, 0, 4, 0]
  """
  @spec histogram(Image.t(), keyword()) ::
          {:ok, %{atom() => [non_neg_integer()]}} | {:error, Error.t()}
  defdelegate histogram(image, opts \\ []), to: Measure

  @doc """
  Compares two images of the same size and format. Returns the largest and mean difference of channel values, and the
  fraction of values that differ by more than `tolerance:` (default 0). `equal?` is true if that fraction is at most
  `outliers:` (default 0).

      iex> {a, b} = {Situ.Image.new_filled(2, 1, :gray8, 3), Situ.Image.new_filled(2, 1, :gray8, 5)}
      iex> Situ.ImageOps.compare(a, b, tolerance: 2)
      {:ok, %{equal?: true, max: 2, mean: 2.0, outliers: 0.0}}
  """
  @spec compare(Image.t(), Image.t(), keyword()) ::
          {:ok, %{equal?: boolean(), max: integer(), mean: float(), outliers: float()}}
          | {:error, Error.t()}
  defdelegate compare(a, b, opts \\ []), to: Measure

  @doc """
  Converts an image to 32-bit floats for a model: `value * scale + offset`, red first, without alpha.

  `layout:` is `:nhwc` (default) or `:nchw`, `scale:` defaults to 1/255 (1/65535 for 16 bit), and `offset:` to 0.0.
  Returns a binary of native floats and its shape.

      iex> {:ok, {data, shape}} = Situ.ImageOps.to_f32(Situ.Image.new_filled(1, 1, :bgr24, [0, 51, 255]))
      iex> {shape, for(<<v::float-native-32 <- data>>, do: Float.round(v, 3))}
      {{1, 1, 1, 3}, [1.0, 0.2, 0.0]}
  """
  @spec to_f32(Image.t(), keyword()) :: {:ok, {binary(), tuple()}} | {:error, Error.t()}
  defdelegate to_f32(image, opts \\ []), to: Measure

  # Files
  @doc """
  Encodes an image in an 8-bit format as JPEG (libjpeg-turbo), without its alpha channel.

  #{Situ.Options.docs(Files.jpeg_schema())}

      iex> {:ok, jpeg} = Situ.ImageOps.encode_jpeg(Situ.Image.new_filled(16, 8, :bgr24, [0, 128, 255]))
      iex> {jpeg.format, jpeg.width, jpeg.height}
      {:jpeg, 16, 8}
      iex> {:error, error} = Situ.ImageOps.encode_jpeg(Situ.Image.new_filled(2, 2, :gray16))
      iex> error.code
      :bad_format
  """
  @spec encode_jpeg(Image.t(), keyword()) :: {:ok, EncodedImage.t()} | {:error, Error.t()}
  defdelegate encode_jpeg(image, opts \\ []), to: Files

  @doc """
  Encodes an image as lossless PNG with 8 or 16 bits. `level:` is `:fast`, `:balanced` (default) or `:small`. The unused
  channel of `:bgrx32` is dropped.

      iex> image = Situ.Image.new_filled(3, 2, :gray16, 1234)
      iex> {:ok, png} = Situ.ImageOps.encode_png(image)
      iex> Situ.ImageOps.parse(png)
      {:ok, image}
  """
  @spec encode_png(Image.t() | DepthImage.t(), keyword()) ::
          {:ok, EncodedImage.t()} | {:error, Error.t()}
  defdelegate encode_png(image, opts \\ []), to: Files

  @doc """
  Decodes JPEG or PNG bytes (`Situ.EncodedImage` or a binary).

  A JPEG is decoded to `:bgr24` or `:gray8`, depending on the file, or to `format:` (any 8-bit format). A PNG is decoded
  to `:gray8`, `:gray16`, `:rgb24`, `:rgba32` or `:rgba64`, depending on the file, and converted if `format:` is given.
  A truncated or corrupt file is the error `:bad_jpeg` or `:bad_png`. Memory for the size in a header is allocated only
  if the bytes could contain such an image, and never more than `Situ.Image.max_bytes/0`.

      iex> {:error, error} = Situ.ImageOps.parse(<<0xFF, 0xD8, 0xFF, 0xE0, 0>>)
      iex> error.code
      :bad_jpeg
  """
  @spec parse(EncodedImage.t() | binary(), keyword()) :: Image.result()
  defdelegate parse(encoded, opts \\ []), to: Files

  @doc """
  Decodes a depth image from a 16-bit grayscale PNG. For `semantics:` and `scale:`, see `Situ.DepthImage`.
  """
  @spec decode_depth(EncodedImage.t() | binary(), keyword()) :: DepthImage.result()
  defdelegate decode_depth(encoded, opts \\ []), to: Files

  @doc """
  Reads a JPEG or PNG file. The format is detected from the content, not the file name.

      iex> {:error, error} = Situ.ImageOps.read("no/such/file.png")
      iex> error.code
      :unreadable
  """
  @spec read(Path.t(), keyword()) :: Image.result()
  defdelegate read(path, opts \\ []), to: Files

  @doc "Writes an image file in the format of the extension `.jpg`, `.jpeg` or `.png`, with options of the encoder."
  @spec write(Image.t(), Path.t(), keyword()) :: :ok | {:error, Error.t()}
  defdelegate write(image, path, opts \\ []), to: Files

  @doc """
  Builds an image from raw pixels without padding: exactly `width * height` pixels of `format`.

      iex> {:ok, image} = Situ.ImageOps.from_raw(<<1, 2, 3, 4>>, 2, 2, :gray8)
      iex> image.stride
      2
      iex> {:error, error} = Situ.ImageOps.from_raw(<<1, 2, 3, 4>>, 2, 2, :gray16)
      iex> error.code
      :bad_image
  """
  @spec from_raw(binary(), pos_integer(), pos_integer(), Image.Format.t()) :: Image.result()
  defdelegate from_raw(bytes, width, height, format), to: Files

  @doc """
  Converts a raw frame from a camera or decoder to a `:bgr24` image. The layout is `:nv12` or `:i420` (both sides even),
  or `:yuyv` (even width), in BT.601 with luma 16..235 and rows without padding.

      iex> {:ok, image} = Situ.ImageOps.from_yuv(<<235, 128, 16, 128>>, 2, 1, :yuyv)
      iex> image.data
      <<255, 255, 255, 0, 0, 0>>
      iex> {:error, error} = Situ.ImageOps.from_yuv("short", 640, 480, :nv12)
      iex> error.code
      :bad_image
  """
  @spec from_yuv(binary(), pos_integer(), pos_integer(), :nv12 | :i420 | :yuyv) :: Image.result()
  defdelegate from_yuv(bytes, width, height, layout), to: Files

  @twins ~w(crop resize scale letterbox flip rotate warp_affine warp_perspective paste convert invert threshold
            extract_channel absdiff convolve pseudo_colorize blur box_blur median_blur canny sobel erode dilate open
            close equalize draw draw_line draw_rectangle fill_rectangle draw_circle fill_circle draw_text
            draw_detections text_size statistics average_color histogram compare to_f32 encode_jpeg encode_png parse
            decode_depth read from_raw from_yuv)a

  for {name, arity} <- Module.definitions_in(__MODULE__, :def), name in @twins do
    args = Macro.generate_arguments(arity, __MODULE__)

    @doc "Calls `#{name}/#{arity}` and returns the value or raises the `Situ.Error`."
    @spec unquote(:"#{name}!")(unquote_splicing(List.duplicate(quote(do: term()), arity))) ::
            term()
    def unquote(:"#{name}!")(unquote_splicing(args)),
      do: Error.unwrap!(unquote(name)(unquote_splicing(args)))
  end
end
