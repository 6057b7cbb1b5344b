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

  | subject | functions | details |
  |---|---|---|
  | geometry | `crop` `resize` `scale` `letterbox` `flip` `rotate` `warp_affine` `warp_perspective` `paste` | `Situ.ImageOps.Geometry` |
  | pixels | `convert` `invert` `threshold` `extract_channel` `absdiff` `convolve` `pseudo_colorize` | `Situ.ImageOps.Pixels` |
  | neighbourhoods | `blur` `box_blur` `median_blur` `canny` `sobel` `erode` `dilate` `open` `close` `equalize` | `Situ.ImageOps.Filter` |
  | drawing | `draw` `draw_line` `draw_rectangle` `draw_circle` `draw_text` `draw_detections` `text_size` ... | `Situ.ImageOps.Drawing` |
  | measurements | `statistics` `average_color` `histogram` `compare` `to_f32` | `Situ.ImageOps.Measure` |
  | files | `read` `write` `parse` `encode_jpeg` `encode_png` `decode_depth` `from_raw` `from_yuv` | `Situ.ImageOps.Files` |
  """
  alias Situ.ImageOps.{Drawing, Files, Filter, Geometry, Measure, Pixels}

  # Geometry
  defdelegate crop(image, rect, opts \\ []), to: Geometry
  defdelegate resize(image, width, height, opts \\ []), to: Geometry
  defdelegate scale(image, sx, sy, opts \\ []), to: Geometry
  defdelegate letterbox(image, width, height, opts \\ []), to: Geometry
  defdelegate letterbox_rect(from_width, from_height, width, height), to: Geometry
  defdelegate flip(image, axis), to: Geometry
  defdelegate rotate(image, degrees, opts \\ []), to: Geometry
  defdelegate warp_affine(image, matrix, opts \\ []), to: Geometry
  defdelegate warp_perspective(image, matrix, opts \\ []), to: Geometry
  defdelegate paste(image, part, place, opts \\ []), to: Geometry

  # Pixels
  defdelegate convert(image, format), to: Pixels
  defdelegate invert(image), to: Pixels
  defdelegate threshold(image, threshold, kind \\ :binary, opts \\ []), to: Pixels
  defdelegate extract_channel(image, channel), to: Pixels
  defdelegate absdiff(a, b), to: Pixels
  defdelegate convolve(image, kernel), to: Pixels
  defdelegate pseudo_colorize(depth, range_m, opts \\ []), to: Pixels

  # Filters
  defdelegate blur(image, sigma, opts \\ []), to: Filter
  defdelegate box_blur(image, size), to: Filter
  defdelegate median_blur(image, size), to: Filter
  defdelegate canny(image, low, high), to: Filter
  defdelegate sobel(image), to: Filter
  defdelegate erode(image, size), to: Filter
  defdelegate dilate(image, size), to: Filter
  defdelegate open(image, size), to: Filter
  defdelegate close(image, size), to: Filter
  defdelegate equalize(image), to: Filter

  # Drawing
  defdelegate draw(image, shapes), to: Drawing
  defdelegate draw_line(image, from, to, opts \\ []), to: Drawing
  defdelegate draw_rectangle(image, rect, opts \\ []), to: Drawing
  defdelegate fill_rectangle(image, rect, opts \\ []), to: Drawing
  defdelegate draw_circle(image, center, radius, opts \\ []), to: Drawing
  defdelegate fill_circle(image, center, radius, opts \\ []), to: Drawing
  defdelegate draw_text(image, at, text, opts \\ []), to: Drawing
  defdelegate draw_detections(image, rects, opts \\ []), to: Drawing
  defdelegate text_size(text, opts \\ []), to: Drawing

  # Measurements
  defdelegate statistics(image, opts \\ []), to: Measure
  defdelegate average_color(image, opts \\ []), to: Measure
  defdelegate histogram(image, opts \\ []), to: Measure
  defdelegate compare(a, b, opts \\ []), to: Measure
  defdelegate to_f32(image, opts \\ []), to: Measure

  # Files
  defdelegate encode_jpeg(image, opts \\ []), to: Files
  defdelegate encode_png(image, opts \\ []), to: Files
  defdelegate parse(encoded, opts \\ []), to: Files
  defdelegate decode_depth(encoded, opts \\ []), to: Files
  defdelegate read(path, opts \\ []), to: Files
  defdelegate write(image, path, opts \\ []), to: Files
  defdelegate from_raw(bytes, width, height, format), to: Files
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
      do: Situ.Error.unwrap!(unquote(name)(unquote_splicing(args)))
  end
end
