defmodule Situ.Store.NativeErrorsTest do
  # Recordings under faults: full disks, clock changes, deleted files and read-only folders.
  use ExUnit.Case, async: true
  import Situ.Test.Eventually
  import Situ.Store.Test.Record
  alias Situ.{Pipeline, Store}
  alias Situ.Store.Writer

  @moduletag :tmp_dir

  # Mounts a small disk. Only root may do so; otherwise the test is skipped.
  defp with_small_disk(root, options, fun) do
    disk = Path.join(root, "disk")
    File.mkdir_p!(disk)

    case System.cmd("mount", ["-t", "tmpfs", "-o", options, "tmpfs", disk], stderr_to_stdout: true) do
      {_, 0} ->
        try do
          fun.(disk)
        after
          System.cmd("umount", ["-l", disk])
        end

      {why, _} ->
        IO.puts(:stderr, "not tested, no disk to fill: " <> String.trim(why))
    end
  end

  test "a full disk fails the pipeline, and the data written before stays intact", %{
    tmp_dir: root
  } do
    with_small_disk(root, "size=2m", fn disk ->
      test = self()

      {:error, error} =
        Pipeline.run(fn p ->
          exporter = Store.create(p, "full", disk, first_extent: 65_536, max_extent: 262_144)

          items = for i <- 1..100_000, do: {i * 1_000, {i, String.duplicate("x", 100)}}

          p
          |> Situ.from_enumerable(items)
          |> Store.write(exporter, "s")
          |> Situ.each(fn _ -> :ok end)

          send(test, {:path, exporter.path})
        end)

      assert Exception.message(error) =~ "no space left on the disk"
      assert_received {:path, path}
      store = Store.open!(path)
      numbers = for %{data: {i, _}} <- Store.messages(store, "s"), do: i
      assert length(numbers) > 1_000
      assert numbers == Enum.to_list(1..length(numbers))
      assert {:ok, %{damage: []}} = Store.verify(path)
      assert {:ok, %{dropped: 0}} = Store.repair(path)
    end)
  end

  test "a writer continues after a full disk was cleared", %{tmp_dir: root} do
    with_small_disk(root, "size=1m", fn disk ->
      {:ok, writer} = Writer.create("w", disk, first_extent: 65_536, max_extent: 65_536)
      {:ok, stream} = Writer.stream(writer, "s")
      {:ok, stream} = Writer.append(stream, messages(["first"]))
      ballast = Path.join(disk, "ballast")
      File.write(ballast, :binary.copy("b", 2_000_000))
      big = for i <- 1..20, do: message(:crypto.strong_rand_bytes(20_000), i * 1_000_000)
      assert {:error, %{code: :disk_full, fix: fix}} = Writer.append(stream, big)
      assert fix =~ "space"
      File.rm!(ballast)

      # On a busy machine, the disk stays full for a moment after the file was deleted (about once in several hundred
      # runs).
      again = fn -> with {:error, _} <- Writer.append(stream, Enum.take(big, 10)), do: nil end
      assert {:ok, stream} = eventually(again)
      {:ok, _} = Writer.close_stream(stream, 99_000_000)
      :ok = Writer.close(writer)

      assert Enum.map(Store.messages(Store.open!(writer.path), "s"), &byte_size(&1.data)) == [
               5 | List.duplicate(20_000, 10)
             ]

      assert {:ok, %{damage: []}} = Store.verify(writer.path)
    end)
  end

  test "a read-only folder refuses writes and allows reads", %{tmp_dir: root} do
    with_small_disk(root, "size=8m", fn disk ->
      path = store(disk, [{"s", messages([1, 2, 3]), []}])
      {_, 0} = System.cmd("mount", ["-o", "remount,ro", disk])
      assert {:error, %{code: :not_permitted}} = Writer.create("new", disk)
      assert path |> Store.open!() |> Store.messages("s") |> Enum.map(& &1.data) == [1, 2, 3]
      assert {:error, %{code: :not_permitted}} = Store.repair(path)
    end)
  end

  test "notices a deleted folder", %{tmp_dir: root} do
    {:ok, writer} = Writer.create("gone", root)
    {:ok, stream} = Writer.stream(writer, "s")
    {:ok, stream} = Writer.append(stream, messages([1]))
    reader = Store.open!(writer.path)
    # Pages that were read once stay mapped.
    {:ok, _} = Store.at(reader, "s", 0)
    File.rm_rf!(writer.path)

    # The check runs at most twice per second, so keep writing until then.
    error =
      Enum.find_value(Stream.iterate(1, &(&1 + 1)), fn n ->
        receive(do: (:never -> nil), after: (20 -> nil))

        case Writer.append(stream, [message(n, n * 1_000_000)]) do
          {:ok, _} when n < 200 -> nil
          result -> result
        end
      end)

    assert {:error, %{code: :store_deleted}} = error
    assert {:ok, %{data: 1}} = Store.at(reader, "s", 0)
  end

  test "clock changes affect creation times only", %{tmp_dir: root} do
    day = 86_400_000_000_000

    # These creation times come from a clock that jumps by days; originating times keep increasing.
    creations = [day, 2 * day, day, 0, 5 * day]
    written = for {c, i} <- Enum.with_index(creations), do: message(i, i * 1_000, c, i + 1)
    path = store(root, [{"s", written, []}])
    store = Store.open!(path)
    assert Enum.map(Store.messages(store, "s"), & &1.creation_time) == creations
    assert {:ok, %{data: 2}} = Store.latest_at(store, "s", 2_500)
    [info] = Store.streams(store)
    assert info.latency_sum == Enum.sum(creations) - 10_000
    test = self()

    {:ok, _} =
      Pipeline.run(
        fn p ->
          p |> Store.importer(path) |> Store.stream("s") |> Situ.each(&send(test, {:got, &1}))
        end,
        pipeline: [replay: [speed: 1.0]]
      )

    for i <- 0..4, do: assert_received({:got, ^i})
  end
end
