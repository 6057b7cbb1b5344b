defmodule Situ.EncodedImageTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.EncodedImage
  doctest Situ.EncodedImage

  property "an encoded image round-trips, and foreign bytes are refused without raising" do
    forall {w, h, bytes, jpeg?} <- {integer(0, 70_000), integer(0, 70_000), binary(), boolean()} do
      format = if jpeg?, do: :jpeg, else: :png
      {:ok, encoded} = EncodedImage.new(format: format, width: w, height: h, data: bytes)

      EncodedImage.decode(IO.iodata_to_binary(EncodedImage.encode(encoded))) == {:ok, encoded} and
        match?({tag, _} when tag in [:ok, :error], EncodedImage.decode(<<1, bytes::binary>>))
    end
  end
end
