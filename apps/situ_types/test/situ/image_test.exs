defmodule Situ.ImageTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Image
  doctest Situ.Image

  test "refuses empty, huge and inconsistent images" do
    data = <<0::64>>

    for {opts, code} <- [
          {[width: 0, height: 2, format: :gray8, data: data], :bad_option},
          {[width: 100_000, height: 100_000, format: :bgr24, data: data], :bad_image},
          {[width: 4, height: 4, format: :gray8, data: data], :bad_image},
          {[width: 4, height: 1, format: :gray8, stride: 3, data: data], :bad_image},
          {[width: 1, height: 1, format: :nv12, data: data], :bad_option}
        ] do
      assert {:error, %Situ.Error{code: ^code}} = Image.new(opts)
    end
  end

  property "an image round-trips, and corrupted bytes decode to an error or a valid image" do
    forall {w, h, format, noise} <-
             {integer(1, 9), integer(1, 9), one_of(Image.Format.list_all()), binary()} do
      image = Image.new_filled(w, h, format, 77)
      stored = IO.iodata_to_binary(Image.encode(image))
      Image.decode(stored) == {:ok, image} and decodes?(Image.decode(<<1>> <> noise <> stored))
    end
  end

  defp decodes?({:ok, _}), do: true
  defp decodes?({:error, error}), do: is_exception(error)

  test "an image read from a store references the store's memory without a copy" do
    image = Image.new_filled(64, 64, :bgr24, 5)
    stored = IO.iodata_to_binary(Image.encode(image))
    {:ok, back} = Image.decode(stored)
    assert :binary.referenced_byte_size(back.data) == byte_size(stored)
  end
end
