defmodule Situ.Annotation.EditorTest do
  use ExUnit.Case, async: true
  import Situ.Annotation.Test.Annotating
  alias Situ.{Annotation, Store}
  alias Situ.Annotation.{Editor, Layer, Recording}

  doctest Situ.Annotation.Editor

  @moduletag :tmp_dir

  setup context do
    case context do
      %{tmp_dir: root} ->
        %{
          path: Path.join(root, "annotation"),
          journal: Path.join(root, "annotation.Speech.journal")
        }

      _doctest ->
        :ok
    end
  end

  defp start(path, stream \\ "Speech") do
    {:ok, editor} = Editor.start_link(path: path, stream: stream, schema: schema())
    editor
  end

  defp stored(path, stream) do
    {:ok, layer} = Recording.load(Store.open!(path), stream)
    spans(layer)
  end

  defp add(editor, from, to),
    do: Editor.edit(editor, &Layer.add(&1, Annotation.new(from, to, "A")))

  defp spans(layer), do: for(a <- Layer.annotations(layer), do: {a.from, a.to})

  test "annotations are a stream: end times, types and schema are the recording's", %{path: path} do
    layer = layer([{0, 10, "A", "speaks"}, {5, 5, "B", "laughs"}, {10, 7, "A", "silent"}])
    {:ok, folder} = Recording.write(layer, path, "Speech")
    {:ok, store} = Store.open(folder)
    {:ok, info} = Store.stream_info(store, "Speech")
    assert Recording.annotations?(store, info)

    assert Enum.map(Store.messages(store, info), &{&1.originating_time, length(&1.data)}) == [
             {10, 2},
             {17, 1}
           ]

    assert {:ok, again} = Recording.load(store, "Speech")
    assert Layer.annotations(again) == Layer.annotations(layer)
    assert again.schema == layer.schema
  end

  test "a stream of something else is refused", %{tmp_dir: root} do
    path = Situ.Dataset.Test.Study.record(root, "x", %{"Level" => [{1, 2}]})
    {:ok, store} = Store.open(path)
    assert {:error, %{code: :bad_annotation}} = Recording.load(store, "Level")
  end

  test "every save is a version; other streams of the store go along", %{path: path} do
    {:ok, _} = Recording.write(layer([{0, 3, "B", "speaks"}]), path, "Other")
    editor = start(path)
    {:ok, _} = add(editor, 0, 10)
    {:ok, first} = Editor.save(editor)
    {:ok, _} = add(editor, 10, 20)
    {:ok, second} = Editor.save(editor)
    assert Path.basename(first) < Path.basename(second)
    {:ok, layer} = Recording.load(Store.open!(first), "Speech")
    assert spans(layer) == [{0, 10}]
    {:ok, layer} = Recording.load(Store.open!(path), "Speech")
    assert spans(layer) == [{0, 10}, {10, 20}]
    assert Store.has_stream?(Store.open!(second), "Other")
    {:ok, layer} = Editor.undo(editor)
    assert spans(layer) == [{0, 10}]

    assert {:error, %{code: :nothing_to_redo}} =
             Editor.edit(editor, fn _ ->
               {:error, %Situ.Error{code: :nothing_to_redo, what: "x"}}
             end)
  end

  test "two streams of one store are edited at once: each save has what the other saved", %{
    path: path
  } do
    [speech, looks] = for stream <- ["Speech", "Looks"], do: start(path, stream)
    {:ok, _} = add(speech, 0, 10)
    {:ok, _} = add(looks, 0, 3)
    {:ok, _} = Editor.save(speech)
    {:ok, _} = Editor.save(looks)
    {:ok, _} = add(speech, 10, 20)
    {:ok, folder} = Editor.save(speech)
    assert Path.basename(folder) == "annotation.0002"
    assert stored(path, "Speech") == [{0, 10}, {10, 20}]
    assert stored(path, "Looks") == [{0, 3}]
  end

  test "many saves at the same moment: none takes another's stream away", %{path: path} do
    streams = for i <- 1..6, do: "Stream#{i}"
    editors = for s <- streams, do: start(path, s)

    for editor <- editors, do: {:ok, _} = add(editor, 0, 10)
    saved = editors |> Enum.map(&Task.async(fn -> Editor.save(&1) end)) |> Task.await_many(60_000)
    folders = for {:ok, folder} <- saved, do: folder
    assert length(Enum.uniq(folders)) == 6
    for s <- streams, do: assert(stored(path, s) == [{0, 10}])
  end

  test "what is unsaved of one stream outlives the save of another", %{path: path} do
    Process.flag(:trap_exit, true)
    [speech, looks] = for stream <- ["Speech", "Looks"], do: start(path, stream)
    {:ok, _} = add(looks, 0, 3)
    {:ok, _} = Editor.save(looks)
    {:ok, _} = add(looks, 3, 5)
    {:ok, _} = add(speech, 0, 10)
    {:ok, _} = Editor.save(speech)
    Process.exit(looks, :kill)
    assert_receive {:EXIT, ^looks, :killed}
    looks = start(path, "Looks")
    assert %{recovered: 1} = Editor.status(looks)
    assert spans(Editor.layer(looks)) == [{0, 3}, {3, 5}]
    {:ok, _} = Editor.save(looks)
    assert {stored(path, "Looks"), stored(path, "Speech")} == {[{0, 3}, {3, 5}], [{0, 10}]}
  end

  test "an editor that is killed loses no edit; the next one carries on", %{
    path: path,
    journal: journal
  } do
    Process.flag(:trap_exit, true)
    editor = start(path)
    {:ok, _} = add(editor, 0, 10)
    {:ok, _} = add(editor, 10, 20)
    {:ok, _} = Editor.undo(editor)
    Process.exit(editor, :kill)
    assert_receive {:EXIT, ^editor, :killed}

    # A line cut off in the middle of a write.
    File.write!(journal, "[[9, nul", [:append])
    editor = start(path)
    assert %{recovered: 3, unsaved?: true} = Editor.status(editor)
    assert spans(Editor.layer(editor)) == [{0, 10}]
    {:ok, _} = add(editor, 30, 40)
    Process.exit(editor, :kill)
    assert_receive {:EXIT, ^editor, :killed}
    assert spans(Editor.layer(start(path))) == [{0, 10}, {30, 40}]
  end

  test "killed after a save and before the journal went, the journal is not applied twice", ctx do
    editor = start(ctx.path)
    {:ok, _} = add(editor, 0, 10)
    kept = File.read!(ctx.journal)
    {:ok, _} = Editor.save(editor)
    refute File.exists?(ctx.journal)
    :ok = Editor.stop(editor)
    File.write!(ctx.journal, kept)
    editor = start(ctx.path)
    assert {spans(Editor.layer(editor)), Editor.status(editor).recovered} == {[{0, 10}], 0}
  end

  test "a damaged journal is told, not guessed at", %{path: path, journal: journal} do
    File.write!(journal, ~s({"base": null}\nnonsense\n[]\n))

    assert {:error, %{code: :bad_journal, why: why}} =
             Editor.start_link(path: path, stream: "Speech", schema: schema())

    assert why =~ "line 2"
    File.write!(journal, ~s({"base": null}\n[[1, {"from":0,"to":1,"track":"A"}, null]]\n))

    assert {:error, %{code: :bad_journal}} =
             Editor.start_link(path: path, stream: "Speech", schema: schema())

    assert {:error, %{code: :no_schema}} = Editor.start_link(path: path, stream: "New")
  end

  test "subscribers follow; a raising edit harms nobody", %{path: path} do
    editor = start(path)
    :ok = Editor.subscribe(editor)
    {:ok, _} = add(editor, 0, 10)
    assert_receive {:situ_annotation, ^editor, [{1, nil, %Annotation{to: 10}}]}
    assert {:error, %{code: :edit_failed}} = Editor.edit(editor, fn _ -> raise "no" end)
    {:ok, _} = Editor.save(editor)
    assert_receive {:situ_annotation, ^editor, :saved}
    assert spans(Editor.layer(editor)) == [{0, 10}]
  end
end
