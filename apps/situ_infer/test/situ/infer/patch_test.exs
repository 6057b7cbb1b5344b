defmodule Situ.Infer.PatchTest do
  use ExUnit.Case, async: true

  alias Situ.Image
  alias Situ.Infer.Patch
  doctest Situ.Infer.Patch

  test "a patch as large as the image equals the image" do
    image =
      Image.new!(
        width: 2,
        height: 2,
        format: :rgb24,
        data: <<1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12>>
      )

    assert {:ok, tensor} =
             Patch.cut_tensor(Patch.from_square({0.0, 0.0}, 2.0, 2), image, 1.0, 0.0)

    assert Situ.Tensor.to_list(tensor) == Enum.map(1..12, &(&1 * 1.0))
  end

  test "rejects a struct with false pixel dimensions" do
    image = %{Image.new_filled(2, 2, :bgr24) | height: 100}
    square = Patch.from_square({0.0, 0.0}, 2.0, 2)
    assert {:error, %{code: :bad_image, why: why}} = Patch.cut_tensor(square, image, 1.0, 0.0)
    assert why =~ "too few"
    huge = %{square | size: 100_000}

    assert {:error, %{code: :bad_image}} =
             Patch.cut_tensor(huge, Image.new_filled(2, 2, :bgr24), 1.0, 0.0)
  end
end
