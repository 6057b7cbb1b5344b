defmodule Situ.Dataset.DatasetDocumentTest do
  use ExUnit.Case, async: true
  alias Situ.Dataset
  alias Situ.EditLog.{Document, DocumentHistory}
  alias Situ.Store.FileLock

  @moduletag :tmp_dir

  setup %{tmp_dir: root} do
    file = Path.join(root, "study.json")
    {:ok, dataset} = Dataset.new("Study", file: file, autosave: true)
    %{path: file, dataset: dataset}
  end

  test "keeps all of many concurrent edits", %{path: file, dataset: dataset} do
    1..12
    |> Task.async_stream(
      fn i ->
        {:ok, mine} = Dataset.load(file)
        {:ok, _} = Dataset.update(mine, &Dataset.put_fields(&1, tags: &1.tags ++ ["t#{i}"]))
        {:ok, _} = Dataset.update(dataset, &Dataset.add_session(&1, "s#{i}"))
      end,
      max_concurrency: 12,
      timeout: 60_000
    )
    |> Stream.run()

    {:ok, found} = Dataset.load(file)
    assert Enum.sort(found.tags) == Enum.sort(for i <- 1..12, do: "t#{i}")
    assert length(found.sessions) == 12
    assert Path.wildcard(file <> ".*") == [file <> ".edits"]
  end

  test "merges changes of different fields, and reports those of the same field", ctx do
    %{path: file, dataset: dataset} = ctx
    {:ok, other} = Dataset.load(file, autosave: true)
    {:ok, other} = Dataset.add_session(other, "theirs")
    {:ok, dataset} = Dataset.add_session(dataset, "mine")
    assert Enum.map(dataset.sessions, & &1.name) == ["theirs", "mine"]
    {:ok, unsaved} = Dataset.put_fields(%{dataset | autosave?: false}, name: "Mine")
    {:ok, other} = Dataset.put_fields(other, tags: ["a"])
    assert {:ok, %{name: "Mine", tags: ["a"]}} = Dataset.update(unsaved, &{:ok, &1})
    {:error, error} = Dataset.put_fields(other, name: "Theirs")
    assert %{code: :dataset_changed, what: what} = error
    assert what =~ ~s(set name from "Study" to "Theirs")
    assert {:ok, %{name: "Mine", tags: ["a"]}} = Dataset.load(file)
    {:ok, other} = Dataset.refresh(other)
    assert {:ok, %{name: "Theirs"}} = Dataset.put_fields(other, name: "Theirs")
  end

  test "a file that is replaced stays in the history", %{path: file, dataset: dataset} do
    {:ok, dataset} = Dataset.add_session(dataset, "a")
    {:ok, new} = Dataset.new("New")
    assert {:ok, _} = Dataset.save_as(new, file)
    assert {:ok, %{name: "New", sessions: []}} = Dataset.load(file)
    {:ok, content} = Document.content_at(dataset.document, 1)
    assert {"Study", [%{name: "a"}]} = {content.name, content.sessions}
  end

  describe "a file that a person has edited" do
    test "is read, and its edits get into the history", %{path: file, dataset: dataset} do
      {:ok, dataset} = Dataset.add_session(dataset, "a")
      edit_text(file, &String.replace(&1, ~s("name": "Study"), ~s("name": "By hand")))
      {:ok, dataset} = Dataset.add_session(dataset, "b")
      assert dataset.name == "By hand"

      assert {:ok, %{name: "By hand", sessions: [%{name: "a"}, %{name: "b"}]}} =
               Dataset.load(file)

      {:ok, entries} = DocumentHistory.list_entries(dataset.document)
      assert Enum.map(entries, & &1.kind) == ["edit", "outside", "edit"]
    end

    test "keeps the operations that the file did not contain", %{path: file, dataset: dataset} do
      {:ok, dataset} = Dataset.put_fields(dataset, metadata: %{"lab" => "A"})
      before = File.read!(file)
      {:ok, _} = Dataset.put_fields(dataset, tags: ["late"])
      # An editor that was open during the last edit saves its older text.
      File.write!(file, String.replace(before, ~s("A"), ~s("B")))
      assert {:ok, %{tags: ["late"], metadata: %{"lab" => "B"}}} = Dataset.load(file)
      File.write!(file, ~s({"name": "Other", "sessions": []}))
      assert {:ok, %{name: "Other", tags: []} = dataset} = Dataset.load(file)
      {:ok, content} = Document.content_at(dataset.document, 3)
      assert content.tags == ["late"]
    end

    test "can be replaced by an older one", %{path: file, dataset: dataset} do
      {:ok, dataset} = Dataset.put_fields(dataset, tags: ["a"])
      before = File.read!(file)

      for name <- ["x", "y"] do
        {:ok, changed} = Dataset.update(dataset, &Dataset.put_fields(&1, name: name))
        {:ok, _} = Dataset.update(changed, &Dataset.put_fields(&1, tags: []))
        File.write!(file, before)
        assert {:ok, %{name: "Study", tags: ["a"]}} = Dataset.load(file)
      end

      # A program that has the file open notices even if only the last edit is taken back.
      {:ok, changed} = Dataset.update(dataset, &{:ok, &1})
      before = File.read!(file)
      {:ok, changed} = Dataset.put_fields(changed, name: "z")
      File.write!(file, before)
      assert {:ok, %{name: "Study"}} = Dataset.refresh(changed)
    end

    test "is reported if it is not a dataset", %{path: file, dataset: dataset} do
      {:ok, dataset} = Dataset.add_session(dataset, "a")
      File.write!(file, "{")
      assert {:error, %{code: :bad_dataset}} = Dataset.load(file)
      assert {:error, %{code: :bad_document}} = Dataset.add_session(dataset, "b")
      assert File.read!(file) == "{"
    end
  end

  defp edit_text(file, fun), do: File.write!(file, file |> File.read!() |> fun.())

  test "a failing or raising edit changes nothing and releases the file", ctx do
    before = File.read!(ctx.path)
    no = {:error, Situ.Error.new(:no, "no")}
    assert Dataset.update(ctx.dataset, fn _ -> no end) == no
    assert_raise RuntimeError, fn -> Dataset.update(ctx.dataset, fn _ -> raise "no" end) end
    assert File.read!(ctx.path) == before
    assert {:ok, lock} = FileLock.acquire(ctx.path <> ".lock")
    FileLock.release(lock)
  end

  test "ignores the lock file of a program that is not running", %{path: file} do
    # A killed program leaves such a file.
    File.write!(file <> ".lock", "nonsense")
    {:ok, dataset} = Dataset.load(file)
    assert {:ok, _} = Dataset.update(dataset, &Dataset.put_fields(&1, name: "Again"))
  end
end
