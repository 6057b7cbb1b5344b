defmodule Situ.CLI.Store.ForeignTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO

  @moduletag :tmp_dir
  @drive Path.expand("../../../../../situ_bridge/test/data/ros1_imu_gps_cam.mcap", __DIR__)

  defp situ(argv), do: with_io(fn -> Situ.CLI.run(["store" | argv]) end)

  test "a sound file is read to its end", %{tmp_dir: root} do
    assert {0, said} = situ(["verify", @drive])
    assert said =~ "545 messages, all can be read"
    copy = Path.join(root, "copy.mcap")
    File.cp!(@drive, copy)
    assert {0, said} = situ(["doctor", @drive, copy, "--json"])

    assert {:ok, [%{"messages" => 545, "damage" => []}, %{"messages" => 545}]} =
             Situ.JSON.decode(said)
  end

  test "one that is cut short or altered is told to be damaged, with the way out", %{
    tmp_dir: root
  } do
    bytes = File.read!(@drive)
    cut = Path.join(root, "cut.mcap")
    File.write!(cut, binary_part(bytes, 0, div(byte_size(bytes), 2)))
    assert {1, said} = situ(["verify", cut])
    assert said =~ "DAMAGED" and said =~ "situ store import --skip-damage"

    altered = Path.join(root, "altered.mcap")
    at = div(byte_size(bytes), 3)
    <<before::binary-size(at), byte, rest::binary>> = bytes
    File.write!(altered, [before, Bitwise.bxor(byte, 0x55), rest])
    assert {1, said} = situ(["verify", altered, "--json"])
    assert {:ok, %{"damage" => [_ | _]}} = Situ.JSON.decode(said)
  end

  test "repair leaves such files alone, and says so" do
    said = capture_io(:stderr, fn -> assert Situ.CLI.run(["store", "repair", @drive]) == 1 end)
    assert said =~ "left as it is" and said =~ "import"
  end
end
