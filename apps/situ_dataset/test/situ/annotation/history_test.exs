defmodule Situ.Annotation.HistoryTest do
  use ExUnit.Case, async: true
  import Situ.Annotation.Test.Annotating
  alias Situ.{Annotation, Store}
  alias Situ.Annotation.{Editor, History, Layer, Recording}

  doctest Situ.Annotation.History

  @tag :tmp_dir
  test "names, undoes and restores while an editor is open", %{tmp_dir: root} do
    path = Path.join(root, "annotation")
    layer = {path, "Speech"}
    {:ok, editor} = Editor.start_link(path: path, stream: "Speech", schema: schema())

    for t <- [0, 10, 20],
        do: {:ok, _} = Editor.edit(editor, &Layer.add(&1, Annotation.new(t, t + 5, "A")))

    :ok = History.name_version(layer, "three")
    {:ok, undone} = History.undo(layer)
    assert length(Layer.annotations(undone)) == 2
    {:ok, seen} = Editor.refresh(editor)
    assert Layer.annotations(seen) == Layer.annotations(undone)
    {:ok, _} = History.restore(layer, "three")
    {:ok, stored} = Recording.load_layer(Store.open!(path), "Speech")
    assert length(Layer.annotations(stored)) == 3
    {:ok, entries} = History.list(layer)
    assert Enum.map(entries, & &1.kind) == ~w(edit edit edit name undo restore)
    assert {:error, %{code: :no_version}} = History.restore(layer, "four")
    assert {:error, %{code: :no_schema}} = History.list({path, "None"})
  end
end
