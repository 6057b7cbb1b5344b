defmodule Situ.Vision do
  @moduledoc """
  Streams of pictures: every function takes a stream of `Situ.Image` first and returns a stream. The same on one picture
  in hand is in `Situ.Imaging`, with the same name and options; originating times are kept.

      def build(p, _opts) do
        camera = Situ.Media.Camera.open(p, size: {1280, 720})

        camera
        |> Situ.Vision.resize(640, 360)
        |> Situ.Vision.convert(:gray8)
        |> Situ.Vision.canny(60, 120)
        |> Situ.Vision.encode_jpeg(quality: 80)
      end

  A straight run of these is one process: only the last picture travels. All take the common options `name:`, `policy:`,
  `async:` and `on_error:` besides their own; a picture that an operator cannot work on (a crop outside of it, a wrong
  format) raises the operator's `Situ.Error` inside the component, so `on_error: :skip` passes over it.

      iex> image = Situ.Image.filled(4, 2, :bgr24, [0, 0, 255])
      iex> Situ.to_list(fn p ->
      ...>   p |> Situ.repeat(image, every: 10, count: 2) |> Situ.Vision.convert(:gray8) |> Situ.Vision.resize(2, 1)
      ...> end)
      [Situ.Image.filled(2, 1, :gray8, 76), Situ.Image.filled(2, 1, :gray8, 76)]
  """
  alias Situ.Graph.Placement
  alias Situ.{DepthImage, EncodedImage, Error, Image, Operator, Stream}
  alias Situ.Imaging.{Drawing, Files, Filter, Geometry, Measure, Pixels}

  # Each row: function, its arguments after the picture, the module it is in, the type that comes out.
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

  # Functions without options of their own.
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

    @doc "Each picture through `Situ.Imaging.#{name}/#{length(args) + 2}`."
    @spec unquote(name)(
            unquote_splicing([
              quote(do: Stream.t()) | Enum.map(args, fn _ -> quote(do: term()) end)
            ]),
            keyword()
          ) ::
            Stream.t()
    def unquote(name)(stream, unquote_splicing(vars), opts \\ []) do
      {placed, opts} = Placement.apart(opts, :operator)
      fun = &Error.unwrap!(unquote(module).unquote(name)(&1, unquote_splicing(vars), opts))
      Operator.attach(stream, unquote(label), {:map, fun}, placed, unquote(type))
    end
  end

  for {name, args, module} <- @plain do
    vars = Enum.map(args, &Macro.var(&1, __MODULE__))
    label = name |> Atom.to_string() |> String.replace("_", " ") |> String.capitalize()

    @doc "Each picture through `Situ.Imaging.#{name}/#{length(args) + 1}`."
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
  The part inside `rect`: one rectangle for all, or a stream of pictures with their rectangles, `{image, rect | nil}`,
  when `rect` is `:paired` (join pictures and rectangles first). `nil` for no rectangle, or one that leaves nothing
  with `clip: true`; so the type is `{:optional, Situ.Image}`, or that of depth images for a stream of them.

      iex> {image, rect} = {Situ.Image.filled(4, 4, :gray8), Situ.Rect.new!(1, 1, 2, 2)}
      iex> Situ.to_list(fn p -> p |> Situ.repeat({image, rect}, every: 10, count: 1) |> Situ.Vision.crop(:paired) end)
      [Situ.Image.filled(2, 2, :gray8)]
  """
  @spec crop(Stream.t(), Situ.Rect.t() | tuple() | :paired, keyword()) :: Stream.t()
  def crop(stream, rect, opts \\ []) do
    {placed, opts} = Placement.apart(opts, :operator)

    fun =
      if rect == :paired,
        do: fn {image, rect} -> rect && Error.unwrap!(Geometry.crop(image, rect, opts)) end,
        else: fn image -> Error.unwrap!(Geometry.crop(image, rect, opts)) end

    picture = if depth?(stream.type), do: DepthImage, else: Image
    Operator.attach(stream, "Crop", {:map, fun}, placed, {:optional, picture})
  end

  defp depth?(DepthImage), do: true
  defp depth?({:tuple, [type | _]}), do: depth?(type)
  defp depth?(_type), do: false

  @doc """
  `:gray16` pictures as depth images, without a copy; `semantics:` and `scale:` as in `Situ.DepthImage`.

      iex> image = Situ.Image.filled(2, 1, :gray16, 1500)
      iex> Situ.to_list(fn p -> p |> Situ.repeat(image, every: 10, count: 1) |> Situ.Vision.to_depth(scale: 0.002) end)
      [Situ.DepthImage.new!(width: 2, height: 1, data: image.data, scale: 0.002)]
  """
  @spec to_depth(Stream.t(), keyword()) :: Stream.t()
  def to_depth(stream, opts \\ []) do
    {placed, opts} = Placement.apart(opts, :operator)
    fun = &Error.unwrap!(DepthImage.from_gray16(&1, opts))
    Operator.attach(stream, "To depth", {:map, fun}, placed, DepthImage)
  end

  @doc "Depth images as `:gray16` pictures, without a copy: for every operator on pictures."
  @spec to_gray16(Stream.t(), keyword()) :: Stream.t()
  def to_gray16(stream, opts \\ []),
    do: Operator.attach(stream, "To gray16", {:map, &DepthImage.to_gray16/1}, opts, Image)

  @doc "JPEG or PNG (`Situ.EncodedImage` or binaries) as pictures: `Situ.Imaging.parse/2`."
  @spec decode(Stream.t(), keyword()) :: Stream.t()
  def decode(stream, opts \\ []) do
    {placed, opts} = Placement.apart(opts, :operator)
    fun = &Error.unwrap!(Files.parse(&1, opts))
    Operator.attach(stream, "Decode", {:map, fun}, placed, Image)
  end

  @doc """
  |a - b| of each picture and the one before it (the first gives nothing): what moved.
  """
  @spec motion(Stream.t(), keyword()) :: Stream.t()
  def motion(stream, opts \\ []) do
    step = fn
      image, _message, nil -> {:skip, image}
      image, _message, last -> {:emit, Error.unwrap!(Pixels.absdiff(image, last)), image}
    end

    Operator.attach(stream, "Motion", {:step, step, nil}, opts, Image)
  end

  @doc "|a - b| of two streams of pictures with the same times: `Situ.Imaging.absdiff/2`."
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
  How alike the pictures of two streams with the same times are: a stream of maps, `Situ.Imaging.compare/3`.

      iex> {a, b} = {Situ.Image.filled(2, 1, :gray8, 3), Situ.Image.filled(2, 1, :gray8, 5)}
      iex> once = [every: 10, count: 1]
      iex> Situ.to_list(fn p -> Situ.Vision.compare(Situ.repeat(p, a, once), Situ.repeat(p, b, once), tolerance: 1) end)
      [%{equal?: false, max: 2, mean: 2.0, outliers: 1.0}]
  """
  @spec compare(Stream.t(), Stream.t(), keyword()) :: Stream.t()
  def compare(stream, other, opts \\ []) do
    {placed, opts} = Placement.apart(opts, :operator)
    fun = fn {a, b} -> Error.unwrap!(Measure.compare(a, b, opts)) end
    stream |> Situ.join(other) |> Operator.attach("Compare", {:map, fun}, placed, :map)
  end

  @doc "Boxes with labels on each picture of a stream of `{image, [Situ.Rect]}`."
  @spec draw_detections(Stream.t(), keyword()) :: Stream.t()
  def draw_detections(stream, opts \\ []) do
    {placed, opts} = Placement.apart(opts, :operator)
    fun = fn {image, rects} -> Error.unwrap!(Drawing.draw_detections(image, rects, opts)) end
    Operator.attach(stream, "Draw detections", {:map, fun}, placed, Image)
  end

  @doc "Any function from picture to picture: `{:ok, image}`, `{:error, error}` or the picture itself."
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
