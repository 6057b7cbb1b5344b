defmodule Situ.InspectTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{Columns, Image, Mesh, Message, PointCloud, Tensor, VoxelGrid}

  test "a message shows its data and its time, shortened" do
    assert inspect(%Message{data: 42, originating_time: 10}) == "#Situ.Message<42 at 10 ns>"
    year_2024 = 1_704_067_200_000_000_000

    assert inspect(%Message{data: :open, originating_time: year_2024}) ==
             "#Situ.Message<:open at 2024-01-01T00:00:00.000000000Z>"

    image = Image.new_filled(640, 480, :rgb24, [1, 2, 3])

    assert inspect(%Message{data: image, originating_time: 0}) ==
             "#Situ.Message<#Situ.Image<640x480 :rgb24, 921600 B> at 0 ns>"

    for data <- [
          :binary.copy("x", 1_000_000),
          Enum.to_list(1..100_000),
          :binary.copy(<<255>>, 9_999)
        ],
        do: assert(String.length(inspect(%Message{data: data, originating_time: 0})) < 200)
  end

  property "a message of any data can be inspected" do
    forall data <- term() do
      assert inspect(%Message{data: data, originating_time: 0}) =~
               ~r/\A#Situ.Message<.* at 0 ns>\z/s
    end
  end

  test "large values show their type and size instead of their bytes" do
    assert inspect(Tensor.new(:binary.copy(<<0>>, 4_096), :f32, {32, 32})) ==
             "#Situ.Tensor<f32 {32, 32}, 4096 B>"

    assert inspect(Columns.new([1, 2], [0.5, 1.5])) == "#Situ.Columns<2 messages, :float>"
    grid = VoxelGrid.put_at(VoxelGrid.new(0.1), {0.0, 0.0, 0.0}, 1)
    assert inspect(grid) == "#Situ.VoxelGrid<0.1 m, 1 voxels>"
  end

  # A developer sees such a value just when something is wrong, so inspecting it must not fail.
  test "values with wrong fields can be inspected" do
    assert inspect(struct(PointCloud)) == "#Situ.PointCloud<invalid>"
    assert inspect(struct(Mesh)) == "#Situ.Mesh<invalid>"
    assert inspect(struct(Tensor)) == "#Situ.Tensor<invalid>"
    assert inspect(%Message{data: 1, originating_time: nil}) == "#Situ.Message<1 at nil>"
  end
end
