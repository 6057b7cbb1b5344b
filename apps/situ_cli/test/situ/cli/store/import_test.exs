defmodule Situ.CLI.Store.ImportTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO
  alias Situ.{Message, Store}

  @moduletag :tmp_dir
  @drive Path.expand("../../../../../situ_bridge/test/data/ros1_imu_gps_cam.mcap", __DIR__)

  defp recorded(root, streams) do
    {:ok, writer} = Store.Writer.create("r", root)

    for {name, values} <- streams do
      {:ok, stream} = Store.Writer.stream(writer, name)

      messages =
        for {value, i} <- Enum.with_index(values, 1),
            do: %Message{
              data: value,
              originating_time: i * 100,
              creation_time: i * 100,
              sequence_id: i
            }

      {:ok, _} = Store.Writer.append(stream, messages)
    end

    :ok = Store.Writer.close(writer)
    writer.path
  end

  defp situ(argv) do
    {:ok, said} =
      with {0, said} <- with_io(fn -> Situ.CLI.run(["store" | argv]) end), do: {:ok, said}

    said
  end

  defp refused(argv),
    do: capture_io(:stderr, fn -> assert Situ.CLI.run(["store" | argv]) in [1, 2] end)

  defp data(store, name),
    do: for(m <- Store.messages(store, name), do: {m.originating_time, m.data})

  test "saves Protobuf files and imports them by their definition", %{tmp_dir: root} do
    levels = for i <- 1..2_500, do: %{"volts" => i / 8, "name" => "ä#{i}"}
    path = recorded(root, %{"Level" => levels})
    proto = Path.join(root, "lab.proto")
    fields = "int64 time = 1; double volts = 2; string name = 3;"
    File.write!(proto, ~s(syntax = "proto3"; package lab; message Level { #{fields} }))
    file = Path.join(root, "levels.pb")

    situ(["save", path, file, "-s", "Level", "--type", "lab.Level", "--definition", proto])
    refute File.exists?(file <> ".unfinished")
    # The definition is next to the file.
    back = String.trim(situ(["import", file, Path.join(root, "back"), "--type", "lab.Level"]))

    expected =
      for {level, i} <- Enum.with_index(levels, 1), do: {i * 100, Map.put(level, "time", i * 100)}

    assert data(Store.open!(back), "levels") == expected

    # The definition also works for a conversion to another format.
    jsonl = Path.join(root, "levels.jsonl")
    situ(["convert", file, jsonl, "--type", "lab.Level"])
    assert jsonl |> File.stream!() |> Enum.count() == 2_500

    assert refused(["import", file, Path.join(root, "x")]) =~ "--type PACKAGE.MESSAGE"
    assert refused(["import", file, Path.join(root, "x"), "--type", "lab.Lewel"]) =~ "lab.Level"

    assert refused([
             "save",
             path,
             file,
             "-s",
             "Level",
             "--type",
             "a.B",
             "--definition",
             "/no/a.proto"
           ]) =~ "--definition needs"

    assert refused([
             "save",
             path,
             "-",
             "-s",
             "Level",
             "--type",
             "lab.Level",
             "--format",
             "protobuf"
           ]) =~ "standard output"

    File.write!(file, binary_part(File.read!(file), 0, 100))

    assert refused(["import", file, Path.join(root, "x"), "--type", "lab.Level"]) =~
             "ends within a message"

    assert Path.wildcard(Path.join(root, "x.*")) == []
  end

  test "keeps values and types in every format", %{tmp_dir: root} do
    streams = %{
      "Level" => {:float, for(i <- 1..2_500, do: i / 8)},
      "Count" => {:integer, Enum.to_list(1..9)},
      "Both" => {:number, [1, 2.5, 3]},
      "Words" => {:string, ["a,b", "ä", "line\nbreak"]},
      "Loud" => {:boolean, [true, false, true]}
    }

    path = recorded(root, for({name, {_, values}} <- streams, do: {name, values}))

    for ending <- ~w(csv json jsonl msgpack parquet) do
      folder = Path.join(root, ending)
      File.mkdir_p!(folder)

      for {name, _} <- streams,
          do: situ(["save", path, Path.join(folder, "#{name}.#{ending}"), "-s", name])

      out = Path.join(root, "from-#{ending}")
      said = situ(["import", Path.join(folder, "*.#{ending}"), out, "--json"])
      assert {:ok, %{"messages" => 2_518}} = Situ.JSON.decode(said)
      store = Store.open!(out)

      for {name, {type, values}} <- streams do
        assert Enum.map(data(store, name), &elem(&1, 1)) == values
        # A whole number in CSV has no decimal point, and a table column has one type.
        type =
          Map.get(
            %{{:float, "csv"} => :number, {:number, "parquet"} => :float},
            {type, ending},
            type
          )

        assert {:ok, %{type: ^type}} = Store.stream_info(store, name)
      end

      assert data(store, "Count") |> Enum.map(&elem(&1, 0)) == for(i <- 1..9, do: i * 100)
      assert Store.closed?(store)
    end
  end

  test "imports a recording, several streams, or a table by another name", %{tmp_dir: root} do
    situ(["import", @drive, Path.join(root, "drive"), "-s", "/imu/*", "-x", "*mag"])

    assert [%{name: "/imu/data_raw", count: 250}, %{name: "/imu/data_raw.extra", count: 250}] =
             Store.streams(Store.open!(Path.join(root, "drive")))

    path = recorded(root, [{"A", [1, 2]}])
    table = Path.join(root, "a.jsonl")
    situ(["save", path, table])
    situ(["import", table, Path.join(root, "one"), "-s", "Mine"])
    assert data(Store.open!(Path.join(root, "one")), "Mine") == [{100, 1}, {200, 2}]
    assert refused(["import", table, @drive, Path.join(root, "x")]) =~ "import them separately"
    assert refused(["import", table, Path.join(root, "x"), "--from", "5"]) =~ "--from"
    assert refused(["import", "-", Path.join(root, "x")]) =~ "--format"
    File.write!(table, File.read!(table) <> File.read!(table))
    assert refused(["import", table, Path.join(root, "x")]) =~ "increas"
    refute Store.exists?(Path.join(root, "x"))
    File.write!(table, "no JSON\nat all\n")
    assert refused(["import", table, Path.join(root, "x")]) =~ "a.jsonl"
  end

  test "converts any file to another format", %{tmp_dir: root} do
    file = &Path.join(root, &1)
    situ(["convert", @drive, file.("drive.bag"), "-s", "/chatter"])

    assert [%{name: "/chatter", count: 10, type_name: "std_msgs/String"}] =
             Store.streams(Store.open!(file.("drive.bag")))

    situ(["convert", file.("drive.bag"), file.("again.mcap"), "--compression", "zstd"])

    assert data(Store.open!(file.("again.mcap")), "/chatter") ==
             data(Store.open!(@drive), "/chatter")

    situ(["convert", file.("again.mcap"), file.("store")])
    assert [%{count: 10}] = Store.streams(Store.open!(file.("store")))

    path = recorded(root, [{"A", [1.5, 2.5]}])
    situ(["save", path, file.("a.parquet")])
    situ(["convert", file.("a.parquet"), file.("a.csv")])
    assert File.read!(file.("a.csv")) =~ ",1.5\r\n"
    assert Path.wildcard(Path.join(System.tmp_dir!(), "situ-convert-#{System.pid()}-*")) == []
  end
end
