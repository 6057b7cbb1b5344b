defmodule Situ.CLI.Store.McapStructureTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO

  @moduletag :tmp_dir
  @drive Path.expand("../../../../../situ_bridge/test/data/ros1_imu_gps_cam.mcap", __DIR__)

  defp situ(argv), do: with_io(fn -> Situ.CLI.run(["store" | argv]) end)

  defp json(argv) do
    assert {0, said} = situ(argv ++ ["--json"])
    {:ok, value} = Situ.JSON.decode(said)
    value
  end

  defp shown(file, part), do: json(["list", file, "--show", part])

  test "shows channels, schemas and their definitions" do
    channels = shown(@drive, "channels")

    assert %{"schema" => "sensor_msgs/Imu", "messages" => 250, "encoding" => "ros1"} =
             Enum.find(channels, &(&1["topic"] == "/imu/data_raw"))

    schemas = shown(@drive, "schemas")

    assert %{"definition" => "string data" <> _} =
             Enum.find(schemas, &(&1["name"] == "std_msgs/String"))

    argv = ["info", @drive, "--show", "schemas", "-s", "std_msgs/String"]
    assert {0, "string data" <> _} = situ(argv)
    assert {0, table} = situ(["info", @drive, "--show", "channels"])
    assert table =~ "/gps/fix" and table =~ "sensor_msgs/NavSatFix"
  end

  test "shows chunks that cover the file, with and without its index", %{tmp_dir: root} do
    chunks = shown(@drive, "chunks")
    assert chunks != []

    for c <- chunks,
        do: assert(c["last"] >= c["first"] and c["unpacked"] > 0 and c["size"] > c["packed"])

    # The same file without its index has the same chunks.
    torn = Path.join(root, "torn.mcap")
    bytes = File.read!(@drive)
    last = List.last(chunks)
    File.write!(torn, binary_part(bytes, 0, last["offset"] + last["size"]))
    assert shown(torn, "chunks") == chunks
  end

  test "shows the bytes of every topic" do
    sizes = Map.new(shown(@drive, "sizes"), &{&1["topic"], &1["bytes"]})
    # A message is a header of 12 bytes and a string.
    assert sizes["/imu/data_raw"] > sizes["/chatter"] and sizes["/chatter"] > 0
    assert map_size(sizes) == 5
  end

  test "adds attachments and metadata, which survive a conversion", %{tmp_dir: root} do
    note = Path.join(root, "note.txt")
    File.write!(note, "left wheel squeaks")
    [one, two] = for n <- ~w(one two), do: Path.join(root, n <> ".mcap")
    argv = ["convert", @drive, one, "--attach", note, "--metadata", "robot:serial=7", "--json"]
    assert {0, _} = situ(argv)

    assert {0, _} =
             situ(["convert", one, two, "--metadata", "robot:name=R2", "--compression", "none"])

    assert [%{"name" => "note.txt", "size" => 18}] = shown(two, "attachments")
    assert [%{"name" => "robot", "metadata" => %{"name" => "R2"}}] = shown(two, "metadata")
    assert [%{"metadata" => %{"serial" => "7"}}] = shown(one, "metadata")
    assert {0, "left wheel squeaks"} = situ(["attachments", two, "note.txt"])

    said =
      capture_io(:stderr, fn ->
        assert {2, _} = situ(["convert", one, Path.join(root, "x.bag"), "--attach", note])
      end)

    assert said =~ "cannot contain attachments"
  end

  test "rejects recordings that have no such parts", %{tmp_dir: root} do
    assert {0, _} = situ(["copy", @drive, Path.join(root, "drive"), "-s", "/chatter"])

    said =
      capture_io(:stderr, fn ->
        assert {1, _} = situ(["list", Path.join(root, "drive"), "--show", "chunks"])
      end)

    assert said =~ "not an MCAP file"
  end
end
