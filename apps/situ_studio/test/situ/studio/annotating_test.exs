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
    assert Annotating.streams(path) == ["Speech"]
    {:ok, again} = Annotating.open(studio, path, "Speech", nil)
    assert length(items(again)) == 20
    assert %{unsaved: true, recovered: 20} = Annotating.told(again, "Speech")
    :ok = Annotating.edit(again, %{"do" => "save"})
    assert %{unsaved: false} = Annotating.told(again, "Speech")
    Editor.stop(again)
  end

  test "segments of a stream become proposals", %{studio: studio, path: path, schema: schema} do
    {:ok, editor} = Annotating.open(studio, path, "Speech", schema)
    segments = [{0, 5, "true", "true", "Ada"}, {5, 9, "false", "false", "Ada"}]
    :ok = Annotating.propose(editor, segments, "Vad.Speaking")

    assert [%{proposed: true, track: "Ada", by: "Vad.Speaking"}] =
             Annotating.told(editor, "Speech").items

    :ok = Annotating.edit(editor, %{"do" => "accept_all", "least" => 0.5})
    assert [%{proposed: false}] = Annotating.told(editor, "Speech").items
  end
end
