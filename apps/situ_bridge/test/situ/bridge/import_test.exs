defmodule Situ.Bridge.ImportTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge.{Mcap, Native, Ros}
  alias Situ.Store

  @moduletag :tmp_dir
  # The same drive, recorded by `rosbag record`, and converted by the mcap tools.
  @bag Path.expand("../../data/ros1_imu_gps_cam.bag", __DIR__)
  @mcap Path.expand("../../data/ros1_imu_gps_cam.mcap", __DIR__)

  # Returns the undecoded messages of the file: their log time, publish time and bytes.
  defp raw(path) do
    %{state: %{ref: ref}} = store = Store.open!(path)

    for channel <- Mcap.list_channels(store), into: %{} do
      what = {{channel.id, :log}, 0, :unbounded, {10_000, 1_000_000_000}, {false, false}}
      {:ok, {messages, _}} = Native.mcap_read(ref, what)
      {channel.topic, {channel.schema, for({_, log, sent, _, x} <- messages, do: {log, sent, x})}}
    end
  end

  for {kind, file} <- [bag: @bag, mcap: @mcap] do
    test "keeps every field of an imported #{kind}, and exports the same messages", %{
      tmp_dir: dir
    } do
      {:ok, path} = Store.copy(unquote(file), Path.join(dir, "drive"))
      store = Store.open!(path)
      maps = Store.open!(unquote(file), reader_opts: [times: :header, messages: :maps])

      # The message is typed for the studio, and its time is the header's.
      assert {:ok, %{data: %Situ.ImuReading{}} = imu} = Store.at(store, "/imu/data_raw", 3)
      assert {:ok, %{data: message}} = Store.at(maps, "/imu/data_raw", 3)
      assert imu.originating_time == message["header"]["stamp"]
      {:ok, recorded} = unquote(file) |> Store.open!() |> Store.at("/imu/data_raw", 3)
      assert imu.creation_time == recorded.originating_time
      assert {:ok, %{data: extra}} = Store.at(store, "/imu/data_raw.extra", 3)
      assert extra["header"] == message["header"]

      out = Path.join(dir, "out.mcap")
      assert {:ok, 545} = Mcap.export(store, out)
      assert raw(out) == raw(@mcap)

      # The same holds for an export through a bag.
      bag = Path.join(dir, "out.bag")
      assert {:ok, 545} = Ros.Bag.export(store, bag)
      {:ok, _} = Mcap.export(Store.open!(bag), again = Path.join(dir, "again.mcap"))
      assert raw(again) == raw(@mcap)
    end

    test "can use the recording times of a #{kind}", %{tmp_dir: dir} do
      {:ok, path} = Store.copy(unquote(file), Path.join(dir, "drive"), times: :record)
      {:ok, want} = unquote(file) |> Store.open!() |> Store.at("/imu/data_raw", 3)
      {:ok, got} = path |> Store.open!() |> Store.at("/imu/data_raw", 3)
      assert got.originating_time == want.originating_time
      assert got.data == want.data
    end
  end

  test "keeps differing publish times and channel metadata", %{tmp_dir: dir} do
    definition = "std_msgs/Header header\ngeometry_msgs/Pose pose\n"
    file = Path.join(dir, "pose.mcap")
    {:ok, writer} = Native.mcap_create(file, "", :none, 1_000)
    {:ok, parsed} = Ros.Definition.parse("geometry_msgs/PoseStamped", definition, :ros2)

    message = %{
      "header" => %{"stamp" => 900, "frame_id" => "map"},
      "pose" => %{"orientation" => %{"w" => 1.0}}
    }

    {:ok, bytes} = Ros.Wire.encode(parsed, message, :cdr)
    schema = {"geometry_msgs/msg/PoseStamped", "ros2msg", whole(definition)}
    {:ok, id} = Native.mcap_channel(writer, "/pose", "cdr", schema, [{"qos", "best"}])

    # The clock of the second message's sender is ahead of the recorder's.
    {:ok, ahead} = Ros.Wire.encode(parsed, put_in(message["header"]["stamp"], 5_000), :cdr)

    {:ok, 2} =
      Native.mcap_write(writer, [{id, 9, 1_000, 950, bytes}, {id, 10, 2_000, 2_000, ahead}])

    {:ok, _} = Native.mcap_finish(writer)

    {:ok, path} = Store.copy(file, Path.join(dir, "pose"))
    store = Store.open!(path)

    assert {:ok, %{data: %Situ.Pose{}, originating_time: 900, creation_time: 1_000}} =
             Store.at(store, "/pose", 0)

    assert {:ok, %{data: %{"publish_time" => 950, "header" => %{"frame_id" => "map"}}}} =
             Store.at(store, "/pose.extra", 0)

    assert {:ok, %{"qos" => "best", "schema" => %{"name" => "geometry_msgs/msg/PoseStamped"}}} =
             Store.metadata(store, "/pose")

    out = Path.join(dir, "out.mcap")
    assert {:ok, 2} = Mcap.export(store, out)
    messages = [{1_000, 950, bytes}, {2_000, 2_000, ahead}]
    assert raw(out) == %{"/pose" => {"geometry_msgs/msg/PoseStamped", messages}}
  end

  defp whole(definition) do
    for name <-
          ~w(std_msgs/Header geometry_msgs/Pose geometry_msgs/Point geometry_msgs/Quaternion),
        reduce: definition do
      text ->
        {:ok, part} = Ros.Library.fetch(name, :ros2)
        text <> String.duplicate("=", 80) <> "\nMSG: #{name}\n" <> part <> "\n"
    end
  end
end
