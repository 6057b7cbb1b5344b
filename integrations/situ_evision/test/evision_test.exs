defmodule Situ.EvisionTest do
  use ExUnit.Case, async: true

  alias Situ.{DepthImage, Image}

  test "images keep their pixels in both directions" do
    for {format, size} <- [gray8: 1, bgr24: 3, bgra32: 4, gray16: 2] do
      image =
        Image.new!(width: 3, height: 2, format: format, data: :crypto.strong_rand_bytes(6 * size))

      assert Situ.Evision.from_mat(Situ.Evision.to_mat(image)) == image
    end
  end

  test "RGB images become BGR" do
    image = Image.new!(width: 1, height: 1, format: :rgb24, data: <<1, 2, 3>>)

    assert %Image{format: :bgr24, data: <<3, 2, 1>>} =
             Situ.Evision.from_mat(Situ.Evision.to_mat(image))
  end

  test "padding of rows is left out, and depth images have 16 bits" do
    image =
      Image.new!(width: 1, height: 2, format: :gray8, stride: 4, data: <<1, 0, 0, 0, 2, 0, 0, 0>>)

    assert Situ.Evision.from_mat(Situ.Evision.to_mat(image)).data == <<1, 2>>
    depth = %DepthImage{width: 1, height: 1, stride: 2, data: <<1_000::16-little>>}

    assert %Image{format: :gray16, data: <<1_000::16-little>>} =
             Situ.Evision.from_mat(Situ.Evision.to_mat(depth))
  end

  test "functions of OpenCV apply to streams" do
    image = Image.new_filled(8, 8, :gray8, 7)

    assert {:ok, [{0, blurred}]} =
             Situ.Test.run(
               [image: [{0, image}]],
               &Situ.Evision.map(&1.image, fn mat -> Evision.blur(mat, {3, 3}) end)
             )

    assert blurred == image

    assert {:ok, [{0, mean}]} =
             Situ.Test.run(
               [image: [{0, image}]],
               &Situ.Evision.map(&1.image, fn mat -> Evision.mean(mat) end)
             )

    assert elem(mean, 0) == 7.0
  end
end
