defmodule Situ.CLI.FileKindsTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO
  alias Situ.CLI.FileKinds
  alias Situ.Recording.Formats

  @moduletag :tmp_dir
  @root Path.expand("../../../../..", __DIR__)

  test "prints the table of the guide" do
    rows =
      for kind <- FileKinds.list_kinds() do
        [title, extensions, can, needs] = FileKinds.kind_row(kind)
        extensions = extensions |> String.split(" ") |> Enum.map_join(" ", &"`#{&1}`")
        "| #{title} | #{extensions} | #{can} | #{needs} |"
      end

    guide = File.read!(Path.join(@root, "docs/guides/other-systems.md"))
    assert for(row <- rows, not String.contains?(guide, row), do: row) == []
    printed = capture_io(fn -> assert Situ.CLI.run(["formats", "--json"]) == 0 end)
    assert {:ok, kinds} = Situ.JSON.decode(printed)
    assert %{"write" => [".mcap"], "open" => true} = Enum.find(kinds, &(&1["name"] == "mcap"))
    assert capture_io(fn -> assert Situ.CLI.run(["formats"]) == 0 end) =~ "sqlite3"
  end

  test "every kind opens by its extensions, in the library and the studio as well" do
    for kind <- FileKinds.list_kinds(), kind.open, extension <- kind.extensions do
      assert Formats.for_file("x" <> extension) != nil, extension
    end

    for kind <- FileKinds.list_exports(), do: assert(kind.export -- kind.extensions == [])
  end

  @ply "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n" <>
         "end_header\n1 2 3\n"
  @pcd "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\nPOINTS 1\n" <>
         "DATA ascii\n1 2 3\n"
  @gpx ~s(<gpx version="1.1"><trk><trkseg><trkpt lat="46" lon="14"><time>2026-01-01T00:00:00Z</time></trkpt>) <>
         "</trkseg></trk></gpx>"
  @urdf ~s(<robot name="r"><link name="base"/></robot>)
  @rows ~s({"originatingTime":"2026-01-01T00:00:00Z","message":7}\n)

  test "info opens every kind of file", %{tmp_dir: root} do
    for {name, text} <- [
          {"a.ply", @ply},
          {"a.pcd", @pcd},
          {"a.gpx", @gpx},
          {"a.urdf", @urdf},
          {"a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"},
          {"a.jsonl", @rows},
          {"a.csv", "time,x\n1,2\n2,3\n"}
        ] do
      path = Path.join(root, name)
      File.write!(path, text)

      assert capture_io(fn -> assert Situ.CLI.run(["store", "info", path]) == 0 end) =~
               ~r/closed; \d stream/
    end
  end

  test "opens tables in place, and what it writes", %{tmp_dir: root} do
    rows = Path.join(root, "level.jsonl")
    lines = for day <- 1..3, do: String.replace(@rows, "01-01", "01-0#{day}")
    File.write!(rows, lines)

    for extension <- ~w(parquet arrow msgpack jsonl) do
      path = Path.join(root, "copy.#{extension}")

      assert capture_io(fn -> assert Situ.CLI.run(["store", "convert", rows, path]) == 0 end) ==
               ""

      store = Situ.Store.open!(path)
      assert {:ok, messages} = Situ.Store.read(store, "copy")
      assert Enum.map(messages, & &1.data) == [7, 7, 7]
      [first, second, third] = Enum.map(messages, & &1.originating_time)
      assert second > first and third > second
      assert {:ok, [_, _]} = Situ.Store.read(store, "copy", from: second)
      assert {:ok, [_]} = Situ.Store.read(store, "copy", to: first)
    end
  end

  test "opens files by their content", %{tmp_dir: root} do
    drive = Path.join(@root, "apps/situ_bridge/test/data/ros1_imu_gps_cam.mcap")
    path = Path.join(root, "recording without an extension")
    File.cp!(drive, path)
    assert Situ.Store.open!(path).module == Situ.Bridge.Mcap
    bytes = :crypto.strong_rand_bytes(600)
    File.write!(path, <<0>> <> bytes)
    assert {:error, %{code: :unknown_format}} = Situ.Store.open(path)
    File.write!(path, "")
    assert {:error, %{code: :unknown_format, fix: fix}} = Situ.Store.open(path)
    assert fix =~ "situ formats"
  end
end
