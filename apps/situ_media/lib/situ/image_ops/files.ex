defmodule Situ.ImageOps.Files do
  @moduledoc false
  # Reads and writes images as JPEG, PNG and raw bytes. `Situ.ImageOps` documents the functions.
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

  @spec jpeg_schema() :: Situ.Options.schema()
  def jpeg_schema, do: @jpeg

  def encode_jpeg(%Image{} = image, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @jpeg),
         {:ok, image} <- Image.validate(image),
         job = {:jpeg_encode, image, round(opts[:quality]), opts[:subsampling]},
         {:ok, bytes} <- NativeKernel.run_image(job, image.width * image.height / 350) do
      {:ok, build_encoded(:jpeg, image, bytes)}
    end
  end

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

  def decode_depth(encoded, opts \\ []) do
    with {:ok, image} <- parse(encoded), do: DepthImage.from_gray16(image, opts)
  end

  def read(path, opts \\ []) do
    case File.read(path) do
      {:ok, bytes} ->
        parse(bytes, opts)

      {:error, reason} ->
        what = "cannot read #{path}: #{:file.format_error(reason)}"
        {:error, Error.new(:unreadable, what, fix: "check the path")}
    end
  end

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

  def from_yuv(bytes, width, height, layout)
      when layout in [:nv12, :i420, :yuyv] and width in 1..0x7FFFFFFF and
             height in 1..0x7FFFFFFF do
    NativeKernel.run_image({:yuv_decode, bytes, layout, width, height}, width * height / 300)
  end

  defp build_encoded(format, image, bytes),
    do: %EncodedImage{format: format, width: image.width, height: image.height, data: bytes}
end
