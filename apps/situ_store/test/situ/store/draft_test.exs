defmodule Situ.Store.DraftTest do
  # Unfinished stores: they have no name yet, and are removed if they will never be completed.
  use ExUnit.Case, async: true
  import Situ.Store.Test.Record
  alias Situ.Store
  alias Situ.Store.Writer

  @moduletag :tmp_dir

  defp data(path, stream),
    do: path |> Store.open!() |> Store.messages(stream) |> Enum.map(& &1.data)

  test "an incomplete store has no name, and the next store removes it", %{tmp_dir: root} do
    path = store(root, [{"N", messages(Enum.to_list(1..10)), []}])
    test = self()

    # The writer is killed in the middle, as by Ctrl-C.
    {pid, monitor} =
      spawn_monitor(fn ->
        Store.copy(path, {"out", root},
          progress: fn _, _ ->
            send(test, :half)
            Process.sleep(:infinity)
          end
        )
      end)

    receive do: (:half -> Process.exit(pid, :kill))
    receive do: ({:DOWN, ^monitor, _, _, _} -> :ok)
    assert [_] = Path.wildcard(Path.join(root, "out.*.unfinished"))
    assert Store.newest("out", root) == nil
    refute Enum.any?(Store.list(root), &(&1 =~ "out"))
    assert swept(path, root)
    assert data(Path.join(root, "out"), "N") == Enum.to_list(1..10)
    assert Path.wildcard(Path.join(root, "out.*.lock")) == []
  end

  # The dead process releases its lock when its memory is collected.
  defp swept(path, root) do
    Enum.any?(1..100, fn _ ->
      :erlang.garbage_collect()
      {:ok, _} = Store.copy(path, {"out", root})
      Path.wildcard(Path.join(root, "out.*.unfinished")) == []
    end)
  end

  test "a complete draft that waits for its name is not removed", %{tmp_dir: root} do
    path = store(root, [{"N", messages([1, 2]), []}])
    test = self()

    first =
      Task.async(fn ->
        Store.copy(path, {"out", root},
          progress: fn done, total ->
            if done == total do
              send(test, :nearly)
              receive do: (:go -> :ok)
            end
          end
        )
      end)

    assert_receive :nearly, 30_000
    assert {:ok, second} = Store.copy(path, {"out", root})
    send(first.pid, :go)
    assert {:ok, path} = Task.await(first, 30_000)
    assert {Path.basename(second), Path.basename(path)} == {"out.0000", "out.0001"}
    assert data(path, "N") == [1, 2]
  end

  test "an empty folder left by a killed writer does not hide a recording", %{tmp_dir: root} do
    path = store(root, [{"N", messages([1, 2]), []}])
    {:ok, copy} = Store.copy(path, {"out", root})
    File.mkdir!(Path.join(root, "out.0001"))
    assert {:ok, %{path: ^copy}} = Store.open(Path.join(root, "out"))
    assert {:ok, next} = Store.copy(path, {"out", root})
    assert Path.basename(next) == "out.0002"
  end

  test "a store that cannot be created leaves no folder", %{tmp_dir: root} do
    disk = Path.join(root, "disk")
    File.mkdir_p!(disk)

    case System.cmd("mount", ["-t", "tmpfs", "-o", "size=1m", "tmpfs", disk],
           stderr_to_stdout: true
         ) do
      {_, 0} ->
        try do
          ballast = Path.join(disk, "ballast")
          File.write!(ballast, :binary.copy(<<1>>, 1_040_000))
          assert {:error, %{code: :disk_full}} = Writer.create("big", disk)
          assert File.ls!(disk) == ["ballast"]
          # A nearly full disk accepts as much as fits.
          File.write!(ballast, :binary.copy(<<1>>, 900_000))
          assert {:ok, writer} = Writer.create("little", disk)
          assert {:ok, stream} = Writer.stream(writer, "S")
          assert {:ok, _} = Writer.append(stream, messages([1, 2, 3]))
          assert :ok = Writer.close(writer)
          assert data(writer.path, "S") == [1, 2, 3]
          :ok = Store.delete(writer.path)
          File.rm!(ballast)
          path = store(root, [{"N", messages([1]), []}])
          assert {:ok, _} = Store.copy(path, {"small", disk})

          large =
            store(root, [
              {"L", messages(for(_ <- 1..20, do: :crypto.strong_rand_bytes(100_000))), []}
            ])

          assert {:error, %{code: :disk_full, why: why}} = Store.copy(large, {"large", disk})
          assert why =~ "was deleted"
          assert File.ls!(disk) == ["small.0000"]
        after
          System.cmd("umount", ["-l", disk])
        end

      {why, _} ->
        IO.puts(:stderr, "not tested, no disk to fill: " <> String.trim(why))
    end
  end

  test "a copy can be written to a given folder, even next to other files", %{tmp_dir: root} do
    path = store(root, [{"N", messages([1, 2]), []}])
    target = Path.join(root, "mine")
    assert {:ok, ^target} = Store.copy(path, {"n", target}, versioned: false)
    assert {:error, %{code: :store_exists}} = Store.copy(path, {"n", target}, versioned: false)
    notes = Path.join(root, "notes")
    File.mkdir_p!(notes)
    File.write!(Path.join(notes, "readme.txt"), "mine")
    assert {:ok, ^notes} = Store.copy(path, {"n", notes}, versioned: false)
    assert data(notes, "N") == [1, 2] and "readme.txt" in File.ls!(notes)
  end
end
