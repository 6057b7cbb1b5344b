defmodule Situ.Store.DraftTest do
  # Stores on their way: what has no name yet, and what becomes of it when there will be none.
  use ExUnit.Case, async: true
  import Situ.Store.Test.Record
  alias Situ.Store
  alias Situ.Store.Writer

  @moduletag :tmp_dir

  defp data(path, stream),
    do: path |> Store.open!() |> Store.messages(stream) |> Enum.map(& &1.data)

  test "what is not whole has no name, and goes with the next of its name", %{tmp_dir: root} do
    path = store(root, [{"N", messages(Enum.to_list(1..10)), []}])
    test = self()

    # Killed in the middle, as by a Ctrl-C.
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

  # The dead process gives its lock up when its memory is collected.
  defp swept(path, root) do
    Enum.any?(1..100, fn _ ->
      :erlang.garbage_collect()
      {:ok, _} = Store.copy(path, {"out", root})
      Path.wildcard(Path.join(root, "out.*.unfinished")) == []
    end)
  end

  test "a draft that is whole and waits for its name is not swept away", %{tmp_dir: root} do
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

  test "an empty folder that a killed writer left hides no recording", %{tmp_dir: root} do
    path = store(root, [{"N", messages([1, 2]), []}])
    {:ok, copy} = Store.copy(path, {"out", root})
    File.mkdir!(Path.join(root, "out.0001"))
    assert {:ok, %{path: ^copy}} = Store.open(Path.join(root, "out"))
    assert {:ok, next} = Store.copy(path, {"out", root})
    assert Path.basename(next) == "out.0002"
  end

  test "a store that cannot even begin leaves no folder behind", %{tmp_dir: root} do
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
          # A disk that is nearly full takes what it has room for.
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
          assert why =~ "removed"
          assert File.ls!(disk) == ["small.0000"]
        after
          System.cmd("umount", ["-l", disk])
        end

      {why, _} ->
        IO.puts(:stderr, "not tested, no disk to fill: " <> String.trim(why))
    end
  end

  test "a folder of its own choice, also one that holds other things", %{tmp_dir: root} do
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
