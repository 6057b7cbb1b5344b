defmodule Situ.Infer.SegmentationTest do
  use ExUnit.Case, async: true
  alias Situ.Image
  alias Situ.Infer.{Segmentation, Test.Networks}

  @moduletag :tmp_dir

  test "each position has the number of its likeliest class", %{tmp_dir: dir} do
    path = Networks.write(Networks.brightest(4), dir)
    rows = [<<200, 0, 0>>, <<0, 200, 0>>, <<0, 0, 200>>, <<0, 90, 100>>]

    picture =
      Image.new!(
        width: 4,
        height: 4,
        format: :rgb24,
        data: Enum.map_join(rows, &:binary.copy(&1, 4))
      )

    assert [mask] =
             Situ.to_list(fn p ->
               p
               |> Situ.from_enumerable([picture], every: 1)
               |> Situ.map(& &1, type: Image)
               |> Situ.via(Segmentation, path: path, mean: [0, 0, 0], std: [1, 1, 1])
             end)

    assert {mask.format, mask.width, mask.height} == {:gray8, 4, 4}
    assert mask.data == <<0::32, 1, 1, 1, 1, 2, 2, 2, 2, 2, 2, 2, 2>>
  end
end
