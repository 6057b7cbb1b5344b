defmodule Situ.Studio.Draw.Picture do
  @moduledoc """
  Converts a message's image to bytes that a browser can draw. Encoded images are passed through unchanged. Raw images
  are sent as JPEG if this machine can encode it, and as plain pixels otherwise. Depth images are sent as 16-bit values,
  so that the page can colour them and show the value under the mouse.
  """
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
  @spec of(term()) :: {:ok, t()} | {:error, String.t()}
  def of(%EncodedImage{format: format} = i) when format in [:jpeg, :png],
    do: {:ok, {format, i.width, i.height, i.data, 0}}

  def of(%DepthImage{scale: scale} = depth) do
    with {:ok, {pixels, w, h, data, _}} <- raw(DepthImage.to_gray16(depth)),
         do: {:ok, {pixels, w, h, data, unit(scale)}}
  end

  def of(%Image{format: :gray16} = image), do: raw(image)

  def of(%Image{width: w, height: h} = image) when w * h > @small do
    case jpeg(image) do
      {:ok, data} -> {:ok, {:jpeg, w, h, data, 0}}
      :error -> raw(image)
    end
  end

  def of(%Image{} = image), do: raw(image)
  def of(_), do: {:error, "this message does not contain an image"}

  defp raw(%Image{width: w, height: h, format: format} = image) do
    with {:ok, image} <- valid(image) do
      case format do
        :gray8 -> {:ok, {:gray8, w, h, Image.pixels(image), 0}}
        :gray16 -> {:ok, {:gray16, w, h, Image.pixels(image), 0}}
        :bgr24 -> {:ok, {:bgr, w, h, Image.pixels(image), 0}}
        :rgb24 -> {:ok, {:rgb, w, h, Image.pixels(image), 0}}
        :bgra32 -> {:ok, {:bgra, w, h, Image.pixels(image), 0}}
        :bgrx32 -> {:ok, {:bgra, w, h, Image.pixels(image), 0}}
        :rgba32 -> {:ok, {:rgba, w, h, Image.pixels(image), 0}}
        :rgba64 -> {:ok, {:rgba, w, h, high_bytes(Image.pixels(image)), 0}}
      end
    end
  end

  # A file may claim any scale, so scales that no sensor has are reported as unknown.
  defp unit(scale) when is_number(scale) and scale > 0 and scale <= 1_000,
    do: round(scale * 1.0e6)

  defp unit(_), do: 0

  defp valid(image) do
    case Image.validate(image) do
      {:ok, image} -> {:ok, image}
      {:error, error} -> {:error, error.what}
    end
  end

  defp high_bytes(pixels), do: for(<<_low, high <- pixels>>, into: <<>>, do: <<high>>)

  defp jpeg(image), do: Situ.Studio.Draw.Jpeg.encode(image, @quality)
end
