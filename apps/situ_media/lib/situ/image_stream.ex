defmodule Situ.ImageStream do
  @moduledoc """
  Operators on streams of images: resize, crop, convert, filter, draw, measure, encode and decode.

  Every function takes a stream of `Situ.Image` first and returns a stream. `Situ.ImageOps` documents the same
  operations for single images, with the same names and options. Originating times do not change.

      def build(p, _opts) do
        camera = Situ.Media.Camera.open(p, size: {1280, 720})

        camera
        |> Situ.ImageStream.resize(640, 360)
        |> Situ.ImageStream.convert(:gray8)
        |> Situ.ImageStream.canny(60, 120)
        |> Situ.ImageStream.encode_jpeg(quality: 80)
      end

  A chain of these operators runs in one process, and only the last image is sent on. All operators also take the common
  options `name:`, `policy:`, `async:` and `on_error:`. If an operator cannot process an image (a crop outside it, an
  invalid format), it raises its `Situ.Error` inside the component, so `on_error: :skip` skips the image.

      iex> image = Situ.Image.new_filled(4, 2, :bgr24, [0, 0, 255])
      iex> Situ.to_list(fn p ->
      ...>   p
      ...>   |> Situ.repeat(image, every: 10, count: 2)
      ...>   |> Situ.ImageStream.convert(:gray8)
      ...>   |> Situ.ImageStream.resize(2, 1)
      ...> end)
      [Situ.Image.new_filled(2, 1, :gray8, 76), Situ.Image.new_filled(2, 1, :gray8, 76)]
  """
  # Images and streams have two facades with the same names. A single function that inspects its
  # argument, or a protocol, would hide whether a call returns a result or a stream. The functions
  # that add nothing are generated from tables, which are easier to read than macros.
  alias Situ.Graph.Placement
  alias Situ.{DepthImage, EncodedImage, Error, Image, Operator, Stream}
  alias Situ.ImageOps.{Drawing, Files, Filter, Geometry, Measure, Pixels}
  alias Situ.ImageStream.OperatorExamples

  # Each row has the function, its arguments after the image, its module, and the output type.
  @operators [
    {:resize, [:width, :height], Geometry, Image},
    {:scale, [:sx, :sy], Geometry, Image},
    {:letterbox, [:width, :height], Geometry, Image},
    {:rotate, [:degrees], Geometry, Image},
    {:warp_affine, [:matrix], Geometry, Image},
    {:warp_perspective, [:matrix], Geometry, Image},
    {:paste, [:part, :place], Geometry, Image},
    {:threshold, [:threshold, :kind], Pixels, Image},
    {:pseudo_colorize, [:range_m], Pixels, Image},
    {:blur, [:sigma], Filter, Image},
    {:draw_line, [:from, :to], Drawing, Image},
    {:draw_rectangle, [:rect], Drawing, Image},
    {:fill_rectangle, [:rect], Drawing, Image},
    {:draw_circle, [:center, :radius], Drawing, Image},
    {:fill_circle, [:center, :radius], Drawing, Image},
    {:draw_text, [:at, :text], Drawing, Image},
    {:statistics, [], Measure, :map},
    {:average_color, [], Measure, :map},
    {:histogram, [], Measure, :map},
    {:encode_jpeg, [], Files, EncodedImage},
    {:encode_png, [], Files, EncodedImage},
    {:decode_depth, [], Files, DepthImage}
  ]

  # Functions without options.
  @plain [
    {:flip, [:axis], Geometry},
    {:convert, [:format], Pixels},
    {:invert, [], Pixels},
    {:extract_channel, [:channel], Pixels},
    {:convolve, [:kernel], Pixels},
    {:box_blur, [:size], Filter},
    {:median_blur, [:size], Filter},
    {:canny, [:low, :high], Filter},
    {:sobel, [], Filter},
    {:erode, [:size], Filter},
    {:dilate, [:size], Filter},
    {:open, [:size], Filter},
    {:close, [:size], Filter},
    {:equalize, [], Filter},
    {:draw, [:shapes], Drawing}
  ]

  for {name, args, module, type} <- @operators do
    vars = Enum.map(args, &Macro.var(&1, __MODULE__))
    label = name |> Atom.to_string() |> String.replace("_", " ") |> String.capitalize()

    @doc """
    Applies `Situ.ImageOps.#{name}/#{length(args) + 2}` to each image.

    #{OperatorExamples.format_example(name)}
    """
    @spec unquote(name)(
            unquote_splicing([
              quote(do: Stream.t()) | Enum.map(args, fn _ -> quote(do: term()) end)
            ]),
            keyword()
          ) ::
            Stream.t()
    def unquote(name)(stream, unquote_splicing(vars), opts \\ []) do
      {placed, opts} = Placement.split_unchecked(opts, :operator)
      fun = &Error.unwrap!(unquote(module).unquote(name)(&1, unquote_splicing(vars), opts))
      Operator.attach(stream, unquote(label), {:map, fun}, placed, unquote(type))
    end
  end

  for {name, args, module} <- @plain do
    vars = Enum.map(args, &Macro.var(&1, __MODULE__))
    label = name |> Atom.to_string() |> String.replace("_", " ") |> String.capitalize()

    @doc """
    Applies `Situ.ImageOps.#{name}/#{length(args) + 1}` to each image.

    #{OperatorExamples.format_example(name)}
    """
    @spec unquote(name)(
            unquote_splicing([
              quote(do: Stream.t()) | Enum.map(args, fn _ -> quote(do: term()) end)
            ]),
            keyword()
          ) ::
            Stream.t()
    def unquote(name)(stream, unquote_splicing(vars), opts \\ []) do
      fun = &Error.unwrap!(unquote(module).unquote(name)(&1, unquote_splicing(vars)))
      Operator.attach(stream, unquote(label), {:map, fun}, opts, Image)
    end
  end

  @doc """
  Crops each image to `rect`. With `:paired`, the stream must carry `{image, rect | nil}`, so join images and rectangles
  first. The result is `nil` without a rectangle, or if nothing is left with `clip: true`. Therefore the output type is
  `{:optional, Situ.Image}`, or `{:optional, Situ.DepthImage}` for a stream of depth images.

      iex> {image, rect} = {Situ.Image.new_filled(4, 4, :gray8), Situ.Rect.new!(1, 1, 2, 2)}
      iex> Situ.to_list(fn p ->
      ...>   p |> Situ.repeat({image, rect}, every: 10, count: 1) |> Situ.ImageStream.crop(:paired)
      ...> end)
      [Situ.Image.new_filled(2, 2, :gray8)]
  """
  @spec crop(Stream.t(), Situ.Rect.t() | tuple() | :paired, keyword()) :: Stream.t()
  def crop(stream, rect, opts \\ []) do
    {placed, opts} = Placement.split_unchecked(opts, :operator)

    fun =
      if rect == :paired,
        do: fn {image, rect} -> rect && Error.unwrap!(Geometry.crop(image, rect, opts)) end,
        else: fn image -> Error.unwrap!(Geometry.crop(image, rect, opts)) end

    picture = if depth_type?(stream.type), do: DepthImage, else: Image
    Operator.attach(stream, "Crop", {:map, fun}, placed, {:optional, picture})
  end

  defp depth_type?(DepthImage), do: true
  defp depth_type?({:tuple, [type | _]}), do: depth_type?(type)
  defp depth_type?(_type), do: false

  @doc """
  Converts `:gray16` images to depth images without a copy. For `semantics:` and `scale:`, see `Situ.DepthImage`.

      iex> image = Situ.Image.new_filled(2, 1, :gray16, 1500)
      iex> Situ.to_list(fn p ->
      ...>   p |> Situ.repeat(image, every: 10, count: 1) |> Situ.ImageStream.to_depth(scale: 0.002)
      ...> end)
      [Situ.DepthImage.new!(width: 2, height: 1, data: image.data, scale: 0.002)]
  """
  @spec to_depth(Stream.t(), keyword()) :: Stream.t()
  def to_depth(stream, opts \\ []) do
    {placed, opts} = Placement.split_unchecked(opts, :operator)
    fun = &Error.unwrap!(DepthImage.from_gray16(&1, opts))
    Operator.attach(stream, "To depth", {:map, fun}, placed, DepthImage)
  end

  @doc """
  Converts depth images to `:gray16` images without a copy, for operators that need an image.

      iex> depth = Situ.DepthImage.new!(width: 1, height: 1, data: <<1500::little-16>>)
      iex> Situ.to_list(fn p ->
      ...>   p |> Situ.repeat(depth, every: 10, count: 1) |> Situ.ImageStream.to_gray16()
      ...> end)
      [Situ.Image.new_filled(1, 1, :gray16, 1500)]
  """
  @spec to_gray16(Stream.t(), keyword()) :: Stream.t()
  def to_gray16(stream, opts \\ []),
    do: Operator.attach(stream, "To gray16", {:map, &DepthImage.to_gray16/1}, opts, Image)

  @doc """
  Decodes JPEG or PNG (`Situ.EncodedImage` or binaries) to images (`Situ.ImageOps.parse/2`).

      iex> image = Situ.Image.new_filled(4, 2, :gray8, 7)
      iex> {:ok, png} = Situ.ImageOps.encode_png(image)
      iex> Situ.to_list(fn p -> p |> Situ.repeat(png, every: 10, count: 1) |> Situ.ImageStream.decode() end) == [image]
      true
  """
  @spec decode(Stream.t(), keyword()) :: Stream.t()
  def decode(stream, opts \\ []) do
    {placed, opts} = Placement.split_unchecked(opts, :operator)
    fun = &Error.unwrap!(Files.parse(&1, opts))
    Operator.attach(stream, "Decode", {:map, fun}, placed, Image)
  end

  @doc """
  Detects motion as |a - b| of each image and the previous one. The first image produces no output.

      iex> Situ.to_list(fn p ->
      ...>   p
      ...>   |> Situ.from_enumerable([5, 6, 7], every: 10)
      ...>   |> Situ.map(&Situ.Image.new_filled(2, 1, :gray8, &1), type: Situ.Image)
      ...>   |> Situ.ImageStream.motion()
      ...> end)
      [Situ.Image.new_filled(2, 1, :gray8, 1), Situ.Image.new_filled(2, 1, :gray8, 1)]
  """
  @spec motion(Stream.t(), keyword()) :: Stream.t()
  def motion(stream, opts \\ []) do
    step = fn
      image, _message, nil -> {:skip, image}
      image, _message, last -> {:emit, Error.unwrap!(Pixels.absdiff(image, last)), image}
    end

    Operator.attach(stream, "Motion", {:step, step, nil}, opts, Image)
  end

  @doc """
  Computes |a - b| of two image streams with the same times (`Situ.ImageOps.absdiff/2`).

      iex> {a, b} = {Situ.Image.new_filled(2, 1, :gray8, 3), Situ.Image.new_filled(2, 1, :gray8, 5)}
      iex> once = [every: 10, count: 1]
      iex> Situ.to_list(fn p ->
      ...>   Situ.ImageStream.absdiff(Situ.repeat(p, a, once), Situ.repeat(p, b, once))
      ...> end)
      [Situ.Image.new_filled(2, 1, :gray8, 2)]
  """
  @spec absdiff(Stream.t(), Stream.t(), keyword()) :: Stream.t()
  def absdiff(stream, other, opts \\ []) do
    stream
    |> Situ.join(other)
    |> Operator.attach(
      "Absdiff",
      {:map, fn {a, b} -> Error.unwrap!(Pixels.absdiff(a, b)) end},
      opts,
      Image
    )
  end

  @doc """
  Compares the images of two streams with the same times, as a stream of maps (`Situ.ImageOps.compare/3`).

      iex> {a, b} = {Situ.Image.new_filled(2, 1, :gray8, 3), Situ.Image.new_filled(2, 1, :gray8, 5)}
      iex> once = [every: 10, count: 1]
      iex> Situ.to_list(fn p ->
      ...>   Situ.ImageStream.compare(Situ.repeat(p, a, once), Situ.repeat(p, b, once), tolerance: 1)
      ...> end)
      [%{equal?: false, max: 2, mean: 2.0, outliers: 1.0}]
  """
  @spec compare(Stream.t(), Stream.t(), keyword()) :: Stream.t()
  def compare(stream, other, opts \\ []) do
    {placed, opts} = Placement.split_unchecked(opts, :operator)
    fun = fn {a, b} -> Error.unwrap!(Measure.compare(a, b, opts)) end
    stream |> Situ.join(other) |> Operator.attach("Compare", {:map, fun}, placed, :map)
  end

  @doc """
  Draws labeled boxes on each image of a stream of `{image, [Situ.Rect]}`.

      iex> image = Situ.Image.new_filled(8, 8, :gray8)
      iex> [drawn] = Situ.to_list(fn p ->
      ...>   p
      ...>   |> Situ.repeat({image, [Situ.Rect.new!(0, 0, 6, 6)]}, every: 10, count: 1)
      ...>   |> Situ.ImageStream.draw_detections(width: 1)
      ...> end)
      iex> drawn == image
      false
  """
  @spec draw_detections(Stream.t(), keyword()) :: Stream.t()
  def draw_detections(stream, opts \\ []) do
    {placed, opts} = Placement.split_unchecked(opts, :operator)
    fun = fn {image, rects} -> Error.unwrap!(Drawing.draw_detections(image, rects, opts)) end
    Operator.attach(stream, "Draw detections", {:map, fun}, placed, Image)
  end

  @doc """
  Applies a function to each image. It returns `{:ok, image}`, `{:error, error}` or the image itself.

      iex> image = Situ.Image.new_filled(2, 1, :gray8, 55)
      iex> Situ.to_list(fn p ->
      ...>   p
      ...>   |> Situ.repeat(image, every: 10, count: 1)
      ...>   |> Situ.ImageStream.transform(&Situ.ImageOps.invert/1)
      ...> end)
      [Situ.Image.new_filled(2, 1, :gray8, 200)]
  """
  @spec transform(Stream.t(), (Image.t() -> Image.t() | Image.result()), keyword()) :: Stream.t()
  def transform(stream, fun, opts \\ []) when is_function(fun, 1) do
    checked = fn image ->
      case fun.(image) do
        %Image{} = image -> image
        result -> Error.unwrap!(result)
      end
    end

    Operator.attach(stream, "Transform", {:map, checked}, opts, Image)
  end
end
