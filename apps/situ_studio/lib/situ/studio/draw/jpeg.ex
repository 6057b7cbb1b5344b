defmodule Situ.Studio.Draw.Jpeg do
  @moduledoc false
  # This is the only module that knows how this machine encodes JPEG. Images that cannot be encoded are sent as plain
  # pixels.

  @spec encode(Situ.Image.t(), 1..100) :: {:ok, iodata()} | :error
  def encode(image, quality) do
    case Situ.ImageOps.encode_jpeg(image, quality: quality) do
      {:ok, encoded} -> {:ok, encoded.data}
      {:error, _} -> :error
    end
  end
end
