defmodule Situ.CLI.AnnotateTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO
  alias Situ.{Annotation, Dataset, Message, Store}
  alias Situ.Annotation.{Editor, Layer, Recording, Schema}
  alias Situ.Dataset.{OpenSession, SessionLayers}

  @moduletag :tmp_dir

  defp boxes(root) do
    numbers = for name <- ~w(x y width height), do: %{"name" => name, "kind" => "number"}
    {:ok, schema} = Schema.parse(%{"name" => "Box", "attributes" => numbers})
    values = &%{"x" => &1, "y" => 0, "width" => 10, "height" => 10}
    keys = [Annotation.new(100, 100, "A", values.(0)), Annotation.new(300, 300, "A", values.(20))]
    {:ok, layer} = Layer.new(schema, keys)
    {:ok, path} = Recording.write(layer, Path.join(root, "boxes"), "Box")
    path
  end

  defp film(root) do
    {:ok, writer} = Store.Writer.create("film", root)
    {:ok, stream} = Store.Writer.stream(writer, "Video", type: :integer)

    messages =
      for i <- 1..4,
          do: %Message{data: i, originating_time: i * 100, creation_time: i * 100, sequence_id: i}

    {:ok, _} = Store.Writer.append(stream, messages)
    :ok = Store.Writer.close(writer)
    writer.path
  end

  defp bboxes(file) do
    {:ok, %{"annotations" => annotations}} = file |> File.read!() |> Situ.JSON.decode()
    for a <- annotations, do: hd(a["bbox"])
  end

  test "exports edits that no version contains yet", %{tmp_dir: root} do
    path = Path.join(root, "talk")
    {:ok, editor} = Editor.start_link(path: path, stream: "Words", schema: Schema.text("Words"))
    add = &Layer.add(&1, Annotation.new(&2, &2 + 1, "P1", %{"Words" => &3}))
    {:ok, _} = Editor.edit(editor, &add.(&1, 0, "saved"))
    {:ok, first} = Editor.save(editor)
    {:ok, _} = Editor.edit(editor, &add.(&1, 9, "in the log"))
    file = Path.join(root, "a.csv")
    assert {0, ""} = with_io(fn -> Situ.CLI.run(["annotate", "export", path, file]) end)
    assert File.read!(file) =~ "in the log"
    {:ok, _} = Editor.save(editor)
    assert {0, ""} = with_io(fn -> Situ.CLI.run(["annotate", "export", first, file]) end)
    refute File.read!(file) =~ "in the log"
  end

  test "exports COCO boxes of key frames, or of every image of a stream", %{tmp_dir: root} do
    {path, file} = {boxes(root), Path.join(root, "b.coco.json")}
    assert {0, ""} = with_io(fn -> Situ.CLI.run(["annotate", "export", path, file]) end)
    assert bboxes(file) == [0, 20]

    argv = [
      "annotate",
      "export",
      path,
      file,
      "--media-of",
      film(root),
      "--pictures",
      "Video",
      "--json"
    ]

    assert {0, said} = with_io(fn -> Situ.CLI.run(argv) end)
    assert {:ok, %{"losses" => [_], "annotations" => 2}} = Situ.JSON.decode(said)
    assert bboxes(file) == [0, 10, 20]

    said =
      capture_io(:stderr, fn ->
        assert Situ.CLI.run(["annotate", "export", path, file, "--pictures", "V"]) == 2
      end)

    assert said =~ "--media-of"
  end

  test "time 0 is the start of the recording if it also has other streams", %{tmp_dir: root} do
    {:ok, _} =
      Situ.Pipeline.run(
        fn p ->
          store = Store.create(p, "room", root)
          said = %Annotation{from: Situ.Time.s(2), to: Situ.Time.s(3), track: "P1", values: %{}}
          p |> Situ.from_enumerable(0..5, every: Situ.Time.s(1)) |> Store.write(store, "Level")

          p
          |> Situ.from_enumerable([{Situ.Time.s(3), [said]}], type: {:list, Annotation})
          |> Store.write(store, "Said")
        end,
        pipeline: [replay: [interval: {Situ.Time.s(1), :unbounded}, speed: :max]]
      )

    argv = ["annotate", "export", Path.join(root, "room"), "-", "--format", "webvtt"]
    assert {0, text} = with_io(fn -> Situ.CLI.run(argv) end)
    assert text =~ "00:00:01.000 --> 00:00:02.000"
  end

  test "lists, compares, names and restores versions of a layer", %{tmp_dir: root} do
    path = Path.join(root, "words")
    {:ok, editor} = Editor.start_link(path: path, stream: "Words", schema: Schema.text("Words"))
    {:ok, _} = Editor.edit(editor, &Layer.add(&1, Annotation.new(0, 10, "P1")), by: "Ada")
    {:ok, _} = Editor.save(editor)
    run = fn argv -> with_io(fn -> Situ.CLI.run(["annotate" | argv]) end) end
    assert {0, text} = run.(["history", path])
    assert text =~ ~r/1 .*Ada .*add annotation on P1 at 00:00:00.000/
    assert {0, "named \"first\"\n"} = run.(["name", path, "first"])
    {:ok, _} = Editor.edit(editor, &Layer.remove(&1, 1))
    assert {0, "delete annotation on P1 at 00:00:00.000\n"} = run.(["diff", path, "first"])
    assert {0, "1 annotation\n"} = run.(["restore", path <> ".0000", "first"])
    assert {0, "0 annotations\n"} = run.(["undo", path])
    assert {0, "1 annotation\n"} = run.(["redo", path])
    {:ok, layer} = Editor.refresh(editor)
    assert length(Layer.annotations(layer)) == 1

    assert capture_io(:stderr, fn ->
             assert Situ.CLI.run(["annotate", "history", path, "--stream", "Faces"]) == 1
           end) =~ "Words"
  end

  describe "with a session of a dataset" do
    setup %{tmp_dir: root} do
      file = Path.join(root, "study.json")
      {:ok, dataset} = Dataset.new("Study", file: file, autosave: true)

      for name <- ["p01", "p02"], reduce: dataset do
        dataset ->
          {:ok, dataset} = Dataset.add_session(dataset, name)

          {:ok, dataset} =
            Dataset.add_partition(dataset, name, "Room", film(Path.join(root, name)))

          dataset
      end

      {:ok, dataset} = Dataset.load(file)

      for {annotator, to} <- [{"Ada", 300}, {"Ben", 200}] do
        one = Annotation.new(150, to, "P1", %{"Speech" => "speaks"})
        {:ok, layer} = Layer.new(Schema.finite("Speech", ["speaks"]), [one])
        name = "Speech." <> annotator
        {:ok, _} = SessionLayers.create_layer(dataset, "p01", name, layer)
      end

      {:ok, study: file}
    end

    defp run(argv), do: with_io(fn -> Situ.CLI.run(["annotate" | argv]) end)

    test "lists its layers", %{study: study} do
      assert {0, said} = run(["info", study])
      assert said =~ "p01  Speech.Ada: 1 annotation" and said =~ "Speech.Ben"
      assert {0, said} = run(["info", study, "--session", "p02"])
      assert said =~ "no annotation streams"
    end

    test "exports and imports a layer; time 0 is the start of the session", %{study: study} do
      file = Path.rootname(study) <> ".csv"
      argv = ["export", study, file, "--session", "p01", "--stream", "Speech.Ada"]
      assert {0, ""} = run(argv)
      assert File.read!(file) =~ "P1"
      argv = ["import", file, study, "--session", "p02", "--stream", "Speech.Eve"]
      assert {0, said} = run(argv)
      assert said =~ "annotations"
      {:ok, dataset} = Dataset.load(study)
      {:ok, session} = Dataset.session(dataset, "p02")
      {:ok, messages} = OpenSession.messages(OpenSession.open(session), "Speech.Eve")
      assert [[%{from: 150, to: 300, track: "P1"}]] = Enum.map(messages, & &1.data)
      # An existing layer is not replaced.
      assert {1, _} = with_stderr(argv)
    end

    test "compares two layers, and asks which session is meant", %{study: study} do
      argv = ["agreement", study, study, "-s", "Speech.Ada", "--second-stream", "Speech.Ben"]
      assert {0, said} = run(argv ++ ["--session", "p01", "--frame", "10ns"])
      assert said =~ "kappa"
      assert {1, said} = with_stderr(argv)
      assert said =~ "--session: p01, p02"
    end

    test "edits the tiers of a layer, which undo brings back", %{study: study} do
      file = Path.rootname(study) <> ".csv"
      path = Path.join(Path.dirname(study), "talk/annotation")

      {:ok, schema} =
        Schema.parse(%{
          "name" => "Talk",
          "attributes" => [%{"name" => "Words", "kind" => "text"}],
          "tiers" => [%{"name" => "Words", "attribute" => "Words"}]
        })

      {:ok, layer} = Layer.new(schema, [Annotation.new(0, 9, "Words", %{"Words" => "hello"})])
      {:ok, _} = Recording.write(layer, path, "Talk")
      tiers = fn argv -> run([hd(argv), path | tl(argv)]) end

      assert tiers.(["add-tier", "Kind of Words: noun, verb"]) ==
               {0, "Words\nKind of Words: noun, verb\n"}

      assert tiers.(["set-values", "Kind", "noun -> N, verb"]) ==
               {0, "Words\nKind of Words: N, verb\n"}

      assert {0, "Tokens\nKind of Tokens" <> _} = tiers.(["rename-tier", "Words", "Tokens"])
      assert {0, "Tokens\nKind in Tokens" <> _} = tiers.(["set-parent", "Kind in Tokens"])
      assert {0, "Kind in Tokens" <> _} = tiers.(["move-tier", "Tokens"])
      assert {1, said} = with_stderr(["remove-tier", path, "Tokens"])
      assert said =~ "1 annotation" and said =~ "undone"
      assert {0, ""} = tiers.(["remove-tier", "Tokens", "--delete"])
      assert {0, "1 annotation\n"} = tiers.(["undo"])
      assert {0, said} = tiers.(["info"])
      assert said =~ "tier Kind in Tokens: N, verb" and said =~ "Tokens: 1"
      assert {0, ""} = run(["export", path, file])
      assert File.read!(file) =~ "hello"
    end

    defp with_stderr(argv) do
      parent = self()

      said =
        capture_io(:stderr, fn -> send(parent, {:status, Situ.CLI.run(["annotate" | argv])}) end)

      assert_received {:status, status}
      {status, said}
    end
  end
end
