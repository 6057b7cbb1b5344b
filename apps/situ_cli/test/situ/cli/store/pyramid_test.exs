defmodule Situ.CLI.Store.PyramidTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO
  alias Situ.{Message, Store}

  @moduletag :tmp_dir
  @drive Path.expand("../../../../../situ_bridge/test/data/ros1_imu_gps_cam.mcap", __DIR__)

  defp json(argv) do
    {0, said} = with_io(fn -> Situ.CLI.run(["store", "pyramid" | argv] ++ ["--json"]) end)
    {:ok, value} = Situ.JSON.decode(said)
    value
  end

  test "the columns of a stored pyramid cover every message", %{tmp_dir: root} do
    {:ok, writer} = Store.Writer.create("r", root)
    {:ok, stream} = Store.Writer.stream(writer, "Level", type: :float)

    messages =
      for i <- 1..1_000,
          do: %Message{data: i / 1, originating_time: i * 1_000, creation_time: i, sequence_id: i}

    {:ok, _} = Store.Writer.append(stream, messages)
    :ok = Store.Writer.close(writer)

    assert [%{"stream" => "Level", "stored" => true, "tracks" => [track]}] =
             json([writer.path, "--pixels", "10"])

    assert %{"kind" => "numbers", "bins" => bins} = track
    assert bins |> Enum.map(& &1["count"]) |> Enum.sum() == 1_000
    assert Enum.map(bins, & &1["max"]) |> Enum.max() == 1_000.0
    assert length(bins) in 10..21

    argv = ["store", "pyramid", writer.path, "-s", "Level"]
    assert capture_io(fn -> assert Situ.CLI.run(argv) == 0 end) =~ "least"
  end

  test "builds the pyramids of an external file in a copy", %{tmp_dir: root} do
    out = Path.join(root, "drive")
    chosen = ["-s", "/gps/fix", "-s", "/chatter"]
    read = json([@drive | chosen])
    assert Enum.map(read, & &1["stored"]) == [false, false]
    assert %{"path" => path} = json([@drive, "--build", out | chosen])
    built = json([path])
    assert Enum.map(built, & &1["stored"]) == [true, true]
    # The bins contain the same messages.
    assert Enum.map(built, & &1["counts"]) == Enum.map(read, & &1["counts"])
  end

  test "rejects a width without pixels", %{tmp_dir: root} do
    argv = ["store", "pyramid", root, "--pixels", "0"]
    assert capture_io(:stderr, fn -> assert Situ.CLI.run(argv) == 2 end) =~ "--pixels"
  end
end
