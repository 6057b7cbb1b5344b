defmodule Situ.Space.GeometryFileTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{Box3, Mesh, PointCloud, Store}
  alias Situ.Space.GeometryFile
  alias Situ.Space.GeometryFile.{Las, Ply}

  @las Path.expand("../../data/simple.las", __DIR__)

  # Its header says 1,065 points between (635619.85, 848899.70, 406.59) and (638982.55, 853535.43, 586.38).
  test "a real LAS file matches its header" do
    assert {:ok, store} = Store.open(@las)
    assert [%{name: "Points", type: PointCloud, count: 1}] = Store.streams(store)

    assert [%{data: cloud, originating_time: 0}] =
             store |> Store.messages("Points") |> Enum.to_list()

    assert PointCloud.point_count(cloud) == 1_065
    assert cloud.colors != nil
    %Box3{min: {x0, y0, z0}, max: {x1, y1, z1}} = PointCloud.bounding_box(cloud)
    assert Enum.all?([x0, y0, z0], &(abs(&1) < 0.01))
    assert_in_delta x1, 638_982.55 - 635_619.85, 0.01
    assert_in_delta y1, 853_535.43 - 848_899.70, 0.01
    assert_in_delta z1, 586.38 - 406.59, 0.01
    {x, y, _} = Store.info(store).origin
    assert {Float.round(x, 2), Float.round(y, 2)} == {635_619.85, 848_899.7}
  end

  # Compressed by LASzip, the reference implementation.
  test "LAZ files contain the same points as the LAS file" do
    {:ok, whole} = GeometryFile.read(@las)
    assert GeometryFile.read(Path.rootname(@las) <> ".laz") == {:ok, whole}
    layered = Path.join(Path.dirname(@las), "layered.laz")
    assert {:ok, store} = Store.open(layered)
    [%{data: few}] = store |> Store.messages("Points") |> Enum.to_list()
    assert PointCloud.point_count(few) == 200
    {ox, oy, oz} = Store.info(store).origin
    {wx, wy, wz} = Store.info(Store.open!(@las)).origin

    for {{x, y, z}, {a, b, c}} <-
          Enum.zip(PointCloud.to_points(few), PointCloud.to_points(whole)) do
      assert_in_delta x + ox, a + wx, 0.006
      assert_in_delta y + oy, b + wy, 0.006
      assert_in_delta z + oz, c + wz, 0.006
    end

    assert few.colors == binary_part(whole.colors, 0, 600)
    # The intensities of the first points, as laspy reads them.
    assert <<143.0::little-float-32, 18.0::little-float-32, _::binary>> = whole.values
    assert few.values == binary_part(whole.values, 0, 800)
  end

  doctest Situ.Space.GeometryFile.NumberParser

  describe "invalid or too large numbers in text" do
    setup do
      root = Path.join(System.tmp_dir!(), "situ-scan-#{System.unique_integer([:positive])}")
      File.mkdir_p!(root)
      on_exit(fn -> File.rm_rf!(root) end)

      %{
        read: fn name, text ->
          path = Path.join(root, name)
          File.write!(path, text)
          GeometryFile.read(path)
        end
      }
    end

    test "are clear errors in a mesh", %{read: read} do
      stl =
        &"solid a\nfacet\nvertex 0 0 #{&1}\nvertex 1 0 0\nvertex 0 1 0\nendfacet\nendsolid a\n"

      for {z, told} <- [
            {"1.0e400", "1.0e400, which is not finite"},
            {"1e39", "not finite in 32 bits"},
            {"nan", "nan, which is not finite"},
            {"x", ~s("x" is not a number)}
          ],
          {name, text} <- [
            {"a.obj", "v 0 0 #{z}\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"},
            {"a.stl", stl.(z)}
          ] do
        assert {:error, %{code: :bad_file, why: why}} = read.(name, text)
        assert why =~ told
      end
    end

    test "make points of a cloud invalid, and colors are clamped", %{read: read} do
      ply =
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n" <>
          "property float red\nproperty float green\nproperty float blue\nend_header\n" <>
          "1 2 3 1e400 nan .5\n-1.0e400 0 0 1 1e308 -1e308\n4 5 nan 0 0 0\n"

      assert {:ok, cloud} = read.("a.ply", ply)
      assert PointCloud.to_points(cloud) == [{1.0, 2.0, 3.0}]
      assert PointCloud.point_count(cloud) == 3
      assert cloud.colors == <<255, 0, 128, 255, 255, 0, 0, 0, 0>>

      pcd = fn row ->
        "FIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nPOINTS 2\nDATA ascii\n1 2 3 0\n#{row}\n"
      end

      assert {:ok, cloud} = read.("a.pcd", pcd.("inf -1e400 5 1e39"))
      assert PointCloud.to_points(cloud) == [{1.0, 2.0, 3.0}]
      assert PointCloud.point_count(cloud) == 2
      assert cloud.colors == <<0::48>>
      assert {:error, %{why: ~s("x" is not a number)}} = read.("a.pcd", pcd.("1 x 5 0"))
      short = String.replace(pcd.("1 2 3 4"), "COUNT 1 1 1 1", "COUNT 1 1 1")
      assert {:error, %{why: why}} = read.("a.pcd", short)
      assert why =~ "4 FIELDS, but a COUNT of 3"
      assert {:ok, _} = read.("a.pcd", String.replace(pcd.("1 2 3 4"), "POINTS", " \nPOINTS"))
    end

    test "are errors in PLY lists", %{read: read} do
      for n <- ["-3", "1.5", "nan"] do
        text =
          "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n" <>
            "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n#{n} 0 0 0\n"

        assert {:error, %{code: :bad_file}} = read.("a.ply", text)
      end
    end

    test "OBJ lines continue after a backslash, and colors may be NaN", %{read: read} do
      text = "v 0 0 \\\n0 nan nan nan\nv 1 0 0 1 0.5 0\nv 0 1 0 2 -1 inf\n"
      assert {:ok, %PointCloud{colors: colors}} = read.("a.obj", text)
      assert colors == <<0, 0, 0, 255, 128, 0, 255, 0, 255>>
      assert {:ok, %Mesh{} = mesh} = read.("a.obj", text <> "f 1 \\\r\n 2 3\n")
      assert Mesh.encode(mesh) |> IO.iodata_length() > 0
    end
  end

  test "PLY text: a number of hundreds of digits is an error" do
    text =
      "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n" <>
        "property float z\nend_header\n#{String.duplicate("9", 400)}.5 2 3\n"

    assert {:error, %{code: :bad_file, why: why}} = Ply.parse_file(text)
    assert why =~ "invalid numbers"
  end

  test "PLY text: a cloud with colors" do
    text =
      "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 2\n" <>
        "property float x\nproperty float y\nproperty float z\n" <>
        "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n1 2 3 255 0 7\n-1.5 0 1e2 0 300 1\n"

    assert {:ok, cloud} = Ply.parse_file(text)
    assert PointCloud.to_points(cloud) == [{1.0, 2.0, 3.0}, {-1.5, 0.0, 100.0}]
    assert cloud.colors == <<255, 0, 7, 0, 255, 1>>
    assert Ply.parse_file(String.replace(text, "\n", "\r\n")) == {:ok, cloud}
  end

  test "PLY: a scanner's intensity is the points' value" do
    text =
      "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n" <>
        "property float intensity\nend_header\n1 2 3 0.5\n4 5 6 8\n"

    assert {:ok, cloud} = Ply.parse_file(text)
    assert cloud.values == <<0.5::little-float-32, 8.0::little-float-32>>
  end

  defp binary_ply do
    head =
      "ply\nformat binary_little_endian 1.0\nelement vertex 4\n" <>
        "property double x\nproperty double y\nproperty double z\n" <>
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"

    vertices =
      for v <- [0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0], into: <<>>, do: <<v::little-float-64>>

    head <> vertices <> <<4, 0::little-32, 1::little-32, 2::little-32, 3::little-32>>
  end

  @tag :tmp_dir
  test "PLY bytes: a square of two triangles", %{tmp_dir: folder} do
    path = Path.join(folder, "square.ply")
    File.write!(path, binary_ply())
    assert {:ok, %Mesh{} = mesh} = GeometryFile.read(path)
    assert {Mesh.vertex_count(mesh), Mesh.triangle_count(mesh)} == {4, 2}
    assert {:ok, store} = Store.open(path)
    assert [%{name: "Mesh"}] = Store.streams(store)
  end

  test "PLY bytes in big-endian order" do
    head =
      "ply\nformat binary_big_endian 1.0\nelement vertex 3\nproperty float x\nproperty double y\n" <>
        "property short z\nelement face 1\nproperty list uchar uint vertex_indices\nend_header\n"

    rows =
      for {x, y, z} <- [{1.5, 2.5, -3}, {0.0, 1.0, 2}, {4.0, 0.0, 0}],
          into: <<>>,
          do: <<x::float-32, y::float-64, z::16>>

    assert {:ok, mesh} = Ply.parse_file(head <> rows <> <<3, 0::32, 1::32, 2::32>>)
    assert mesh.indices == <<0::little-32, 1::little-32, 2::little-32>>
    assert hd(PointCloud.to_points(Mesh.to_cloud(mesh))) == {1.5, 2.5, -3.0}
  end

  test "an invalid file gives the reason" do
    las = File.read!(@las)
    assert {:error, %{why: "it is cut short" <> _}} = Las.parse_file(binary_part(las, 0, 2_000))
    assert {:error, %{why: "its header is invalid"}} = Las.parse_file("LASF")
    <<before::binary-size(104), _, rest::binary>> = las

    assert {:error, %{why: "it is compressed, but" <> _}} =
             Las.parse_file(before <> <<131>> <> rest)

    assert {:error, %{why: "its header has no end"}} = Ply.parse_file("ply\nformat ascii 1.0\n")

    assert {:error, %{why: "its format morse is unknown"}} =
             Ply.parse_file("ply\nformat morse 1.0\nend_header\n")

    assert {:error, %{why: "it is cut short"}} =
             Ply.parse_file(binary_part(binary_ply(), 0, byte_size(binary_ply()) - 3))

    assert {:error, %{why: "a face refers" <> _}} =
             Ply.parse_file(
               String.replace(binary_ply(), <<4, 0::little-32>>, <<4, 9::little-32>>)
             )

    assert {:error, %{why: "its number of" <> _}} =
             Ply.parse_file("ply\nformat ascii 1.0\nelement vertex 99999999999\nend_header\n")

    bomb = "ply\nformat binary_little_endian 1.0\nelement vertex 90000000\nend_header\nfew bytes"
    assert {:error, %{why: "it is cut short"}} = Ply.parse_file(bomb)
    assert {:error, %{code: :no_file}} = GeometryFile.read("/nowhere/x.ply")
  end

  @tag numtests: 300
  property "files with changed bytes are read or rejected" do
    las = File.read!(@las)
    laz = File.read!(Path.join(Path.dirname(@las), "layered.laz"))

    forall {at, byte, cut} <- {integer(0, 400), integer(0, 255), integer(0, 600)} do
      for {module, file} <- [{Las, las}, {Las, laz}, {Ply, binary_ply()}] do
        at = rem(at, byte_size(file))
        <<before::binary-size(at), _, rest::binary>> = file
        changed = before <> <<byte>> <> rest
        cut = binary_part(changed, 0, max(byte_size(changed) - cut, 0))
        assert elem(module.parse_file(changed), 0) in [:ok, :error]
        assert elem(module.parse_file(cut), 0) in [:ok, :error]
      end
    end
  end
end
