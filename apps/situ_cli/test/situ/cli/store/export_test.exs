defmodule Situ.CLI.Store.ExportTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO
  alias Situ.{Bridge, Message, Store}

  @moduletag :tmp_dir

  setup %{tmp_dir: root} do
    {:ok, writer} = Store.Writer.create("r", root)
    {:ok, a} = Store.Writer.stream(writer, "A", type: :float)
    {:ok, _} = Store.Writer.stream(writer, "Pids", type: :any)

    messages =
      for i <- 1..5,
          do: %Message{
            data: i / 2,
            originating_time: i * 1_000,
            creation_time: i * 1_000,
            sequence_id: i
          }

    {:ok, _} = Store.Writer.append(a, messages)
    :ok = Store.Writer.close(writer)
    %{path: writer.path}
  end

  test "saves a stream in each format and reads it back", %{path: path, tmp_dir: root} do
    for {ending, format} <- [csv: :csv, json: :json, jsonl: :json_lines, msgpack: :message_pack] do
      file = Path.join(root, "a.#{ending}")

      assert capture_io(fn ->
               assert Situ.CLI.run(["store", "save", path, file, "-s", "A"]) == 0
             end) == ""

      read = Enum.to_list(Bridge.File.messages(file, format))
      assert Enum.map(read, &elem(&1, 0)) == for(i <- 1..5, do: i * 1_000)
      refute File.exists?(file <> ".unfinished")
    end
  end

  test "saves every value of structured messages as CSV", %{tmp_dir: root} do
    drive = Path.expand("../../../../../situ_bridge/test/data/ros1_imu_gps_cam.mcap", __DIR__)
    file = Path.join(root, "imu.csv")
    assert Situ.CLI.run(["store", "convert", drive, file, "-s", "/imu/data_raw", "--quiet"]) == 0
    {:ok, table} = Store.open(file)
    {:ok, store} = Store.open(drive)
    {:ok, messages} = Store.read(store, "/imu/data_raw", limit: 1_000)
    {:ok, turns} = Store.read(table, "angular_velocity[2]", limit: 1_000)

    expected = for m <- messages, do: {m.originating_time, elem(m.data.angular_velocity, 2)}

    assert Enum.map(turns, &{&1.originating_time, &1.data}) == expected

    nested = Path.join(root, "imu.parquet")

    assert Situ.CLI.run(["store", "convert", drive, nested, "-s", "/imu/data_raw", "--nested"]) ==
             0

    [{_time, %{"acceleration" => [_, _, _] = acceleration}} | _] =
      Enum.to_list(Bridge.Parquet.messages(nested))

    assert acceleration == Tuple.to_list(hd(messages).data.acceleration)

    refused = ["store", "convert", drive, file, "-s", "/imu/mag", "--nested"]
    assert capture_io(:stderr, fn -> assert Situ.CLI.run(refused) == 2 end) =~ "as Parquet"

    picture = Path.join(root, "camera.jsonl")
    camera = ["-s", "/camera/image/compressed", "--quiet"]
    assert Situ.CLI.run(["store", "convert", drive, picture | camera]) == 0
    [{_time, %{"data" => jpeg}} | _] = Enum.to_list(Bridge.File.messages(picture, :json_lines))
    assert <<0xFF, 0xD8, _::binary>> = Base.decode64!(jpeg)
  end

  test "reports an unclear stream, format or target", %{
    path: path,
    tmp_dir: root
  } do
    for {argv, status, said} <- [
          {[path, Path.join(root, "x.csv")], 1, "A, Pids"},
          {[path, Path.join(root, "x.doc"), "-s", "A"], 2, "format"},
          {[path, Path.join(root, "no/x.csv"), "-s", "A"], 1, "cannot write"},
          {[path, Path.join(root, "x.csv"), "-s", "B"], 1, "no stream"},
          {[path, Path.join(root, "x.csv"), "--on", "A"], 2, "Parquet or Arrow"},
          {[path, Path.join(root, "x.parquet"), "--on", "B"], 1, "no stream"}
        ] do
      assert capture_io(:stderr, fn -> assert Situ.CLI.run(["store", "save" | argv]) == status end) =~
               said
    end
  end

  test "saves streams as an HTML page, and states its size", %{path: path, tmp_dir: root} do
    file = Path.join(root, "page.html")
    argv = ["store", "export", path, file, "-s", "A", "--from", "2000", "--to", "4000"]
    said = capture_io(fn -> assert Situ.CLI.run(argv) == 0 end)
    megabytes = :erlang.float_to_binary(File.stat!(file).size / 1.0e6, decimals: 2)
    assert said == "#{file}: #{megabytes} MB, 1 stream\n"
    assert File.read!(file) =~ "<title>#{Path.basename(path)}</title>"
    refute File.exists?(file <> ".unfinished")

    for {argv, message} <- [
          {[path, file, "--from", "9000"], "no messages between these times"},
          {[path, "-", "--format", "html"], "--format"}
        ] do
      assert capture_io(:stderr, fn -> refute Situ.CLI.run(["store", "export" | argv]) == 0 end) =~
               message
    end
  end

  test "saves images as a video with other streams drawn over them", %{tmp_dir: root} do
    {:ok, writer} = Store.Writer.create("film", root)

    for {name, type, data} <- [
          {"Camera", Situ.Image, Situ.Image.new_filled(64, 48, :rgb24, [20, 40, 60])},
          {"Faces", {:list, Situ.Rect}, [%Situ.Rect{x: 8, y: 8, width: 30, height: 20}]}
        ] do
      {:ok, stream} = Store.Writer.stream(writer, name, type: type)

      messages =
        for i <- 1..10 do
          time = i * 100_000_000
          %Message{data: data, originating_time: time, creation_time: time, sequence_id: i}
        end

      {:ok, _} = Store.Writer.append(stream, messages)
    end

    :ok = Store.Writer.close(writer)
    file = Path.join(root, "faces.mp4")
    argv = ["store", "export", writer.path, file, "-s", "Camera", "--over", "Faces"]
    assert capture_io(fn -> assert Situ.CLI.run(argv) == 0 end) == ""

    {:ok, film} = Store.open(file)
    {:ok, info} = Store.stream_info(film, film |> Store.streams() |> hd() |> Map.get(:name))
    {:ok, message} = Store.latest_at(film, info, info.last)
    {:ok, image} = Situ.ImageOps.convert(message.data, :rgb24)
    # The color of an edge, and of the image within the rectangle.
    {:ok, [r, g, b]} = Situ.Image.fetch_pixel(image, 20, 8)
    assert abs(r - 20) + abs(g - 40) + abs(b - 60) > 60
    {:ok, [r, g, b]} = Situ.Image.fetch_pixel(image, 22, 20)
    assert abs(r - 20) + abs(g - 40) + abs(b - 60) < 40

    argv = ["store", "export", writer.path, file, "-s", "Camera", "--over", "Nothing"]
    assert capture_io(:stderr, fn -> assert Situ.CLI.run(argv) == 1 end) =~ "no stream"
  end

  test "joins streams on time into one table", %{tmp_dir: root} do
    for {more, row} <- [
          {[], %{"Room.A" => 1, "Room.B" => 101}},
          {["-x", "Room.B"], %{"Room.A" => 1}},
          {["--latest", "--within", "1ms"], %{"Room.A" => 1, "Room.B" => 101}}
        ] do
      file = Path.join(root, "j.arrow")
      argv = ["store", "save", both(root), file, "--on", "Room.A" | more]
      assert capture_io(fn -> assert Situ.CLI.run(argv) == 0 end) == ""
      assert [{_, ^row} | _] = Enum.to_list(Bridge.Arrow.messages(file))
    end
  end

  defp both(root) do
    {:ok, writer} = Store.Writer.create("both", root)

    for {name, more} <- [{"Room.A", 0}, {"Room.B", 100}] do
      {:ok, stream} = Store.Writer.stream(writer, name, type: :integer)

      messages =
        for i <- 1..9,
            do: %Message{data: i + more, originating_time: i, creation_time: i, sequence_id: i}

      {:ok, _} = Store.Writer.append(stream, messages)
    end

    :ok = Store.Writer.close(writer)
    writer.path
  end

  test "saves a stream as a Parquet table", %{path: path, tmp_dir: root} do
    file = Path.join(root, "a.parquet")
    argv = ["store", "save", path, file, "-s", "A", "--compression", "gzip", "--json"]
    assert {0, said} = with_io(fn -> Situ.CLI.run(argv) end)

    assert {:ok, %{"messages" => 5, "format" => "parquet", "stream" => "A"}} =
             Situ.JSON.decode(said)

    assert Enum.to_list(Bridge.Parquet.messages(file)) == for(i <- 1..5, do: {i * 1_000, i / 2})
  end

  test "saves a recording as MCAP and as a bag, entirely or in part", %{tmp_dir: root} do
    path = both(root)
    {:ok, _} = Application.ensure_all_started(:situ_bridge)

    for ending <- ["mcap", "bag"] do
      file = Path.join(root, "r.#{ending}")
      assert {0, said} = with_io(fn -> Situ.CLI.run(["store", "save", path, file, "--json"]) end)
      assert {:ok, %{"messages" => 18, "streams" => 2}} = Situ.JSON.decode(said)
      assert store = Store.open!(file)

      assert for(i <- Store.streams(store), do: {i.name, i.count}) |> Enum.sort() == [
               {"Room.A", 9},
               {"Room.B", 9}
             ]

      span = ["--from", "3", "--to", "5"]
      argv = ["store", "export", path, file, "-s", "Room.*", "-x", "*.A"] ++ span
      assert {0, _} = with_io(fn -> Situ.CLI.run(argv) end)
      store = Store.open!(file)
      assert [%{name: "Room.B"} = info] = Store.streams(store)
      assert for(m <- Store.messages(store, info), do: m.originating_time) == [3, 4, 5]
    end
  end

  test "keeps the file when saving it to itself, or when a message cannot be written", %{
    tmp_dir: root
  } do
    path = both(root)
    {:ok, _} = Application.ensure_all_started(:situ_bridge)
    file = Path.join(root, "r.mcap")

    save = fn from ->
      with_io(:stderr, fn -> Situ.CLI.run(["store", "save", from, file, "-q"]) end)
    end

    assert {0, _} = save.(path)
    assert {0, _} = save.(file)
    assert Enum.map(Store.streams(Store.open!(file)), & &1.count) == [9, 9]

    {:ok, writer} = Store.Writer.create("pairs", root)
    {:ok, stream} = Store.Writer.stream(writer, "Pairs")

    message = %Message{
      data: %{{1, 2} => 3},
      originating_time: 1,
      creation_time: 1,
      sequence_id: 1
    }

    {:ok, _} = Store.Writer.append(stream, [message])
    :ok = Store.Writer.close(writer)
    assert {1, _} = save.(writer.path)
    assert Enum.map(Store.streams(Store.open!(file)), & &1.count) == [9, 9]
    refute File.exists?(file <> ".unfinished")
  end

  test "rejects files on standard output, and unsupported compressions", %{path: path} do
    for {argv, said} <- [
          {["-", "--format", "mcap"], "cannot be written to standard output"},
          {["-", "--format", "parquet", "-s", "A"], "cannot be written to standard output"},
          {["x.csv", "-s", "A", "--compression", "zstd"], "does not support this --compression"},
          {["x.parquet", "-s", "A", "--compression", "lz4"], "use none, snappy, gzip, zstd"}
        ] do
      assert capture_io(:stderr, fn ->
               assert Situ.CLI.run(["store", "save", path | argv]) == 2
             end) =~
               said
    end
  end
end
