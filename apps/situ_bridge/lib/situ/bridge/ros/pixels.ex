defmodule Situ.Bridge.Ros.Pixels do
  @moduledoc false
  # Converts images to and from the encodings of ROS and Foxglove, and extracts bytes from rows of points. Pure.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.{DepthImage, Image}

  @encodings %{
    "mono8" => :gray8,
    "8UC1" => :gray8,
    "mono16" => :gray16,
    "rgb8" => :rgb24,
    "bgr8" => :bgr24,
    "8UC3" => :bgr24,
    "rgba8" => :rgba32,
    "bgra8" => :bgra32
  }
  @formats %{
    gray8: "mono8",
    gray16: "mono16",
    rgb24: "rgb8",
    bgr24: "bgr8",
    rgba32: "rgba8",
    bgra32: "bgra8"
  }

  @doc "Returns the name of an image's encoding, or `nil`."
  @spec encoding_name(Image.t()) :: String.t() | nil
  def encoding_name(%Image{format: format}), do: @formats[format]

  @doc """
  Builds the image of a message with the fields `encoding` and `data`. `width`, `height` and `step` are the names of the
  other fields. Pixels are little-endian unless the message sets `is_bigendian`.
  """
  @spec from_message(map(), String.t(), String.t(), String.t()) ::
          {:ok, struct()} | {:error, term()} | :error
  def from_message(%{"encoding" => encoding, "data" => data} = m, width, height, step) do
    size = [width: m[width], height: m[height], stride: m[step], data: data]
    big? = m["is_bigendian"] == 1

    case {encoding, @encodings[encoding]} do
      {"16UC1", nil} when not big? -> DepthImage.new(size)
      {_, nil} -> :error
      {_, :gray16} when big? -> :error
      {_, format} -> Image.new([format: format] ++ size)
    end
  end

  @doc "Converts an image to the fields of a message. `step` is the name of the field for the bytes per row."
  @spec to_message(Image.t() | DepthImage.t(), String.t()) :: map()
  def to_message(%{} = image, step) do
    %{
      "width" => image.width,
      "height" => image.height,
      step => image.stride,
      "encoding" => encoding_of(image),
      "data" => image.data
    }
  end

  defp encoding_of(%DepthImage{}), do: "16UC1"
  defp encoding_of(%Image{} = image), do: encoding_name(image)

  @doc "Returns the `n` bytes at offset `at` of every `step` bytes, joined."
  @spec slice_every(binary(), pos_integer(), non_neg_integer(), pos_integer()) :: binary()
  def slice_every(data, n, 0, n), do: data

  def slice_every(data, step, at, n) do
    rest = step - at - n

    for <<_::binary-pinned_size(at), part::binary-pinned_size(n),
          _::binary-pinned_size(rest) <- data>>,
        into: <<>>,
        do: part
  end

  @doc "Interleaves 12-byte points and 3-byte colors as 16 bytes each; the last byte is zero."
  @spec interleave_points(binary(), binary()) :: binary()
  def interleave_points(points, colors), do: interleave_step(points, colors, [])

  defp interleave_step(
         <<point::binary-12, points::binary>>,
         <<rgb::binary-3, colors::binary>>,
         acc
       ),
       do: interleave_step(points, colors, [[point, rgb, 0] | acc])

  defp interleave_step("", "", acc), do: acc |> Enum.reverse() |> IO.iodata_to_binary()
end
