defmodule Situ.Dataset.DatasetFileTest do
  use ExUnit.Case, async: true
  alias Situ.Dataset
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
    assert Path.wildcard(file <> ".*") == []
  end

  test "does not overwrite another program's changes", %{path: file, dataset: dataset} do
    {:ok, other} = Dataset.load(file, autosave: true)
    {:ok, other} = Dataset.add_session(other, "theirs")
    assert {:error, %{code: :dataset_changed}} = Dataset.add_session(dataset, "mine")
    assert {:error, %{code: :dataset_changed}} = Dataset.save(dataset)
    {:ok, unsaved} = Dataset.put_fields(%{dataset | autosave?: false}, name: "Mine")
    assert {:error, %{code: :dataset_changed}} = Dataset.update(unsaved, &{:ok, &1})
    {:ok, dataset} = Dataset.update(dataset, &Dataset.add_session(&1, "mine"))
    assert Enum.map(dataset.sessions, & &1.name) == ["theirs", "mine"]
    {:ok, dataset} = Dataset.put_fields(dataset, tags: ["a"])
    assert {:error, %{code: :dataset_changed}} = Dataset.put_fields(other, tags: ["b"])
    assert {:ok, %{tags: ["a"]}} = Dataset.load(file)
    assert {:ok, _} = Dataset.save_as(%{dataset | tags: ["c"]}, file)
    assert {:ok, %{tags: ["c"]}} = Dataset.load(file)
  end

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
