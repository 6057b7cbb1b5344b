defmodule Situ.Store.MovingTest do
  # A recording moves with everything next to it, and a move that is killed at any step is completed.
  use ExUnit.Case, async: true
  alias Situ.{Message, Store}
  alias Situ.Store.{FileLock, Moving, Rotation, Writer}
  alias Situ.Store.Rotation.SplitPoint

  @moduletag :tmp_dir
  @times Enum.to_list(1..25)

  setup %{tmp_dir: tmp} do
    root = Path.join(tmp, "lab")
    {:ok, rotation} = Rotation.start_link({"hall", root, []}, SplitPoint.new(10), nil)

    for time <- @times, reduce: %{} do
      held ->
        number = SplitPoint.segment_number(SplitPoint.new(10), time)
        {:ok, real, stream} = Rotation.open_stream(rotation, number, "N", [])
        {:ok, stream} = Writer.append(Map.get(held, real, stream), [message(time)])
        :ok = Rotation.report_append(rotation, SplitPoint.new(10), real, time)
        Map.put(held, real, stream)
    end

    :ok = Rotation.close_all(rotation)
    # What the studio keeps next to a recording, and recordings that only have similar names.
    record("hall-annotation-Speech", root)
    File.write!(Path.join(root, "hall-annotation-Speech.Speech.edits"), "edits")
    File.write!(Path.join(root, "hall.bookmarks"), "[]")
    record("hallway", root)
    {:ok, root: root, path: Path.join(root, "hall"), to: Path.join(tmp, "archive/2026")}
  end

  defp message(time),
    do: %Message{data: time, originating_time: time, creation_time: time, sequence_id: time}

  defp record(name, root) do
    {:ok, writer} = Writer.create(name, root)
    {:ok, stream} = Writer.stream(writer, "N", type: :integer)
    {:ok, _} = Writer.append(stream, Enum.map(@times, &message/1))
    :ok = Writer.close(writer)
    writer.path
  end

  defp times(path), do: path |> Store.open!() |> Store.messages("N") |> Enum.map(& &1.data)

  @moved ~w(hall-annotation-Speech.0000 hall-annotation-Speech.Speech.edits hall.bookmarks) ++
           ~w(hall.0000 hall.0001 hall.0002)

  defp ls(folder), do: folder |> File.ls!() |> Enum.sort()

  test "moves all segments, annotations and bookmarks", %{root: root, path: path, to: to} do
    test = self()
    finish = fn pairs -> send(test, {:pairs, pairs}) && :ok end
    assert {:ok, moved} = Store.move(path, to, finish: finish)
    assert moved == Path.join(to, "hall")
    assert times(moved) == @times
    assert ls(to) == Enum.sort(@moved)
    assert ls(root) == ["hallway.0000"]
    assert {:error, %{code: :no_store}} = Store.open(path)
    assert_received {:pairs, pairs}
    assert {path, moved} in pairs and length(pairs) == length(@moved) + 1
    # Back again, into a folder that exists.
    assert {:ok, ^path} = Store.move(moved, root)
    assert times(path) == @times and ls(to) == []
  end

  test "moves one version of a name", %{root: root, to: to} do
    first = record("walk", root)
    second = record("walk", root)
    File.write!(second <> ".bookmarks", "[]")
    record("walk.0001-annotation-Speech", root)
    File.write!(second <> "-annotation-Speech.Speech.edits", "edits")
    assert {:ok, moved} = Store.move(Path.join(root, "walk"), to)
    assert moved == Path.join(to, "walk.0001")

    assert ls(to) ==
             ~w(walk.0001 walk.0001-annotation-Speech.0000 walk.0001-annotation-Speech.Speech.edits) ++
               ["walk.0001.bookmarks"]

    assert times(first) == @times
  end

  test "moves all versions of a layer of annotations with its log", %{root: root, to: to} do
    record("hall-annotation-Speech", root)
    layer = Path.join(root, "hall-annotation-Speech")
    assert {:ok, moved} = Store.move(layer <> ".0001", to)
    assert moved == Path.join(to, "hall-annotation-Speech")

    assert ls(to) ==
             ~w(hall-annotation-Speech.0000 hall-annotation-Speech.0001 hall-annotation-Speech.Speech.edits)

    assert times(moved) == @times
  end

  test "refuses names that are taken, the same folder, and what is being used", ctx do
    %{root: root, path: path, to: to} = ctx
    record("hall", to)
    assert {:error, %{code: :store_exists}} = Store.move(path, to)
    assert {:error, %{code: :same_folder}} = Store.move(path, root)
    assert {:error, %{code: :no_store}} = Store.move(Path.join(root, "none"), to)
    assert {:error, %{code: :not_local, fix: fix}} = Store.move(path, "s3://bucket/x")
    assert fix =~ "push"

    {:ok, writer} = Writer.create("live", root)
    assert {:error, %{code: :store_in_use}} = Store.move(writer.path, to)
    :ok = Writer.close(writer)

    File.rm_rf!(to)
    {:ok, lock} = FileLock.acquire(Path.join(root, "hall-annotation-Speech.Speech.lock"))
    File.write!(Path.join(to |> Path.dirname() |> tap(&File.mkdir_p!/1), "x"), "")
    task = Task.async(fn -> Store.move(path, to) end)
    assert {:error, %{code: :in_use, why: why}} = Task.await(task, 20_000)
    assert why =~ "process"
    FileLock.release(lock)
    assert {:ok, _} = Store.move(path, to)
  end

  test "an error of the last step keeps the plan, and another call completes the move", ctx do
    failing = fn _ -> {:error, Situ.Error.new(:not_saved, "the dataset cannot be saved")} end
    assert {:error, %{code: :not_saved}} = Store.move(ctx.path, ctx.to, finish: failing)
    assert {:error, %{code: :move_interrupted, fix: fix}} = Store.open(Path.join(ctx.to, "hall"))
    assert fix =~ "situ store move"
    assert {:error, %{code: :move_interrupted}} = Store.move(ctx.path, ctx.root <> "2")
    assert {:ok, moved} = Store.move(ctx.path, ctx.to)
    assert times(moved) == @times
  end

  for copied <- [false, true] do
    @copied copied
    test "a move#{if copied, do: " to another file system"} that is killed at any step is completed",
         ctx do
      %{path: path, root: root, to: to} = ctx
      File.mkdir_p!(to)
      moved = Path.join(to, "hall")
      make_plan = fn -> make_plan(path, to, @copied) end
      count = length(Moving.list_steps(make_plan.()))
      clean(to)

      for killed <- 0..count do
        plan = make_plan.()

        for step <- Enum.take(Moving.list_steps(plan), killed),
            do: :ok = Moving.run_step(step, plan)

        # Each path is the complete recording, does not exist, or says that it is incomplete.
        for name <- [path, moved] do
          case Store.open(name) do
            {:ok, _} -> assert times(name) == @times
            {:error, error} -> assert error.code in [:no_store, :move_interrupted]
          end
        end

        # Nothing is ever in no folder.
        for entry <- @moved,
            do: assert(Enum.any?([root, to], &File.exists?(Path.join(&1, entry))))

        # A program that creates a store there deletes copies whose program was killed.
        if rem(killed, 2) == 1, do: Situ.Store.Draft.delete_abandoned(moved)

        result = Store.move(path, to)
        if killed < count, do: assert(result == {:ok, moved}), else: assert({:error, _} = result)
        assert times(moved) == @times
        assert Enum.reject(ls(to), &(&1 =~ "unfinished")) == Enum.sort(@moved)
        assert ls(root) == ["hallway.0000"]
        {:ok, ^path} = Store.move(moved, root)
        clean(to)
      end
    end
  end

  defp make_plan(path, to, copied?) do
    {:ok, plan} = Moving.build_plan(path, to)
    {:ok, plan} = if copied?, do: Moving.stage_entries(plan), else: {:ok, plan}
    plan
  end

  # Copies that were made before the plan was written are left after a kill.
  defp clean(to) do
    for entry <- ls(to) do
      assert entry =~ "unfinished"
      File.rm_rf!(Path.join(to, entry))
    end
  end

  test "copies to another file system, and deletes the originals last", ctx do
    other =
      Path.join("/dev/shm", "situ-move-#{System.unique_integer([:positive])}-#{System.pid()}")

    if File.dir?("/dev/shm") and
         File.stat!("/dev/shm").major_device != File.stat!(ctx.root).major_device do
      on_exit(fn -> File.rm_rf!(other) end)
      test = self()
      progress = fn done, total -> send(test, {:bytes, done, total}) end
      assert {:ok, moved} = Store.move(ctx.path, other, progress: progress)
      assert times(moved) == @times
      assert ls(other) == Enum.sort(@moved)
      assert ls(ctx.root) == ["hallway.0000"]
      assert_received {:bytes, total, total}
    end
  end
end
