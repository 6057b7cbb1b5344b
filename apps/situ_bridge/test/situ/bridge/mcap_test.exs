defmodule Situ.Bridge.McapTest do
  use ExUnit.Case, async: true
  import Situ.Test.Eventually
  alias Situ.Bridge.Mcap
  alias Situ.Store

  @moduletag :tmp_dir
  @moduletag :capture_log
  # Recorded by `rosbag record` and converted by the mcap tools.
  @real Path.expand("../../data/ros1_imu_gps_cam.mcap", __DIR__)

  test "opens a real recording like a store" do
    store = Store.open!(@real)
    assert %{profile: "ros1", closed?: true, damage: []} = Store.info(store)
    counts = Map.new(Store.streams(store), &{&1.name, &1.count})

    assert counts == %{
             "/imu/data_raw" => 250,
             "/imu/mag" => 250,
             "/gps/fix" => 25,
             "/camera/image/compressed" => 10,
             "/chatter" => 10
           }

    assert {:ok, [%{data: "tick 0"}, %{data: "tick 25"}]} =
             Store.read(store, "/chatter", limit: 2)

    assert {:ok, %{data: %Situ.EncodedImage{format: :jpeg}}} =
             Store.at(store, "/camera/image/compressed", 0)

    {:ok, imu} = Store.at(store, "/imu/data_raw", 3)
    assert %Situ.ImuReading{acceleration: {_, _, z}} = imu.data
    assert_in_delta z, 9.8, 1.0
    assert {:ok, ^imu} = Store.latest_at(store, "/imu/data_raw", imu.originating_time)
    assert {:ok, ^imu} = Store.first_at(store, "/imu/data_raw", imu.originating_time)
    by_stamp = Store.open!(@real, reader_opts: [times: :header, messages: :maps])
    {:ok, stamped} = Store.at(by_stamp, "/imu/data_raw", 3)
    assert stamped.originating_time == stamped.data["header"]["stamp"]
    assert stamped.creation_time == imu.originating_time
  end

  test "images that are stored as video are exported as packets, from a key frame on", %{
    tmp_dir: dir
  } do
    packet = fn i ->
      bytes = <<0, 0, 0, 1, if(rem(i, 5) == 0, do: 0x65, else: 0x41), i>>
      {:h264, rem(i, 5), bytes}
    end

    {:ok, writer} = Store.Writer.create("video", dir)
    {:ok, stream} = Store.Writer.stream(writer, "Camera", type: Situ.Image)

    messages =
      for i <- 0..19 do
        {codec, position, bytes} = packet.(i)
        size = [width: 16, height: 16, format: :bgr24]
        data = struct!(Situ.VideoPacket, [codec: codec, position: position, data: bytes] ++ size)

        %Situ.Message{
          data: data,
          originating_time: i * 1_000,
          creation_time: i * 1_000,
          sequence_id: i
        }
      end

    {:ok, _} = Store.Writer.append(stream, messages)
    :ok = Store.Writer.close(writer)
    file = Path.join(dir, "video.mcap")
    assert {:ok, 18} = Mcap.export(Store.open!(writer.path), file, from: 3_000, to: 17_000)
    again = Store.open!(file, reader_opts: [messages: :maps])
    [first | _] = exported = again |> Store.messages("Camera") |> Enum.to_list()
    assert %{"format" => "h264", "data" => <<0, 0, 0, 1, 0x65, 0>>, "timestamp" => 0} = first.data
    assert Enum.map(exported, & &1.originating_time) == for(i <- 0..17, do: i * 1_000)
    assert {:ok, %{type_name: "foxglove.CompressedVideo"}} = Store.stream_info(again, "Camera")
  end

  test "records a file in a pipeline and replays it", %{tmp_dir: dir} do
    path = Path.join(dir, "own.mcap")
    values = for i <- 1..500, do: {i * 1_000_000, i / 2}

    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        file = Mcap.create(p, path, compression: :zstd)
        p |> Situ.from_enumerable(values) |> Mcap.write(file, "/level")

        p
        |> Situ.from_enumerable(for({t, v} <- values, do: {t, %{"v" => v, "list" => [1, nil]}}))
        |> Mcap.write(file, "/maps")

        p
        |> Situ.from_enumerable(for({t, v} <- values, do: {t, %Situ.Point3{x: v, y: 0.0, z: -v}}))
        |> Mcap.write(file, "/points", encoding: :cdr)
      end)

    store = Store.open!(path)
    assert for(m <- Store.messages(store, "/level"), do: {m.originating_time, m.data}) == values
    assert {:ok, %{data: %{"v" => 0.5, "list" => [1, nil]}}} = Store.at(store, "/maps", 0)
    assert {:ok, %{data: %Situ.Point3{x: 250.0}}} = Store.at(store, "/points", -1)

    got =
      Situ.to_list(fn p -> p |> Store.importer(path) |> Store.stream("/level") end, times: true)

    assert got == values
  end

  test "writes Foxglove's and custom Protobuf messages, with frames", %{tmp_dir: dir} do
    path = Path.join(dir, "foxglove.mcap")
    image = Situ.Image.new!(width: 2, height: 1, format: :rgb24, data: <<1, 2, 3, 4, 5, 6>>)

    definition =
      ~s(syntax = "proto3"; package lab; message Level { double volts = 1; repeated sint32 raw = 2; })

    times = for i <- 1..50, do: i * 1_000_000_007

    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        file = Mcap.create(p, path)
        stream = &Situ.from_enumerable(p, for(t <- times, do: {t, &1.(t)}))
        fox = [encoding: :protobuf]
        stream.(fn _ -> image end) |> Mcap.write(file, "/camera", fox ++ [frame: "lens"])
        stream.(fn t -> "at #{t}" end) |> Mcap.write(file, "/log", fox)
        own = [type: "lab.Level", definition: definition]

        stream.(fn t -> %{"volts" => t / 2, "raw" => [-1, t |> rem(1_000)]} end)
        |> Mcap.write(file, "/level", fox ++ own)
      end)

    store = Store.open!(path)
    assert Store.info(store).damage == []
    types = Map.new(Store.streams(store), &{&1.name, &1.type_name})

    assert types == %{
             "/camera" => "foxglove.RawImage",
             "/log" => "foxglove.Log",
             "/level" => "lab.Level"
           }

    assert {:ok, %{data: ^image}} = Store.at(store, "/camera", 7)

    assert {:ok, %{data: %{"message" => "at 1000000007", "timestamp" => 1_000_000_007}}} =
             Store.at(store, "/log", 0)

    assert {:ok, %{data: %{"volts" => 500_000_003.5, "raw" => [-1, 7]}}} =
             Store.at(store, "/level", 0)

    stamped = Store.open!(path, reader_opts: [messages: :maps])
    assert for(m <- Store.messages(stamped, "/camera"), do: m.originating_time) == times

    assert {:ok, %{data: %{"frame_id" => "lens", "encoding" => "rgb8"}}} =
             Store.at(stamped, "/camera", 0)

    # An export as Protobuf keeps everything, including the frames.
    again = Path.join(dir, "again.mcap")

    assert {:ok, 100} =
             Mcap.export(store, again, encoding: :protobuf, streams: ["/camera", "/log"])

    maps = Store.open!(again, reader_opts: [messages: :maps])
    assert {:ok, %{data: %{"frame_id" => "lens"}}} = Store.at(maps, "/camera", 3)
    assert {:error, %{code: :no_ros_type}} = Mcap.export(store, again, encoding: :protobuf)
  end

  test "writes and reads attachments and metadata", %{tmp_dir: dir} do
    path = Path.join(dir, "with.mcap")
    note = Path.join(dir, "calibration.yaml")
    File.write!(note, "fx: 500")
    opts = [attachments: [note], metadata: %{"robot" => %{"serial" => 7, "name" => "ada"}}]

    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        p |> Situ.from_enumerable([{5, 1.5}]) |> Mcap.write(Mcap.create(p, path, opts), "/x")
      end)

    store = Store.open!(path)
    assert [%{name: "calibration.yaml", size: 7, time: time}] = Mcap.list_attachments(store)
    assert time > 1_600_000_000_000_000_000
    assert Mcap.read_attachment(store, "calibration.yaml") == {:ok, "fx: 500"}
    assert Store.info(store).metadata == [{"robot", %{"serial" => "7", "name" => "ada"}}]

    missing = Path.join(dir, "nowhere.yaml")

    assert {:error, %{code: :io, what: what}} =
             Situ.Pipeline.run(fn p ->
               file = Mcap.create(p, path, attachments: [missing])
               p |> Situ.from_enumerable([{5, 1.5}]) |> Mcap.write(file, "/x")
             end)

    assert what =~ "nowhere.yaml"
  end

  test "keeps the messages recorded before a pipeline is killed", %{tmp_dir: dir} do
    path = Path.join(dir, "killed.mcap")
    me = self()

    {:ok, pipeline} =
      Task.start(fn ->
        {:ok, p} =
          Situ.Pipeline.start_link(fn p ->
            p
            |> Situ.from_enumerable(for(i <- 1..100, do: {i, i}), keep_open: true)
            |> Situ.each(&send(me, {:got, &1}))
            |> Mcap.write(Mcap.create(p, path), "/n")
          end)

        send(me, {:pipeline, p})
        receive(do: (:never -> :ok))
      end)

    assert_receive {:got, 100}
    Process.exit(pipeline, :kill)

    assert eventually(fn ->
             match?({:ok, _}, Store.open(path)) and Store.info(Store.open!(path)).closed?
           end)

    assert Store.count(Store.open!(path), "/n") > 0
  end

  test "exports a recording and reads it back", %{tmp_dir: dir} do
    path = Path.join(dir, "copy.mcap")
    store = Store.open!(@real)
    assert {:ok, 545} = Mcap.export(store, path)
    copy = Store.open!(path)
    for info <- Store.streams(store), do: assert(data(copy, info.name) == data(store, info.name))
    assert {:ok, 10} = Mcap.export(store, path, streams: ["/chatter"], encoding: :json)
    assert {:ok, %{data: %{"value" => "tick 0"}}} = Store.at(Store.open!(path), "/chatter", 0)
  end

  defp data(store, name),
    do: for(m <- Store.messages(store, name), do: {m.originating_time, m.data})

  test "opens truncated files, and rejects other files", %{tmp_dir: dir} do
    path = Path.join(dir, "cut.mcap")
    bytes = File.read!(@real)
    File.write!(path, binary_part(bytes, 0, div(byte_size(bytes), 2)))
    store = Store.open!(path)
    assert %{closed?: false, damage: [_ | _]} = Store.info(store)
    for info <- Store.streams(store), do: assert({:ok, _} = Store.read(store, info))
    File.write!(path, "nothing of the kind")
    assert {:error, %{code: :not_mcap}} = Store.open(path)
    assert {:error, %{code: :io}} = Mcap.open(Path.join(dir, "none.mcap"), [])
  end

  test "fails the pipeline if a value cannot be written", %{tmp_dir: dir} do
    path = Path.join(dir, "bad.mcap")

    build = fn value, opts ->
      fn p ->
        p |> Situ.from_enumerable([{1, value}]) |> Mcap.write(Mcap.create(p, path), "/x", opts)
      end
    end

    assert {:error, error} = Situ.Pipeline.run(build.(self(), []))
    assert Exception.message(error) =~ "/x"
    assert {:error, _} = Situ.Pipeline.run(build.(%{"a" => 1}, encoding: :ros1))
    assert {:error, _} = Situ.Pipeline.run(build.(%{"a" => 1}, type: "no/Such"))

    assert {:error, _} =
             Situ.Pipeline.run(fn p ->
               p
               |> Situ.from_enumerable([{1, 1}])
               |> Mcap.write(Mcap.create(p, Path.join(dir, "no/such/folder.mcap")), "/x")
             end)
  end
end
