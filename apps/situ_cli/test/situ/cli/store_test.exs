defmodule Situ.CLI.StoreTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO
  alias Situ.{Message, Store}
  alias Situ.Store.Writer

  @moduletag :tmp_dir

  setup %{tmp_dir: root} do
    {:ok, writer} = Writer.create("lobby", root)
    {:ok, numbers} = Writer.stream(writer, "Room.Level", type: :integer)
    {:ok, words} = Writer.stream(writer, "Words", type: :string, compression: :zstd)
    {:ok, _} = Writer.append(numbers, for(i <- 0..99, do: message(i, i)))
    {:ok, _} = Writer.append(words, for(i <- 0..9, do: message("word #{i}", i * 10)))
    for stream <- [numbers, words], do: {:ok, _} = Writer.close_stream(stream, 99_000_000_000)
    :ok = Writer.close(writer)
    {:ok, path: Path.join(root, "lobby")}
  end

  defp message(data, i) do
    time = i * 1_000_000_000

    %Message{
      data: data,
      originating_time: time,
      creation_time: time + 2_000_000,
      sequence_id: i + 1
    }
  end

  defp run(argv), do: with_io(fn -> Situ.CLI.run(["store" | argv]) end)

  defp refused(argv),
    do: capture_io(:stderr, fn -> assert Situ.CLI.run(["store" | argv]) == 1 end)

  defp json(argv) do
    {:ok, value} = argv |> run() |> elem(1) |> Situ.JSON.decode()
    value
  end

  test "info shows streams, rates, sizes and latencies", %{path: path, tmp_dir: root} do
    {0, text} = run(["info", path])
    assert text =~ "closed; 2 streams, 110 messages"
    assert text =~ ~r/Room.Level +:integer +100 +1.0 Hz .* 2.00 ms/
    assert text =~ "1970-01-01T00:00:00.000000000Z .. 1970-01-01T00:01:39"

    assert [%{"closed" => true, "streams" => [%{"count" => 100, "rate" => 1.0}, _]}] =
             json(["info", path, "--json"])

    # The shape is the same for a recording, for a folder that contains one, and for several.
    assert [[%{"closed" => true}], [%{"closed" => true}], [%{"closed" => true}, _]] =
             for(args <- [[path], [root], [path, path]], do: json(["info", "--json" | args]))

    assert refused(["info", Path.join(root, "gone"), "--json"]) =~ "no store"

    {0, list} = run(["info", root])
    assert list =~ "lobby.0000  2 streams, 1 min 39 s"
    assert text =~ "1 min 39 s (not real time)"
  end

  test "info marks unknown and meaningless values", %{tmp_dir: root} do
    csv = Path.join(root, "level.csv")
    File.write!(csv, "time,level\n1,2\n2,3\n")
    {0, text} = run(["info", csv])
    assert text =~ ~r/level .* -  +-  +- / and not (text =~ "0 B")

    assert [%{"streams" => [%{"size" => nil, "average_latency" => nil, "count" => 2} | _]}] =
             json(["info", csv, "--json"])

    {:ok, writer} = Writer.create("fast", root)
    {:ok, stream} = Writer.stream(writer, "S")
    early = for i <- 1..3, do: %{message(i, i) | creation_time: 0}
    {:ok, _} = Writer.append(stream, early)
    :ok = Writer.close(writer)
    assert elem(run(["info", writer.path]), 1) =~ ~r/S .* not real time/
    assert elem(run(["info", writer.path, "-s", "S"]), 1) =~ "latency     not real time"
  end

  describe "a recording in segments" do
    setup %{tmp_dir: tmp} do
      root = Path.join(tmp, "segments")

      for run <- 0..2 do
        {:ok, writer} = Writer.create("hall", root)
        {:ok, _} = Writer.append_catalog(writer, %{kind: "piece", every: 10, run: "#{run}"})
        {:ok, stream} = Writer.stream(writer, "N", type: :integer)
        at = run * 10

        {:ok, _} = Writer.append(stream, for(i <- 1..5, do: message(at + i, at + i)))

        :ok = Writer.close(writer)
      end

      %{hall: Path.join(root, "hall"), root: root}
    end

    test "is one recording for info, messages, export and query", %{hall: hall, root: root} do
      {0, text} = run(["info", hall])
      assert text =~ "hall  (#{hall})"

      assert text =~ "15 messages" and
               text =~ "3 segments of 3 runs: `situ store info '#{hall}' --segments`"

      assert text =~ ~r/N +:integer +15 /
      {0, text} = run(["info", hall, "--segments"])
      assert [_, first, _, last] = String.split(text, "\n", trim: true)
      assert first =~ ~r/hall.0000 +1970-01-01T00:00:01\.0+Z +4.00 s +5 .* closed/
      assert last =~ "hall.0002"
      {0, text} = run(["info", hall <> ".0001"])
      assert text =~ "a segment of '#{hall}'" and text =~ "5 messages"
      {0, list} = run(["info", root])
      assert [line] = String.split(list, "\n", trim: true)
      assert line =~ ~r/hall +1 stream, 24.0 s, .*, 3 segments, closed/

      assert [%{"name" => "hall", "segments" => [_, _, %{"messages" => 5}]}] =
               json(["info", hall, "--json"])

      {0, messages} = run(["messages", hall, "-n", "0"])
      assert length(String.split(messages, "\n", trim: true)) == 15
      file = Path.join(root, "n.csv")
      {0, _} = run(["export", hall, file])
      assert length(String.split(File.read!(file), "\n", trim: true)) == 16
      {0, text} = run(["pyramid", hall, "-s", "N"])
      assert text != ""
    end

    test "is copied, cropped, verified, repaired, compacted, renamed and deleted", ctx do
      out = Path.join(ctx.root, "out")
      {0, copy} = run(["copy", ctx.hall, out])
      assert length(values(String.trim(copy), "N")) == 15
      error = capture_io(:stderr, fn -> assert {1, _} = run(["remove", ctx.hall, "N"]) end)
      assert error =~ "a recording in segments, which has no further versions"
      {0, crop} = run(["crop", ctx.hall, out, "--start", "3s", "--length", "9s"])
      assert values(String.trim(crop), "N") == [4, 5, 11, 12, 13]
      {0, text} = run(["verify", ctx.hall])
      assert text =~ "all intact"
      {0, text} = run(["compact", ctx.hall])
      assert text =~ "#{ctx.hall}: "
      {0, _} = run(["repair", ctx.hall])
      {0, renamed} = run(["rename", ctx.hall, "door"])
      assert String.trim(renamed) == Path.join(ctx.root, "door")
      assert length(values(String.trim(renamed), "N")) == 15
      assert {0, _} = run(["delete", String.trim(renamed), "--yes"])
      assert Enum.filter(File.ls!(ctx.root), &(&1 =~ "door")) == []
    end
  end

  test "crops, copies, concatenates, edits, renames and deletes", %{path: path, tmp_dir: root} do
    out = Path.join(root, "out")

    {0, made} =
      run(["crop", path, out, "--start", "10s", "--length", "5s", "--stream", "Room.Level"])

    assert values(String.trim(made), "Room.Level") == Enum.to_list(10..15)

    {0, second} =
      run(["crop", path, out, "--from", "1970-01-01T00:00:20Z", "--to", "22000000000"])

    assert values(String.trim(second), "Room.Level") == [20, 21, 22]
    assert values(String.trim(second), "Words") == ["word 2"]

    {0, both} =
      run(["concat", String.trim(made), String.trim(second), out, "--compression", "lz4"])

    assert values(String.trim(both), "Room.Level") == Enum.to_list(10..15) ++ [20, 21, 22]

    edit = ["edit", path, out, "--delete", "Words@0", "--set", "Words@5000000000=\"five\""]
    {0, edited} = run(edit)
    assert Enum.take(values(String.trim(edited), "Words"), 2) == ["five", "word 1"]
    assert values(path, "Words") == for(i <- 0..9, do: "word #{i}")

    {0, renamed} = run(["rename", String.trim(edited), "better"])
    assert renamed =~ "better.0000"
    assert {0, _} = run(["delete", String.trim(renamed), "--yes"])
    refute File.exists?(String.trim(renamed))
  end

  test "shows messages of all streams, or of streams that match a pattern", %{path: path} do
    {0, text} = run(["messages", path, "-n", "0"])
    assert text |> String.split("\n", trim: true) |> length() == 110
    assert text =~ "Words  " and text =~ "Room.Level  "
    {0, text} = run(["messages", path, "-s", "Room.*", "-n", "0"])
    assert text |> String.split("\n", trim: true) |> length() == 100
  end

  test "shows messages from a time on", %{path: path} do
    {0, text} = run(["messages", path, "-s", "Words", "-n", "2", "--from", "15000000000"])
    assert [first, _] = String.split(text, "\n", trim: true)
    assert first =~ "00:00:20" and first =~ "+2.00 ms" and first =~ "\"word 2\""
  end

  test "verify reports damage by its status, and repair fixes it", %{path: path} do
    {0, sound} = run(["verify", path])
    assert sound =~ ~r/^\d+ chunks, all intact/
    file = Path.join(Store.open!(path).path, "data-000000.situ")
    bytes = File.read!(file)
    {found, _} = :binary.match(bytes, "Room.Level")
    <<a::binary-size(found), "Room", rest::binary>> = bytes
    File.write!(file, [a, "Doom", rest])
    assert {1, text} = run(["verify", path])
    assert text =~ "DAMAGED" and text =~ "data-000000.situ at byte"
    assert %{"damage" => [_ | _]} = json(["verify", path, "--json"])
    assert {0, text} = run(["repair", path])
    assert text =~ "1 lost"
    assert {0, _} = run(["verify", path])
  end

  test "exits with 2 for wrong usage and 1 for failures, each with a fix", %{path: path} do
    for {argv, status, said} <- [
          {["infoo", path], 2, "did you mean `situ store info`"},
          {["info"], 2, "PATH... is missing"},
          {["rename", path], 2, "NAME is missing"},
          {["rename", path, "a", "b"], 2, "one argument too many"},
          {["info", path, "--strem", "x"], 2, "did you mean --stream"},
          {["info", path, "--stream"], 2, "needs a value"},
          {["info", path, "-s", "a", "-s", "b"], 2, "more than once"},
          {["messages", path, "-s", "Words", "-n", "some"], 2, "whole number"},
          {["crop", path, path <> "y"], 2, "no interval given"},
          {["crop", path, path <> "y", "--start", "soon"], 2, "span of time"},
          {["copy", path, path <> "y", "--compression", "rar"], 2, "none, lz4, zstd"},
          {["copy", path, path <> "y", "--from", "noon"], 2, "a time like"},
          {["info", path <> "x"], 1, "no store"},
          {["messages", path, "-s", "Wrods"], 1, "Words"},
          {["edit", path, path <> "y", "--set", "Words@1=nojson"], 1, "invalid JSON"},
          {["remove", path, "Nothing*"], 1, "no stream"}
        ] do
      assert capture_io(:stderr, fn -> assert Situ.CLI.run(["store" | argv]) == status end) =~
               said
    end

    assert capture_io(fn -> assert Situ.CLI.run(["store"]) == 2 end) =~ "Usage"

    for help <- [["help", "store"], ["store", "help"], ["store", "--help"]],
        do: assert(capture_io(fn -> assert Situ.CLI.run(help) == 0 end) =~ "concat PATH... OUT")

    assert capture_io(fn -> assert Situ.CLI.run(["help", "store", "crop"]) == 0 end) =~
             "--start SPAN"
  end

  test "shows messages of several streams in time order", %{path: path} do
    {0, text} = run(["messages", path, "-s", "Words", "-s", "Room.Level", "-n", "0"])
    lines = String.split(text, "\n", trim: true)
    assert length(lines) == 110

    assert Enum.sort(lines) |> Enum.map(&binary_part(&1, 0, 30)) ==
             Enum.map(lines, &binary_part(&1, 0, 30))

    assert text =~ "Room.Level  7" and text =~ ~s(Words  "word 3")
    {0, text} = run(["messages", path, "-s", "Words", "-s", "Room.Level", "-n", "3", "--json"])

    assert [%{"stream" => _, "data" => _} | _] =
             for(l <- String.split(text, "\n", trim: true), do: elem(Situ.JSON.decode(l), 1))
  end

  test "stats reports periods, gaps and latencies of every message", %{tmp_dir: root} do
    {:ok, writer} = Writer.create("timing", root)
    {:ok, stream} = Writer.stream(writer, "S", type: :integer)
    # Messages are 10 ms apart with one second missing. Message i has a latency of i us.
    messages =
      for i <- 0..999 do
        time = i * 10_000_000 + if(i >= 500, do: 1_000_000_000, else: 0)

        %Message{
          data: i,
          originating_time: time,
          creation_time: time + i * 1_000,
          sequence_id: i + 1
        }
      end

    {:ok, _} = Writer.append(stream, messages)
    :ok = Writer.close(writer)
    assert [stats] = json(["stats", writer.path, "--json"])
    assert %{"messages" => 1_000, "gaps" => 1, "gap_time" => 1_010_000_000} = stats
    assert_in_delta stats["period_p50"], 10_000_000, 60_000
    assert_in_delta stats["latency_p50"], 499_000, 4_000
    assert_in_delta stats["latency_p99"], 989_000, 8_000
    assert stats["period_most"] == 1_010_000_000
    {0, text} = run(["stats", writer.path, "--gap", "2s"])
    assert text =~ ~r/S +1000 .* 1.01 s +-/
  end

  test "analyze reports the lag between streams", %{tmp_dir: root} do
    {:ok, writer} = Writer.create("lag", root)

    for {name, late} <- [{"Prompt", 0}, {"Late", 40_000_000}] do
      {:ok, stream} = Writer.stream(writer, name, type: :integer)

      messages =
        for i <- 0..99,
            do: %Message{
              data: i,
              originating_time: i * 10_000_000,
              creation_time: i * 10_000_000 + late,
              sequence_id: i + 1
            }

      {:ok, _} = Writer.append(stream, messages)
    end

    :ok = Writer.close(writer)

    assert [%{"stream" => "Prompt", "most" => 40_000_000}, %{"stream" => "Late", "most" => 0}] =
             json(["analyze", writer.path, "--json"])
  end

  test "diff reports equal, different and missing messages, and exits with 1 if they differ", %{
    path: path,
    tmp_dir: root
  } do
    {0, copy} = run(["copy", path, Path.join(root, "copy")])
    assert {0, text} = run(["diff", path, String.trim(copy), "--envelopes"])
    assert text =~ "Words: the same (10 messages)"

    {0, edited} =
      run([
        "edit",
        path,
        Path.join(root, "e"),
        "--delete",
        "Words@0",
        "--set",
        "Words@10000000000=\"x\""
      ])

    assert {1, text} = run(["diff", path, String.trim(edited)])

    assert text =~
             "Words: 8 equal, 1 different, 1 only in the first, 0 only in the second; " <>
               "the first difference at 1970-01-01T00:00:00"

    {0, less} = run(["remove", path, "Wor*"])
    assert {1, text} = run(["diff", Path.join(root, "lobby.0000"), String.trim(less)])
    assert text =~ "Words: only in the first (10 messages)"
  end

  test "splits, removes, and copies without some streams", %{path: path, tmp_dir: root} do
    {0, made} = run(["split", path, Path.join(root, "part"), "--every", "40s"])
    assert [a, b, c] = String.split(made, "\n", trim: true)
    assert Path.basename(a) == "part-001.0000"
    assert Enum.flat_map([a, b, c], &values(&1, "Room.Level")) == Enum.to_list(0..99)
    {0, less} = run(["copy", path, Path.join(root, "less"), "-x", "Wo*"])
    assert Enum.map(Store.streams(Store.open!(String.trim(less))), & &1.name) == ["Room.Level"]
    {0, next} = run(["remove", path, "Room.Level"])
    assert Path.basename(String.trim(next)) == "lobby.0001"
    assert Store.has_stream?(Store.open!(Path.join(root, "lobby.0000")), "Room.Level")
  end

  test "escapes control characters and invalid UTF-8 in names", %{
    tmp_dir: root
  } do
    {:ok, writer} = Writer.create("names", root)
    {:ok, stream} = Writer.stream(writer, "Evil\e]0;owned\a\nName", type: :integer)
    {:ok, _} = Writer.append(stream, [message(1, 1)])
    :ok = Writer.close(writer)
    {0, text} = run(["info", writer.path])
    refute text =~ "\e" or text =~ "\a"
    assert text =~ "Evil\\e]0;owned\\x07\\nName"

    assert capture_io(:stderr, fn ->
             assert Situ.CLI.run(["store", "info", <<"caf", 0xE9>>]) == 1
           end) =~ "no store at"
  end

  test "expands patterns that the shell did not expand", %{path: path, tmp_dir: root} do
    {0, _} = run(["copy", path, Path.join(root, "two")])
    {0, text} = run(["verify", Path.join(root, "*.0000")])
    assert text |> String.split("\n", trim: true) |> length() == 2
  end

  test "shows a line for each recording, with the error of unreadable ones", %{
    path: path,
    tmp_dir: root
  } do
    File.write!(Path.join(root, "notes.txt"), "no recording")
    paths = [path, Path.join(root, "notes.txt"), Path.join(root, "gone")]
    {1, text} = run(["info" | paths])
    assert text =~ "2 streams" and text =~ "notes.txt  no reader" and text =~ "gone  no store"

    assert [%{"closed" => true}, %{"error" => _}, %{"path" => _}] =
             json(["info", "--json" | paths])

    assert {0, text} = run(["verify", path, path])
    assert text |> String.split("\n", trim: true) |> Enum.count(&(&1 =~ "all intact")) == 2
    assert {1, text} = run(["verify", path, Path.join(root, "gone")])
    assert text =~ "all intact" and text =~ "no store at"
  end

  test "info of one stream shows everything about it", %{path: path, tmp_dir: root} do
    {:ok, writer} = Writer.create("meta", root)
    {:ok, stream} = Writer.stream(writer, "S", type: :float, metadata: %{"unit" => "rad"})
    {:ok, stream} = Writer.append(stream, for(i <- 0..9, do: message(i / 1, i)))
    {:ok, _} = Writer.close_stream(stream, 9_000_000_000)
    :ok = Writer.close(writer)
    {0, text} = run(["info", writer.path, "--stream", "S"])
    assert text =~ ~s(%{"unit" => "rad"} \(:map\)) and text =~ "10, 1.0 Hz"
    assert text =~ "80 B, 8 B each" and text =~ "2.00 ms on average, 20.0 ms in total"
    assert text =~ "at 1970-01-01T00:00:09" and text =~ "compression none"
    info = json(["info", writer.path, "-s", "S", "--json"])
    assert %{"metadata" => %{"data" => %{"unit" => "rad"}, "type" => ":map"}} = info

    assert %{"count" => 10, "size" => 80, "latency_sum" => 20_000_000, "store_name" => "meta"} =
             info

    assert refused(["info", path, "-s", "Nope"]) =~ "Words"
  end

  test "messages --json contains the data itself", %{path: path, tmp_dir: root} do
    {0, lines} = run(["messages", path, "-s", "Words", "-n", "2", "--json"])

    [first, _] =
      lines |> String.split("\n", trim: true) |> Enum.map(&elem(Situ.JSON.decode(&1), 1))

    assert %{"data" => "word 0", "sequence_id" => 1, "originating_time" => 0} = first
    {:ok, writer} = Writer.create("odd", root)
    {:ok, stream} = Writer.stream(writer, "S")
    odd = [%{a: {1, :b}}, <<255, 0>>, %{{1} => 2}, [1 | 2], nil]
    {:ok, _} = Writer.append(stream, for({data, i} <- Enum.with_index(odd), do: message(data, i)))
    :ok = Writer.close(writer)
    {0, lines} = run(["messages", writer.path, "-s", "S", "--json"])
    lines = lines |> String.split("\n", trim: true) |> Enum.map(&elem(Situ.JSON.decode(&1), 1))
    assert Enum.map(lines, &Map.get(&1, "data")) == [%{"a" => [1, "b"]}, nil, nil, nil, nil]

    assert Enum.map(lines, &Map.get(&1, "text")) == [
             nil,
             "<<255, 0>>",
             "%{{1} => 2}",
             "[1 | 2]",
             nil
           ]
  end

  test "rejects an option that the verb does not use, an empty crop and an empty edit",
       %{
         path: path
       } do
    out = path <> " out"

    for argv <- [
          ["copy", path, out, "--number", "3"],
          ["verify", path, "--stream", "Words"],
          ["crop", path, out],
          ["edit", path, out]
        ] do
      assert capture_io(:stderr, fn -> assert Situ.CLI.run(["store" | argv]) == 2 end) =~ "Fix:"
    end

    refute Store.exists?(out)
  end

  test "rejects edits of another type, or of messages that do not exist", %{
    path: path,
    tmp_dir: root
  } do
    out = Path.join(root, "out")
    edit = &["edit", path, out | &1]

    said = refused(edit.(["--delete", "Words@5"]))
    assert said =~ "no message at" and said =~ "00:00:10"
    said = refused(edit.(["--set", "Room.Level@0=\"x\""]))
    assert said =~ "Room.Level"
    refute Store.exists?(out)
  end

  test "rejects an interval without messages, and selects streams by patterns", %{
    path: path,
    tmp_dir: root
  } do
    out = Path.join(root, "out")
    said = refused(["crop", path, out, "--start", "1h"])
    assert said =~ "no messages between 1970-01-01T01:00" and said =~ "spans 1970"
    assert refused(["copy", path, out, "--from", "2020-01-01"]) =~ "between 2020-01-01T00:00:00"
    assert Store.newest("out", root) == nil
    {0, made} = run(["copy", path, out, "-s", "Room.*"])
    assert [%{name: "Room.Level"}] = made |> String.trim() |> Store.open!() |> Store.streams()
  end

  test "accepts dates as times, and split skips gaps", %{path: path, tmp_dir: root} do
    out = Path.join(root, "day")
    {0, made} = run(["crop", path, out, "--from", "1970-01-01", "--to", "1970-01-01 00:01"])
    assert length(values(String.trim(made), "Room.Level")) == 61
    {:ok, writer} = Writer.create("gap", root)
    {:ok, stream} = Writer.stream(writer, "S")
    {:ok, _} = Writer.append(stream, for(i <- [0, 1, 25], do: message(i, i)))
    :ok = Writer.close(writer)
    {0, parts} = run(["split", writer.path, Path.join(root, "part"), "--every", "10s"])

    assert parts |> String.split() |> Enum.map(&Path.basename/1) ==
             ~w(part-001.0000 part-003.0000)
  end

  test "compacts a store in place", %{path: path, tmp_dir: root} do
    folder = Store.open!(path).path
    {0, text} = run(["compact", folder])
    assert text =~ folder and text =~ "before"
    assert values(path, "Room.Level") == Enum.to_list(0..99)
    assert [%{"path" => ^folder, "size" => _}] = json(["compact", path, "--json"])
    assert Enum.filter(File.ls!(root), &(&1 =~ "lobby")) == ["lobby.0000"]
    assert refused(["compact", Path.join(root, "gone")]) =~ "no store"
  end

  test "moves a store, and datasets name the new path", %{path: path, tmp_dir: root} do
    alias Situ.Dataset
    folder = Store.open!(path).path
    study = Path.join(root, "study.json")
    far = Path.join(root, "far/off/other.json")
    archive = Path.join(root, "archive")
    File.mkdir_p!(Path.dirname(far))
    File.write!(Path.join(root, "broken.json"), ~s({"Sessions": 7}))

    for file <- [study, far] do
      {:ok, dataset} = Dataset.new("Study", file: file, autosave: true)
      {:ok, dataset} = Dataset.add_session(dataset, "p01")
      {:ok, _} = Dataset.add_partition(dataset, "p01", "Room", folder)
    end

    said =
      capture_io(:stderr, fn ->
        {0, said} = run(["move", path, archive, "--dataset", far])
        assert said =~ ~r/\A#{archive}\/lobby.0000\n#{far}: p01, Room\n#{study}: p01, Room\n\z/
      end)

    assert said =~ "broken.json was not changed"
    assert values(Path.join(archive, "lobby"), "Room.Level") == Enum.to_list(0..99)

    for file <- [study, far] do
      {:ok, dataset} = Dataset.load(file)
      assert [%{path: found}] = Dataset.list_partitions(dataset)
      assert found == Path.join(archive, "lobby.0000")
    end

    assert refused(["move", path, archive]) =~ "no store"
    assert refused(["move", Path.join(archive, "lobby"), archive]) =~ "already"
  end

  test "names a store after its folder", %{path: path} do
    {0, made} = run(["rename", path, "entrance"])
    made = String.trim(made)
    assert [%{"name" => "entrance"}] = json(["info", made, "--json"])
    assert elem(run(["info", made]), 1) =~ ~r/\Aentrance /
    moved = made |> Path.dirname() |> Path.join("hall.0007")
    File.rename!(made, moved)
    assert [%{"name" => "hall"}] = json(["info", moved, "--json"])
  end

  test "accepts file names that are not UTF-8", %{path: path, tmp_dir: root} do
    folder = Path.join(root, <<"caf", 0xE9>>)

    case File.mkdir(folder) do
      :ok ->
        {0, made} = run(["copy", path, Path.join(folder, "x")])
        assert made =~ "caf\\xE9/x.0000"
        assert File.ls!(folder) == ["x.0000"]
        assert values(Path.join(folder, "x"), "Room.Level") == Enum.to_list(0..99)
        {0, _} = run(["info", Path.join(folder, "x")])
        assert [%{"closed" => true}] = json(["info", Path.join(folder, "x"), "--json"])

      # Some file systems accept only UTF-8 names.
      {:error, _} ->
        :ok
    end
  end

  test "shows a store with an invalid catalog or returns an error, and never crashes", %{
    tmp_dir: root
  } do
    odd = [1.0e300, 12_345_678_901_234_567_890_123, "text", %{}, [1], nil]

    records =
      for value <- odd do
        [
          %{kind: "closed", id: 1, time: value},
          %{kind: "stream", id: 2, name: "B", type: value, opened: value},
          %{kind: "codec", id: 1, number: value, name: "c"},
          %{kind: "metadata", id: 1, type: value, term: Base.encode64("no term")},
          %{kind: "fields", id: 1, module: value, fields: value},
          %{kind: "store", name: value},
          %{kind: "piece", every: value, full: value}
        ]
      end

    {:ok, writer} = Writer.create("odd", root)
    {:ok, stream} = Writer.stream(writer, "A", type: :integer)
    {:ok, _} = Writer.append(stream, for(i <- 1..3, do: message(i, i)))
    for record <- Enum.concat(records), do: {:ok, _} = Writer.append_catalog(writer, record)
    :ok = Writer.close(writer)
    out = Path.join(root, "out")

    for {verb, args} <- [
          {"info", []},
          {"info", ["--json"]},
          {"info", ["-s", "A"]},
          {"info", ["-s", "A", "--json"]},
          {"info", ["-s", "B", "--json"]},
          {"messages", ["-s", "A"]},
          {"stats", []},
          {"copy", [out]},
          {"crop", [out, "--start", "0s", "--length", "5s"]},
          {"edit", [out, "--delete", "A@1000000000"]},
          {"save", [Path.join(root, "a.csv"), "-s", "A"]},
          {"compact", []},
          {"verify", []}
        ] do
      said =
        capture_io(:stderr, fn ->
          capture_io(fn -> Situ.CLI.run(["store", verb, writer.path | args]) end)
        end)

      refute said =~ "a bug in Situ", "#{verb} #{Enum.join(args, " ")}: #{said}"
    end
  end

  test "damage is an error when reading, unless it is to be skipped", %{
    path: path,
    tmp_dir: root
  } do
    folder = Store.open!(path).path
    File.rename!(Path.join(folder, "index.situ"), Path.join(root, "index"))
    said = refused(["info", path])
    assert said =~ "lost its index" and said =~ "repair"
    File.rename!(Path.join(root, "index"), Path.join(folder, "index.situ"))
    {:ok, writer} = Writer.create("big", root, first_extent: 65_536, max_extent: 65_536)
    {:ok, stream} = Writer.stream(writer, "Noise")

    Enum.reduce(0..99, stream, fn i, stream ->
      {:ok, stream} = Writer.append(stream, [message(:crypto.strong_rand_bytes(2_000), i)])
      stream
    end)

    :ok = Writer.close(writer)
    File.rm!(Path.join(writer.path, "data-000001.situ"))
    {0, text} = run(["info", writer.path])
    assert text =~ "DAMAGED: data-000001.situ is missing"
    {1, text} = run(["verify", writer.path])

    assert text =~
             ~r/data-000001.situ at byte 64: the file is missing \(and at \d+ more positions\)/

    out = Path.join(root, "out")
    assert refused(["copy", writer.path, out]) =~ "has lost its file"
    refute Store.exists?(out)

    messages = ["messages", writer.path, "-s", "Noise", "-n", "100"]

    assert capture_io(:stderr, fn -> assert {1, _} = run(messages) end) =~ "has lost its file"
    {0, made} = run(["copy", writer.path, out, "--skip-damage"])
    assert length(values(String.trim(made), "Noise")) in 50..90
  end

  test "deletes a store that is too damaged to open", %{path: path} do
    folder = Store.open!(path).path
    File.write!(Path.join(folder, "index.situ"), "rubbish")
    assert {:error, _} = Store.open(folder)
    assert {0, _} = run(["delete", folder, "-y"])
    refute File.exists?(folder)
  end

  defp values(path, stream),
    do: path |> Store.open!() |> Store.messages(stream) |> Enum.map(& &1.data)

  @psi Path.expand("../../../../situ_bridge/test/data/psi/truncated", __DIR__)

  test "reports losses of an external recording in the words of its reader" do
    {0, text} = run(["info", @psi])
    assert text =~ "DAMAGED 9 of 10 messages of the stream Small are missing"
  end
end
