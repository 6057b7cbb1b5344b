defmodule Situ.Infer.PatchTest do
  use ExUnit.Case, async: true

  alias Situ.Image
  alias Situ.Infer.Patch
  doctest Situ.Infer.Patch

  test "a patch of a patch's own size is the picture" do
    image =
      Image.new!(
        width: 2,
        height: 2,
        format: :rgb24,
        data: <<1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12>>
      )

    assert {:ok, tensor} = Patch.cut(Patch.square({0.0, 0.0}, 2.0, 2), image, 1.0, 0.0)
    assert Situ.Tensor.to_list(tensor) == Enum.map(1..12, &(&1 * 1.0))
  end

  test "a struct that lies about its pixels is refused" do
    image = %{Image.filled(2, 2, :bgr24) | height: 100}
    square = Patch.square({0.0, 0.0}, 2.0, 2)
    assert {:error, %{code: :bad_image, why: why}} = Patch.cut(square, image, 1.0, 0.0)
    assert why =~ "too few"
    huge = %{square | size: 100_000}
    assert {:error, %{code: :bad_image}} = Patch.cut(huge, Image.filled(2, 2, :bgr24), 1.0, 0.0)
  end
end
