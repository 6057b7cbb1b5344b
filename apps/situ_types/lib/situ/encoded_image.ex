defmodule Situ.EncodedImage do
  @moduledoc """
  A compressed image: the bytes of a JPEG or PNG file, and its size.

  `width` and `height` hold the size stored in the bytes, or 0 if it has not been read.

      iex> {:ok, encoded} = Situ.EncodedImage.new(format: :jpeg, width: 640, height: 480, data: "...")
      iex> encoded
      #Situ.EncodedImage<640x480 :jpeg, 3 B>
  """
  @behaviour Situ.Codec

  alias Situ.Error

  @enforce_keys [:format, :data]
  defstruct [:format, :data, width: 0, height: 0]

  @type format :: :jpeg | :png
  @type t :: %__MODULE__{
          width: non_neg_integer(),
          height: non_neg_integer(),
          format: format(),
          data: binary()
        }

  @schema [
    format: [type: {:in, [:jpeg, :png]}, required: true, doc: "Compression format."],
    width: [type: {:integer, 0, 0xFFFFFFFF}, default: 0, doc: "Width in pixels; 0 if unknown."],
    height: [type: {:integer, 0, 0xFFFFFFFF}, default: 0, doc: "Height in pixels; 0 if unknown."],
    data: [type: :string, required: true, doc: "The bytes of the file."]
  ]

  @doc """
  Builds an encoded image from `data` without inspecting the bytes.

  #{Situ.Options.docs(@schema)}
  """
  @spec new(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def new(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         do: {:ok, struct!(__MODULE__, opts)}
  end

  @doc """
  Detects the format from the first bytes.

      iex> Situ.EncodedImage.detect_format(<<0xFF, 0xD8, 0xFF, 0>>)
      {:ok, :jpeg}
      iex> {:error, error} = Situ.EncodedImage.detect_format("GIF89a")
      iex> error.code
      :unknown_image_format
  """
  @spec detect_format(binary()) :: {:ok, format()} | {:error, Error.t()}
  def detect_format(<<0xFF, 0xD8, 0xFF, _::binary>>), do: {:ok, :jpeg}
  def detect_format(<<0x89, "PNG\r\n", 0x1A, "\n", _::binary>>), do: {:ok, :png}

  def detect_format(_) do
    {:error,
     Error.new(:unknown_image_format, "these bytes are neither JPEG nor PNG",
       fix: "convert the file to JPEG or PNG first, for example with ffmpeg"
     )}
  end

  @impl Situ.Codec
  def codec_name, do: "situ.encoded_image"

  @impl Situ.Codec
  def encode(%__MODULE__{} = e) do
    code = if e.format == :jpeg, do: 1, else: 2
    [<<1, code, 0::16, e.width::little-32, e.height::little-32, 0::32>>, e.data]
  end

  @impl Situ.Codec
  def decode(<<1, code, _::16, width::little-32, height::little-32, _::32, data::binary>>)
      when code in [1, 2] do
    format = if code == 1, do: :jpeg, else: :png
    {:ok, %__MODULE__{format: format, width: width, height: height, data: data}}
  end

  def decode(_), do: {:error, Error.new(:bad_image, "not a stored encoded image")}

  defimpl Inspect do
    def inspect(e, _opts) do
      bytes = if is_binary(e.data), do: byte_size(e.data), else: "?"

      "#Situ.EncodedImage<#{inspect(e.width)}x#{inspect(e.height)} #{inspect(e.format)}, #{bytes} B>"
    end
  end
end
