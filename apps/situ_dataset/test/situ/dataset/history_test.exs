defmodule Situ.Dataset.HistoryTest do
  use ExUnit.Case, async: true
  alias Situ.Dataset
  alias Situ.Dataset.History

  doctest Situ.Dataset.History

  @moduletag :tmp_dir

  setup context do
    if root = context[:tmp_dir] do
      {:ok, dataset} = Dataset.new("Study", file: Path.join(root, "study.json"), autosave: true)
      %{dataset: dataset}
    else
      :ok
    end
  end

  test "an undo that would discard another change is refused", %{dataset: dataset} do
    {:ok, dataset} = Dataset.put_fields(dataset, name: "A")
    {:ok, dataset} = Dataset.put_fields(dataset, tags: ["x"])
    # A person edits the file.
    file = dataset.file
    File.write!(file, file |> File.read!() |> String.replace(~s("x"), ~s("x", "y")))
    {:ok, dataset} = Dataset.load(file)
    {:ok, dataset} = History.undo(dataset)
    assert {dataset.name, dataset.tags} == {"A", ["y"]}
    File.write!(file, file |> File.read!() |> String.replace(~s("A"), ~s("B")))
    {:ok, dataset} = Dataset.load(file)
    assert {:error, %{code: :dataset_changed}} = History.undo(dataset)
    {:ok, dataset} = History.redo(dataset)
    assert {dataset.name, Enum.sort(dataset.tags)} == {"B", ["x", "y"]}
    assert {:error, %{code: :nothing_to_redo}} = History.redo(dataset)
  end

  test "every version can be fetched and restored", %{dataset: dataset} do
    {:ok, dataset} =
      Enum.reduce(1..20, {:ok, dataset}, fn i, {:ok, dataset} ->
        Dataset.add_session(dataset, "s#{i}", metadata: %{"n" => i})
      end)

    {:ok, dataset} = Dataset.rename_session(dataset, "s1", "first")

    for n <- [0, 7, 20] do
      {:ok, old} = History.fetch_version(dataset, "#{n}")
      assert length(old.sessions) == n
    end

    {:ok, dataset} = History.restore(dataset, "v3")
    assert Enum.map(dataset.sessions, & &1.name) == ["s1", "s2", "s3"]
    assert {:ok, again} = Dataset.load(dataset.file)
    assert again.sessions == dataset.sessions
    assert {:error, %{code: :no_version, why: why}} = History.restore(dataset, "v99")
    assert why =~ "0 to 22"
    assert {:error, %{code: :no_file}} = History.list(%{dataset | document: nil})
  end
end
