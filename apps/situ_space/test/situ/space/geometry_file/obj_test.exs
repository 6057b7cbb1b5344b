defmodule Situ.Space.GeometryFile.ObjTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{Mesh, PointCloud, Store}
  alias Situ.Space.GeometryFile.Obj

  @pyramid """
  # A pyramid over a square.
  mtllib stone.mtl
  o Pyramid
  v -1 -1 0
  v 1 -1 0
  v 1.0 1.0 0
  v -1 1 0
  vn 0 0 1
  vt 0.5 0.5
  v 0 0 1e0
  usemtl stone
  f 1 2 3 4
  f 1//1 2//1 5//1
  f 2/1/1 3/1/1 -1/1/1
  f 3/1 4/1 5/1
  f -2 -5 -1
  """

  test "polygons of a mesh become triangles, and indices count from either end" do
    assert {:ok, %Mesh{} = mesh} = Obj.parse_file(@pyramid)
    assert Mesh.triangle_count(mesh) == 6
    indices = for <<i::little-32 <- mesh.indices>>, do: i

    assert Enum.chunk_every(indices, 3) ==
             [[0, 1, 2], [0, 2, 3], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]

    assert Obj.parse_file(String.replace(@pyramid, "\n", "\r\n")) == {:ok, mesh}
  end

  test "a file without faces is a cloud, with colors if all points have one" do
    assert {:ok, %PointCloud{} = cloud} = Obj.parse_file("v 1 2 3 1 0 0.5\nv 4 5 6 0 2 -1\n")
    assert PointCloud.to_points(cloud) == [{1.0, 2.0, 3.0}, {4.0, 5.0, 6.0}]
    assert cloud.colors == <<255, 0, 128, 0, 255, 0>>
    assert {:ok, %{colors: nil}} = Obj.parse_file("v 1 2 3 1 0 0\nv 4 5 6\n")
  end

  @tag :tmp_dir
  test "opens as a recording", %{tmp_dir: dir} do
    path = Path.join(dir, "pyramid.obj")
    File.write!(path, @pyramid)
    assert {:ok, store} = Store.open(path)
    assert [%{name: "Mesh", type: Mesh, count: 1}] = Store.streams(store)
  end

  test "a damaged file is a readable error" do
    for {text, words} <- [
          {"", "no vertices"},
          {"v 1 2\n", "fewer than three numbers"},
          {"v 1 2 left\n", ~s("left" is not a number)},
          {"v 1 2 1e99\n", "not finite"},
          {"v 1 2 " <> String.duplicate("9", 400), "is not a number"},
          {"v 1 2 3\nf 1 1\n", "fewer than three vertices"},
          {"v 1 2 3\nf 1 1 2\n", ~s(refers to vertex "2" of 1)},
          {"v 1 2 3\nf 1 1 0\n", "refers to vertex"},
          {"v 1 2 3\nf 1 1 -2\n", "refers to vertex"},
          {"v 1 2 3\nf 1 1 1x\n", "refers to vertex"}
        ] do
      assert {:error, error} = Obj.parse_file(text)
      assert error.code == :bad_file and error.why =~ words, "#{text}: #{error.why}"
    end
  end

  property "no bytes crash it" do
    forall bytes <- binary() do
      match?({_, _}, Obj.parse_file(bytes)) and
        match?({_, _}, Obj.parse_file("v 1 2 3\nf " <> bytes))
    end
  end
end
