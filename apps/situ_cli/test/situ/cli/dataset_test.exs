defmodule Situ.CLI.DatasetTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO
  alias Situ.{Annotation, Message, Store}
  alias Situ.Annotation.{Layer, Recording, Schema}

  @moduletag :tmp_dir

  defp run(argv), do: with_io(fn -> Situ.CLI.run(argv) end)

  defp json(argv) do
    {_, text} = run(argv ++ ["--json"])
    {:ok, value} = Situ.JSON.decode(text)
    value
  end

  defp record(root, name, start) do
    {:ok, writer} = Store.Writer.create(name, root)
    {:ok, stream} = Store.Writer.stream(writer, "Level", type: :integer)

    messages =
      for i <- 0..9 do
        time = (start + i) * 1_000_000_000
        %Message{data: i, originating_time: time, creation_time: time, sequence_id: i + 1}
      end

    {:ok, _} = Store.Writer.append(stream, messages)
    :ok = Store.Writer.close(writer)
    writer.path
  end

  test "lists, compares, names and restores versions", %{tmp_dir: root} do
    file = Path.join(root, "study.json")
    for i <- 1..2, do: record(Path.join(root, "p#{i}"), "room", i * 100)
    {0, _} = run(["dataset", "create", file, root])
    assert {0, text} = run(["dataset", "history", file])
    assert text =~ "no edits yet"
    {0, ""} = run(["dataset", "set", file, "p1", "--tag", "pilot"])
    {0, "2: name version 1 \"paper\"\n"} = run(["dataset", "name", file, "paper"])
    {0, ""} = run(["dataset", "rename", file, "p2", "late"])
    {0, text} = run(["dataset", "history", file])

    assert text =~ ~r/1 .*add tag pilot to session p1/ and
             text =~ ~r/3 .*rename session p2 to late/

    assert {0, "rename session p2 to late\n"} = run(["dataset", "diff", file, "paper"])
    assert {0, "4: undo 3\n"} = run(["dataset", "undo", file])
    assert {0, "5: redo 3\n"} = run(["dataset", "redo", file])
    assert {0, "6: restore version 0 (2 changes)\n"} = run(["dataset", "restore", file, "0"])
    assert {0, "no difference\n"} = run(["dataset", "diff", file, "0", "now"])
    assert [_, _, _, _, _, %{"version" => 6}] = json(["dataset", "history", file])

    assert capture_io(:stderr, fn ->
             assert Situ.CLI.run(["dataset", "restore", file, "9"]) == 1
           end) =~
             "0 to 6"
  end

  test "creates, lists, tags, seals and verifies a study of a folder", %{tmp_dir: root} do
    for i <- 1..3, do: record(Path.join(root, "p#{i}"), "room", i * 100)
    file = Path.join(root, "study.json")
    assert {0, text} = run(["dataset", "create", file, root])
    assert text =~ "3 sessions"

    assert capture_io(:stderr, fn ->
             assert Situ.CLI.run(["dataset", "create", file, root]) == 1
           end) =~ "--force"

    assert {0, ""} =
             run([
               "dataset",
               "set",
               file,
               "p2",
               "--tag",
               "pilot",
               "--set",
               "age=31",
               "--set",
               "notes=came late"
             ])

    assert {0, text} = run(["dataset", "info", file])

    assert text =~ "3 sessions, 30 messages in 3 streams" and
             text =~ ~r/p2 +pilot +1970-01-01T00:03:20 +9.00 s +1 +1 +10/

    assert %{
             "sessions" => [
               %{"name" => "p2", "metadata" => %{"age" => 31, "notes" => "came late"}}
             ]
           } = json(["dataset", "info", file, "--tag", "pilot"])

    assert {0, text} = run(["dataset", "info", file, "p2"])
    assert text =~ ~s(notes: "came late") and text =~ ~r/Level +:integer +10/

    extra = record(root, "extra", 900)
    assert {0, ""} = run(["dataset", "add", file, "p4", extra, "--tag", "late"])
    assert {0, ""} = run(["dataset", "rename", file, "p4/extra", "Room"])
    assert {0, ""} = run(["dataset", "rename", file, "p4", "p04"])
    assert {0, ""} = run(["dataset", "remove", file, "p1"])

    assert ["p2", "p3", "p04"] =
             for(s <- json(["dataset", "info", file])["sessions"], do: s["name"])

    assert {0, ""} = run(["dataset", "seal", file])
    assert {0, text} = run(["dataset", "verify", file])
    assert text =~ "3 recordings, all intact"

    File.rm_rf!(Path.join(root, "p3/room.0000"))

    assert capture_io(:stderr, fn -> assert {1, _} = run(["dataset", "info", file]) end) =~
             "p3/room"

    assert {1, text} = run(["dataset", "verify", file])
    assert text =~ "p3/room" and text =~ "no store"

    assert capture_io(:stderr, fn ->
             assert Situ.CLI.run(["dataset", "add", file, "p9", "/nowhere"]) == 1
           end) =~ "no store"
  end

  test "exports annotations to ELAN and back, and compares annotators", %{tmp_dir: root} do
    schema = Schema.finite("Speech", ["speaks", "laughs"])

    make = fn spans ->
      Layer.new(
        schema,
        for(
          {from, to} <- spans,
          do: Annotation.new(from * 1_000_000_000, to * 1_000_000_000, "P1")
        )
      )
    end

    {:ok, anna} = make.([{100, 110}, {120, 130}])
    {:ok, ben} = make.([{101, 110}, {120, 132}])
    record(root, "room", 90)
    {:ok, _} = Recording.write(anna, Path.join(root, "anna"), "Speech")
    {:ok, _} = Recording.write(ben, Path.join(root, "ben"), "Speech")
    {0, text} = run(["annotate", "info", Path.join(root, "anna")])
    assert text =~ "Speech: 2 annotations; Speech (finite)" and text =~ "P1: 2"
    eaf = Path.join(root, "anna.eaf")

    assert {0, ""} =
             run([
               "annotate",
               "export",
               Path.join(root, "anna"),
               eaf,
               "--media-of",
               Path.join(root, "room")
             ])

    assert File.read!(eaf) =~ ~s(TIME_VALUE="10000")
    assert {0, text} = run(["annotate", "import", eaf, Path.join(root, "again"), "-s", "Speech"])
    assert {:ok, again} = Recording.load_layer(Store.open!(String.trim(text)), "Speech")
    assert Layer.annotations(again) == Layer.annotations(anna)

    {0, text} = run(["annotate", "agreement", eaf, Path.join(root, "ben"), "--frame", "1s"])
    assert text =~ "Speech: kappa 0.7966"
    assert text =~ "2 pairs; begins 500 ms apart, ends 1.00 s"
    assert {1, _} = run(["annotate", "agreement", eaf, Path.join(root, "ben"), "--least", "0.95"])

    assert %{"paired" => 2, "confusion" => [_ | _]} =
             json(["annotate", "agreement", eaf, Path.join(root, "ben")])

    {0, vtt} = run(["annotate", "export", Path.join(root, "anna"), "-", "--format", "webvtt"])
    assert vtt =~ "WEBVTT" and vtt =~ "<v P1>speaks</v>"
  end

  test "reports losses and mistakes", %{tmp_dir: root} do
    {:ok, layer} =
      Layer.new(Schema.text("Words"), [
        Annotation.new(0, 1, "A", %{"Words" => "x"}, confidence: 0.5)
      ])

    path = Path.join(root, "a")
    {:ok, _} = Recording.write_all(%{"One" => layer, "Two" => layer}, path)
    out = Path.join(root, "x.srt")

    said =
      capture_io(:stderr, fn -> assert Situ.CLI.run(["annotate", "export", path, out]) == 1 end)

    assert said =~ "One, Two"

    said =
      capture_io(:stderr, fn ->
        assert Situ.CLI.run(["annotate", "export", path, out, "-s", "One"]) == 0
      end)

    assert said =~ "lost: SubRip" and said =~ "milliseconds"
    File.write!(Path.join(root, "bad.eaf"), "<!DOCTYPE x [<!ENTITY a 'b'>]><x>&a;</x>")

    said =
      capture_io(:stderr, fn ->
        assert Situ.CLI.run(["annotate", "import", Path.join(root, "bad.eaf"), path]) == 1
      end)

    assert said =~ "document type"
  end

  test "queries a recording or all sessions, and keeps proposals", %{tmp_dir: root} do
    for i <- 1..2, do: record(Path.join(root, "p#{i}"), "room", i * 100)
    file = Path.join(root, "study.json")
    {0, _} = run(["dataset", "create", file, root])

    assert {0, text} =
             run(["store", "query", Path.join(root, "p1/room"), "Level >= 3 and Level < 5"])

    assert text == "1970-01-01T00:01:43.000000000Z  1970-01-01T00:01:45.000000000Z  2.00 s\n"

    assert [%{"session" => "p1", "intervals" => [_]}, %{"session" => "p2"}] =
             json(["dataset", "query", file, "Level > 7"])

    assert {0, _} =
             run([
               "dataset",
               "query",
               file,
               "Level in [2, 3]",
               "--name",
               "p2",
               "--annotate",
               "Found"
             ])

    {:ok, dataset} = Situ.Dataset.open(file)
    {:ok, session} = Situ.Dataset.session(dataset, "p2")
    {:ok, layer} = Recording.load_layer(Store.open!(List.last(session.partitions).path), "Found")

    assert [%{from: 202_000_000_000, to: 204_000_000_000, proposed?: true}] =
             Layer.annotations(layer)

    said =
      capture_io(:stderr, fn ->
        assert Situ.CLI.run(["store", "query", Path.join(root, "p1/room"), "Level >"]) == 1
      end)

    assert said =~ "character 8"

    assert capture_io(:stderr, fn ->
             assert Situ.CLI.run(["store", "query", Path.join(root, "p1/room"), "Levl > 1"]) == 1
           end) =~ "Level"
  end
end
