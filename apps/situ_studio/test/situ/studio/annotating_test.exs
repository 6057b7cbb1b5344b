defmodule Situ.Studio.AnnotatingTest do
  # Annotations of a recording: made, changed, found again after a crash.
  use ExUnit.Case, async: true

  alias Situ.Annotation.Editor
  alias Situ.Studio.{Annotating, Catalog}

  @moduletag :tmp_dir

  setup %{tmp_dir: dir} do
    id = "annotating-#{System.unique_integer([:positive])}"
    supervisor = {DynamicSupervisor, name: Catalog.watches(id), strategy: :one_for_one}
    start_supervised!(supervisor)
    {:ok, schema} = Annotating.schema("Speech", "speaks 1 #1f77b4, laughs 2")
    {:ok, studio: id, path: Path.join(dir, "talk.0000"), schema: schema}
  end

  defp add(editor, from, to, value) do
    Annotating.edit(editor, %{
      "do" => "add",
      "from" => Integer.to_string(from),
      "to" => Integer.to_string(to),
      "track" => "P1",
      "values" => %{"Speech" => value}
    })
  end

  defp items(editor) do
    for a <- Annotating.told(editor, "Speech").items, do: {a.from, a.to, a.values["Speech"]}
  end

  test "edits keep the rules; wrong ones say why", %{studio: studio, path: path, schema: schema} do
    {:ok, editor} = Annotating.open(studio, path, "Speech", schema)
    assert {:ok, ^editor} = Annotating.open(studio, path, "Speech", nil)
    :ok = add(editor, 0, 10, "speaks")
    :ok = add(editor, 20, 10, "laughs")
    assert items(editor) == [{"0", "10", "speaks"}, {"10", "20", "laughs"}]
    assert {:error, %{code: :overlap}} = add(editor, 5, 15, "speaks")
    assert {:error, _} = add(editor, 30, 40, "sings")
    edge = %{"do" => "edge", "id" => 1, "edge" => "to", "to" => "14"}
    :ok = Annotating.edit(editor, edge)
    assert items(editor) == [{"0", "14", "speaks"}, {"14", "20", "laughs"}]
    :ok = Annotating.edit(editor, %{"do" => "undo"})
    assert items(editor) == [{"0", "10", "speaks"}, {"10", "20", "laughs"}]

    for bad <- [%{}, %{"do" => "dance"}, %{"do" => "remove", "id" => "x"}, %{"do" => "add"}],
        do: assert({:error, %{code: :bad_request}} = Annotating.edit(editor, bad))
  end

  test "key frames, confidence, intervals and tracks", context do
    %{studio: studio, path: path} = context
    {:ok, editor} = Annotating.open(studio, path, "Cars", Annotating.spatial("Cars", :point))

    at = fn t, x ->
      values = %{"x" => x, "y" => 2}

      Annotating.edit(editor, %{
        "do" => "key_frame",
        "at" => t,
        "track" => "1",
        "values" => values
      })
    end

    :ok = at.("10", 1)
    :ok = at.("20", 3)
    # at the same moment: the same key frame
    :ok = at.("10", 5)
    found = Annotating.told(editor, "Cars").items
    assert [%{from: "10", to: "10", values: %{"x" => 5, "y" => 2}}, %{from: "20"}] = found
    assert {:error, _} = at.("30", "left")
    :ok = Annotating.edit(editor, %{"do" => "confidence", "id" => 1, "confidence" => 0.5})
    assert [%{confidence: 0.5} | _] = Annotating.told(editor, "Cars").items
    bad = %{"do" => "confidence", "id" => 1, "confidence" => 2}
    assert {:error, %{code: :bad_request}} = Annotating.edit(editor, bad)
    interval = %{"do" => "interval", "id" => 1, "from" => "12", "to" => "15"}
    :ok = Annotating.edit(editor, interval)
    assert [%{from: "12", to: "15"} | _] = Annotating.told(editor, "Cars").items
    :ok = Annotating.edit(editor, %{"do" => "delete_track", "track" => "1"})
    assert Annotating.told(editor, "Cars").items == []
  end

  test "two streams of a recording are saved independently", context do
    %{studio: studio, path: path, schema: schema} = context
    {:ok, one} = Annotating.open(studio, path, "Speech", schema)
    {:ok, two} = Annotating.open(studio, path, "Speech.Ada", schema)
    :ok = add(one, 0, 10, "speaks")
    :ok = add(two, 20, 30, "laughs")
    {:ok, _} = Editor.save(one)
    :ok = add(two, 40, 50, "laughs")
    ref = Process.monitor(two)
    Process.exit(two, :kill)
    assert_receive {:DOWN, ^ref, _, _, _}
    assert Annotating.Shelf.streams(path) == ["Speech", "Speech.Ada"]
    {:ok, two} = reopened(studio, path, "Speech.Ada")
    assert length(items(two)) == 2
    {:ok, _} = Editor.save(two)
    assert items(one) == [{"0", "10", "speaks"}]
  end

  # The name is free a moment after the process has ended.
  defp reopened(studio, path, stream) do
    case Annotating.open(studio, path, stream, nil) do
      {:ok, pid} -> if Process.alive?(pid), do: {:ok, pid}, else: reopened(studio, path, stream)
      error -> error
    end
  end

  test "another schema renames what annotations say, and refuses to lose any", context do
    %{studio: studio, path: path, schema: schema} = context
    {:ok, editor} = Annotating.open(studio, path, "Speech", schema)
    :ok = add(editor, 0, 10, "speaks")
    draft = Annotating.SchemaForm.draft(Editor.layer(editor).schema)
    fields = %{"0" => %{"name" => "Voice", "values" => %{"0" => %{"value" => "talks"}}}}
    renamed = Annotating.SchemaForm.read(draft, fields)
    :ok = Annotating.put_schema(editor, renamed)
    assert [%{values: %{"Voice" => "talks"}}] = Annotating.told(editor, "Speech").items
    less = renamed |> Annotating.SchemaForm.remove(0, 0)
    assert {:error, error} = Annotating.put_schema(editor, less)
    assert Exception.message(error) =~ "talks"
    assert [%{values: %{"Voice" => "talks"}}] = Annotating.told(editor, "Speech").items
    assert {:error, %{code: :bad_schema}} = Annotating.put_schema(editor, [])
    # it is on the disk
    :ok = Editor.stop(editor)
    {:ok, editor} = reopened(studio, path, "Speech")
    assert [%{values: %{"Voice" => "talks"}}] = Annotating.told(editor, "Speech").items
  end

  test "what a killed server had not saved is there again", %{
    studio: studio,
    path: path,
    schema: schema
  } do
    {:ok, editor} = Annotating.open(studio, path, "Speech", schema)
    for i <- 0..19, do: :ok = add(editor, i * 10, i * 10 + 8, "speaks")
    ref = Process.monitor(editor)
    Process.exit(editor, :kill)
    assert_receive {:DOWN, ^ref, _, _, _}
    assert Annotating.Shelf.streams(path) == ["Speech"]
    {:ok, again} = Annotating.open(studio, path, "Speech", nil)
    assert length(items(again)) == 20
    assert %{unsaved: true, recovered: 20} = Annotating.told(again, "Speech")
    :ok = Annotating.edit(again, %{"do" => "save"})
    assert %{unsaved: false} = Annotating.told(again, "Speech")
    Editor.stop(again)
  end

  test "segments of a stream become proposals", %{studio: studio, path: path, schema: schema} do
    {:ok, editor} = Annotating.open(studio, path, "Speech", schema)
    one = &%{from: &1, to: &2, lane: &3, label: &4, confidence: &5}

    found = [
      one.(0, 5, "Ada", "", 0.6),
      one.(2, 3, "Ada", "", 0.9),
      one.(7, 9, "Ada", "unknown", nil)
    ]

    assert {:ok, 1} = Annotating.propose(editor, found, "Vad.Speaking")

    assert [%{proposed: true, track: "Ada", by: "Vad.Speaking"}] =
             Annotating.told(editor, "Speech").items

    :ok = Annotating.edit(editor, %{"do" => "accept_all", "least" => 0.5})
    assert [%{proposed: false}] = Annotating.told(editor, "Speech").items
  end
end
