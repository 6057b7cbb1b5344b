defmodule Situ.Store.ReplacementTest do
  # After a compaction is killed at any point, the recording still has its name, or repair restores it.
  use ExUnit.Case, async: true
  import Situ.Store.Test.Record
  alias Situ.Store
  alias Situ.Store.Replacement

  @moduletag :tmp_dir

  setup context do
    root = context.tmp_dir
    path = store(root, [{"N", messages(Enum.to_list(1..50)), []}])
    %{root: root, path: path}
  end

  defp data(path), do: path |> Store.open!() |> Store.messages("N") |> Enum.map(& &1.data)

  test "keeps the recording if killed before the names are exchanged", ctx do
    test = self()
    writing = fn _, _ -> send(test, :writing) && receive(do: (:never -> :ok)) end
    {pid, monitor} = spawn_monitor(fn -> Store.compact(ctx.path, progress: writing) end)
    assert_receive :writing, 30_000
    Process.exit(pid, :kill)
    assert_receive {:DOWN, ^monitor, _, _, _}
    assert data(ctx.path) == Enum.to_list(1..50)
    assert Store.list(ctx.root) == [ctx.path]
  end

  test "leaves the old store as an unfinished one if killed after the exchange", ctx do
    {:ok, old} = Store.copy(ctx.path, {"old", ctx.root})
    left = Path.join(ctx.root, "#{Store.Folder.store_name(ctx.path)}.4711-1.unfinished")
    File.rename!(old, left)
    assert Store.list(ctx.root) == [ctx.path]
    assert {:ok, _} = Store.compact(ctx.path)
    assert File.ls!(ctx.root) == [Path.basename(ctx.path)]
    assert data(ctx.path) == Enum.to_list(1..50)
  end

  test "repairs a store if killed between two renames", %{path: path, root: root} do
    File.cp_r!(path, path <> ".compacted")
    File.rename!(path, path <> ".before-compaction")

    for asked <- [path, Path.join(root, Store.Folder.store_name(path))] do
      assert {:error, %{code: :compaction_interrupted, fix: fix}} = Store.open(asked)
      assert fix =~ "situ store repair"
    end

    assert {:error, %{code: :compaction_interrupted}} = Store.repair(path, dry_run: true)

    assert {:ok, %{dropped: 0, damage: []}} =
             Store.repair(Path.join(root, Store.Folder.store_name(path)))

    assert data(path) == Enum.to_list(1..50)
    assert File.ls!(root) == [Path.basename(path)]
  end

  test "keeps the recording's name if killed after both renames", %{path: path} do
    fresh = path <> ".fresh"
    File.cp_r!(path, fresh)
    assert {:ok, old} = Replacement.rename_both(fresh, path)
    assert old == path <> ".before-compaction" and File.dir?(old)
    assert data(path) == Enum.to_list(1..50)
    assert Replacement.find_interrupted(path) == nil
  end

  test "changes nothing if the second of two renames fails", %{path: path} do
    assert {:error, %Situ.Error{}} = Replacement.rename_both(path <> ".nothing", path)
    assert data(path) == Enum.to_list(1..50)
  end

  test "keeps other files in the recording's folder", %{path: path} do
    File.write!(Path.join(path, "notes.txt"), "mine")
    assert {:ok, ^path} = Store.compact(path)
    assert File.read!(Path.join(path, "notes.txt")) == "mine"
    assert data(path) == Enum.to_list(1..50)
  end
end
