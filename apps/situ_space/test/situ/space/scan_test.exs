defmodule Situ.Space.ScanTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{Box3, Mesh, PointCloud, Store}
  alias Situ.Space.Scan
  alias Situ.Space.Scan.{Las, Ply}

  @las Path.expand("../../data/simple.las", __DIR__)

  # Its header says 1,065 points between (635619.85, 848899.70, 406.59) and (638982.55, 853535.43, 586.38).
  test "a real LAS file, as its header says" do
    assert {:ok, store} = Store.open(@las)
    assert [%{name: "Points", type: PointCloud, count: 1}] = Store.streams(store)

    assert [%{data: cloud, originating_time: 0}] =
             store |> Store.messages("Points") |> Enum.to_list()

    assert PointCloud.count(cloud) == 1_065
    assert cloud.colors != nil
    %Box3{min: {x0, y0, z0}, max: {x1, y1, z1}} = PointCloud.bounds(cloud)
    assert Enum.all?([x0, y0, z0], &(abs(&1) < 0.01))
    assert_in_delta x1, 638_982.55 - 635_619.85, 0.01
    assert_in_delta y1, 853_535.43 - 848_899.70, 0.01
    assert_in_delta z1, 586.38 - 406.59, 0.01
    {x, y, _} = Store.info(store).origin
    assert {Float.round(x, 2), Float.round(y, 2)} == {635_619.85, 848_899.7}
  end

  # Packed by LASzip, the reference.
  test "LAZ files are what the LAS file is" do
    {:ok, whole} = Scan.read(@las)
    assert Scan.read(Path.rootname(@las) <> ".laz") == {:ok, whole}
    layered = Path.join(Path.dirname(@las), "layered.laz")
    assert {:ok, store} = Store.open(layered)
    [%{data: few}] = store |> Store.messages("Points") |> Enum.to_list()
    assert PointCloud.count(few) == 200
    {ox, oy, oz} = Store.info(store).origin
    {wx, wy, wz} = Store.info(Store.open!(@las)).origin

    for {{x, y, z}, {a, b, c}} <-
          Enum.zip(PointCloud.to_points(few), PointCloud.to_points(whole)) do
      assert_in_delta x + ox, a + wx, 0.006
      assert_in_delta y + oy, b + wy, 0.006
      assert_in_delta z + oz, c + wz, 0.006
    end

    assert few.colors == binary_part(whole.colors, 0, 600)
    # laspy's intensities of the first points
    assert <<143.0::little-float-32, 18.0::little-float-32, _::binary>> = whole.values
    assert few.values == binary_part(whole.values, 0, 800)
  end

  doctest Situ.Space.Scan.Text

  test "PLY as text: a number of hundreds of digits is an error" do
    text =
      "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n" <>
        "property float z\nend_header\n#{String.duplicate("9", 400)}.5 2 3\n"

    assert {:error, %{code: :bad_file, why: why}} = Ply.read(text)
    assert why =~ "holds no numbers"
  end

  test "PLY as text: a cloud with colours" do
    text =
      "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 2\n" <>
        "property float x\nproperty float y\nproperty float z\n" <>
        "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n1 2 3 255 0 7\n-1.5 0 1e2 0 300 1\n"

    assert {:ok, cloud} = Ply.read(text)
    assert PointCloud.to_points(cloud) == [{1.0, 2.0, 3.0}, {-1.5, 0.0, 100.0}]
    assert cloud.colors == <<255, 0, 7, 0, 255, 1>>
    assert Ply.read(String.replace(text, "\n", "\r\n")) == {:ok, cloud}
  end

  test "PLY: a scanner's intensity is the points' value" do
    text =
      "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n" <>
        "property float intensity\nend_header\n1 2 3 0.5\n4 5 6 8\n"

    assert {:ok, cloud} = Ply.read(text)
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
  test "PLY as bytes: a square as two triangles", %{tmp_dir: folder} do
    path = Path.join(folder, "square.ply")
    File.write!(path, binary_ply())
    assert {:ok, %Mesh{} = mesh} = Scan.read(path)
    assert {Mesh.vertex_count(mesh), Mesh.triangle_count(mesh)} == {4, 2}
    assert {:ok, store} = Store.open(path)
    assert [%{name: "Mesh"}] = Store.streams(store)
  end

  test "PLY as bytes of the other order" do
    head =
      "ply\nformat binary_big_endian 1.0\nelement vertex 3\nproperty float x\nproperty double y\n" <>
        "property short z\nelement face 1\nproperty list uchar uint vertex_indices\nend_header\n"

    rows =
      for {x, y, z} <- [{1.5, 2.5, -3}, {0.0, 1.0, 2}, {4.0, 0.0, 0}],
          into: <<>>,
          do: <<x::float-32, y::float-64, z::16>>

    assert {:ok, mesh} = Ply.read(head <> rows <> <<3, 0::32, 1::32, 2::32>>)
    assert mesh.indices == <<0::little-32, 1::little-32, 2::little-32>>
    assert hd(PointCloud.to_points(Mesh.to_cloud(mesh))) == {1.5, 2.5, -3.0}
  end

  test "what is none says why" do
    las = File.read!(@las)
    assert {:error, %{why: "it is cut short" <> _}} = Las.read(binary_part(las, 0, 2_000))
    assert {:error, %{why: "its header is none"}} = Las.read("LASF")
    <<before::binary-size(104), _, rest::binary>> = las

    assert {:error, %{why: "it is compressed, and does not say how"}} =
             Las.read(before <> <<131>> <> rest)

    assert {:error, %{why: "its header has no end"}} = Ply.read("ply\nformat ascii 1.0\n")

    assert {:error, %{why: "its format is morse"}} =
             Ply.read("ply\nformat morse 1.0\nend_header\n")

    assert {:error, %{why: "it is cut short"}} =
             Ply.read(binary_part(binary_ply(), 0, byte_size(binary_ply()) - 3))

    assert {:error, %{why: "a face names" <> _}} =
             Ply.read(String.replace(binary_ply(), <<4, 0::little-32>>, <<4, 9::little-32>>))

    assert {:error, %{why: "it has no sensible" <> _}} =
             Ply.read("ply\nformat ascii 1.0\nelement vertex 99999999999\nend_header\n")

    bomb = "ply\nformat binary_little_endian 1.0\nelement vertex 90000000\nend_header\nfew bytes"
    assert {:error, %{why: "it is cut short"}} = Ply.read(bomb)
    assert {:error, %{code: :no_file}} = Scan.read("/nowhere/x.ply")
  end

  @tag numtests: 300
  property "bytes that were changed anywhere are read or refused, never more" do
    las = File.read!(@las)
    laz = File.read!(Path.join(Path.dirname(@las), "layered.laz"))

    forall {at, byte, cut} <- {integer(0, 400), integer(0, 255), integer(0, 600)} do
      for {module, file} <- [{Las, las}, {Las, laz}, {Ply, binary_ply()}] do
        at = rem(at, byte_size(file))
        <<before::binary-size(at), _, rest::binary>> = file
        changed = before <> <<byte>> <> rest
        cut = binary_part(changed, 0, max(byte_size(changed) - cut, 0))
        assert elem(module.read(changed), 0) in [:ok, :error]
        assert elem(module.read(cut), 0) in [:ok, :error]
      end
    end
  end
end
