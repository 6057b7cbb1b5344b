defmodule Situ.VideoPacket do
  @moduledoc """
  One image of a compressed video: the bytes for a decoder, and the distance to the place where decoding begins.

  A recording that is written with `encode:` (`Situ.Store.write/4`) contains one packet for each image. Packets are in
  the order of the images' times, because no image refers to a later one.

    * `codec`: `:h264` (in Annex B form, with the parameters in every key frame), `:vp8` or `:vp9`
    * `position`: 0 for a key frame, where a decoder can start; otherwise the number of images since the last one
    * `width`, `height`, `format`: the size in pixels and the pixel format of the image that was compressed. The
      compressed image may have one more column or row, because its size must be even

      iex> packet = %Situ.VideoPacket{codec: :vp8, position: 2, width: 3, height: 1, format: :gray8, data: <<1, 2>>}
      iex> {:ok, ^packet} = packet |> Situ.VideoPacket.encode() |> IO.iodata_to_binary() |> Situ.VideoPacket.decode()
      iex> {packet, Situ.VideoPacket.key?(packet)}
      {#Situ.VideoPacket<3x1 :gray8 as :vp8, image 2 after a key frame, 2 B>, false}
  """
  @behaviour Situ.Codec

  alias Situ.Error
  alias Situ.Image.Format

  @enforce_keys [:codec, :position, :width, :height, :format, :data]
  defstruct @enforce_keys

  @type codec :: :h264 | :vp8 | :vp9
  @type t :: %__MODULE__{
          codec: codec(),
          position: non_neg_integer(),
          width: pos_integer(),
          height: pos_integer(),
          format: Format.t(),
          data: binary()
        }

  @codes %{h264: 1, vp8: 2, vp9: 3}
  @names Map.new(@codes, fn {name, code} -> {code, name} end)

  @doc "Returns whether a decoder can start at this packet."
  @spec key?(t()) :: boolean()
  def key?(%__MODULE__{position: position}), do: position == 0

  @impl Situ.Codec
  def codec_name, do: "situ.video_packet"

  @impl Situ.Codec
  def encode(%__MODULE__{} = p) do
    codes = <<1, Map.fetch!(@codes, p.codec), Format.code(p.format), 0>>
    [<<codes::binary, p.width::little-32, p.height::little-32, p.position::little-32>>, p.data]
  end

  @impl Situ.Codec
  def decode(
        <<1, codec, format, _, width::little-32, height::little-32, position::little-32,
          data::binary>>
      )
      when is_map_key(@names, codec) and width > 0 and height > 0 do
    with {:ok, format} <- Format.from_code(format) do
      {:ok,
       %__MODULE__{
         codec: @names[codec],
         position: position,
         width: width,
         height: height,
         format: format,
         data: data
       }}
    end
  end

  def decode(_bytes), do: {:error, Error.new(:bad_image, "not a stored video packet")}

  defimpl Inspect do
    def inspect(p, _opts) do
      place = if p.position == 0, do: "key frame", else: "image #{p.position} after a key frame"
      size = "#{p.width}x#{p.height} #{inspect(p.format)} as #{inspect(p.codec)}"
      bytes = if is_binary(p.data), do: byte_size(p.data), else: "?"
      "#Situ.VideoPacket<#{size}, #{place}, #{bytes} B>"
    end
  end
end
