defmodule Situ.Annotation.PythonTest do
  # Annotations are edited with Elixir and with the Python package at the same time, through one log.
  use ExUnit.Case, async: true
  alias Situ.{Annotation, Message, Store}
  alias Situ.Annotation.{Editor, History, Layer, LayerDocument, Schema, TierText}

  @moduletag :tmp_dir
  @package Path.expand("../../../../../clients/python/src", __DIR__)

  setup %{tmp_dir: root} do
    {:ok, writer} = Store.Writer.create("lobby", root)
    {:ok, stream} = Store.Writer.stream(writer, "N", type: :integer)
    message = %Message{data: 1, originating_time: 5, creation_time: 5, sequence_id: 1}
    {:ok, _} = Store.Writer.append(stream, [message])
    :ok = Store.Writer.close(writer)
    {:ok, recording: writer.path, layers: writer.path <> "-annotation-Speech"}
  end

  defp start_editor(ctx, schema) do
    {:ok, editor} = Editor.start_link(path: ctx.layers, stream: "Speech", schema: schema)
    {:ok, _} = Editor.save(editor)
    editor
  end

  defp python(code, arguments) do
    env = [{"PYTHONPATH", @package}, {"PYTHONDONTWRITEBYTECODE", "1"}]
    System.cmd("python3", ["-c", code | arguments], env: env, stderr_to_stdout: true)
  end

  defp summary(annotations),
    do:
      for(a <- annotations, do: {a.id, a.from, a.to, a.track, a.values, a.proposed?})
      |> Enum.sort()

  @reading """
  import json, sys, situ
  layer = situ.annotations(sys.argv[1], "Speech")
  print(json.dumps([[a.id, a.start, a.end, a.track, a.values, a.proposed] for a in layer]))
  """

  defp read_in_python(recording) do
    {text, 0} = python(@reading, [recording])
    {:ok, rows} = Situ.JSON.decode(text)
    rows |> Enum.map(&List.to_tuple/1) |> Enum.sort()
  end

  test "both see each other's edits, and the history names the person", ctx do
    editor = start_editor(ctx, Schema.finite("Speech", ["speaks", "laughs"]))
    {:ok, _} = Editor.edit(editor, &Layer.add(&1, Annotation.new(0, 10, "P1")))

    code = """
    import sys, situ
    recording = sys.argv[1]
    assert situ.layers(recording) == ["Speech"]
    layer = situ.annotations(recording, "Speech")
    assert [(a.start, a.end, a.values) for a in layer] == [(0, 10, {"Speech": "speaks"})]
    assert layer.schema["name"] == "Speech" and len(layer) == 1
    layer.change(1, end=20, values={"Speech": "laughs"}, editor="Ada")
    new = layer.add(30, 40, "P1", by="detector", confidence=0.75, proposed=True)
    assert layer[new.id] == new and layer.version == 3
    with layer.edit(by="Ada") as batch:
        batch.add(50, 60, "P1")
        batch.add(60, 70, "P1")
        batch.remove(new.id)
    assert len(layer) == 3 and layer.version == 4
    """

    assert {"", 0} = python(code, [ctx.recording])
    {:ok, layer} = Editor.refresh(editor)

    assert [%{from: 0, to: 20, values: %{"Speech" => "laughs"}}, %{from: 50}, %{from: 60}] =
             Layer.annotations(layer)

    {:ok, entries} = History.list({ctx.layers, "Speech"})
    assert Enum.map(entries, & &1.by) |> Enum.drop(1) == ["Ada", "detector", "Ada"]
    assert List.last(entries).what =~ "add annotation"
    # The same user undoes the edit of the Python program.
    {:ok, layer} = Editor.undo(editor)
    assert [_, %{from: 30, proposed?: true, confidence: 0.75}] = Layer.annotations(layer)
    {:ok, _} = Editor.save(editor)
    assert read_in_python(ctx.recording) == summary(Layer.annotations(layer))
  end

  test "a rule that would be broken and a conflict are errors, and change nothing", ctx do
    editor = start_editor(ctx, Schema.finite("Speech", ["speaks", "laughs"]))
    {:ok, _} = Editor.edit(editor, &Layer.add(&1, Annotation.new(0, 10, "P1")))

    code = """
    import sys, situ
    layer = situ.annotations(sys.argv[1], "Speech")
    other = situ.annotations(sys.argv[1], "Speech")

    def refused(error, call):
        before = list(situ.annotations(sys.argv[1], "Speech"))
        try:
            call()
        except error:
            assert before == list(situ.annotations(sys.argv[1], "Speech"))
        else:
            raise AssertionError("it is not refused")

    refused(ValueError, lambda: layer.add(5, 15, "P1"))
    refused(ValueError, lambda: layer.add(20, 15, "P1"))
    refused(ValueError, lambda: layer.add(20, 25, ""))
    refused(ValueError, lambda: layer.add(20, 25, "P1", {"Speech": "sings"}))
    refused(ValueError, lambda: layer.add(20, 25, "P1", {"Mood": "calm"}))
    refused(ValueError, lambda: layer.add(20, 25, "P1", confidence=float("nan")))
    refused(ValueError, lambda: layer.add(20, 25, "P1", note="\\ud800"))
    refused(ValueError, lambda: layer.add(1 << 63, 1 << 64, "P1"))
    refused(TypeError, lambda: layer.add(1.5, 2.5, "P1"))
    refused(KeyError, lambda: layer.remove(99))
    other.change(1, note="mine")
    layer.change(1, values={"Speech": "laughs"})
    refused(situ.ConflictError, lambda: layer.remove(1) or other.change(1, end=5))
    """

    # The last call removes it with the layer that has seen the latest edit, so the other one is refused.
    {text, status} = python(String.replace(code, "layer.remove(1) or ", ""), [ctx.recording])
    assert status == 1 and text =~ "it is not refused", text
    assert [%{note: "mine", to: 5}] = editor |> refreshed() |> Layer.annotations()

    conflict = """
    import sys, situ
    layer, other = (situ.annotations(sys.argv[1], "Speech") for _ in range(2))
    layer.change(1, end=7)
    for call in (lambda: other.change(1, start=2), lambda: other.remove(1)):
        try:
            call()
        except situ.ConflictError as error:
            print(error)
    other.refresh()
    other.change(1, start=2)
    """

    assert {text, 0} = python(conflict, [ctx.recording])
    assert length(Regex.scan(~r/was changed by another program/, text)) == 2
    assert [%{from: 2, to: 7}] = editor |> refreshed() |> Layer.annotations()
  end

  defp refreshed(editor) do
    {:ok, layer} = Editor.refresh(editor)
    layer
  end

  test "a layer that does not exist is created, and the studio's editor opens it", ctx do
    code = """
    import sys, situ
    try:
        situ.annotations(sys.argv[1], "Speech")
    except FileNotFoundError:
        schema = {"name": "Speech", "attributes": [{"name": "Words", "kind": "text"}]}
        layer = situ.annotations(sys.argv[1], "Speech", schema=schema)
        layer.add(0, 10, "P1", {"Words": "hello"})
    """

    assert {"", 0} = python(code, [ctx.recording])
    {:ok, editor} = Editor.start_link(path: ctx.layers, stream: "Speech")
    layer = Editor.current_layer(editor)
    assert layer.schema == Schema.text("Words") |> Map.put(:name, "Speech")
    assert [%{values: %{"Words" => "hello"}, id: 1}] = Layer.annotations(layer)
    {:ok, _} = Editor.edit(editor, &Layer.remove(&1, 1))
    {:ok, _} = Editor.save(editor)
    assert read_in_python(ctx.recording) == []
  end

  test "programs edit at the same time, and no acknowledged edit is lost", ctx do
    editor = start_editor(ctx, Schema.text("Words"))

    code = """
    import random, sys, situ
    recording, track = sys.argv[1:3]
    layer = situ.annotations(recording, "Speech")
    for n in range(25):
        print(layer.add(n * 10, n * 10 + 5, track, {"Words": f"{track} {n}"}).id)
        if n % 5 == 4:
            layer.change(layer.add(n * 10 + 5, n * 10 + 9, track).id, values={"Words": "changed"})
    """

    tasks = for n <- 1..3, do: Task.async(fn -> python(code, [ctx.recording, "py#{n}"]) end)

    for n <- 0..39 do
      add = &Layer.add(&1, Annotation.new(n * 10, n * 10 + 5, "ex", %{"Words" => "ex #{n}"}))
      {:ok, _} = Editor.edit(editor, add)
      if rem(n, 10) == 0, do: {:ok, _} = Editor.save(editor)
    end

    for {text, status} <- Task.await_many(tasks, 120_000), do: assert({status, text} == {0, text})
    layer = refreshed(editor)
    for n <- 1..3, do: assert(length(Layer.on_track(layer, "py#{n}")) == 30)
    assert length(Layer.on_track(layer, "ex")) == 40
    assert layer |> Layer.annotations() |> Enum.count(&(&1.values["Words"] == "changed")) == 15
    assert read_in_python(ctx.recording) == summary(Layer.annotations(layer))
    {:ok, document} = LayerDocument.open(ctx.layers, "Speech", nil)
    assert summary(Layer.annotations(document.layer)) == summary(Layer.annotations(layer))
  end

  # An operation that breaks a rule would make the log unreadable for Elixir, so Python must be at least as strict.
  test "every edit that Python accepts is valid in Elixir, also on tiers", ctx do
    lines =
      "Utterance\nWords in Utterance\nTurns divides Utterance\nKind of Words: noun, verb\nGaze"

    {:ok, schema} = TierText.parse_schema("Talk", lines)
    editor = start_editor(ctx, schema)

    code = """
    import random, sys, situ
    random.seed(int(sys.argv[2]))
    layer = situ.annotations(sys.argv[1], "Speech")
    tracks = ["Utterance", "Words", "Turns", "Kind", "Gaze", "Utterance@Ada", "Words@Ada", "free"]
    for _ in range(400):
        start = random.randrange(60)
        end = start + random.choice([0, 1, 5, 20])
        try:
            if random.random() < 0.6 or not len(layer):
                track = random.choice(tracks)
                values = {random.choice(["Utterance", "Words", "Kind"]): "noun"} if random.random() < 0.3 else {}
                layer.add(start, end, track, values)
            elif random.random() < 0.5:
                fields = random.choice([{"start": start}, {"end": end}, {"track": random.choice(tracks)}])
                layer.change(random.choice(list(layer)).id, **fields)
            else:
                layer.remove(random.choice(list(layer)).id)
        except ValueError:
            pass
    print(layer.version)
    """

    {text, 0} = python(code, [ctx.recording, to_string(:rand.uniform(1_000_000))])
    {:ok, document} = LayerDocument.open(ctx.layers, "Speech", nil)
    assert document.log.n == String.to_integer(String.trim(text)), text
    assert document.log.n > 20
    layer = refreshed(editor)
    assert read_in_python(ctx.recording) == summary(Layer.annotations(layer))
    assert {:ok, _} = Layer.new(layer.schema, Layer.annotations(layer))
  end
end
