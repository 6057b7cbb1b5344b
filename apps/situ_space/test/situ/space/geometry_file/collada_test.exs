defmodule Situ.Space.GeometryFile.ColladaTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{Mesh, PointCloud, Store}
  alias Situ.Space.Robot.Urdf
  alias Situ.Space.GeometryFile
  alias Situ.Space.GeometryFile.Collada

  # A square and a triangle as most programs write them, with separate indices for positions and normals.
  @file_text """
  <?xml version="1.0" encoding="utf-8"?>
  <COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
    <asset><unit name="centimeter" meter="0.01"/><up_axis>Z_UP</up_axis></asset>
    <library_geometries>
      <geometry id="plate"><mesh>
        <source id="places">
          <float_array id="numbers" count="12">0 0 0 100 0 0
            100 1.e2 0 .0 100 0</float_array>
          <technique_common><accessor source="#numbers" count="4" stride="3"/></technique_common>
        </source>
        <source id="normals"><float_array count="3">0 0 1</float_array></source>
        <vertices id="corners"><input semantic="POSITION" source="#places"/></vertices>
        <polylist material="grey" count="1">
          <input semantic="VERTEX" source="#corners" offset="0"/><input semantic="NORMAL" source="#normals" offset="1"/>
          <vcount>4</vcount><p>0 0 1 0 2 0 3 0</p>
        </polylist>
        <triangles count="1">
          <input semantic="NORMAL" source="#normals" offset="0"/><input semantic="VERTEX" source="#corners" offset="1"/>
          <p>0 0 0 1 0 2</p>
        </triangles>
      </mesh></geometry>
    </library_geometries>
    <library_nodes><node id="part"><instance_geometry url="#plate"/></node></library_nodes>
    <library_visual_scenes><visual_scene id="all">
      <node><translate>0 0 200</translate><rotate>0 0 1 90</rotate>
        <node><scale>1 2 1</scale><instance_node url="#part"/></node>
      </node>
      <node><matrix>1 0 0 300 0 1 0 0 0 0 1 0 0 0 0 1</matrix><instance_geometry url="#plate"/></node>
    </visual_scene></library_visual_scenes>
    <scene><instance_visual_scene url="#all"/></scene>
  </COLLADA>
  """

  defp corners(mesh),
    do: for({x, y, z} <- PointCloud.to_points(Mesh.to_cloud(mesh)), do: {r(x), r(y), r(z)})

  defp r(x), do: Float.round(x, 4) + 0.0

  test "places nested nodes, in meters" do
    assert {:ok, mesh} = Collada.parse_file(@file_text)
    assert {Mesh.vertex_count(mesh), Mesh.triangle_count(mesh)} == {8, 6}

    # Stretched twice along y, a quarter turn around z, 2 m up and 3 m forward.
    assert corners(mesh) == [
             {0.0, 0.0, 2.0},
             {0.0, 1.0, 2.0},
             {-2.0, 1.0, 2.0},
             {-2.0, 0.0, 2.0},
             {3.0, 0.0, 0.0},
             {4.0, 0.0, 0.0},
             {4.0, 1.0, 0.0},
             {3.0, 1.0, 0.0}
           ]

    assert binary_part(mesh.indices, 0, 36) ==
             for(i <- [0, 1, 2, 0, 2, 3, 0, 1, 2], into: <<>>, do: <<i::little-32>>)
  end

  test "rotates a y-up file, unless axes: :own is given" do
    text = String.replace(@file_text, "Z_UP", "Y_UP")
    assert {:ok, turned} = Collada.parse_file(text)
    assert {:ok, own} = Collada.parse_file(text, axes: :own)
    assert corners(turned) == for({x, y, z} <- corners(own), do: {x, -z + 0.0, y})
    assert {:ok, ^own} = Collada.parse_file(@file_text)
  end

  @tag :tmp_dir
  test "opens as a recording and as a robot's shape", %{tmp_dir: folder} do
    File.write!(Path.join(folder, "plate.dae"), String.replace(@file_text, "Z_UP", "Y_UP"))
    assert {:ok, store} = Store.open(Path.join(folder, "plate.dae"))
    assert [%{name: "Mesh", type: Mesh}] = Store.streams(store)

    File.write!(Path.join(folder, "arm.urdf"), """
    <robot name="arm"><link name="base"><visual><geometry><mesh filename="package://plate.dae"/></geometry></visual></link></robot>
    """)

    {:ok, robot} = Urdf.read(Path.join(folder, "arm.urdf"))
    {:ok, own} = GeometryFile.read(Path.join(folder, "plate.dae"), axes: :own)
    [shape] = robot.links["base"]
    assert corners(shape) == corners(own)
  end

  test "an unreadable file gives the reason" do
    for {from, to, says} <- [
          {"<p>0 0 0 1 0 2</p>", "<p>0 0 0 1 0 9</p>", "vertex that does not exist"},
          {"url=\"#plate\"/></node></library", "url=\"#none\"/></node></library",
           "no geometry with the id none"},
          {"#part", "part.dae#part", "another file"},
          {"100 1.e2", "100 nan", "\"nan\" is not a number"},
          {"<rotate>0 0 1 90</rotate>", "<rotate>0 0 1</rotate>", "must have 4 numbers"},
          {"<vcount>4</vcount>", "", "numbers of corners"},
          {"<instance_geometry url=\"#plate\"/></node></library_nodes>",
           "<instance_node url=\"#part\"/></node></library_nodes>", "nested too deeply"},
          {"COLLADA", "COLLADO", "not COLLADA"},
          {"meter=\"0.01\"", "meter=\"1e11\"", nil}
        ] do
      case Collada.parse_file(String.replace(@file_text, from, to)) do
        {:error, %{code: :bad_file, why: why}} when says != nil -> assert why =~ says
        other -> assert {says, elem(other, 0)} == {nil, :ok}
      end
    end

    assert {:error, %{why: "its scene has no surface"}} =
             Collada.parse_file(String.replace(@file_text, ~r/<p>.*<\/p>/, ""))
  end

  @tag numtests: 200
  property "text that was changed anywhere is read or rejected" do
    forall {at, byte, cut} <- {integer(0, 2_600), integer(32, 126), integer(0, 400)} do
      at = rem(at, byte_size(@file_text))
      <<before::binary-size(at), _, rest::binary>> = @file_text
      changed = before <> <<byte>> <> rest
      assert elem(Collada.parse_file(changed), 0) in [:ok, :error]
      cut = binary_part(changed, 0, byte_size(changed) - cut)
      assert elem(Collada.parse_file(cut), 0) in [:ok, :error]
    end
  end
end
