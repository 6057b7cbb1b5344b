defmodule Situ.CLI.StoreTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO
  alias Situ.CLI.Store, as: Command
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

  defp run(argv), do: with_io(fn -> Command.run(argv) end)

  defp json(argv) do
    {:ok, value} = argv |> run() |> elem(1) |> Situ.JSON.decode()
    value
  end

  test "info shows streams, rates, sizes, latency", %{path: path, tmp_dir: root} do
    {0, text} = run(["info", path])
    assert text =~ "closed; 2 streams, 110 messages"
    assert text =~ ~r/Room.Level +:integer +100 +1.0 Hz .* 2.00 ms/
    assert text =~ "1970-01-01T00:00:00.000000000Z .. 1970-01-01T00:01:39"

    assert %{"closed" => true, "streams" => [%{"count" => 100, "rate" => 1.0}, _]} =
             json(["info", path, "--json"])

    {0, list} = run(["info", root])
    assert list =~ "lobby.0000  2 streams, 1 min 39 s"
  end

  test "crop, copy, concat, edit, rename, delete", %{path: path, tmp_dir: root} do
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

  test "messages", %{path: path} do
    {0, text} = run(["messages", path, "-s", "Words", "-n", "2", "--from", "15000000000"])
    assert [first, _] = String.split(text, "\n", trim: true)
    assert first =~ "00:00:20" and first =~ "+2.00 ms" and first =~ "\"word 2\""
  end

  test "verify finds damage and says so by its status; repair mends", %{path: path} do
    {0, sound} = run(["verify", path])
    assert sound =~ ~r/^\d+ chunks, all sound/
    file = Path.join(Store.open!(path).path, "data-000000.situ")
    bytes = File.read!(file)
    {found, _} = :binary.match(bytes, "Room.Level")
    <<a::binary-size(found), "Room", rest::binary>> = bytes
    File.write!(file, [a, "Doom", rest])
    assert {1, text} = run(["verify", path])
    assert text =~ "DAMAGED" and text =~ "data-000000.situ at byte"
    assert %{"damage" => [_ | _]} = json(["verify", path, "--json"])
    assert {0, text} = run(["repair", path])
    assert text =~ "1 dropped"
    assert {0, _} = run(["verify", path])
  end

  test "wrong usage has status 2, what fails raises an error that says how to fix it", %{
    path: path
  } do
    for argv <- [[], ["infoo", path], ["info"], ["info", path, "--colour"], ["messages", path]] do
      assert capture_io(:stderr, fn -> assert Command.run(argv) == 2 end) =~ "Fix:"
    end

    for argv <- [
          ["info", path <> "x"],
          ["messages", path, "-s", "Wrods"],
          ["crop", path, path <> "y", "--start", "soon"],
          ["copy", path, path <> "y", "--compression", "rar"],
          ["edit", path, path <> "y", "--set", "Words@1=nojson"]
        ] do
      error = assert_raise Situ.Error, fn -> Command.run(argv) end
      assert error.fix
    end
  end

  test "several recordings: a line each, and the ones that cannot be read are told of", %{
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
    assert text |> String.split("\n", trim: true) |> Enum.count(&(&1 =~ "all sound")) == 2
    assert {1, text} = run(["verify", path, Path.join(root, "gone")])
    assert text =~ "all sound" and text =~ "no store at"
  end

  test "info of one stream: all that is known of it", %{path: path, tmp_dir: root} do
    {:ok, writer} = Writer.create("meta", root)
    {:ok, stream} = Writer.stream(writer, "S", type: :float, metadata: %{"unit" => "rad"})
    {:ok, stream} = Writer.append(stream, for(i <- 0..9, do: message(i / 1, i)))
    {:ok, _} = Writer.close_stream(stream, 9_000_000_000)
    :ok = Writer.close(writer)
    {0, text} = run(["info", writer.path, "--stream", "S"])
    assert text =~ ~s(%{"unit" => "rad"} \(:map\)) and text =~ "10, 1.0 Hz"
    assert text =~ "80 B, 8 B each" and text =~ "2.00 ms on average, 20.0 ms in all"
    assert text =~ "at 1970-01-01T00:00:09" and text =~ "compression none"
    info = json(["info", writer.path, "-s", "S", "--json"])
    assert %{"metadata" => %{"data" => %{"unit" => "rad"}, "type" => ":map"}} = info

    assert %{"count" => 10, "size" => 80, "latency_sum" => 20_000_000, "store_name" => "meta"} =
             info

    assert_raise Situ.Error, fn -> run(["info", path, "-s", "Nope"]) end
  end

  test "messages for programs hold the data itself", %{path: path, tmp_dir: root} do
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

  test "an option that says nothing to a verb, a crop to nothing, an edit of nothing are refused",
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
      assert capture_io(:stderr, fn -> assert Command.run(argv) == 2 end) =~ "Fix:"
    end

    refute Store.exists?(out)
  end

  test "edits are of the stream's type and of messages that are there", %{
    path: path,
    tmp_dir: root
  } do
    out = Path.join(root, "out")
    edit = &["edit", path, out | &1]

    error = assert_raise Situ.Error, fn -> run(edit.(["--delete", "Words@5"])) end
    assert error.code == :no_message and error.fix =~ "00:00:10"
    error = assert_raise Situ.Error, fn -> run(edit.(["--set", "Room.Level@0=\"x\""])) end
    assert error.code == :type_mismatch
    refute Store.exists?(out)
  end

  test "an interval without messages is told of; streams are chosen by patterns", %{
    path: path,
    tmp_dir: root
  } do
    out = Path.join(root, "out")
    argv = ["crop", path, out, "--start", "1h"]
    assert capture_io(:stderr, fn -> assert {0, _} = run(argv) end) =~ "empty"
    {0, made} = run(["copy", path, out, "-s", "Room.*"])
    assert [%{name: "Room.Level"}] = made |> String.trim() |> Store.open!() |> Store.streams()
  end

  test "damage is an error of what reads, unless it is to be left out", %{
    path: path,
    tmp_dir: root
  } do
    folder = Store.open!(path).path
    File.rename!(Path.join(folder, "index.situ"), Path.join(root, "index"))
    error = assert_raise Situ.Error, fn -> run(["info", path]) end
    assert error.code == :index_lost and error.fix =~ "repair"
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
    assert text =~ ~r/data-000001.situ at byte 64: the file is missing \(and at \d+ more places\)/
    out = Path.join(root, "out")
    error = assert_raise Situ.Error, fn -> run(["copy", writer.path, out]) end
    assert error.code == :missing_extent
    refute Store.exists?(out)

    error =
      assert_raise Situ.Error, fn ->
        run(["messages", writer.path, "-s", "Noise", "-n", "100"])
      end

    assert error.code == :missing_extent
    {0, made} = run(["copy", writer.path, out, "--skip-damage"])
    assert length(values(String.trim(made), "Noise")) in 50..90
  end

  test "a store too broken to be opened can be deleted", %{path: path} do
    folder = Store.open!(path).path
    File.write!(Path.join(folder, "index.situ"), "rubbish")
    assert {:error, _} = Store.open(folder)
    assert {0, _} = run(["delete", folder, "-y"])
    refute File.exists?(folder)
  end

  defp values(path, stream),
    do: path |> Store.open!() |> Store.messages(stream) |> Enum.map(& &1.data)
end
