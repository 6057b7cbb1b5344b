defmodule Situ.Space.ViewImage do
  @moduledoc """
  Resizes, crops, converts, encodes and decodes the images in camera views (`Situ.CameraView`). The intrinsics change
  with the size of the image, so that each pixel of the new image still shows the same direction.

      iex> camera = Situ.CameraIntrinsics.new!(width: 64, height: 48, focal: {50, 50})
      iex> view = Situ.CameraView.new(Situ.Image.new_filled(64, 48, :rgb24, :red), camera, Situ.Pose.identity())
      iex> {:ok, small} = Situ.Space.ViewImage.resize(view, 32, 24)
      iex> {small.viewed.width, small.intrinsics.focal, small.intrinsics.principal}
      {32, {25.0, 25.0}, {16.0, 12.0}}

  For streams:

      Situ.map(camera.color, &Situ.Error.unwrap!(Situ.Space.ViewImage.encode(&1, quality: 80)))
  """
  alias Situ.{CameraIntrinsics, CameraView, DepthImage, EncodedImage, Error, Image, ImageOps}

  @type result :: {:ok, CameraView.t()} | {:error, Error.t()}

  @doc """
  Resizes the image of a view. Takes the options of `Situ.ImageOps.resize/4`. Depth uses the nearest pixel, because the
  mean of a wall and an object in front of it would be a false depth.
  """
  @spec resize(CameraView.t(), pos_integer(), pos_integer(), keyword()) :: result()
  def resize(view, width, height, opts \\ [])

  def resize(%CameraView{viewed: %DepthImage{} = depth} = view, width, height, opts) do
    opts = Keyword.put_new(opts, :filter, :nearest)

    depth
    |> DepthImage.map_gray16(&ImageOps.resize(&1, width, height, opts))
    |> put_resized(view, width, height)
  end

  def resize(%CameraView{viewed: %Image{} = image} = view, width, height, opts),
    do: image |> ImageOps.resize(width, height, opts) |> put_resized(view, width, height)

  def resize(view, _width, _height, _opts), do: no_pixels(view)

  defp put_resized({:ok, viewed}, view, width, height) do
    intrinsics = CameraIntrinsics.resize_to(view.intrinsics, width, height)
    {:ok, %{view | viewed: viewed, intrinsics: intrinsics}}
  end

  defp put_resized(error, _view, _width, _height), do: error

  @doc "Scales the image of a view by a factor. Sizes are rounded to integers, with a minimum of 1."
  @spec scale(CameraView.t(), number(), keyword()) :: result()
  def scale(view, factor, opts \\ [])

  def scale(%CameraView{viewed: %{width: w, height: h}} = view, factor, opts)
      when is_number(factor) and factor > 0,
      do: resize(view, max(round(w * factor), 1), max(round(h * factor), 1), opts)

  def scale(%CameraView{}, factor, _opts),
    do:
      {:error,
       Error.new(:bad_option, "the scale must be a positive number, got #{inspect(factor)}")}

  @doc "Crops a view to a rectangle of integers, `{x, y, width, height}`, which must be inside the image."
  @spec crop(CameraView.t(), {integer(), integer(), pos_integer(), pos_integer()}) :: result()
  def crop(%CameraView{viewed: %module{} = viewed} = view, {x, y, w, h} = part)
      when module in [Image, DepthImage] and is_integer(x) and is_integer(y) and is_integer(w) and
             is_integer(h) do
    with {:ok, viewed} <- ImageOps.crop(viewed, part),
         do:
           {:ok,
            %{view | viewed: viewed, intrinsics: CameraIntrinsics.crop_to(view.intrinsics, part)}}
  end

  def crop(view, _part), do: no_pixels(view)

  @doc "Converts the image of a view to another format, like `Situ.ImageOps.convert/2`."
  @spec convert(CameraView.t(), Image.format()) :: result()
  def convert(%CameraView{viewed: %Image{}} = view, format),
    do: CameraView.map_viewed(view, &ImageOps.convert(&1, format))

  def convert(view, _format), do: no_pixels(view)

  @doc """
  Encodes the image of a view as JPEG (`quality:`, 90), or as PNG with `format: :png`. Depth is always encoded as PNG,
  which does not contain the unit and the meaning of depth values. Pass them to `decode/2`.
  """
  @spec encode(CameraView.t(), keyword()) :: result()
  def encode(view, opts \\ [])

  def encode(%CameraView{viewed: %DepthImage{}} = view, _opts),
    do: CameraView.map_viewed(view, &ImageOps.encode_png(DepthImage.to_gray16(&1)))

  def encode(%CameraView{viewed: %Image{}} = view, opts) do
    case Keyword.pop(opts, :format, :jpeg) do
      {:png, opts} ->
        CameraView.map_viewed(view, &ImageOps.encode_png(&1, opts))

      {:jpeg, opts} ->
        CameraView.map_viewed(view, &ImageOps.encode_jpeg(&1, opts))

      {other, _} ->
        {:error,
         Error.new(:bad_option, "the format must be :jpeg or :png, got #{inspect(other)}")}
    end
  end

  def encode(view, _opts), do: no_pixels(view)

  @doc """
  Decodes the encoded image of a view. With `depth:`, which gives the unit and meaning of its values, it is decoded as
  depth, like `Situ.DepthImage.from_gray16/2`.

      iex> camera = Situ.CameraIntrinsics.new!(width: 2, height: 1, focal: {2, 2})
      iex> depth = Situ.DepthImage.new!(width: 2, height: 1, data: <<1000::little-16, 0::16>>, scale: 0.002)
      iex> {:ok, encoded} = Situ.Space.ViewImage.encode(Situ.CameraView.new(depth, camera, Situ.Pose.identity()))
      iex> {:ok, decoded} = Situ.Space.ViewImage.decode(encoded, depth: [scale: 0.002])
      iex> decoded.viewed == depth
      true
  """
  @spec decode(CameraView.t(), keyword()) :: result()
  def decode(view, opts \\ [])

  def decode(%CameraView{viewed: %EncodedImage{}} = view, depth: depth),
    do: CameraView.map_viewed(view, &ImageOps.decode_depth(&1, depth))

  def decode(%CameraView{viewed: %EncodedImage{}} = view, opts),
    do: CameraView.map_viewed(view, &ImageOps.parse(&1, opts))

  def decode(view, _opts), do: no_pixels(view)

  defp no_pixels(%CameraView{viewed: viewed}) do
    name = if is_struct(viewed), do: inspect(viewed.__struct__), else: inspect(viewed, limit: 3)

    {:error,
     Error.new(:bad_image, "this operation does not support views of #{name}",
       why: "only images and depth images can be changed, and only encoded images can be decoded",
       fix: "decode encoded images first with Situ.Space.ViewImage.decode/2"
     )}
  end
end
