defmodule Situ.CLI.Store.ExternalFilesTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO

  @moduletag :tmp_dir
  @drive Path.expand("../../../../../situ_bridge/test/data/ros1_imu_gps_cam.mcap", __DIR__)

  defp situ(argv), do: with_io(fn -> Situ.CLI.run(["store" | argv]) end)

  test "reads an intact file to its end", %{tmp_dir: root} do
    assert {0, said} = situ(["verify", @drive])
    assert said =~ "545 messages, all readable"
    copy = Path.join(root, "copy.mcap")
    File.cp!(@drive, copy)
    assert {0, said} = situ(["doctor", @drive, copy, "--json"])

    assert {:ok, [%{"messages" => 545, "damage" => []}, %{"messages" => 545}]} =
             Situ.JSON.decode(said)
  end

  test "copies a damaged file only with --skip-damage", %{tmp_dir: root} do
    csv = Path.join(root, "walk.csv")
    File.write!(csv, "time,x\n0,1\nnever,2\n1,3\nlater,4\n")
    bag = Path.join(root, "cut.bag")
    File.write!(bag, binary_part(File.read!(Path.rootname(@drive) <> ".bag"), 0, 60_000))

    for {path, why} <- [{csv, ~s("never" is not a valid time; and 1 more)}, {bag, "cut short"}],
        verb <- ["import", "copy"] do
      out = Path.join(root, "out")
      said = failed([verb, path, out, "--quiet"])
      assert said =~ why and said =~ "--skip-damage"
      assert Path.wildcard(out <> "*") == []
    end

    out = Path.join(root, "kept")
    assert {0, _} = situ(["import", csv, out, "--quiet", "--skip-damage"])
    assert {:ok, [%{data: 1}, %{data: 3}]} = Situ.Store.read(Situ.Store.open!(out), "x", limit: 9)
  end

  test "reports no latencies of files with one time per message" do
    bag = Path.rootname(@drive) <> ".bag"
    assert {0, said} = situ(["stats", bag, "--stream", "/chatter"])
    assert said =~ ~r{/chatter  .* -    -    -\n}
    assert {0, said} = situ(["stats", bag, "--stream", "/chatter", "--json"])
    assert {:ok, [%{"latency_p50" => nil, "latency_mean" => nil}]} = Situ.JSON.decode(said)
  end

  test "lists the files of a folder after its recordings", %{tmp_dir: root} do
    File.mkdir_p!(Path.join(root, "drives/monday"))
    File.cp!(@drive, Path.join(root, "drives/monday/one.MCAP"))
    File.write!(Path.join(root, "notes.txt"), "nothing to see")
    File.write!(Path.join(root, "data.json"), "{}")
    # A link back to the folder, which lists nothing twice.
    File.ln_s!(root, Path.join(root, "drives/again"))
    File.ln_s!(root, Path.join(root, "drives/and_again"))
    assert {0, said} = situ(["info", root])
    assert said =~ "No stores in #{root}."
    assert said =~ "1 file that Situ can open"
    assert said =~ ~r{drives/monday/one\.MCAP  MCAP, 62\.\d kB\n\z}

    store = Path.join(root, "copy.0000")
    assert {0, _} = situ(["copy", Path.join(root, "drives/monday/one.MCAP"), store, "--quiet"])
    assert {0, said} = situ(["info", root])
    assert length(String.split(said, "copy.0000")) == 2
    assert said =~ "copy.0000  8 streams" and said =~ "1 file that Situ can open"
    assert {0, said} = situ(["info", root, "--json"])
    assert {:ok, [%{"streams" => _}]} = Situ.JSON.decode(said)
  end

  test "reports a truncated or altered file as damaged, and how to recover it", %{
    tmp_dir: root
  } do
    bytes = File.read!(@drive)
    cut = Path.join(root, "cut.mcap")
    File.write!(cut, binary_part(bytes, 0, div(byte_size(bytes), 2)))
    assert {1, said} = situ(["verify", cut])
    assert said =~ "DAMAGED" and said =~ "situ store recover"

    altered = Path.join(root, "altered.mcap")
    at = div(byte_size(bytes), 3)
    <<before::binary-size(at), byte, rest::binary>> = bytes
    File.write!(altered, [before, Bitwise.bxor(byte, 0x55), rest])
    assert {1, said} = situ(["verify", altered, "--json"])
    assert {:ok, %{"damage" => [_ | _]}} = Situ.JSON.decode(said)
  end

  test "repair does not change external files, and says so" do
    assert failed(["repair", @drive]) =~ "never changed"
    assert failed(["repair", @drive]) =~ "situ store recover"
    bag = Path.rootname(@drive) <> ".bag"
    assert failed(["repair", bag]) =~ "situ store import --skip-damage"
    assert failed(["recover", bag, "out.bag"]) =~ "situ store import --skip-damage"
    assert failed(["recover", @drive, "out.bag"]) =~ "ends in .mcap"
  end

  defp failed(argv),
    do: capture_io(:stderr, fn -> assert Situ.CLI.run(["store" | argv]) == 1 end)

  test "reports the invalid rows of a table", %{tmp_dir: root} do
    path = Path.join(root, "walk.csv")
    File.write!(path, "time,x\n0,1\nnever,2\n1,3\n")
    assert {0, said} = situ(["info", path])
    assert said =~ ~s(walk.csv: line 3: "never" is not a valid time)
  end

  test "recovers the readable part of a damaged MCAP file into a new one", %{tmp_dir: root} do
    sound = Path.join(root, "sound.mcap")
    {:ok, _} = @drive |> Situ.Store.open!() |> Situ.Bridge.Mcap.copy(sound, chunk: 20_000)
    bytes = File.read!(sound)
    broken = Path.join(root, "broken.mcap")
    whole = Path.join(root, "whole.mcap")
    at = div(byte_size(bytes), 3)
    <<before::binary-size(at), _::binary-20, rest::binary>> = bytes
    # Without its end, the file has no index.
    File.write!(broken, [
      before,
      :binary.copy(<<0xAA>>, 20),
      binary_part(rest, 0, byte_size(rest) - 100)
    ])

    said =
      capture_io(:stderr, fn ->
        assert {0, json} = situ(["recover", broken, whole, "--json"])
        assert {:ok, %{"messages" => n, "left_out" => [_ | _]}} = Situ.JSON.decode(json)
        assert n > 100
      end)

    assert said =~ "Omitted: "
    assert {0, said} = situ(["verify", whole])
    assert said =~ "all readable"

    assert failed(["recover", root, whole]) =~ "repaired in place"
  end

  test "writes a file named .mcap as MCAP with the original bytes", %{tmp_dir: root} do
    want = raw(@drive)

    for {verb, more} <- [
          {"copy", []},
          {"filter", []},
          {"compress", []},
          {"decompress", []},
          {"sort", []},
          {"crop", ["--start", "0s"]},
          {"convert", ["--compression", "lz4"]}
        ] do
      out = Path.join(root, verb <> ".mcap")
      assert {verb, {0, _}} = {verb, situ([verb, @drive, out | more])}
      assert File.ls!(root) == [verb <> ".mcap"]
      assert {verb, raw(out)} == {verb, want}
      File.rm!(out)
    end
  end

  # Returns the undecoded messages of all channels.
  defp raw(path) do
    store = Situ.Store.open!(path)
    %{state: %{ref: ref}} = store

    for channel <- Situ.Bridge.Mcap.list_channels(store), into: %{} do
      what = {{channel.id, :log}, 0, :unbounded, {10_000, 1_000_000_000}, {false, false}}
      {:ok, {messages, _}} = Situ.Bridge.Native.mcap_read(ref, what)
      {channel, messages}
    end
  end

  test "verbs that only create stores reject the name of a file", %{tmp_dir: root} do
    out = Path.join(root, "out.mcap")

    for argv <- [
          ["split", @drive, out, "--every", "1s"],
          ["edit", @drive, out, "--set", "/chatter@0=1"]
        ] do
      assert failed(argv) =~ "creates a store"
    end

    assert File.ls!(root) == []
  end

  defp bytes_by_topic(paths) do
    stores = paths |> List.wrap() |> Enum.map(&Situ.Store.open!/1)

    stores
    |> Situ.Bridge.RawMessages.stream()
    |> Enum.map(&{&1.channel.topic, &1.log_time, &1.bytes})
    |> Enum.sort()
  end

  test "cutting and merging keep the kind of a file and its bytes", %{tmp_dir: root} do
    path = &Path.join(root, &1)
    drive = bytes_by_topic(@drive)

    assert {0, said} = situ(["crop", @drive, path.("start"), "--length", "2s"])
    assert String.trim(said) == path.("start.mcap")
    assert {0, _} = situ(["compress", @drive, path.("small")])
    assert bytes_by_topic(path.("small.mcap")) == drive
    assert bytes_by_topic(path.("start.mcap")) -- drive == []

    assert {0, said} = situ(["split", @drive, path.("part"), "--every", "2s", "--json"])
    assert {:ok, %{"paths" => parts}} = Situ.JSON.decode(said)
    assert Enum.map(parts, &Path.basename/1) == ~w(part-001.mcap part-002.mcap part-003.mcap)
    assert bytes_by_topic(parts) == drive

    assert {0, _} = situ(["merge" | parts] ++ [path.("whole.bag"), "--compression", "lz4"])
    assert bytes_by_topic(path.("whole.bag")) == drive

    assert {0, _} =
             situ(["concat", path.("whole.bag"), @drive, path.("two.mcap"), "-s", "/chatter"])

    chatter = for {"/chatter", _, _} = row <- drive, do: row
    assert bytes_by_topic(path.("two.mcap")) == Enum.sort(chatter ++ chatter)
  end

  test "writes a bag of ROS 2 with its summary", %{tmp_dir: root} do
    File.mkdir!(Path.join(root, "walk"))
    bag = Path.join([root, "walk", "walk_0.db3"])
    assert {0, _} = situ(["save", @drive, bag, "-s", "/chatter"])
    assert File.read!(Path.join([root, "walk", "metadata.yaml"])) =~ "- \"walk_0.db3\""
    store = Situ.Store.open!(bag)
    assert {:ok, [%{data: "tick" <> _} | _]} = Situ.Store.read(store, "/chatter")
    assert File.ls!(Path.join(root, "walk")) |> Enum.sort() == ["metadata.yaml", "walk_0.db3"]
  end
end
