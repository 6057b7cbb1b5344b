defmodule Situ.Space.Robot.UrdfTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{JointState, Mesh, Pose, Quaternion, Store, Vector3}
  alias Situ.Space.{FrameTree, Robot, GeometryFile}
  alias Situ.Space.Robot.{Primitives, Urdf}

  doctest Situ.Space.Robot

  # An arm with two links on a sliding foot, a hand that mirrors the elbow, and a shape from a file.
  @arm """
  <?xml version="1.0"?>
  <robot name="arm">
    <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
    <link name="rail"><visual><geometry><box size="2 0.2 0.1"/></geometry></visual></link>
    <link name="foot"/>
    <link name="upper">
      <visual><origin xyz="0.5 0 0" rpy="0 1.5707963267948966 0"/>
        <geometry><cylinder radius="0.05" length="1"/></geometry></visual>
      <visual><geometry><sphere radius="0.1"/></geometry></visual>
    </link>
    <link name="lower"><visual><origin xyz="0.25 0 0"/>
      <geometry><mesh filename="package://arm/meshes/plate.stl" scale="2 1 1"/></geometry></visual></link>
    <link name="hand"><visual><geometry><mesh filename="package://arm/meshes/none.stl"/></geometry></visual></link>
    <joint name="slide" type="prismatic"><parent link="rail"/><child link="foot"/><axis xyz="1 0 0"/></joint>
    <joint name="shoulder" type="revolute"><parent link="foot"/><child link="upper"/>
      <origin xyz="0 0 0.5"/><axis xyz="0 0 1"/></joint>
    <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
      <origin xyz="1 0 0" rpy="0 0 0"/><axis xyz="0 0 2"/></joint>
    <joint name="wrist" type="revolute"><parent link="lower"/><child link="hand"/>
      <origin xyz="1 0 0"/><axis xyz="0 0 1"/><mimic joint="elbow" multiplier="-1" offset="0.5"/></joint>
  </robot>
  """

  @plate """
  solid plate
    facet normal 0 0 1
      outer loop
        vertex 0 0 0
        vertex 0.5 0 0
        vertex 0.5 0.5 0
      endloop
    endfacet
    facet normal 0 0 1
      outer loop
        vertex 0 0 0
        vertex 0.5 0.5 0
        vertex 0 0.5 0
      endloop
    endfacet
  endsolid plate
  """

  defp folder do
    folder = Path.join(System.tmp_dir!(), "urdf-#{System.unique_integer([:positive])}")
    File.mkdir_p!(Path.join(folder, "arm/meshes"))
    File.mkdir_p!(Path.join(folder, "arm/urdf"))
    File.write!(Path.join(folder, "arm/meshes/plate.stl"), @plate)
    File.write!(Path.join(folder, "arm/urdf/arm.urdf"), @arm)
    on_exit(fn -> File.rm_rf!(folder) end)
    folder
  end

  defp near?({a, b, c}, {x, y, z}), do: Enum.all?([a - x, b - y, c - z], &(abs(&1) < 1.0e-5))

  test "places links at the positions given by the joints" do
    {:ok, robot} = Urdf.parse(@arm)
    assert {robot.name, robot.root} == {"arm", "rail"}
    quarter = :math.pi() / 2
    {:ok, state} = JointState.new(["slide", "shoulder", "elbow"], [0.3, quarter, quarter])
    poses = Robot.link_poses(robot, state)
    # Up the arm: forward along the rail, then to the left, then back.
    assert near?(poses["upper"].position, {0.3, 0.0, 0.5})
    assert near?(poses["lower"].position, {0.3, 1.0, 0.5})
    assert near?(poses["hand"].position, {-0.7, 1.0, 0.5})
    {yaw, _, _} = Quaternion.to_euler(poses["hand"].rotation)
    assert_in_delta yaw, quarter + 0.5, 1.0e-9
    # Joints without a state are at 0, and the mirroring joint is at its offset.
    assert near?(Robot.link_poses(robot)["hand"].position, {2.0, 0.0, 0.5})
  end

  test "places shapes at their links; a mesh is read from the same folder or reported in its place" do
    {:ok, robot} = Urdf.read(Path.join(folder(), "arm/urdf/arm.urdf"))
    shapes = Robot.link_shapes(robot)
    assert Map.keys(shapes) == ["hand", "lower", "rail", "upper"]
    assert bounds(shapes["rail"]) == {{-1.0, -0.1, -0.05}, {1.0, 0.1, 0.05}}
    # The cylinder is along x, the sphere at the shoulder.
    [cylinder, sphere] = shapes["upper"]
    assert close?(bounds([cylinder]), {{0.0, -0.05, 0.45}, {1.0, 0.05, 0.55}})
    assert close?(bounds([sphere]), {{-0.1, -0.1, 0.4}, {0.1, 0.1, 0.6}})
    # From x = 1.25, twice as wide as in its file.
    [plate] = shapes["lower"]
    assert {Mesh.vertex_count(plate), Mesh.triangle_count(plate)} == {4, 2}
    assert close?(bounds([plate]), {{1.25, 0.0, 0.5}, {2.25, 0.5, 0.5}})
    assert [{"none.stl: the file does not exist", %Situ.Point3{} = point}] = shapes["hand"]
    assert near?({point.x, point.y, point.z}, {2.0, 0.0, 0.5})
  end

  defp bounds(meshes) do
    corners = meshes |> Enum.flat_map(&Mesh.list_triangles/1) |> Enum.flat_map(&Tuple.to_list/1)
    sides = for i <- 0..2, do: corners |> Enum.map(&elem(&1, i)) |> Enum.min_max()
    {low, high} = Enum.unzip(sides)
    {rounded(low), rounded(high)}
  end

  defp rounded(list), do: list |> Enum.map(&(Float.round(&1, 5) + 0.0)) |> List.to_tuple()

  defp close?({a, b}, {c, d}),
    do: Vector3.distance(a, c) < 1.0e-3 and Vector3.distance(b, d) < 1.0e-3

  test "a recording contains shapes and frames, and a stream of joint states moves both" do
    path = Path.join(folder(), "arm/urdf/arm.urdf")
    {:ok, store} = Store.open(path)
    assert Enum.map(Store.streams(store), & &1.name) == ["Robot", "Frames"]
    [%{data: shapes}] = store |> Store.messages("Robot") |> Enum.to_list()
    assert is_map_key(shapes, "upper")
    [%{data: transforms}] = store |> Store.messages("Frames") |> Enum.to_list()
    {:ok, frames} = FrameTree.put_transforms(FrameTree.new(), transforms, 0)
    assert {:ok, %Pose{position: at}} = FrameTree.lookup(frames, "hand", "rail", 0)
    assert near?(at, {2.0, 0.0, 0.5})

    {:ok, robot} = Urdf.read(path)
    states = for x <- [0.0, 0.5], do: JointState.new(["slide"], [x]) |> elem(1)

    moved =
      Situ.to_list(fn p ->
        p |> Situ.from_enumerable(states, every: 10) |> Robot.shape_stream(robot)
      end)

    assert [{0.0, _, _}, {0.5, _, _}] =
             for(%{"upper" => [mesh | _]} <- moved, do: elem(bounds([mesh]), 0))

    [_, last] =
      Situ.to_list(fn p ->
        p |> Situ.from_enumerable(states, every: 10) |> Robot.frame_stream(robot)
      end)

    assert %{pose: %{position: {0.5, 0.0, 0.0}}} = Enum.find(last, &(&1.frame == "foot"))
  end

  test "invalid files and impossible robots are errors that give the reason" do
    link = &~s(<link name="#{&1}"/>)

    joint = fn name, a, b ->
      ~s(<joint name="#{name}" type="fixed"><parent link="#{a}"/><child link="#{b}"/></joint>)
    end

    in_box = &~s(<link name="a"><visual>#{&1}</visual></link>)

    for {body, why} <- [
          {"", "no root link"},
          {link.("a") <> link.("b"), "2 root links"},
          {link.("a") <> link.("a"), ~s(two links "a")},
          {link.("a") <> joint.("j", "a", "x"), ~s(refers to the link "x", which does not exist)},
          {link.("a") <> link.("b") <> joint.("j", "a", "b") <> joint.("k", "a", "b"),
           "two joints"},
          {Enum.map_join(~w(a b c), link) <> joint.("j", "b", "c") <> joint.("k", "c", "b"),
           "form a cycle"},
          {link.("a") <> link.("b") <> ~s(<joint name="j" type="odd"/>), "an unknown type"},
          {link.("a") <> link.("b") <> ~s(<joint name="j" type="fixed"/>), "has no parent"},
          {"<link/>", "a link has no name"},
          {in_box.(~s(<geometry><box size="1 2"/></geometry>)), "must have three numbers"},
          {in_box.(~s(<geometry><sphere radius="1e99"/></geometry>)), "is not a number"},
          {in_box.(~s(<geometry><sphere/></geometry>)), "is not a number"},
          {in_box.("<geometry/>"), "contains no shape"},
          {"<link", "not well-formed"}
        ] do
      assert {:error, %{code: :bad_file, why: said}} = Urdf.parse("<robot>#{body}</robot>"), body
      assert said =~ why, "#{body}: #{said}"
    end

    doctype = ~s(<!DOCTYPE robot [<!ENTITY y "z">]><robot/>)
    assert {:error, %{code: :bad_file, why: why}} = Urdf.parse(doctype)
    assert why =~ "document type"
    assert {:error, %{why: "its first element is sdf, not robot"}} = Urdf.parse("<sdf/>")
    deep = String.duplicate("<a>", 1_000) <> String.duplicate("</a>", 1_000)
    assert {:error, %{why: why}} = Urdf.parse(deep)
    assert why =~ "nested too deeply"
  end

  test "a mesh name cannot lead outside the robot's folders" do
    folder = folder()
    File.write!(Path.join(folder, "secret.stl"), @plate)

    for name <- [
          Path.join(folder, "secret.stl"),
          "../secret.stl",
          "package://arm/../secret.stl",
          "file://#{folder}/secret.stl",
          "package:///etc/passwd.stl",
          "meshes/plate.txt",
          ""
        ] do
      xml =
        ~s(<robot><link name="a"><visual><geometry><mesh filename="#{name}"/></geometry></visual></link></robot>)

      {:ok, robot} = Urdf.parse(xml, Path.join(folder, "arm"))
      assert %{"a" => [{text, _}]} = Robot.link_shapes(robot)
      assert text =~ "outside the robot's folders" or text =~ "not supported", "#{name}: #{text}"
    end
  end

  test "solids are closed and face outwards" do
    for {mesh, volume} <- [
          {Primitives.box({1, 2, 3}), 6.0},
          {Primitives.cylinder(0.5, 2), :math.pi() * 0.25 * 2},
          {Primitives.sphere(1), 4 / 3 * :math.pi()}
        ] do
      found =
        for {a, b, c} <- Mesh.list_triangles(mesh), reduce: 0.0 do
          sum -> sum + Vector3.dot_product(a, Vector3.cross_product(b, c)) / 6
        end

      # 32 corners around the axis enclose slightly less than a circle.
      assert found / volume > 0.97 and found / volume < 1.0 + 1.0e-6
    end
  end

  test "reads binary STL, even if its header says solid, and rejects invalid files" do
    triangle =
      for v <- [0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0], into: <<>>, do: <<v::little-float-32>>

    bytes = String.pad_trailing("solid but bytes", 80) <> <<1::little-32>> <> triangle <> <<0, 0>>
    path = Path.join(folder(), "one.stl")
    File.write!(path, bytes)
    assert {:ok, %Mesh{} = mesh} = GeometryFile.read(path)
    assert Mesh.list_triangles(mesh) == [{{0.0, 0.0, 0.0}, {1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}}]
    nan = String.replace(bytes, <<1.0::little-float-32>>, <<0, 0, 0xC0, 0x7F>>)

    for {bad, why} <- [
          {binary_part(bytes, 0, 100), "do not form triangles"},
          {<<0::640, 9::little-32>>, "does not match its number of triangles"},
          {nan, "not finite"},
          {"solid\nvertex 1 2 x\n", "not a number"},
          {"solid\nvertex 1 2\n", "three numbers"},
          {"solid\nvertex 1 2 3\n", "do not form triangles"}
        ] do
      File.write!(path, bad)
      assert {:error, %{code: :bad_file, why: said}} = GeometryFile.read(path)
      assert said =~ why
    end
  end

  property "damaged files are read or rejected" do
    forall {at, byte} <- {integer(0, byte_size(@arm) - 1), integer(0, 255)} do
      <<head::binary-size(at), _, rest::binary>> = @arm

      case Urdf.parse(head <> <<byte>> <> rest) do
        {:ok, robot} -> is_map(Robot.link_shapes(robot))
        {:error, %Situ.Error{code: :bad_file}} -> true
      end
    end
  end
end
