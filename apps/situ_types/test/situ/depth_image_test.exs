defmodule Situ.DepthImageTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.DepthImage
  doctest Situ.DepthImage

  property "a depth image round-trips, and corrupted bytes decode to an error or a valid image" do
    forall {w, h, point?, noise} <- {integer(1, 9), integer(1, 9), boolean(), binary()} do
      semantics = if point?, do: :point, else: :plane
      data = :binary.copy(<<1, 2>>, w * h)
      depth = DepthImage.new!(width: w, height: h, data: data, semantics: semantics)
      stored = IO.iodata_to_binary(DepthImage.encode(depth))

      DepthImage.decode(stored) == {:ok, depth} and
        decodes?(DepthImage.decode(<<1>> <> noise <> stored))
    end
  end

  defp decodes?({:ok, depth}), do: match?({:ok, _}, DepthImage.validate(depth))
  defp decodes?({:error, error}), do: is_exception(error)

  test "refuses impossible depth data" do
    assert {:error, %{code: :bad_image}} = DepthImage.new(width: 2, height: 2, data: <<0::16>>)

    assert {:error, %{code: :bad_image}} =
             DepthImage.new(width: 1, height: 1, data: <<0::16>>, scale: 0)

    gray8 = Situ.Image.new_filled(1, 1, :gray8)
    assert {:error, %{code: :bad_format}} = DepthImage.from_gray16(gray8)
  end
end
