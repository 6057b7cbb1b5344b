defmodule Situ.Studio.Scene.TermItemsTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{
    Box3,
    CameraIntrinsics,
    CameraView,
    DepthImage,
    Image,
    Mesh,
    Plane,
    Point3,
    PointCloud
  }

  alias Situ.{Line3, Pose, PoseVelocity, Ray3, Rectangle3, Skeleton, Velocity3, VoxelGrid}
  alias Situ.Studio.{Scene, StreamInfo}
  alias Situ.Studio.Scene.TermItems
  doctest Scene
  doctest TermItems

  @camera CameraIntrinsics.new!(width: 8, height: 6, focal: {8, 8})
  @pose Pose.new({1.0, 2.0, 3.0})
  @ray %Ray3{origin: {0.0, 0.0, 0.0}, direction: {1.0, 0.0, 0.0}}

  defp image, do: Image.new!(width: 8, height: 6, format: :rgb24, data: <<0::1152>>)

  defp depth do
    values = for i <- 1..48, into: <<>>, do: <<1000 + i::little-16>>
    DepthImage.new!(width: 8, height: 6, data: values)
  end

  defp kinds(term, settings \\ %{}) do
    {items, []} = TermItems.collect_items(term, settings)
    for item <- items, do: {item.kind, item.count}
  end

  defp mesh do
    {:ok, mesh} =
      Mesh.from_lists([{0.0, 0.0, 0.0}, {1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}], [{0, 1, 2}])

    mesh
  end

  test "draws everything that \\psi draws in space" do
    body = Skeleton.new!(%{head: @pose, neck: @pose}, [{:head, :neck}])
    cloud = PointCloud.from_points([{1.0, 2.0, 3.0}])
    {:ok, plane} = Plane.from_points({0.0, 0.0, 1.0}, {1.0, 0.0, 1.0}, {0.0, 1.0, 1.0})
    {:ok, velocity} = Velocity3.linear_between(Pose.identity(), @pose, 1_000_000_000)
    rectangle = Rectangle3.new!(@pose, 1.0, 1.0)

    grid =
      VoxelGrid.new(0.1)
      |> VoxelGrid.put_at({0.0, 0.0, 0.0}, 1)
      |> VoxelGrid.put_at({1.0, 0.0, 0.0}, 0)

    assert kinds(@pose) == [lines: 3]
    assert kinds([@pose, @pose]) == [lines: 6]
    assert kinds(Point3.new(1, 2, 3)) == [graphs: 1]
    assert kinds({"lamp", Point3.new(1, 2, 3)}) == [graphs: 1, texts: 1]
    assert kinds(%{"a" => Point3.new(1, 2, 3), "b" => nil}) == [graphs: 1, texts: 1]
    assert kinds(cloud) == [points: 1]
    assert kinds(%{nodes: %{1 => {0, 0, 0}, 2 => {1, 0, 0}}, edges: [{1, 2}]}) == [graphs: 2]
    assert kinds(@ray) == [lines: 1]
    assert kinds(velocity) == [lines: 1]
    assert kinds(Box3.new!({0.0, 0.0, 0.0}, {1.0, 1.0, 1.0})) == [boxes: 1]
    assert kinds(rectangle) == [quads: 1]
    assert kinds(plane) == [quads: 1]
    assert kinds(mesh()) == [meshes: 1]
    assert kinds(grid) == [voxels: 1]
    assert kinds(grid, %{threshold: -1}) == [voxels: 2]
    assert kinds({image(), rectangle}) == [quads: 1]
    assert kinds({depth(), rectangle}) == [quads: 1]
    assert kinds({@camera, @pose}) == [frusta: 1]
    assert kinds(CameraView.new(image(), @camera, @pose)) == [frusta: 1, quads: 1]
    assert kinds({image(), @pose}) == [frusta: 1, quads: 1]
    assert kinds(CameraView.new(depth(), @camera, @pose)) == [frusta: 1, points: 48]
    assert kinds({depth(), @camera, @pose}, %{depth_as: "surface"}) == [frusta: 1, meshes: 70]
    assert kinds({depth(), @pose}, %{depth_as: "picture"}) == [frusta: 1, quads: 1]
    assert kinds(CameraView.new(cloud, @camera, @pose)) == [frusta: 1, points: 1]
    assert kinds(body) == [graphs: 2]
    assert kinds([body, nil, @ray]) == [graphs: 2, lines: 1]
    line = Line3.new({0.0, 0.0, 0.0}, {1.0, 0.0, 0.0})
    assert kinds([line, nil, line]) == [lines: 2]
    assert {[%{meta: %{"arrow" => false}}], []} = TermItems.collect_items(line)
    {:ok, both} = PoseVelocity.from_poses(Pose.identity(), @pose, 1_000_000_000)
    assert kinds(both) == [lines: 1, lines: 1]
    assert kinds({mesh(), @pose}) == [meshes: 1]
    assert kinds({cloud, @pose}) == [points: 1]
    assert kinds({"wall", @pose}) == [lines: 3, texts: 1]
    assert kinds({"wall", @pose}, %{text: 0.5}) == [quads: 1]
    assert kinds(%{"a" => @pose}, %{text: 0.5}) == [lines: 3, texts: 1]

    assert {[%{meta: %{"text" => "wall"}}], []} =
             TermItems.collect_items({"wall", rectangle}, %{text: 0.5})
  end

  test "keeps a cloud's values, also when it is thinned" do
    points = PointCloud.from_points(for x <- 1..4, do: {x * 1.0, 0.0, 0.0}).points

    {:ok, cloud} =
      PointCloud.new(points, nil, for(x <- 1..4, into: <<>>, do: <<x * 10.0::little-float-32>>))

    {[%{numbers: numbers}], []} = TermItems.collect_items(cloud, %{budget: 2})
    assert numbers[:value] == <<10.0::little-float-32, 30.0::little-float-32>>

    assert {[], ["a point cloud whose values" <> _]} =
             TermItems.collect_items(%{cloud | values: 3})

    assert {[_], []} = cloud |> Map.delete(:values) |> TermItems.collect_items()
  end

  test "places a mesh by the pose next to it" do
    {[%{meta: %{"matrix" => matrix}}], []} = TermItems.collect_items({mesh(), @pose})
    assert Enum.slice(matrix, 12, 3) == [1.0, 2.0, 3.0]

    {[%{numbers: [position: at]}], []} =
      TermItems.collect_items({PointCloud.from_points([{0.0, 0.0, 1.0}]), @pose})

    assert at == <<1.0::little-float-32, 2.0::little-float-32, 4.0::little-float-32>>
  end

  test "thins depth, and gives images without a lens one from the settings" do
    view = CameraView.new(depth(), @camera, @pose)
    assert kinds(view, %{sparsity: 2}) == [frusta: 1, points: 12]

    far = fn focal ->
      {[%{numbers: [corner: <<_::binary-size(16), y::little-float-32, _::binary>>]} | _], []} =
        TermItems.collect_items({image(), Pose.identity()}, %{focal: focal})

      y
    end

    assert_in_delta far.(4), 1.0, 1.0e-6
    assert_in_delta far.(8), 0.5, 1.0e-6
  end

  test "keeps to a budget of points, and reports the total" do
    cloud = PointCloud.from_points(for x <- 1..1000, do: {x * 1.0, 0.0, 0.0})
    {[item], []} = TermItems.collect_items(cloud, %{budget: 100})
    assert {item.count, item.meta["of"]} == {100, 1000}

    assert kinds(CameraView.new(depth(), @camera, @pose), %{budget: 12}) == [
             frusta: 1,
             points: 12
           ]
  end

  test "describes invalid items in a sentence, and draws the rest" do
    bad = %{mesh() | vertices: <<1>>}
    assert {[%{kind: :lines}], ["a mesh whose" <> _]} = TermItems.collect_items([bad, @ray])

    assert {[%{kind: :frusta}], [what]} =
             TermItems.collect_items(CameraView.new(%{depth() | data: <<>>}, @camera, @pose))

    assert what =~ "bytes"

    assert {[], ["an invalid point cloud" <> _]} =
             TermItems.collect_items(%PointCloud{points: <<1>>})

    assert {[], ["a point cloud" <> _]} = TermItems.collect_items(%PointCloud{points: nil})
    assert {[], ["a voxel grid" <> _]} = TermItems.collect_items(%VoxelGrid{size: 0})

    assert {[%{kind: :graphs}], ["1 edges" <> _]} =
             TermItems.collect_items(%Skeleton{joints: %{a: @pose}, bones: [:oops]})
  end

  property "draws or skips any term, and its bytes match their layout" do
    forall term <- anything() do
      {items, problems} = TermItems.collect_items(term)
      bytes = IO.iodata_to_binary(Scene.pack(items, problems))
      <<size::little-32, 0::32, json::binary-size(size), _::binary>> = bytes
      {:ok, %{"items" => rows}} = Situ.JSON.decode(json)
      rest = byte_size(bytes) - 8 - size - rem(8 - rem(size, 8), 8)

      assert rem(byte_size(bytes), 8) == 0

      for %{"at" => at} <- rows,
          {_, [from, length]} <- at,
          do: assert(rem(from, 8) == 0 and from + length <= rest)
    end
  end

  # Generates terms as they may come from files: the right structs with any content.
  defp anything do
    leaf =
      one_of([
        integer(-5, 5),
        nil,
        :nan,
        "name",
        1.5,
        {1.0, 2.0, 3.0},
        Point3.new(1, 2, 3),
        @pose,
        @ray
      ])

    one_of([
      leaf,
      list(leaf, 3),
      {leaf, leaf},
      map(leaf, &%{x: &1}),
      map(leaf, &%PointCloud{points: &1}),
      map(leaf, &%Mesh{vertices: &1, indices: <<>>})
    ])
  end

  test "recognizes streams of spatial data" do
    assert StreamInfo.shape_of_type(Pose) == :space
    assert StreamInfo.shape_of_type({:list, Skeleton}) == :space
    assert StreamInfo.shape_of_type({:map, :string, Pose}) == :space
    assert StreamInfo.shape_of_type(Situ.Transform) == :frames
    assert StreamInfo.shape_of({@camera, @pose}) == :space
    graph = %{nodes: %{a: {0.0, 0.0, 1.0}, b: {1.0, 0.0, 1.0}}, edges: [{:a, :b}]}
    assert StreamInfo.shape_of(graph) == :space
    refute StreamInfo.shape_of(%{nodes: %{a: 1}, edges: []}) == :space
    assert StreamInfo.shape_of_text("list of Situ.Skeleton") == :space
  end
end
