defmodule SpaceFixture do
  @moduledoc false
  # The data for the tests of 3D panels: each of the nine primitives at its own position, and
  # broken items.
  alias Situ.{
    Box3,
    CameraIntrinsics,
    CameraView,
    DepthImage,
    Image,
    Mesh,
    Point3,
    PointCloud,
    Pose
  }

  alias Situ.{Quaternion, Ray3, Rectangle3, Skeleton, Transform, VoxelGrid}
  alias Situ.Store.Writer
  alias Situ.Studio.History

  @t0 1_767_225_600_000_000_000
  @second 1_000_000_000

  # The position of the nth item on the floor: four in a row, 3 m apart.
  def place(n), do: {rem(n, 4) * 3.0, div(n, 4) * 3.0, 0.0}

  defp at(n, {dx, dy, dz}) do
    {x, y, z} = place(n)
    {x + dx, y + dy, z + dz}
  end

  defp up(n),
    do: Pose.new(at(n, {0.0, 0.0, 0.3}), Quaternion.from_euler(0.0, -:math.pi() / 2, 0.0))

  # Second s of each stream. The order of the names is the order of the layers.
  def streams do
    [
      {"A.Points", PointCloud, fn _ -> cloud(0) end},
      {"B.Arrows", {:list, Ray3},
       fn _ -> [elem(Ray3.new(at(1, {-0.5, 0.0, 0.2}), {1.0, 0.0, 0.0}), 1)] end},
      {"C.Box", Box3, fn _ -> Box3.new!(at(2, {-0.5, -0.5, 0.0}), at(2, {0.5, 0.5, 0.5})) end},
      {"D.Mesh", Mesh, fn _ -> mesh(3) end},
      {"E.Text", :any,
       fn s ->
         {"second #{s}",
          struct!(Point3, Map.new(Enum.zip([:x, :y, :z], Tuple.to_list(place(4)))))}
       end},
      {"F.Picture", :any, fn _ -> {picture(), Rectangle3.new!(up(5), 1.0, 1.0)} end},
      {"G.Camera", :any,
       fn _ -> {CameraIntrinsics.new!(width: 64, height: 48, focal: {60, 60}), up(6)} end},
      {"H.Body", Skeleton, fn s -> body(7, s) end},
      {"I.Voxels", VoxelGrid, fn _ -> voxels(8) end}
    ]
  end

  defp cloud(n) do
    {x, y, _} = place(n)
    points = for i <- -25..25, j <- -25..25, do: {x + i / 50, y + j / 50, 0.0}

    {:ok, cloud} =
      PointCloud.new(
        PointCloud.from_points(points).points,
        String.duplicate(<<250, 30, 200>>, length(points))
      )

    cloud
  end

  defp mesh(n) do
    corners =
      for {dx, dy} <- [{-0.5, -0.5}, {0.5, -0.5}, {0.5, 0.5}, {-0.5, 0.5}],
          do: at(n, {dx, dy, 0.1})

    {:ok, mesh} = Mesh.from_lists(corners, [{0, 1, 2}, {0, 2, 3}])
    mesh
  end

  # The left half is green, the right half blue.
  defp picture do
    row = String.duplicate(<<20, 220, 60>>, 32) <> String.duplicate(<<30, 60, 240>>, 32)
    Image.new!(width: 64, height: 64, format: :rgb24, data: String.duplicate(row, 64))
  end

  # The figure walks along x, half a metre in ten seconds.
  defp body(n, s) do
    joint = fn offset -> Pose.new(at(n, offset)) end
    x = s / 20

    Skeleton.new!(
      %{head: joint.({x, 0.0, 1.0}), hip: joint.({x, 0.0, 0.5}), foot: joint.({x, 0.4, 0.0})},
      [{:head, :hip}, {:hip, :foot}],
      id: 3,
      confidence: %{foot: 0.2}
    )
  end

  defp voxels(n) do
    for i <- -3..2, j <- -3..2, reduce: VoxelGrid.new(0.2) do
      grid -> VoxelGrid.put_at(grid, at(n, {i / 5 + 0.1, j / 5 + 0.1, 0.1}), i + j + 7)
    end
  end

  def record(name, folder) do
    {:ok, writer} = Writer.create(name, folder)

    for {stream, type, make} <- streams() do
      {:ok, out} = Writer.stream(writer, stream, type: type)
      {:ok, out} = Writer.append(out, for(s <- 0..10, do: message(s, make.(s))))
      {:ok, _} = Writer.close_stream(out, @t0 + 10 * @second)
    end

    :ok = Writer.close(writer)
  end

  defp message(s, data) do
    time = @t0 + s * @second
    %Situ.Message{data: data, originating_time: time, creation_time: time, sequence_id: s}
  end

  # A lamp in the frame of a robot that moves through the room, and a frame without a parent.
  def frames do
    h = History.new(seconds: 3_600, live: false)

    for s <- 0..10 do
      lamp = Transform.new("lamp", "robot", Pose.new({0.0, 0.0, 1.0}), static: true)
      robot = Transform.new("robot", "room", Pose.new({s / 2, 0.0, 0.0}))
      put(h, "Frames", s, if(s == 0, do: [lamp, robot], else: [robot]))
      put(h, "Light", s, Point3.new(0.0, 0.0, 0.0))
    end

    h
  end

  # Data that no sensor emits, but that files may contain.
  def broken do
    h = History.new(seconds: 3_600, live: false)
    nan = <<0, 0, 0xC0, 0x7F>>
    good = for x <- 1..5, into: <<>>, do: <<x::little-float-32, 0::64>>

    {:ok, whole} =
      Mesh.from_lists([{0.0, 0.0, 0.0}, {1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}], [{0, 1, 2}])

    camera = CameraIntrinsics.new!(width: 8, height: 6, focal: {8, 8})
    depth = %DepthImage{width: 80, height: 60, stride: 160, data: <<0::800>>}

    things = [
      {"A.Holes", %PointCloud{points: good <> nan <> <<0::64>>}},
      {"B.Empty", %PointCloud{points: <<>>}},
      {"C.Torn", %PointCloud{points: <<1, 2, 3>>}},
      {"D.Mesh", %{whole | indices: <<0::32, 1::little-32, 900::little-32>>}},
      {"E.Body", %Skeleton{joints: %{a: Pose.identity()}, bones: [{:a, :b}]}},
      {"F.Nowhere", %Point3{x: :nan, y: 0.0, z: 0.0}},
      {"G.View", CameraView.new(depth, camera, Pose.identity())},
      {"H.Good", whole},
      {"J.Line", Situ.Line3.new({0.0, 3.0, 0.0}, {1.0, 3.0, 0.0})},
      {"K.Value",
       %PointCloud{
         points:
           for(
             x <- 0..40,
             into: <<>>,
             do: <<x / 40::little-float-32, 6.0::little-float-32, 0::32>>
           ),
         values: for(x <- 0..40, into: <<>>, do: <<x * 1.0::little-float-32>>)
       }}
    ]

    for {stream, data} <- things, s <- 0..1, do: put(h, stream, s, data)
    put(h, "I.Nobody", 0, [])
    put(h, "I.Nobody", 1, [Point3.new(0, 9, 0)])
    h
  end

  # More points than a panel draws.
  def big(count) do
    h = History.new(seconds: 3_600, megabytes: 2_000, live: false)

    slab =
      for i <- 0..9_999,
          into: <<>>,
          do: <<rem(i, 100) / 50::little-float-32, div(i, 100) / 50::little-float-32, 0::32>>

    put(h, "Cloud", 0, %PointCloud{points: :binary.copy(slab, div(count, 10_000))})
    put(h, "Cloud", 1, cloud(0))
    h
  end

  defp put(h, stream, s, data), do: Fixture.put(h, stream, @t0 + s * @second, 0, data, s)
end
