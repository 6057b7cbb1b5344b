defmodule Situ.Image do
  @moduledoc """
  An uncompressed image: a binary of pixels with its size and format.

  Rows are stored from top to bottom, and each row starts `stride` bytes after the previous one. Pixels within a row
  are contiguous. `stride` may be larger than a row needs (external buffers, crops without a copy) and may be odd;
  images created by Situ have no padding. 16-bit channels are little-endian.

  | format | bytes per pixel | channels in memory order |
  |---|---|---|
  | `:gray8` | 1 | grey |
  | `:gray16` | 2 | grey, 16 bit |
  | `:bgr24` | 3 | blue, green, red (used by cameras, OpenCV and video files) |
  | `:rgb24` | 3 | red, green, blue |
  | `:bgrx32` | 4 | blue, green, red, unused |
  | `:bgra32` | 4 | blue, green, red, alpha |
  | `:rgba32` | 4 | red, green, blue, alpha (used by browsers) |
  | `:rgba64` | 8 | red, green, blue, alpha, 16 bit each |

      iex> {:ok, image} = Situ.Image.new(width: 2, height: 1, format: :bgr24, data: <<255, 0, 0, 0, 0, 255>>)
      iex> image
      #Situ.Image<2x1 :bgr24, 6 B>
      iex> Situ.Image.fetch_pixel(image, 1, 0)
      {:ok, [0, 0, 255]}

  Every operator validates its images again in Rust, including structs built by hand.

  ## Colours

  A colour, for drawing and filling, is one of these:

    * a name: `:black`, `:white`, `:red`, `:green`, `:blue`, `:yellow`, `:cyan`, `:magenta`, `:orange` or `:gray`
    * `{r, g, b}` or `{r, g, b, a}` with values of 0..255
    * a list of channel values in the image's memory order
    * one number for all channels

  Names and tuples work with every format: they are converted to grey for grey images, and widened for 16-bit channels.
  """
  @behaviour Situ.Codec

  alias Situ.Error
  alias Situ.Image.{Color, Format}

  @enforce_keys [:width, :height, :format, :stride, :data]
  defstruct [:width, :height, :format, :stride, :data]

  @type t :: %__MODULE__{
          width: pos_integer(),
          height: pos_integer(),
          format: Format.t(),
          stride: pos_integer(),
          data: binary()
        }
  @type result :: {:ok, t()} | {:error, Error.t()}

  # 1 GiB is more than any camera needs, and small enough that one image cannot exhaust the machine's memory.
  @max_bytes 1_073_741_824

  @schema [
    width: [type: :pos_integer, required: true, doc: "Width in pixels."],
    height: [type: :pos_integer, required: true, doc: "Height in pixels."],
    format: [type: {:in, Format.list_all()}, required: true, doc: "The pixel format."],
    stride: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "Bytes from one row to the next; `nil` means no padding."
    ],
    data: [type: :string, required: true, doc: "The pixels, at least `stride * height` bytes."]
  ]

  @doc """
  Builds a validated image without copying `data`.

  #{Situ.Options.docs(@schema)}

  The last row need not be padded to `stride`.

      iex> {:error, error} = Situ.Image.new(width: 2, height: 2, format: :gray8, data: "abc")
      iex> {error.code, error.what}
      {:bad_image, "3 bytes are too few for 2x2 :gray8 with stride 2"}
  """
  @spec new(keyword()) :: result()
  def new(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema) do
      opts = Map.new(opts)
      stride = opts.stride || opts.width * Format.bytes_per_pixel(opts.format)
      validate(struct!(__MODULE__, %{opts | stride: stride}))
    end
  end

  @doc "Like `new/1`, but returns the image or raises the error."
  @spec new!(keyword()) :: t()
  def new!(opts), do: Situ.Error.unwrap!(new(opts))

  @doc """
  Builds an image of one colour.

      iex> Situ.Image.new_filled(2, 1, :bgr24, [1, 2, 3]).data
      <<1, 2, 3, 1, 2, 3>>
      iex> Situ.Image.new_filled(1, 1, :gray16, 258).data
      <<2, 1>>
  """
  @spec new_filled(pos_integer(), pos_integer(), Format.t(), Color.t()) ::
          t()
  def new_filled(width, height, format, color \\ 0) do
    pixel = Color.pack_pixel(format, color)
    bytes = width * height * byte_size(pixel)

    if bytes > @max_bytes do
      raise ArgumentError,
            "#{width}x#{height} #{inspect(format)} is larger than #{@max_bytes} bytes"
    end

    new!(
      width: width,
      height: height,
      format: format,
      data: :binary.copy(pixel, width * height)
    )
  end

  @doc "Returns the maximum size of an image in bytes."
  @spec max_bytes() :: pos_integer()
  def max_bytes, do: @max_bytes

  @doc """
  Validates a struct: the size must be positive, the stride wide enough, the data long enough, and the total size at
  most `max_bytes/0`.
  """
  @spec validate(t()) :: result()
  def validate(%__MODULE__{} = image) do
    %{width: width, height: height, format: format, stride: stride, data: data} = image

    cond do
      not (is_integer(width) and is_integer(height) and width > 0 and height > 0) ->
        image_error("invalid image size #{inspect(width)}x#{inspect(height)}")

      format not in Format.list_all() ->
        image_error("unknown pixel format #{inspect(format)}")

      not is_integer(stride) or stride < width * Format.bytes_per_pixel(format) ->
        image_error(
          "stride #{inspect(stride)} is too small for #{width} pixels of #{inspect(format)}"
        )

      not is_binary(data) ->
        image_error("the pixels must be a binary")

      stride * height > @max_bytes ->
        image_error("#{width}x#{height} with stride #{stride} is larger than #{@max_bytes} bytes")

      byte_size(data) < required_bytes(image) ->
        image_error(
          "#{byte_size(data)} bytes are too few for #{describe(image)} with stride #{stride}"
        )

      true ->
        {:ok, image}
    end
  end

  @doc "Returns the number of bytes in one row without padding."
  @spec row_bytes(t()) :: pos_integer()
  def row_bytes(%__MODULE__{} = image), do: image.width * Format.bytes_per_pixel(image.format)

  @doc "Returns whether the data has no padding between rows and no bytes after the last row."
  @spec tightly_packed?(t()) :: boolean()
  def tightly_packed?(%__MODULE__{} = image),
    do: image.stride == row_bytes(image) and byte_size(image.data) == image.stride * image.height

  @doc """
  Returns the pixels without padding as one binary. An image without padding is not copied.

      iex> image = Situ.Image.new!(width: 1, height: 2, format: :gray8, stride: 4, data: <<1, 0, 0, 0, 2>>)
      iex> Situ.Image.pixel_bytes(image)
      <<1, 2>>
  """
  @spec pixel_bytes(t()) :: binary()
  def pixel_bytes(%__MODULE__{} = image) do
    row = row_bytes(image)

    if image.stride == row do
      binary_part(image.data, 0, row * image.height)
    else
      for y <- 0..(image.height - 1),
          into: <<>>,
          do: binary_part(image.data, y * image.stride, row)
    end
  end

  @doc """
  Returns the channel values at column `x`, row `y`, in memory order.

      iex> Situ.Image.fetch_pixel(Situ.Image.new_filled(2, 2, :gray8, 7), 2, 0) |> elem(1) |> Map.fetch!(:code)
      :bad_point
  """
  @spec fetch_pixel(t(), integer(), integer()) :: {:ok, [non_neg_integer()]} | {:error, Error.t()}
  def fetch_pixel(%__MODULE__{width: w, height: h} = image, x, y)
      when x >= 0 and y >= 0 and x < w and y < h do
    size = Format.bytes_per_pixel(image.format)

    {:ok,
     Format.unpack_pixel(image.format, binary_part(image.data, y * image.stride + x * size, size))}
  end

  def fetch_pixel(%__MODULE__{} = image, x, y) do
    {:error, Error.new(:bad_point, "pixel {#{x}, #{y}} is outside #{describe(image)}")}
  end

  @doc """
  Returns a copy with one pixel changed. It copies the complete image, so use the drawing operators to draw many
  pixels.

      iex> Situ.Image.new_filled(2, 1, :gray8) |> Situ.Image.put_pixel(1, 0, [9]) |> elem(1) |> Situ.Image.pixel_bytes()
      <<0, 9>>
  """
  @spec put_pixel(t(), integer(), integer(), Color.t()) :: result()
  def put_pixel(%__MODULE__{} = image, x, y, color) do
    with {:ok, _} <- fetch_pixel(image, x, y) do
      pixel = Color.pack_pixel(image.format, color)
      offset = y * image.stride + x * byte_size(pixel)
      behind = offset + byte_size(pixel)
      before = binary_part(image.data, 0, offset)
      rest = binary_part(image.data, behind, byte_size(image.data) - behind)
      {:ok, %{image | data: <<before::binary, pixel::binary, rest::binary>>}}
    end
  end

  @doc "Formats size and pixel format for people: `640x480 :bgr24`."
  @spec describe(t()) :: String.t()
  def describe(%__MODULE__{} = image),
    do: "#{image.width}x#{image.height} #{inspect(image.format)}"

  # The header has 64 bytes so that the pixels after it keep the alignment of the record.
  @header_bytes 64

  @impl Situ.Codec
  def codec_name, do: "situ.image"

  @impl Situ.Codec
  def encode(%__MODULE__{} = image) do
    header =
      <<1, Format.code(image.format), 0::16, image.width::little-32, image.height::little-32,
        image.stride::little-32, 0::size((@header_bytes - 16) * 8)>>

    [header, image.data]
  end

  @impl Situ.Codec
  def decode(
        <<1, code, _::16, width::little-32, height::little-32, stride::little-32,
          _::binary-size(@header_bytes - 16), data::binary>>
      ) do
    with {:ok, format} <- Format.from_code(code) do
      validate(%__MODULE__{
        width: width,
        height: height,
        format: format,
        stride: stride,
        data: data
      })
    end
  end

  def decode(_), do: image_error("not a stored image")

  defp required_bytes(image), do: image.stride * (image.height - 1) + row_bytes(image)
  defp image_error(what), do: {:error, Error.new(:bad_image, what)}

  defimpl Inspect do
    def inspect(%{data: data} = image, _opts) when is_binary(data) do
      size = "#{image.width}x#{image.height} #{inspect(image.format)}"
      tight = image.width * Situ.Image.Format.bytes_per_pixel(image.format)
      stride = if image.stride == tight, do: "", else: ", stride #{inspect(image.stride)}"
      "#Situ.Image<#{size}#{stride}, #{byte_size(data)} B>"
    rescue
      _ -> "#Situ.Image<invalid>"
    end

    def inspect(_image, _opts), do: "#Situ.Image<invalid>"
  end
end
