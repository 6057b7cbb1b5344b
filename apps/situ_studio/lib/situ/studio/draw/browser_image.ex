defmodule Situ.Studio.Draw.BrowserImage do
  @moduledoc false
  # Converts a message's image to bytes that a browser can draw. Encoded images are passed through
  # unchanged. Raw images are sent as JPEG if this machine can encode it, and as plain pixels
  # otherwise. Depth images are sent as 16-bit values, so that the page can colour them and show
  # the value under the mouse.
  alias Situ.{DepthImage, EncodedImage, Image}

  @quality 85
  # In images with fewer pixels, JPEG would blur details that people look at closely, and would save little.
  @small 4_096

  @type t ::
          {atom(), non_neg_integer(), non_neg_integer(), iodata(), unit_um :: non_neg_integer()}

  @doc """
  Returns `{pixels, width, height, data, unit}` as expected by `Situ.Studio.Frame.image/3`. In a depth image, a value of
  1 is `unit` micrometres.
  """
  @spec to_browser_image(term()) :: {:ok, t()} | {:error, String.t()}
  def to_browser_image(%EncodedImage{format: format} = i) when format in [:jpeg, :png],
    do: {:ok, {format, i.width, i.height, i.data, 0}}

  def to_browser_image(%DepthImage{scale: scale} = depth) do
    with {:ok, {pixels, w, h, data, _}} <- raw_pixels(DepthImage.to_gray16(depth)),
         do: {:ok, {pixels, w, h, data, unit_micrometres(scale)}}
  end

  def to_browser_image(%Image{format: :gray16} = image), do: raw_pixels(image)

  def to_browser_image(%Image{width: w, height: h} = image) when w * h > @small do
    case encode_jpeg(image) do
      {:ok, data} -> {:ok, {:jpeg, w, h, data, 0}}
      :error -> raw_pixels(image)
    end
  end

  def to_browser_image(%Image{} = image), do: raw_pixels(image)
  def to_browser_image(_), do: {:error, "this message does not contain an image"}

  defp raw_pixels(%Image{width: w, height: h, format: format} = image) do
    with {:ok, image} <- validate_image(image) do
      case format do
        :gray8 -> {:ok, {:gray8, w, h, Image.pixel_bytes(image), 0}}
        :gray16 -> {:ok, {:gray16, w, h, Image.pixel_bytes(image), 0}}
        :bgr24 -> {:ok, {:bgr, w, h, Image.pixel_bytes(image), 0}}
        :rgb24 -> {:ok, {:rgb, w, h, Image.pixel_bytes(image), 0}}
        :bgra32 -> {:ok, {:bgra, w, h, Image.pixel_bytes(image), 0}}
        :bgrx32 -> {:ok, {:bgra, w, h, Image.pixel_bytes(image), 0}}
        :rgba32 -> {:ok, {:rgba, w, h, Image.pixel_bytes(image), 0}}
        :rgba64 -> {:ok, {:rgba, w, h, high_bytes(Image.pixel_bytes(image)), 0}}
      end
    end
  end

  # A file may claim any scale, so scales that no sensor has are reported as unknown.
  defp unit_micrometres(scale) when is_number(scale) and scale > 0 and scale <= 1_000,
    do: round(scale * 1.0e6)

  defp unit_micrometres(_), do: 0

  defp validate_image(image) do
    case Image.validate(image) do
      {:ok, image} -> {:ok, image}
      {:error, error} -> {:error, error.what}
    end
  end

  defp high_bytes(pixels), do: for(<<_low, high <- pixels>>, into: <<>>, do: <<high>>)

  defp encode_jpeg(image), do: Situ.Studio.Draw.Jpeg.encode(image, @quality)
end
