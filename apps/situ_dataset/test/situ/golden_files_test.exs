defmodule Situ.GoldenFilesTest do
  # Reads the recordings, annotations and datasets of test/golden, which every later version must be able to read.
  use ExUnit.Case, async: true
  alias Situ.{Annotation, Dataset, Store}

  @root Path.expand("../../../../test/golden", __DIR__)
  Code.require_file("values.exs", @root)

  for folder <- Path.wildcard(Path.join(@root, "*/expected.json")) |> Enum.map(&Path.dirname/1) do
    @folder folder
    @recordings Path.join(folder, "recordings")
    expected = folder |> Path.join("expected.json") |> File.read!()

    for {name, streams} <- expected |> Situ.JSON.decode() |> elem(1) do
      test "#{Path.basename(folder)}: #{name} has the expected messages" do
        options = if unquote(name) =~ "damaged", do: [skip_damage: true], else: []
        path = Path.join(@recordings, unquote(name))

        assert Situ.GoldenValues.describe(path, options) == unquote(Macro.escape(streams))
      end
    end

    @tag :tmp_dir
    test "#{Path.basename(folder)}: damage is reported, and repair keeps the rest", %{
      tmp_dir: tmp
    } do
      path = Path.join(tmp, "damaged.0000")
      File.cp_r!(Path.join(@recordings, "damaged.0000"), path)

      assert {:ok, %{damage: [_]}} = Store.verify(path)
      assert {:ok, %{dropped: 1}} = Store.repair(path)
      assert {:ok, %{damage: []}} = Store.verify(path)
      assert Store.count(Store.open!(path), "Ints") == 2_500
    end

    test "#{Path.basename(folder)}: the dataset opens with its recordings" do
      assert {:ok, dataset} = Dataset.open(Path.join(@folder, "study.json"))

      assert {dataset.name, dataset.tags, dataset.metadata} ==
               {"Golden", ["golden"], %{"age" => 31}}

      assert [%{name: "first", partitions: [values, annotations]} | _] = dataset.sessions
      assert Enum.map([values, annotations], & &1.name) == ["Values", "Annotations"]
      session = Dataset.OpenSession.open(hd(dataset.sessions))
      assert session |> Dataset.OpenSession.messages("Ints") |> elem(1) |> Enum.count() == 1_200
    end

    test "#{Path.basename(folder)}: the annotations have their schema and fields" do
      store = Store.open!(Path.join(@recordings, "annotation.0000"))
      assert {:ok, schema} = Annotation.Recording.read_schema(store, "Annotations.Speech")
      assert schema.name == "Speech"
      assert {:ok, layer} = Annotation.Recording.load_layer(store, "Annotations.Speech")
      assert track_names(layer) == ["Ada", "Ben"]
    end
  end

  # Version 2 adds logs of edits.
  for folder <- Path.wildcard(Path.join(@root, "*/study.json.edits")) |> Enum.map(&Path.dirname/1) do
    @folder folder

    @tag :tmp_dir
    test "#{Path.basename(folder)}: the dataset has its history", %{tmp_dir: tmp} do
      File.cp_r!(@folder, tmp)
      assert {:ok, dataset} = Dataset.open(Path.join(tmp, "study.json"))
      assert Enum.map(dataset.sessions, & &1.name) == ["first", "last"]
      assert {:ok, entries} = Dataset.History.list(dataset)

      assert for(e <- entries, do: {e.version, e.by, e.what}) ==
               [{1, "ada", "add session second"}, {2, "ben", "rename session second to last"}]

      assert {:ok, dataset} = Dataset.History.restore(dataset, "1")
      assert Enum.map(dataset.sessions, & &1.name) == ["first", "second"]
    end

    @tag :tmp_dir
    test "#{Path.basename(folder)}: annotations have the edits that were not saved", %{
      tmp_dir: tmp
    } do
      File.cp_r!(@folder, tmp)
      path = Path.join(tmp, "recordings/edited")
      assert {:ok, editor} = Annotation.Editor.start_link(path: path, stream: "Notes")
      assert Annotation.Editor.status(editor).recovered > 0
      assert editor |> Annotation.Editor.current_layer() |> track_names() == ["Ada", "Ben"]
      assert {:ok, layer} = Annotation.Editor.redo(editor)
      assert track_names(layer) == ["Ada", "Ben", "Cy"]
      :ok = Annotation.Editor.stop(editor)
    end
  end

  defp track_names(layer), do: layer |> Annotation.Layer.track_names() |> Enum.sort()
end
