defmodule Situ.ImageOps.Files do
  @moduledoc false
  # Reads and writes images as JPEG, PNG and raw bytes. Call these functions through
  # `Situ.ImageOps`.
  #
  # A decoder allocates the size given in a header only if the bytes could hold such an image, and
  # never more than `Situ.Image.max_bytes/0`.
  alias Situ.{DepthImage, EncodedImage, Error, Image}
  alias Situ.ImageOps.{CostEstimate, Pixels}
  alias Situ.Media.NativeKernel

  @jpeg [
    quality: [type: {:integer, 1, 100}, default: 90, doc: "1 (worst) to 100."],
    subsampling: [
      type: {:in, [:full, :half, :quarter]},
      default: :quarter,
      doc: "Color resolution: 4:4:4, 4:2:2 or 4:2:0."
    ]
  ]

  @levels [fast: 0, balanced: 1, small: 2]

  @doc """
  Encodes an image in an 8-bit format as JPEG (libjpeg-turbo), without its alpha channel.

  #{Situ.Options.docs(@jpeg)}

      iex> {:ok, jpeg} = Situ.ImageOps.encode_jpeg(Situ.Image.new_filled(16, 8, :bgr24, [0, 128, 255]))
      iex> {jpeg.format, jpeg.width, jpeg.height}
      {:jpeg, 16, 8}
      iex> {:error, error} = Situ.ImageOps.encode_jpeg(Situ.Image.new_filled(2, 2, :gray16))
      iex> error.code
      :bad_format
  """
  @spec encode_jpeg(Image.t(), keyword()) :: {:ok, EncodedImage.t()} | {:error, Error.t()}
  def encode_jpeg(%Image{} = image, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @jpeg),
         {:ok, image} <- Image.validate(image),
         job = {:jpeg_encode, image, round(opts[:quality]), opts[:subsampling]},
         {:ok, bytes} <- NativeKernel.run_image(job, image.width * image.height / 350) do
      {:ok, build_encoded(:jpeg, image, bytes)}
    end
  end

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
  def encode_png(image, opts \\ [])

  def encode_png(%DepthImage{} = depth, opts),
    do: encode_png(DepthImage.to_gray16(depth), opts)

  def encode_png(%Image{} = image, opts) do
    level = Keyword.fetch!(@levels, Keyword.validate!(opts, level: :balanced)[:level])

    with {:ok, image} <- Image.validate(image),
         {:ok, bytes} <-
           NativeKernel.run_image({:png_encode, image, level}, byte_size(image.data) / 50) do
      {:ok, build_encoded(:png, image, bytes)}
    end
  end

  @doc """
  Decodes JPEG or PNG bytes (`Situ.EncodedImage` or a binary).

  A JPEG is decoded to `:bgr24` or `:gray8`, depending on the file, or to `format:` (any 8-bit format). A PNG is decoded
  to `:gray8`, `:gray16`, `:rgb24`, `:rgba32` or `:rgba64`, depending on the file, and converted if `format:` is given.
  A truncated or corrupt file is the error `:bad_jpeg` or `:bad_png`.

      iex> {:error, error} = Situ.ImageOps.parse(<<0xFF, 0xD8, 0xFF, 0xE0, 0>>)
      iex> error.code
      :bad_jpeg
  """
  @spec parse(EncodedImage.t() | binary(), keyword()) :: Image.result()
  def parse(encoded, opts \\ [])
  def parse(%EncodedImage{data: data}, opts), do: parse(data, opts)

  def parse(bytes, opts) when is_binary(bytes) do
    wanted = Keyword.validate!(opts, format: nil)[:format]

    case EncodedImage.detect_format(bytes) do
      {:ok, :jpeg} ->
        NativeKernel.run_image({:jpeg_decode, bytes, wanted}, CostEstimate.jpeg_cost(bytes))

      {:ok, :png} ->
        decode_png(bytes, wanted)

      {:error, _} = error ->
        error
    end
  end

  defp decode_png(bytes, wanted) do
    # The length of a PNG does not predict its decoding time, so only tiny ones avoid a dirty scheduler.
    cost = if byte_size(bytes) < 512, do: 1, else: 1000

    with {:ok, image} <- NativeKernel.run_image({:png_decode, bytes}, cost) do
      if wanted, do: Pixels.convert(image, wanted), else: {:ok, image}
    end
  end

  @doc """
  Decodes a depth image from a 16-bit grayscale PNG. For `semantics:` and `scale:`, see `Situ.DepthImage`.
  """
  @spec decode_depth(EncodedImage.t() | binary(), keyword()) :: DepthImage.result()
  def decode_depth(encoded, opts \\ []) do
    with {:ok, image} <- parse(encoded), do: DepthImage.from_gray16(image, opts)
  end

  @doc """
  Reads a JPEG or PNG file. The format is detected from the content, not the file name.

      iex> {:error, error} = Situ.ImageOps.read("no/such/file.png")
      iex> error.code
      :unreadable
  """
  @spec read(Path.t(), keyword()) :: Image.result()
  def read(path, opts \\ []) do
    case File.read(path) do
      {:ok, bytes} ->
        parse(bytes, opts)

      {:error, reason} ->
        what = "cannot read #{path}: #{:file.format_error(reason)}"
        {:error, Error.new(:unreadable, what, fix: "check the path")}
    end
  end

  @doc "Writes an image file in the format of the extension `.jpg`, `.jpeg` or `.png`, with options of the encoder."
  @spec write(Image.t(), Path.t(), keyword()) :: :ok | {:error, Error.t()}
  def write(%Image{} = image, path, opts \\ []) do
    with {:ok, encoded} <- encode_as(image, path |> Path.extname() |> String.downcase(), opts) do
      case File.write(path, encoded.data) do
        :ok ->
          :ok

        {:error, reason} ->
          what = "cannot write #{path}: #{:file.format_error(reason)}"
          {:error, Error.new(:unwritable, what)}
      end
    end
  end

  defp encode_as(image, extension, opts) when extension in [".jpg", ".jpeg"],
    do: encode_jpeg(image, opts)

  defp encode_as(image, ".png", opts), do: encode_png(image, opts)

  defp encode_as(_image, extension, _opts) do
    {:error,
     Error.new(
       :unknown_image_format,
       "cannot write an image with the extension #{inspect(extension)}",
       fix: "name the file .jpg or .png"
     )}
  end

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
  def from_raw(bytes, width, height, format) do
    with {:ok, image} <- Image.new(width: width, height: height, format: format, data: bytes) do
      if Image.tightly_packed?(image) do
        {:ok, image}
      else
        what = "#{byte_size(bytes)} bytes are more than #{Image.describe(image)} takes"
        {:error, Error.new(:bad_image, what)}
      end
    end
  end

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
  def from_yuv(bytes, width, height, layout)
      when layout in [:nv12, :i420, :yuyv] and width in 1..0x7FFFFFFF and
             height in 1..0x7FFFFFFF do
    NativeKernel.run_image({:yuv_decode, bytes, layout, width, height}, width * height / 300)
  end

  defp build_encoded(format, image, bytes),
    do: %EncodedImage{format: format, width: image.width, height: image.height, data: bytes}
end
