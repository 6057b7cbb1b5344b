defmodule Situ.Evision do
  @moduledoc """
  Converts between Situ's images and `Evision.Mat`, and applies functions of OpenCV to streams of images.

      edges = Situ.Evision.map(camera, &Evision.canny(&1, 100, 200))

  OpenCV expects the channel order blue, green, red, so `:rgb24` images are converted; `:bgr24` and `:gray8` are not.
  """
  alias Situ.{DepthImage, Image}

  @doc """
  Converts an image to a `Mat` of `{height, width, channels}`. Evision copies the bytes once; rows with padding are
  copied before. A depth image becomes a `Mat` of 16-bit values.
  """
  @spec to_mat(Image.t() | DepthImage.t()) :: Evision.Mat.t()
  def to_mat(%DepthImage{} = image),
    do: Evision.Mat.from_binary(pack_rows(image, 2), :u16, image.height, image.width, 1)

  def to_mat(%Image{format: format} = image) do
    channels = length(Image.Format.channels(format))
    size = Image.Format.bytes_per_pixel(format)
    type = if div(size, channels) == 2, do: :u16, else: :u8

    mat =
      Evision.Mat.from_binary(pack_rows(image, size), type, image.height, image.width, channels)

    if format == :rgb24, do: Evision.cvtColor(mat, Evision.Constant.cv_COLOR_RGB2BGR()), else: mat
  end

  @doc """
  Converts a `Mat` of 8 or 16 bits with one, three or four channels to an image: `:gray8`, `:gray16`, `:bgr24` or
  `:bgra32`. Raises `Situ.Error` (`:bad_mat`) for other types.
  """
  @spec from_mat(Evision.Mat.t()) :: Image.t()
  def from_mat(mat) do
    {height, width, channels} =
      case Evision.Mat.shape(mat) do
        {height, width} -> {height, width, 1}
        shape -> shape
      end

    format = image_format(Evision.Mat.type(mat), channels)
    Image.new!(width: width, height: height, format: format, data: Evision.Mat.to_binary(mat))
  end

  @doc "Applies a function of a `Mat` to each image. A result that is a `Mat` becomes an image."
  @spec map(Situ.Stream.t(), (Evision.Mat.t() -> term()), keyword()) :: Situ.Stream.t()
  def map(%Situ.Stream{} = stream, fun, opts \\ []) when is_function(fun, 1) do
    apply_function = fn image ->
      case fun.(to_mat(image)) do
        %Evision.Mat{} = mat ->
          from_mat(mat)

        {:error, reason} ->
          raise Situ.Error.new(:opencv_failed, "OpenCV failed: #{inspect(reason)}")

        other ->
          other
      end
    end

    Situ.map(stream, apply_function, [name: "Evision", async: true] ++ opts)
  end

  defp image_format({:u, 8}, 1), do: :gray8
  defp image_format({:u, 16}, 1), do: :gray16
  defp image_format({:u, 8}, 3), do: :bgr24
  defp image_format({:u, 8}, 4), do: :bgra32

  defp image_format(type, channels) do
    raise Situ.Error.new(
            :bad_mat,
            "there is no image of #{channels} channels of #{inspect(type)}",
            why: "images have 8 bits and 1, 3 or 4 channels, or 16 bits and 1 channel",
            fix: "convert it with Evision.Mat.as_type/2 or Evision.cvtColor/2"
          )
  end

  defp pack_rows(%{width: width, height: height, stride: stride, data: data}, pixel) do
    row = width * pixel

    if stride == row,
      do: binary_part(data, 0, row * height),
      else: for(y <- 0..(height - 1), into: <<>>, do: binary_part(data, y * stride, row))
  end
end
