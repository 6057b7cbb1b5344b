defmodule Situ.Space.GeometryFile.PcdTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{PointCloud, Store}
  alias Situ.Space.GeometryFile.Pcd

  # The file from the format's own description, shortened. 4.2108e+06 is the float with the bits of (255, 255, 0)
  # there.
  @text """
  # .PCD v.7 - Point Cloud Data file format
  VERSION .7
  FIELDS x y z rgb
  SIZE 4 4 4 4
  TYPE F F F U
  COUNT 1 1 1 1
  WIDTH 3
  HEIGHT 1
  VIEWPOINT 0 0 0 1 0 0 0
  POINTS 3
  DATA ascii
  0.93773 0.33763 0 16711680
  0.90805 0.35641 0 65280
  nan 0.32 0 255
  """

  defp head(data, n),
    do:
      "VERSION .7\nFIELDS x _ y z rgb\nSIZE 4 1 8 4 4\nTYPE F U F F F\nCOUNT 1 3 1 1 1\n" <>
        "WIDTH #{n}\nHEIGHT 1\nPOINTS #{n}\nDATA #{data}\n"

  defp row(x, y, z, {r, g, b}),
    do: <<x::little-float-32, 1, 2, 3, y::little-float-64, z::little-float-32, b, g, r, 0>>

  test "reads text with colors, and a point with an invalid number is invalid" do
    assert {:ok, cloud} = Pcd.parse_file(@text)
    assert [{x, y, +0.0}, {_, _, _}] = PointCloud.to_points(cloud)
    assert_in_delta x, 0.93773, 1.0e-6
    assert_in_delta y, 0.33763, 1.0e-6
    assert PointCloud.point_count(cloud) == 3
    assert cloud.colors == <<255, 0, 0, 0, 255, 0, 0, 0, 255>>
    assert Pcd.parse_file(String.replace(@text, "\n", "\r\n")) == {:ok, cloud}
  end

  test "reads the intensity as the points' value" do
    for {data, body} <- [
          {"ascii", "1 2 3 7.5\n4 5 6 9\n"},
          {"binary", for(v <- [1, 2, 3, 7.5, 4, 5, 6, 9], into: <<>>, do: <<v::little-float-32>>)}
        ] do
      head = "FIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nPOINTS 2\nDATA #{data}\n"
      assert {:ok, cloud} = Pcd.parse_file(head <> body)
      assert cloud.values == <<7.5::little-float-32, 9.0::little-float-32>>
      assert PointCloud.to_points(cloud) == [{1.0, 2.0, 3.0}, {4.0, 5.0, 6.0}]
    end
  end

  test "reads bytes with padding, a double and packed colors" do
    rows = row(1, 2, 3, {10, 20, 30}) <> row(-1, 0.5, 0, {200, 100, 50})
    assert {:ok, cloud} = Pcd.parse_file(head("binary", 2) <> rows)
    assert PointCloud.to_points(cloud) == [{1.0, 2.0, 3.0}, {-1.0, 0.5, 0.0}]
    assert cloud.colors == <<10, 20, 30, 200, 100, 50>>
  end

  # x, padding, y, z and rgb of all points one after another; four repeated points are stored as a copy.
  test "reads compressed literals, and copies that overlap themselves" do
    n = 4
    x = <<1.0::little-float-32>>
    head = head("binary_compressed", n)
    size = n * 23

    plain =
      String.duplicate(x, n) <>
        <<0::size(n * 24)>> <> <<0::size(n * 64)>> <> <<0::size(n * 64)>>

    assert byte_size(plain) == size
    # Four literal bytes, a copy of 12 from 4 before, one 0, then copies of 0.
    packed = <<3, x::binary>> <> <<7::3, 0::5, 3, 3>> <> <<0, 0>> <> <<7::3, 0::5, 66, 0>>
    body = <<byte_size(packed)::little-32, size::little-32, packed::binary>>
    assert {:ok, cloud} = Pcd.parse_file(head <> body)
    assert PointCloud.to_points(cloud) == List.duplicate({1.0, 0.0, 0.0}, n)
  end

  @tag :tmp_dir
  test "opens as a recording", %{tmp_dir: dir} do
    path = Path.join(dir, "chair.pcd")
    File.write!(path, @text)
    assert {:ok, store} = Store.open(path)
    assert [%{name: "Points", type: PointCloud, count: 1}] = Store.streams(store)
  end

  test "rejects a number of hundreds of digits" do
    text = String.replace(@text, "0.93773", String.duplicate("9", 400))
    assert {:error, error} = Pcd.parse_file(text)
    assert error.code == :bad_file and error.why =~ "is not a number"
  end

  test "a damaged file is a readable error" do
    for {text, words} <- [
          {"", "no DATA line"},
          {"FIELDS x y\nSIZE 4 4\nTYPE F F\nPOINTS 1\nDATA ascii\n1 2\n", "no x, y and z"},
          {String.replace(@text, "POINTS 3", "POINTS 4"), "cut short"},
          {String.replace(@text, "POINTS 3", "POINTS 99999999999"), "not a valid number"},
          {String.replace(@text, "SIZE 4 4", "SIZE 3 4"), "invalid SIZE"},
          {String.replace(@text, "DATA ascii", "DATA morse"), "morse"},
          {head("binary", 5) <> "short", "cut short"},
          {head("binary_compressed", 1) <> <<2::little-32, 23::little-32, 32, 255>>, "damaged"}
        ] do
      assert {:error, error} = Pcd.parse_file(text)
      assert error.code == :bad_file and error.why =~ words, "#{inspect(error)}"
    end
  end

  property "no bytes crash it" do
    forall {data, bytes} <-
             {:proper_types.oneof(["ascii", "binary", "binary_compressed"]), binary()} do
      match?({_, _}, Pcd.parse_file(head(data, 3) <> bytes)) and
        match?({:error, _}, Pcd.parse_file(bytes))
    end
  end
end
