defmodule Situ.Annotation.EditorTest do
  use ExUnit.Case, async: true
  import Situ.Annotation.Test.Annotating
  alias Situ.{Annotation, Store}
  alias Situ.Annotation.{Edit, Editor, Layer, Recording}
  alias Situ.EditLog

  doctest Situ.Annotation.Editor

  @moduletag :tmp_dir

  setup context do
    case context do
      %{tmp_dir: root} ->
        %{
          path: Path.join(root, "annotation"),
          log: Path.join(root, "annotation.Speech.edits"),
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
    {:ok, layer} = Recording.load_layer(Store.open!(path), stream)
    spans(layer)
  end

  defp add(editor, from, to),
    do: Editor.edit(editor, &Layer.add(&1, Annotation.new(from, to, "A")))

  defp spans(layer), do: for(a <- Layer.annotations(layer), do: {a.from, a.to})

  test "stores annotations as a stream with end times, types and schema", %{path: path} do
    layer = layer([{0, 10, "A", "speaks"}, {5, 5, "B", "laughs"}, {10, 7, "A", "silent"}])
    {:ok, folder} = Recording.write(layer, path, "Speech")
    {:ok, store} = Store.open(folder)
    {:ok, info} = Store.stream_info(store, "Speech")
    assert Recording.annotation_stream?(store, info)

    assert Enum.map(Store.messages(store, info), &{&1.originating_time, length(&1.data)}) == [
             {10, 2},
             {17, 1}
           ]

    assert {:ok, again} = Recording.load_layer(store, "Speech")
    assert Layer.annotations(again) == Layer.annotations(layer)
    assert again.schema == layer.schema
  end

  test "saves when the last subscriber that has edited ends, if asked to", %{path: path} do
    {:ok, editor} =
      Editor.start_link(path: path, stream: "Speech", schema: schema(), save_on_leave: true)

    # This process only watches.
    :ok = Editor.subscribe(editor)
    [one, two] = for from <- [0, 20], do: start_annotator(editor, from)
    end_annotator(one)
    assert Editor.status(editor).unsaved?
    end_annotator(two)
    assert_receive {:situ_annotation, ^editor, :saved}
    assert stored(path, "Speech") == [{0, 10}, {20, 30}]
  end

  defp start_annotator(editor, from) do
    test = self()

    pid =
      spawn_link(fn ->
        :ok = Editor.subscribe(editor)
        {:ok, _} = add(editor, from, from + 10)
        send(test, {:edited, self()})
        receive do: (:leave -> :ok)
      end)

    assert_receive {:edited, ^pid}
    pid
  end

  defp end_annotator(pid) do
    monitor = Process.monitor(pid)
    send(pid, :leave)
    assert_receive {:DOWN, ^monitor, :process, ^pid, _}
  end

  test "stores the outcome of a review", %{path: path} do
    editor = start(path)

    {:ok, _} =
      Editor.edit(
        editor,
        &Edit.add_proposals(&1, for(t <- 0..3, do: Annotation.new(10 * t, 10 * t + 5, "A")))
      )

    {:ok, _} = Editor.edit(editor, &Layer.accept_proposal(&1, 1))
    {:ok, _} = Editor.edit(editor, &Edit.move_edge(&1, 2, :to, 17))
    {:ok, _} = Editor.edit(editor, &Layer.accept_proposal(&1, 2))
    {:ok, _} = Editor.edit(editor, &Layer.remove(&1, 4))
    counts = %{total: 4, reviewed: 3, accepted: 2, corrected: 1, rejected: 1}
    assert Layer.review_progress(Editor.current_layer(editor)) == counts
    {:ok, layer} = Editor.undo(editor)
    assert %{reviewed: 2, rejected: 0} = Layer.review_progress(layer)
    {:ok, _} = Editor.redo(editor)
    # A killed editor loses no outcome.
    :ok = Editor.stop(editor)
    editor = start(path)
    assert Layer.review_progress(Editor.current_layer(editor)) == counts
    {:ok, folder} = Editor.save(editor)
    {:ok, again} = Recording.load_layer(Store.open!(folder), "Speech")
    assert Layer.review_progress(again) == counts
    # The id of the rejected proposal is not used again.
    {:ok, again, _} = Layer.add(again, Annotation.new(50, 60, "A"))
    assert Layer.fetch!(again, 5).from == 50
  end

  test "proposals that are undone were not rejected", %{path: path} do
    editor = start(path)
    {:ok, _} = Editor.edit(editor, &Edit.add_proposals(&1, [Annotation.new(0, 5, "A")]))
    {:ok, layer} = Editor.undo(editor)
    assert %{total: 0} = Layer.review_progress(layer)
    {:ok, layer} = Editor.redo(editor)
    assert %{total: 1, reviewed: 0} = Layer.review_progress(layer)
  end

  test "rejects a stream of another type", %{tmp_dir: root} do
    path = Situ.Dataset.Test.Study.record(root, "x", %{"Level" => [{1, 2}]})
    {:ok, store} = Store.open(path)
    assert {:error, %{code: :bad_annotation}} = Recording.load_layer(store, "Level")
  end

  test "every save is a version that keeps the other streams", %{path: path} do
    {:ok, _} = Recording.write(layer([{0, 3, "B", "speaks"}]), path, "Other")
    editor = start(path)
    {:ok, _} = add(editor, 0, 10)
    {:ok, first} = Editor.save(editor)
    {:ok, _} = add(editor, 10, 20)
    {:ok, second} = Editor.save(editor)
    assert Path.basename(first) < Path.basename(second)
    {:ok, layer} = Recording.load_layer(Store.open!(first), "Speech")
    assert spans(layer) == [{0, 10}]
    {:ok, layer} = Recording.load_layer(Store.open!(path), "Speech")
    assert spans(layer) == [{0, 10}, {10, 20}]
    assert Store.has_stream?(Store.open!(second), "Other")
    {:ok, layer} = Editor.undo(editor)
    assert spans(layer) == [{0, 10}]

    assert {:error, %{code: :nothing_to_redo}} =
             Editor.edit(editor, fn _ ->
               {:error, %Situ.Error{code: :nothing_to_redo, what: "x"}}
             end)
  end

  test "editors of two streams in one store keep each other's saves", %{
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

  test "concurrent saves keep every stream", %{path: path} do
    streams = for i <- 1..6, do: "Stream#{i}"
    editors = for s <- streams, do: start(path, s)

    for editor <- editors, do: {:ok, _} = add(editor, 0, 10)
    saved = editors |> Enum.map(&Task.async(fn -> Editor.save(&1) end)) |> Task.await_many(60_000)
    folders = for {:ok, folder} <- saved, do: folder
    assert length(Enum.uniq(folders)) == 6
    for s <- streams, do: assert(stored(path, s) == [{0, 10}])
  end

  test "unsaved edits of one stream survive a save of another", %{path: path} do
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
    assert spans(Editor.current_layer(looks)) == [{0, 3}, {3, 5}]
    {:ok, _} = Editor.save(looks)
    assert {stored(path, "Looks"), stored(path, "Speech")} == {[{0, 3}, {3, 5}], [{0, 10}]}
  end

  test "a killed editor loses no edit, and the next one continues", %{
    path: path,
    log: log
  } do
    Process.flag(:trap_exit, true)
    editor = start(path)
    {:ok, _} = add(editor, 0, 10)
    {:ok, _} = add(editor, 10, 20)
    {:ok, _} = Editor.undo(editor)
    Process.exit(editor, :kill)
    assert_receive {:EXIT, ^editor, :killed}

    # The line is truncated in the middle of a write.
    File.write!(log, "0f9c7ae0 {\"n\":4,\"ki", [:append])
    editor = start(path)
    assert %{recovered: 3, unsaved?: true} = Editor.status(editor)
    assert spans(Editor.current_layer(editor)) == [{0, 10}]
    {:ok, _} = add(editor, 30, 40)
    Process.exit(editor, :kill)
    assert_receive {:EXIT, ^editor, :killed}
    assert spans(Editor.current_layer(start(path))) == [{0, 10}, {30, 40}]
  end

  test "does not apply operations twice if the editor is killed after a save", ctx do
    editor = start(ctx.path)
    {:ok, _} = add(editor, 0, 10)
    {:ok, _} = Editor.save(editor)
    {:ok, _} = add(editor, 10, 20)
    {:ok, _} = Editor.save(editor)
    :ok = Editor.stop(editor)
    editor = start(ctx.path)

    assert {spans(Editor.current_layer(editor)), Editor.status(editor).recovered} ==
             {[{0, 10}, {10, 20}], 0}
  end

  test "undo continues after a restart, also of saved edits", %{path: path} do
    editor = start(path)
    {:ok, _} = add(editor, 0, 10)
    {:ok, _} = Editor.save(editor)
    {:ok, _} = add(editor, 10, 20)
    {:ok, _} = Editor.undo(editor)
    :ok = Editor.stop(editor)
    editor = start(path)
    assert %{undo: 1, redo: 1} = Editor.status(editor)
    {:ok, layer} = Editor.redo(editor)
    assert spans(layer) == [{0, 10}, {10, 20}]
    {:ok, _} = Editor.undo(editor)
    {:ok, layer} = Editor.undo(editor)
    assert spans(layer) == []
    assert {:error, %{code: :nothing_to_undo}} = Editor.undo(editor)
  end

  test "an earlier version is restored by a new operation", %{path: path} do
    editor = start(path)
    for t <- [0, 10, 20], do: {:ok, _} = add(editor, t, t + 5)
    {:ok, _} = Editor.save(editor)
    {:ok, _} = Editor.edit(editor, &Layer.remove(&1, [1, 2]))
    {:ok, layer} = Editor.restore(editor, 2)
    assert spans(layer) == [{0, 5}, {10, 15}]
    {:ok, layer} = Editor.undo(editor)
    assert spans(layer) == [{20, 25}]
  end

  test "a changed schema can be undone", %{path: path} do
    editor = start(path)
    {:ok, _} = add(editor, 0, 10)

    {:ok, _} =
      Editor.put_schema(editor, Situ.Annotation.Schema.text("Words"), &%{&1 | values: %{}})

    :ok = Editor.stop(editor)
    editor = start(path)
    {:ok, layer} = Editor.undo(editor)
    assert {layer.schema, spans(layer)} == {schema(), [{0, 10}]}
  end

  describe "two editors of one stream" do
    test "merge their edits", %{path: path} do
      [anna, ben] = for _ <- 1..2, do: start(path)
      {:ok, _} = add(anna, 0, 10)
      :ok = Editor.subscribe(ben)
      {:ok, layer} = add(ben, 20, 30)
      assert_receive {:situ_annotation, ^ben, :reloaded}
      assert spans(layer) == [{0, 10}, {20, 30}]
      assert {:error, %{code: :overlap}} = add(anna, 25, 40)
      {:ok, _} = Editor.edit(anna, &Layer.change(&1, 2, note: "loud"))
      {:ok, layer} = Editor.edit(ben, &Layer.change(&1, 2, confidence: 0.5))
      assert %{note: "loud", confidence: 0.5} = Layer.fetch!(layer, 2)
      {:ok, _} = Editor.save(anna)
      {:ok, _} = Editor.save(ben)
      assert stored(path, "Speech") == [{0, 10}, {20, 30}]
    end

    test "are told of a conflict with another user's edit", %{path: path, log: log} do
      editor = start(path)
      {:ok, _} = add(editor, 0, 10)
      # Another user changes the interval.
      change = [[1, annotation(0, 10), annotation(0, 12)]]
      append_as_ben(log, %{"annotations" => change})
      remove = &Layer.remove(&1, 1)
      assert {:error, %{code: :stale_edit, why: why}} = Editor.edit(editor, remove, version: 1)
      assert why =~ "ben"
      {:ok, layer} = Editor.edit(editor, &Layer.change(&1, 1, note: "x"), version: 1)
      assert %{to: 12, note: "x"} = Layer.fetch!(layer, 1)
      assert {:ok, _} = Editor.edit(editor, remove, version: 3)
    end

    defp annotation(from, to) do
      values = Situ.Annotation.Schema.default_values(schema())
      Annotation.to_json(%{Annotation.new(from, to, "A", values) | id: 1})
    end

    defp append_as_ben(path, operation) do
      {:ok, log, _} = EditLog.read_all(Path.rootname(path))
      {:ok, _, _} = EditLog.append(log, %{EditLog.Entry.new("edit", operation) | user: "ben"})
    end

    test "are not blocked by a failing edit", %{path: path, log: log} do
      [anna, ben] = for _ <- 1..2, do: start(path)
      assert {:error, _} = Editor.edit(anna, fn _ -> raise "no" end)
      assert {:error, %{code: :nothing_to_undo}} = Editor.undo(anna)
      refute File.exists?(log)
      assert {:ok, _} = add(ben, 0, 10)
      :ok = Editor.stop(ben)
      assert {:ok, layer} = add(anna, 10, 20)
      assert spans(layer) == [{0, 10}, {10, 20}]
    end
  end

  test "keeps edits on top of another's save after a failed edit", ctx do
    Process.flag(:trap_exit, true)
    editor = start(ctx.path)
    {:ok, _} = add(editor, 0, 10)
    {:ok, _} = Editor.save(editor)
    {:ok, _} = add(editor, 40, 50)
    by_another(ctx.path, [{0, 10}, {20, 30}])
    assert {:error, _} = Editor.edit(editor, fn _ -> raise "no" end)
    {:ok, layer} = add(editor, 60, 70)
    assert spans(layer) == [{0, 10}, {20, 30}, {40, 50}, {60, 70}]
    assert %{shadowed: nil} = Editor.status(editor)
    Process.exit(editor, :kill)
    assert_receive {:EXIT, ^editor, :killed}
    assert spans(Editor.current_layer(start(ctx.path))) == spans(layer)
  end

  describe "while another program saves the same stream" do
    defp by_another(path, spans, schema \\ schema()) do
      {:ok, layer} = Layer.new(schema, for({a, b} <- spans, do: Situ.Annotation.new(a, b, "A")))
      {:ok, folder} = Recording.write(layer, path, "Speech")
      folder
    end

    test "takes over its annotations without unsaved edits", %{path: path} do
      editor = start(path)
      {:ok, _} = add(editor, 0, 10)
      {:ok, _} = Editor.save(editor)
      :ok = Editor.subscribe(editor)
      by_another(path, [{0, 10}, {20, 30}])
      {:ok, layer} = Editor.refresh(editor)
      assert spans(layer) == [{0, 10}, {20, 30}]
      assert_receive {:situ_annotation, ^editor, :reloaded}
      assert %{unsaved?: false, shadowed: nil} = Editor.status(editor)
    end

    test "reapplies unsaved edits to them, also after a crash", ctx do
      Process.flag(:trap_exit, true)
      editor = start(ctx.path)
      {:ok, _} = add(editor, 0, 10)
      {:ok, _} = Editor.save(editor)
      {:ok, _} = add(editor, 40, 50)
      {:ok, layer} = Editor.edit(editor, &Layer.remove(&1, 1))
      assert spans(layer) == [{40, 50}]
      # The other program numbers its annotations differently.
      by_another(ctx.path, [{60, 70}, {20, 30}, {0, 10}])
      {:ok, layer} = add(editor, 80, 90)
      assert spans(layer) == [{20, 30}, {40, 50}, {60, 70}, {80, 90}]
      assert %{undo: 4, unsaved?: true} = Editor.status(editor)
      Process.exit(editor, :kill)
      assert_receive {:EXIT, ^editor, :killed}
      editor = start(ctx.path)
      assert spans(Editor.current_layer(editor)) == [{20, 30}, {40, 50}, {60, 70}, {80, 90}]
      {:ok, layer} = Editor.undo(editor)
      assert spans(layer) == [{20, 30}, {40, 50}, {60, 70}]
      {:ok, _} = Editor.save(editor)
      assert stored(ctx.path, "Speech") == [{20, 30}, {40, 50}, {60, 70}]
    end

    test "reapplies the edits of a stopped editor when it starts again", ctx do
      Process.flag(:trap_exit, true)
      editor = start(ctx.path)
      {:ok, _} = add(editor, 0, 10)
      {:ok, _} = Editor.save(editor)
      {:ok, _} = add(editor, 40, 50)
      Process.exit(editor, :kill)
      assert_receive {:EXIT, ^editor, :killed}
      by_another(ctx.path, [{0, 10}, {20, 30}])
      editor = start(ctx.path)
      assert spans(Editor.current_layer(editor)) == [{0, 10}, {20, 30}, {40, 50}]
      assert %{recovered: 1, unsaved?: true} = Editor.status(editor)
    end

    test "keeps conflicting edits, and names the other version", ctx do
      editor = start(ctx.path)
      {:ok, _} = add(editor, 0, 10)
      {:ok, _} = Editor.save(editor)
      {:ok, _} = add(editor, 20, 30)
      theirs = by_another(ctx.path, [{25, 40}])
      {:ok, layer} = add(editor, 50, 60)
      assert spans(layer) == [{0, 10}, {20, 30}, {50, 60}]
      assert Editor.status(editor).shadowed == theirs
      {:ok, folder} = Editor.save(editor)
      assert folder > theirs
      assert stored(ctx.path, "Speech") == [{0, 10}, {20, 30}, {50, 60}]
      {:ok, layer} = Recording.load_layer(Store.open!(theirs), "Speech")
      assert spans(layer) == [{25, 40}]
    end

    test "takes over its schema with the annotations", %{path: path} do
      editor = start(path)
      {:ok, _} = add(editor, 0, 10)
      {:ok, _} = Editor.save(editor)
      by_another(path, [{0, 10}], Situ.Annotation.Schema.text("Words"))
      {:ok, layer} = Editor.refresh(editor)
      assert [%{name: "Words", kind: :text}] = layer.schema.attributes
    end
  end

  test "reports a damaged log instead of guessing", %{path: path, log: log} do
    editor = start(path)
    for t <- [0, 10, 20], do: {:ok, _} = add(editor, t, t + 5)
    :ok = Editor.stop(editor)
    File.write!(log, String.replace(File.read!(log), ~s("from":10), ~s("from":11)))
    assert {:error, %{code: :bad_log}} = Editor.start_link(path: path, stream: "Speech")
    assert {:error, %{code: :no_schema}} = Editor.start_link(path: path, stream: "New")
  end

  describe "the journal of an earlier release" do
    test "becomes operations", %{path: path, journal: journal} do
      {:ok, folder} = Recording.write(layer([{0, 10, "A", "speaks"}]), path, "Speech")
      new = Annotation.to_json(%{Annotation.new(20, 30, "A") | id: 2})
      lines = [~s({"base":"#{Path.basename(folder)}"}), Situ.JSON.encode([[2, nil, new]])]
      File.write!(journal, Enum.join(lines, "\n") <> "\n[[9, nul")
      editor = start(path)
      assert %{recovered: 1, undo: 1, unsaved?: true} = Editor.status(editor)
      assert spans(Editor.current_layer(editor)) == [{0, 10}, {20, 30}]
      refute File.exists?(journal)
      :ok = Editor.stop(editor)
      # The program was killed before it removed the journal.
      File.write!(journal, Enum.join(lines, "\n") <> "\n[[9, nul")
      editor = start(path)
      assert spans(Editor.current_layer(editor)) == [{0, 10}, {20, 30}]
      assert %{undo: 1} = Editor.status(editor)
    end

    test "is reported if it is damaged", %{path: path, journal: journal} do
      File.write!(journal, ~s({"base": null}\nnonsense\n[]\n))

      assert {:error, %{code: :bad_journal, why: why}} =
               Editor.start_link(path: path, stream: "Speech", schema: schema())

      assert why =~ "line 2"
      File.write!(journal, ~s({"base": null}\n[[1, {"from":0,"to":1,"track":"A"}, null]]\n))

      assert {:error, %{code: :bad_journal}} =
               Editor.start_link(path: path, stream: "Speech", schema: schema())
    end
  end

  test "notifies subscribers, and survives a raising edit", %{path: path} do
    editor = start(path)
    :ok = Editor.subscribe(editor)
    {:ok, _} = add(editor, 0, 10)
    assert_receive {:situ_annotation, ^editor, [{1, nil, %Annotation{to: 10}}]}
    assert {:error, %{code: :edit_failed}} = Editor.edit(editor, fn _ -> raise "no" end)
    {:ok, _} = Editor.save(editor)
    assert_receive {:situ_annotation, ^editor, :saved}
    assert spans(Editor.current_layer(editor)) == [{0, 10}]
  end
end
