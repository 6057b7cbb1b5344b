defmodule Situ.Studio.AnnotationsTest do
  # Creates and changes annotations of a recording, and recovers them after a crash.
  use ExUnit.Case, async: true

  alias Situ.Annotation.Editor
  alias Situ.Studio.{Annotations, Catalog}

  @moduletag :tmp_dir

  setup %{tmp_dir: dir} do
    id = "annotating-#{System.unique_integer([:positive])}"
    supervisor = {DynamicSupervisor, name: Catalog.watch_supervisor(id), strategy: :one_for_one}
    start_supervised!(supervisor)
    {:ok, schema} = Annotations.parse_schema("Speech", "speaks 1 #1f77b4, laughs 2")
    {:ok, studio: id, path: Path.join(dir, "talk.0000"), schema: schema}
  end

  defp open_editor(studio, path, stream, schema),
    do:
      Annotations.open_editor(studio, Annotations.Files.store_path(path, stream), stream, schema)

  defp add(editor, from, to, value) do
    Annotations.apply_edit(editor, %{
      "do" => "add",
      "from" => Integer.to_string(from),
      "to" => Integer.to_string(to),
      "track" => "P1",
      "values" => %{"Speech" => value}
    })
  end

  defp items(editor) do
    for a <- Annotations.page_state(editor, "Speech").items,
        do: {a.from, a.to, a.values["Speech"]}
  end

  test "edits follow the rules or say why not", %{studio: studio, path: path, schema: schema} do
    {:ok, editor} = open_editor(studio, path, "Speech", schema)
    assert {:ok, ^editor} = open_editor(studio, path, "Speech", nil)
    :ok = add(editor, 0, 10, "speaks")
    :ok = add(editor, 20, 10, "laughs")
    assert items(editor) == [{"0", "10", "speaks"}, {"10", "20", "laughs"}]
    assert {:error, %{code: :overlap}} = add(editor, 5, 15, "speaks")
    assert {:error, _} = add(editor, 30, 40, "sings")
    edge = %{"do" => "edge", "id" => 1, "edge" => "to", "to" => "14"}
    :ok = Annotations.apply_edit(editor, edge)
    assert items(editor) == [{"0", "14", "speaks"}, {"14", "20", "laughs"}]
    :ok = Annotations.apply_edit(editor, %{"do" => "undo"})
    assert items(editor) == [{"0", "10", "speaks"}, {"10", "20", "laughs"}]

    for bad <- [%{}, %{"do" => "dance"}, %{"do" => "remove", "id" => "x"}, %{"do" => "add"}],
        do: assert({:error, %{code: :bad_request}} = Annotations.apply_edit(editor, bad))
  end

  test "edits key frames, confidence, intervals and tracks", context do
    %{studio: studio, path: path} = context

    {:ok, editor} =
      open_editor(studio, path, "Cars", Annotations.build_spatial_schema("Cars", :point))

    at = fn t, x ->
      values = %{"x" => x, "y" => 2}

      Annotations.apply_edit(editor, %{
        "do" => "key_frame",
        "at" => t,
        "track" => "1",
        "values" => values
      })
    end

    :ok = at.("10", 1)
    :ok = at.("20", 3)
    # The time is the same, so this changes the same key frame.
    :ok = at.("10", 5)
    found = Annotations.page_state(editor, "Cars").items
    assert [%{from: "10", to: "10", values: %{"x" => 5, "y" => 2}}, %{from: "20"}] = found
    assert {:error, _} = at.("30", "left")
    :ok = Annotations.apply_edit(editor, %{"do" => "confidence", "id" => 1, "confidence" => 0.5})
    assert [%{confidence: 0.5} | _] = Annotations.page_state(editor, "Cars").items
    bad = %{"do" => "confidence", "id" => 1, "confidence" => 2}
    assert {:error, %{code: :bad_request}} = Annotations.apply_edit(editor, bad)
    interval = %{"do" => "interval", "id" => 1, "from" => "12", "to" => "15"}
    :ok = Annotations.apply_edit(editor, interval)
    assert [%{from: "12", to: "15"} | _] = Annotations.page_state(editor, "Cars").items
    :ok = Annotations.apply_edit(editor, %{"do" => "delete_track", "track" => "1"})
    assert Annotations.page_state(editor, "Cars").items == []
  end

  test "saves two streams of a recording independently", context do
    %{studio: studio, path: path, schema: schema} = context
    {:ok, one} = open_editor(studio, path, "Speech", schema)
    {:ok, two} = open_editor(studio, path, "Speech.Ada", schema)
    :ok = add(one, 0, 10, "speaks")
    :ok = add(two, 20, 30, "laughs")
    {:ok, _} = Editor.save(one)
    :ok = add(two, 40, 50, "laughs")
    ref = Process.monitor(two)
    Process.exit(two, :kill)
    assert_receive {:DOWN, ^ref, _, _, _}
    assert Annotations.Home.list_names({:recording, path}) == ["Speech", "Speech.Ada"]
    {:ok, two} = reopened(studio, path, "Speech.Ada")
    assert length(items(two)) == 2
    {:ok, _} = Editor.save(two)
    assert items(one) == [{"0", "10", "speaks"}]
  end

  # The name becomes free a moment after the process has ended.
  defp reopened(studio, path, stream) do
    case open_editor(studio, path, stream, nil) do
      {:ok, pid} -> if Process.alive?(pid), do: {:ok, pid}, else: reopened(studio, path, stream)
      error -> error
    end
  end

  test "another schema renames the values in use, and cannot remove them", context do
    %{studio: studio, path: path, schema: schema} = context
    {:ok, editor} = open_editor(studio, path, "Speech", schema)
    :ok = add(editor, 0, 10, "speaks")
    draft = Annotations.SchemaForm.from_schema(Editor.current_layer(editor).schema)
    fields = %{"0" => %{"name" => "Voice", "values" => %{"0" => %{"value" => "talks"}}}}
    renamed = Annotations.SchemaForm.update_from_params(draft, fields)
    :ok = Annotations.put_schema(editor, renamed)
    assert [%{values: %{"Voice" => "talks"}}] = Annotations.page_state(editor, "Speech").items
    less = renamed |> Annotations.SchemaForm.remove_entry(0, 0)
    assert {:error, error} = Annotations.put_schema(editor, less)
    assert Exception.message(error) =~ "talks"
    assert [%{values: %{"Voice" => "talks"}}] = Annotations.page_state(editor, "Speech").items
    assert {:error, %{code: :bad_schema}} = Annotations.put_schema(editor, [])
    # The change was written to disk.
    :ok = Editor.stop(editor)
    {:ok, editor} = reopened(studio, path, "Speech")
    assert [%{values: %{"Voice" => "talks"}}] = Annotations.page_state(editor, "Speech").items
  end

  test "recovers the unsaved edits of a killed server", %{
    studio: studio,
    path: path,
    schema: schema
  } do
    {:ok, editor} = open_editor(studio, path, "Speech", schema)
    for i <- 0..19, do: :ok = add(editor, i * 10, i * 10 + 8, "speaks")
    ref = Process.monitor(editor)
    Process.exit(editor, :kill)
    assert_receive {:DOWN, ^ref, _, _, _}
    assert Annotations.Home.list_names({:recording, path}) == ["Speech"]
    {:ok, again} = open_editor(studio, path, "Speech", nil)
    assert length(items(again)) == 20
    assert %{unsaved: true, recovered: 20} = Annotations.page_state(again, "Speech")
    :ok = Annotations.apply_edit(again, %{"do" => "save"})
    assert %{unsaved: false} = Annotations.page_state(again, "Speech")
    Editor.stop(again)
  end

  test "adds segments of a stream as proposals", %{studio: studio, path: path, schema: schema} do
    {:ok, editor} = open_editor(studio, path, "Speech", schema)
    one = &%{from: &1, to: &2, lane: &3, label: &4, confidence: &5}

    found = [
      one.(0, 5, "Ada", "", 0.6),
      one.(2, 3, "Ada", "", 0.9),
      one.(7, 9, "Ada", "unknown", nil)
    ]

    assert {:ok, 1} = Annotations.add_proposals(editor, found, "Vad.Speaking")

    assert [%{proposed: true, track: "Ada", by: "Vad.Speaking"}] =
             Annotations.page_state(editor, "Speech").items

    :ok = Annotations.apply_edit(editor, %{"do" => "accept_all", "least" => 0.5})
    assert [%{proposed: false}] = Annotations.page_state(editor, "Speech").items
  end
end
