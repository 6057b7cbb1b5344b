defmodule Situ.Studio.PageExport.Pictures do
  @moduledoc false
  # Makes the pictures of an exported page smaller. The page draws them in the size of their messages, so that
  # coordinates of other streams stay right.
  alias Situ.{EncodedImage, Image, ImageOps}
  alias Situ.Studio.Draw.{BrowserImage, Jpeg}

  @side 640
  @quality 75

  @doc "Returns the longest side of a picture in pixels."
  @spec longest_side() :: pos_integer()
  def longest_side, do: @side

  @doc "Returns a picture for a browser with the width and height of the message. Small images are unchanged."
  @spec make_small(term()) :: {:ok, BrowserImage.t()} | {:error, String.t()}
  def make_small(%EncodedImage{width: w, height: h} = image)
      when w in 1..@side and h in 1..@side,
      do: BrowserImage.to_browser_image(image)

  def make_small(%EncodedImage{} = image) do
    case ImageOps.parse(image, format: :bgr24) do
      {:ok, decoded} -> make_small(decoded)
      {:error, error} -> {:error, error.what}
    end
  end

  def make_small(%Image{format: format, width: w, height: h} = image)
      when format != :gray16 and (w > @side or h > @side) do
    factor = @side / max(w, h)

    with {:ok, image} <- ImageOps.convert(image, :bgr24),
         {:ok, small} <- ImageOps.resize(image, round_side(w * factor), round_side(h * factor)),
         {:ok, bytes} <- Jpeg.encode(small, @quality) do
      {:ok, {:jpeg, w, h, bytes, 0}}
    else
      _ -> BrowserImage.to_browser_image(image)
    end
  end

  def make_small(data), do: BrowserImage.to_browser_image(data)

  defp round_side(pixels), do: max(round(pixels), 1)
end
