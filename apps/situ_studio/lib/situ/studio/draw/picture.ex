defmodule Situ.Studio.Draw.Picture do
  @moduledoc """
  A message's picture as bytes a browser can draw. Encoded pictures pass through as they are; raw ones go as JPEG where
  this machine can encode it and as plain pixels where not; depth goes as 16-bit values, so that the page can colour it
  and tell the value under the mouse.
  """
  alias Situ.{DepthImage, EncodedImage, Image}

  @quality 85
  # Below this many pixels a JPEG would blur what people look at closely, and saves little.
  @small 4_096

  @type t :: {atom(), non_neg_integer(), non_neg_integer(), iodata()}

  @doc "`{pixels, width, height, data}` as `Situ.Studio.Frame.image/3` takes it."
  @spec of(term()) :: {:ok, t()} | {:error, String.t()}
  def of(%EncodedImage{format: format} = i) when format in [:jpeg, :png],
    do: {:ok, {format, i.width, i.height, i.data}}

  def of(%DepthImage{} = depth), do: raw(DepthImage.to_gray16(depth))
  def of(%Image{format: :gray16} = image), do: raw(image)

  def of(%Image{width: w, height: h} = image) when w * h > @small do
    case jpeg(image) do
      {:ok, data} -> {:ok, {:jpeg, w, h, data}}
      :error -> raw(image)
    end
  end

  def of(%Image{} = image), do: raw(image)
  def of(_), do: {:error, "this message holds no picture"}

  defp raw(%Image{width: w, height: h, format: format} = image) do
    with {:ok, image} <- valid(image) do
      case format do
        :gray8 -> {:ok, {:gray8, w, h, Image.pixels(image)}}
        :gray16 -> {:ok, {:gray16, w, h, Image.pixels(image)}}
        :bgr24 -> {:ok, {:bgr, w, h, Image.pixels(image)}}
        :rgb24 -> {:ok, {:rgb, w, h, Image.pixels(image)}}
        :bgra32 -> {:ok, {:bgra, w, h, Image.pixels(image)}}
        :bgrx32 -> {:ok, {:bgra, w, h, Image.pixels(image)}}
        :rgba32 -> {:ok, {:rgba, w, h, Image.pixels(image)}}
        :rgba64 -> {:ok, {:rgba, w, h, high_bytes(Image.pixels(image))}}
      end
    end
  end

  defp valid(image) do
    case Image.validate(image) do
      {:ok, image} -> {:ok, image}
      {:error, error} -> {:error, error.what}
    end
  end

  defp high_bytes(pixels), do: for(<<_low, high <- pixels>>, into: <<>>, do: <<high>>)

  defp jpeg(image), do: Situ.Studio.Draw.Jpeg.encode(image, @quality)
end
