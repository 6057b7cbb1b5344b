defmodule Situ.Dataset.RelocationTest do
  use ExUnit.Case, async: true
  alias Situ.{Annotation, Dataset, Store}
  alias Situ.Annotation.{Editor, Layer, Schema}
  alias Situ.Dataset.{History, Relocation}

  @moduletag :tmp_dir

  setup %{tmp_dir: root} do
    {:ok, writer} = Store.Writer.create("room", Path.join(root, "lab"))
    {:ok, stream} = Store.Writer.stream(writer, "N", type: :integer)
    message = %Situ.Message{data: 1, originating_time: 5, creation_time: 5, sequence_id: 1}
    {:ok, _} = Store.Writer.append(stream, [message])
    :ok = Store.Writer.close(writer)
    file = Path.join(root, "study.json")
    {:ok, dataset} = Dataset.new("Study", file: file, autosave: true)
    {:ok, dataset} = Dataset.add_session(dataset, "p01")
    {:ok, _} = Dataset.add_partition(dataset, "p01", "Room", writer.path)
    {:ok, study: file, path: writer.path, to: Path.join(root, "archive")}
  end

  test "a dataset names a recording that has moved, as an edit that can be undone", ctx do
    finish = fn pairs ->
      with {:ok, moved} <- Relocation.relocate_file(ctx.study, pairs) do
        assert moved == [{"p01", "Room"}]
        :ok
      end
    end

    {:ok, moved} = Store.move(ctx.path, ctx.to, finish: finish)
    {:ok, dataset} = Dataset.load(ctx.study)
    assert [%{path: ^moved}] = Dataset.list_partitions(dataset)
    assert Dataset.troubles(dataset) == []
    assert File.read!(ctx.study) =~ ~s("archive/room.0000")
    {:ok, entries} = History.list(dataset)
    assert List.last(entries).what =~ "archive/room.0000"
    assert {:ok, []} = Relocation.relocate_file(ctx.study, [{ctx.path, moved}])
    assert Relocation.list_dataset_files([Path.dirname(ctx.study), ctx.to]) == [ctx.study]
  end

  test "annotations move with their history, and an editor that is open loses no edit", ctx do
    layers = fn recording -> recording <> "-annotation-Speech" end
    opts = [stream: "Speech", schema: Schema.text("Speech")]
    {:ok, editor} = Editor.start_link([path: layers.(ctx.path)] ++ opts)
    add = fn editor, t -> Editor.edit(editor, &Layer.add(&1, Annotation.new(t, t + 1, "P1"))) end
    {:ok, _} = add.(editor, 0)
    {:ok, _} = Editor.save(editor)
    {:ok, _} = add.(editor, 10)

    {:ok, moved} = Store.move(ctx.path, ctx.to)
    assert {:error, %{code: :layer_moved}} = add.(editor, 20)
    assert {:error, %{code: :layer_moved}} = Editor.refresh(editor)
    assert File.ls!(Path.dirname(ctx.path)) == []

    {:ok, other} = Editor.start_link([path: layers.(moved)] ++ opts)
    assert [%{from: 0}, %{from: 10}] = Layer.annotations(Editor.current_layer(other))
    assert %{undo: 2, unsaved?: true} = Editor.status(other)
    {:ok, _} = add.(other, 20)
  end
end
