defmodule Situ.Store.SegmentedRecordingTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  import Situ.Test.SegmentFiles
  alias Situ.{Message, Store}
  alias Situ.Store.{Rotation, SegmentRenaming, Writer}
  alias Situ.Store.Rotation.SplitPoint
  alias Situ.Store.Summary.Fold

  @moduletag :tmp_dir
  @moduletag :capture_log

  # A recorder without a pipeline: the same steps as those of `Situ.Store.Sink`, one message at a time.
  defp start_run(root, split, keep) do
    cut = SplitPoint.new(split)
    opts = [first_extent: 65_536, max_extent: 65_536]
    {:ok, rotation} = Rotation.start_link({"hall", root, opts}, cut, keep)
    %{rotation: rotation, cut: cut, held: %{}}
  end

  defp append(run, name, time, data) do
    number = SplitPoint.segment_number(run.cut, time)
    {:ok, real, stream} = Rotation.open_stream(run.rotation, number, name, [])
    stream = Map.get(run.held, {real, name}, stream)
    message = %Message{data: data, originating_time: time, creation_time: time, sequence_id: time}
    {:ok, stream} = Writer.append(stream, [message])
    :ok = Rotation.report_append(run.rotation, run.cut, real, time)
    put_in(run.held[{real, name}], stream)
  end

  defp stop_run(run), do: :ok = Rotation.close_all(run.rotation)

  # The process ends without closing its segments, as after a kill.
  defp kill_run(run) do
    Process.unlink(run.rotation)
    ref = Process.monitor(run.rotation)
    Process.exit(run.rotation, :kill)
    assert_receive {:DOWN, ^ref, _, _, _}
  end

  defp times(store, name),
    do: store |> Store.messages(name) |> Enum.map(&{&1.originating_time, &1.data})

  defp open(root), do: Store.open!(Path.join(root, "hall"))

  describe "one name" do
    test "is all segments of all runs", %{tmp_dir: root} do
      first = Enum.reduce(1..50, start_run(root, 10, nil), &append(&2, "N", &1, &1))
      stop_run(first)
      second = Enum.reduce(100..150, start_run(root, 10, nil), &append(&2, "N", &1, &1 * 1.0))
      second = append(second, "Late", 151, "new")
      stop_run(second)
      store = open(root)
      wanted = for(t <- 1..50, do: {t, t}) ++ for(t <- 100..150, do: {t, t * 1.0})
      assert times(store, "N") == wanted
      assert times(store, "Late") == [{151, "new"}]

      assert %{name: "hall", segments: 12, closed?: true, live?: false, damage: []} =
               Store.info(store)

      assert [%{name: "N", count: 101, first: 1, last: 150}, %{name: "Late", count: 1}] =
               Store.streams(store)

      assert Store.interval(store) == {1, 151}
      assert Store.gaps(store, "N", 20) == [{50, 100}]
      assert {:ok, %{data: 105.0}} = Store.at(store, "N", 55)
      assert {:ok, %{data: 150.0}} = Store.at(store, "N", -1)
      assert {:ok, nil} = Store.at(store, "N", 101)
      assert {:ok, 6} = Store.count(store, "N", 48, 102)
      assert {:ok, %{data: 50}} = Store.latest_at(store, "N", 99)
      assert {:ok, %{data: 100.0}} = Store.first_at(store, "N", 51)
      assert {:error, %{code: :no_stream}} = Store.stream_info(store, "None")
      # A segment opened by its own name is a store.
      assert [{1, 1} | _] = times(Store.open!(Path.join(root, "hall.0000")), "N")
      assert Store.count(Store.open!(Path.join(root, "hall.0000")), "N") == 9
    end

    test "has the same summaries and columns as one store", %{tmp_dir: root} do
      run = start_run(root, 100, nil)

      run =
        for i <- 1..600, reduce: run do
          run ->
            run
            |> append("N", i, :math.sin(i) * 10)
            |> append("Open", i, rem(div(i, 70), 2) == 0)
            |> append("Map", i, %{
              "speed" => i,
              "door" => if(rem(i, 130) < 20, do: "open", else: "shut")
            })
        end

      stop_run(run)
      store = open(root)
      {:ok, whole} = Store.copy(Path.join(root, "hall"), Path.join(root, "whole"))
      whole = Store.open!(whole)

      for {from, to, pixels, changes} <- [
            {1, 600, 10, 100},
            {150, 420, 7, 100},
            {205, 215, 3, 100},
            {1, 600, 4, 1},
            {90, 600, 4, 2}
          ],
          name <- ["N", "Open", "Map"] do
        opts = [changes: changes]
        assert {:ok, one} = Store.Summary.read(store, name, from, to, pixels, opts)
        assert {:ok, other} = Store.Summary.read(whole, name, from, to, pixels, opts)
        assert sort_tracks(one) == sort_tracks(other), inspect({name, from, to, pixels, changes})

        assert Store.summary(store, name, from, to, pixels) ==
                 Store.summary(whole, name, from, to, pixels)
      end

      assert Enum.flat_map(Store.columns(store, "N"), &Situ.Columns.to_pairs/1) ==
               times(whole, "N")

      assert times(store, "Map") == times(whole, "Map")
    end

    defp sort_tracks(summary), do: %{summary | tracks: Enum.sort(summary.tracks)}

    test "is the newest version if that is not a segment", %{tmp_dir: root} do
      run = Enum.reduce(1..30, start_run(root, 10, nil), &append(&2, "N", &1, &1))
      stop_run(run)
      {:ok, writer} = Writer.create("hall", root)
      {:ok, stream} = Writer.stream(writer, "Other")

      {:ok, _} =
        Writer.append(stream, [
          %Message{data: 1, originating_time: 1, creation_time: 1, sequence_id: 0}
        ])

      :ok = Writer.close(writer)
      assert [%{name: "Other"}] = Store.streams(open(root))
      # Recording in segments continues the segmented recording.
      run = Enum.reduce(50..60, start_run(root, 10, nil), &append(&2, "N", &1, &1))
      stop_run(run)
      assert [%{name: "N", count: 41}] = Store.streams(open(root))
    end

    test "is not hidden by a recorder that was killed before it wrote anything", ctx do
      path = Path.join(ctx.tmp_dir, "hall")
      run = Enum.reduce(1..30, start_run(ctx.tmp_dir, 10, nil), &append(&2, "N", &1, &1))
      stop_run(run)
      assert {:ok, empty} = create_unwritten(ctx.tmp_dir)
      assert %{closed?: false, piece: nil, entries: n} = Store.info(Store.open!(empty))
      assert n < 2

      assert [%{name: "N", count: 30}] = Store.streams(open(ctx.tmp_dir))
      assert Store.list(ctx.tmp_dir) == [path]
      # A repair closes the empty version, which is still no recording.
      assert {:ok, %{dropped: 0}} = Store.repair(path)
      assert %{closed?: true} = Store.info(Store.open!(empty))
      assert [%{name: "N", count: 30}] = Store.streams(open(ctx.tmp_dir))
      assert {:ok, copy} = Store.copy(path, {"copy", ctx.tmp_dir})
      assert [%{name: "N", count: 30}] = Store.streams(Store.open!(copy))
      :ok = Store.delete(copy)
      # A recorder continues the recording.
      run = Enum.reduce(50..60, start_run(ctx.tmp_dir, 10, nil), &append(&2, "N", &1, &1))
      stop_run(run)
      assert [%{name: "N", count: 41}] = Store.streams(open(ctx.tmp_dir))
      assert :ok = Store.delete(path)
      refute File.exists?(empty)
      assert {:error, %{code: :no_store}} = Store.open(path)
    end

    test "has no damage if a recorder was killed before it wrote a header", %{tmp_dir: root} do
      path = Path.join(root, "hall")
      run = Enum.reduce(1..30, start_run(root, 10, nil), &append(&2, "N", &1, &1))
      stop_run(run)

      for {number, index} <- [{50, ""}, {51, <<0::size(65_536)-unit(8)>>}] do
        folder = "#{path}.00#{number}"
        File.mkdir_p!(folder)
        File.write!(Path.join(folder, "lock"), "")
        File.write!(Path.join(folder, "index.situ"), index)
      end

      assert %{damage: []} = Store.info(open(root))
      assert [%{count: 30}] = Store.streams(open(root))
      assert {:ok, %{damage: []}} = Store.verify(path)
      assert {:ok, %{dropped: 0, damage: []}} = Store.repair(path)
      # Other content may be a segment.
      File.write!("#{path}.0051/index.situ", "no index")
      assert %{damage: [_]} = Store.info(open(root))
      assert {:ok, %{damage: [_ | _]}} = Store.verify(path)
    end

    # As a recorder that is killed after it has created its first segment.
    defp create_unwritten(root) do
      {pid, monitor} =
        spawn_monitor(fn ->
          {:ok, writer} = Writer.create("hall", root)
          exit({:created, writer.path})
        end)

      assert_receive {:DOWN, ^monitor, :process, ^pid, {:created, path}}
      {:ok, path}
    end

    test "shows streams of the same name and another type separately", %{tmp_dir: root} do
      run = start_run(root, 10, nil)
      {:ok, _, stream} = Rotation.open_stream(run.rotation, 0, "N", type: :integer)

      {:ok, _} =
        Writer.append(stream, [
          %Message{data: 1, originating_time: 1, creation_time: 1, sequence_id: 0}
        ])

      stop_run(run)
      run = start_run(root, 10, nil)
      {:ok, _, stream} = Rotation.open_stream(run.rotation, 2, "N", type: :float)

      {:ok, _} =
        Writer.append(stream, [
          %Message{data: 2.5, originating_time: 21, creation_time: 21, sequence_id: 0}
        ])

      stop_run(run)
      store = open(root)
      assert times(store, "N") == [{21, 2.5}]
      assert times(store, "N (:integer)") == [{1, 1}]
    end

    test "shows the later run where runs overlap, and says so", %{tmp_dir: root} do
      run = Enum.reduce(1..50, start_run(root, 10, nil), &append(&2, "N", &1, {1, &1}))
      stop_run(run)
      run = Enum.reduce(26..40, start_run(root, 10, nil), &append(&2, "N", &1, {2, &1}))
      stop_run(run)
      store = open(root)
      wanted = for(t <- 1..25, do: {t, {1, t}}) ++ for(t <- 26..40, do: {t, {2, t}})
      assert times(store, "N") == wanted
      assert %{notes: ["25 messages of earlier runs" <> _]} = Store.info(store)
      assert Store.count(store, "N") == 40
      assert {:ok, 10} = Store.count(store, "N", 21, 30)
      assert {:ok, %{data: {1, 25}}} = Store.latest_at(store, "N", 25)
      {:ok, copy} = Store.copy(Path.join(root, "hall"), Path.join(root, "copy"))
      assert times(Store.open!(copy), "N") == wanted
    end

    test "loses nothing because of a message with an impossible time", %{tmp_dir: root} do
      far = 3 * 365 * 86_400_000_000_000
      run = Enum.reduce(1..60, start_run(root, 10, {:span, 1_000}), &append(&2, "N", &1, &1))
      run = run |> append("B", 5, :first) |> append("B", far, :far)
      stop_run(run)
      run = Enum.reduce(61..99, start_run(root, 10, {:span, 1_000}), &append(&2, "N", &1, &1))
      run = append(run, "B", 80, :now)
      store = open(root)
      assert times(store, "N") == for(t <- 1..99, do: {t, t})
      # The later run is believed, and the message stays in its segment.
      assert times(store, "B") == [{5, :first}, {80, :now}]
      assert %{notes: ["1 messages of earlier runs" <> _]} = Store.info(store)
      kept = for s <- Store.segments(store), {far, _} <- far_messages(s.path), do: far
      assert kept == [far]
      stop_run(run)
    end

    defp far_messages(path) do
      store = Store.open!(path)

      if Store.has_stream?(store, "B"),
        do: Enum.filter(times(store, "B"), &(elem(&1, 0) > 100)),
        else: []
    end

    test "includes segments of earlier releases, which do not mark their run", %{tmp_dir: root} do
      for first <- [1, 21, 11],
          do: write_segment(root, "hall", %{"N" => first..(first + 8)}, run: nil)

      numbers = &Enum.map(times(open(&1), "N"), fn {time, _} -> time end)
      assert numbers.(root) == Enum.to_list(1..9) ++ Enum.to_list(11..19) ++ Enum.to_list(21..29)
      # If they overlap, the newest segment is believed.
      other = Path.join(root, "other")

      for first <- [1, 11, 5],
          do: write_segment(other, "hall", %{"N" => first..(first + 8)}, run: nil)

      assert numbers.(other) == Enum.to_list(1..13)
      write_segment(other, "hall", %{"N" => 20..22}, run: "new")
      assert numbers.(other) == Enum.to_list(1..13) ++ [20, 21, 22]
    end

    test "survives damage to segments while they are open", %{tmp_dir: root} do
      for first <- [1, 11], do: write_segment(root, "hall", %{"N" => first..(first + 8)})
      writer = write_segment(root, "hall", %{"N" => 21..29}, open?: true)
      store = open(root)
      assert Store.count(store, "N") == 27
      File.write!(Path.join(writer.path, "index.situ"), "short")
      assert [%{name: "N"}] = Store.streams(store)
      assert {:ok, %{data: 15}} = Store.latest_at(store, "N", 15)
      _ = Writer.close(writer)
      File.rm_rf!(writer.path)
      assert length(times(store, "N")) == 18
      for path <- Store.list(root, segments: true), do: File.rm_rf!(path)
      assert_raise Situ.Error, ~r/no store/, fn -> Store.info(store) end

      assert Enum.to_list(
               Store.messages(store, %{id: 1, name: "N"} |> then(&struct!(Store.StreamInfo, &1)))
             ) == []
    end

    test "reports a segment that cannot be read, and reads the others", %{tmp_dir: root} do
      run = Enum.reduce(1..50, start_run(root, 10, nil), &append(&2, "N", &1, &1))
      stop_run(run)
      File.write!(Path.join(root, "hall.0002/index.situ"), "nonsense")
      store = open(root)
      assert %{damage: ["hall.0002 cannot be read" <> _]} = Store.info(store)
      assert length(times(store, "N")) == 40
      File.write!(Path.join(root, "hall.0005/index.situ"), "nonsense")
      assert length(times(open(root), "N")) == 39
    end
  end

  describe "a recording that is being written" do
    test "is replayed by a pipeline, which follows it until its recorder stops", %{tmp_dir: root} do
      run = Enum.reduce(1..25, start_run(root, 10, nil), &append(&2, "N", &1, &1))
      me = self()

      task =
        Task.async(fn ->
          Situ.to_list(fn p ->
            hall = Store.importer(p, Path.join(root, "hall"))
            hall |> Store.stream("N") |> Situ.each(&send(me, {:read, &1}))
          end)
        end)

      assert_receive {:read, 25}, 5_000
      run = Enum.reduce(26..70, run, &append(&2, "N", &1, &1))
      assert_receive {:read, 70}, 5_000
      stop_run(run)
      assert Task.await(task) == Enum.to_list(1..70)

      # A finished recording is replayed in its recorded time, through all segments.
      run = Enum.reduce(100..110, start_run(root, 10, nil), &append(&2, "N", &1, &1))
      stop_run(run)

      data =
        Situ.to_list(fn p -> p |> Store.importer(Path.join(root, "hall")) |> Store.stream("N") end)

      assert data == Enum.to_list(1..70) ++ Enum.to_list(100..110)
    end

    test "is followed into new segments", %{tmp_dir: root} do
      run = append(start_run(root, 10, nil), "N", 1, 1)
      store = open(root)
      assert %{live?: true, closed?: false} = Store.info(store)
      :ok = Store.notify(store, 0, 7)
      assert_receive {:situ_store, 7, {:published, n}}
      :ok = Store.notify(store, n, 7)
      run = append(run, "N", 35, 35)
      assert_receive {:situ_store, 7, {:published, n}}
      assert times(store, "N") == [{1, 1}, {35, 35}]
      run = Enum.reduce(36..80, run, &append(&2, "N", &1, &1))
      assert length(times(store, "N")) == 47
      stop_run(run)
      assert ended?(store, n)
      assert %{live?: false, closed?: true} = Store.info(store)
    end

    defp ended?(store, n) do
      :ok = Store.notify(store, n, 8)

      receive do
        {:situ_store, 8, {:published, n}} -> ended?(store, n)
        {:situ_store, 8, {:ended, _}} -> true
      after
        5_000 -> false
      end
    end

    test "keeps its ordinals when the oldest segments are deleted", %{tmp_dir: root} do
      run = Enum.reduce(1..25, start_run(root, 10, {:span, 20}), &append(&2, "N", &1, &1))
      store = open(root)
      {:ok, info} = Store.stream_info(store, "N")
      {:ok, first, next} = Store.Query.read_batch(store, info, 0, :unbounded, 5, exact: true)
      assert Enum.map(first, & &1.data) == [1, 2, 3, 4, 5]
      run = Enum.reduce(26..100, run, &append(&2, "N", &1, &1))

      log =
        ExUnit.CaptureLog.capture_log(fn ->
          # Deleted segments are noticed when the recording is asked for its current state.
          assert Store.stream_info(store, "N")
          {:ok, later, _} = Store.Query.read_batch(store, info, next, :unbounded, 5, exact: true)
          assert [%{data: data} | _] = later
          assert data > 50
        end)

      assert log =~ "messages of \"N\" were deleted before they were read"
      assert log =~ "were recorded and deleted since the recording was last read"
      assert {:ok, ordinal} = Store.ordinal(store, "N", 100)
      run = Enum.reduce(101..115, run, &append(&2, "N", &1, &1))
      assert {:ok, ^ordinal} = Store.ordinal(store, "N", 100)
      assert {:ok, %{data: 115}} = Store.at(store, "N", -1)
      # A recording that is opened now begins with the messages that exist now.
      [{first, _} | _] = times(open(root), "N")
      assert {:ok, %{data: ^first}} = Store.at(open(root), "N", 0)
      assert {:ok, %{data: second}} = Store.at(open(root), "N", 1)
      assert second == first + 1
      stop_run(run)
    end
  end

  describe "a verb acts on all segments:" do
    setup %{tmp_dir: root} do
      run = Enum.reduce(1..50, start_run(root, 10, nil), &append(&2, "N", &1, &1))
      stop_run(run)
      %{path: Path.join(root, "hall"), messages: for(t <- 1..50, do: {t, t})}
    end

    test "copy and crop create one store", %{tmp_dir: root, path: path} = ctx do
      {:ok, copy} = Store.copy(path, Path.join(root, "copy"))
      assert Path.basename(copy) == "copy.0000"
      assert times(Store.open!(copy), "N") == ctx.messages
      assert {:ok, %{closed: closed}} = Store.stream_info(Store.open!(copy), "N")
      assert closed == nil
      {:ok, crop} = Store.crop(path, Path.join(root, "crop"), from: 8, to: 31)
      assert times(Store.open!(crop), "N") == Enum.slice(ctx.messages, 7..30)

      {:ok, edited} =
        Store.edit(path, Path.join(root, "edited"), %{
          "N" => [{:upsert, 10, 0}, {:delete, 29}, {:upsert, 60, 60}]
        })

      wanted = List.keyreplace(List.keydelete(ctx.messages, 29, 0), 10, 0, {10, 0}) ++ [{60, 60}]
      assert times(Store.open!(edited), "N") == wanted
      {:ok, joined} = Store.concat([path, edited] |> Enum.take(1), Path.join(root, "joined"))
      assert times(Store.open!(joined), "N") == ctx.messages
    end

    test "verify and repair", %{path: path} = ctx do
      assert {:ok, %{damage: [], chunks: chunks}} = Store.verify(path)
      assert chunks > 50

      assert {:ok, %{kept: ^chunks, damage: [], rebuilt?: false}} =
               Store.repair(path, dry_run: true)

      File.rm!(Path.join(path <> ".0002", "index.situ"))
      assert {:ok, %{damage: [%{file: "hall.0002"}]}} = Store.verify(path)
      assert {:ok, %{rebuilt?: true}} = Store.repair(path)
      assert times(Store.open!(path), "N") == ctx.messages
    end

    # A repair within a second of the last change may leave the size and the modification time as they were.
    test "a changed state is seen although the size and the time of the file are the same", ctx do
      assert Store.closed?(Store.open!(ctx.path))
      index = Path.join(ctx.path <> ".0002", "index.situ")
      %{mtime: mtime} = File.stat!(index)
      {:ok, file} = :file.open(index, [:read, :write, :raw, :binary])
      # The state at byte 80: 0 is open, 1 is closed (`priv/schema/store.md`).
      :ok = :file.pwrite(file, 80, <<0>>)
      :ok = :file.close(file)
      File.touch!(index, mtime)
      refute Store.closed?(Store.open!(ctx.path))
      {:ok, _} = Store.repair(ctx.path)
      File.touch!(index, mtime)
      assert Store.closed?(Store.open!(ctx.path))
    end

    test "compact", %{path: path, tmp_dir: root} = ctx do
      store = Store.open!(path)
      assert {:ok, ^path} = Store.compact(path, compression: :zstd)
      assert times(Store.open!(path), "N") == ctx.messages
      assert length(Store.segments(Store.open!(path))) == 6
      # A recording that was open before is still readable.
      assert times(store, "N") == ctx.messages
      # The recorder continues it.
      run = append(start_run(root, 10, nil), "N", 70, 70)
      assert {:error, %{code: :store_in_use}} = Store.compact(path)
      stop_run(run)
      assert times(Store.open!(path), "N") == ctx.messages ++ [{70, 70}]
    end

    test "repair restores the name of a segment whose compaction was killed",
         %{path: path} = ctx do
      File.rename!(path <> ".0002", path <> ".0002.before-compaction")
      assert %{damage: ["hall.0002 has lost its name" <> _]} = Store.info(Store.open!(path))
      assert {:error, %{code: :compaction_interrupted}} = Store.repair(path, dry_run: true)
      assert {:ok, %{dropped: 0}} = Store.repair(path)
      assert times(Store.open!(path), "N") == ctx.messages
      assert %{damage: []} = Store.info(Store.open!(path))
    end

    test "delete", %{path: path, tmp_dir: root} do
      run = append(start_run(root, 10, nil), "N", 70, 70)
      assert {:error, %{code: :store_in_use}} = Store.delete(path)
      assert length(Store.list(root, segments: true)) == 7
      stop_run(run)
      File.write!(Path.join(path <> ".0001", "notes.txt"), "mine")
      assert :ok = Store.delete(path)
      assert File.ls!(root) == ["hall.0001"]
      assert File.ls!(path <> ".0001") == ["notes.txt"]
      File.rm_rf!(path <> ".0001")
      assert {:error, %{code: :no_store}} = Store.open(path)
    end

    test "a deletion that is killed at any step is completed by the next one",
         %{path: path} = ctx do
      # The deletion was killed after it had renamed the second segment.
      :ok = Store.delete(path <> ".0000")
      File.rename!(path <> ".0001", path <> ".0001.1-1.unfinished")
      assert times(Store.open!(path), "N") == Enum.drop(ctx.messages, 19)
      assert length(Store.list(ctx.tmp_dir, segments: true)) == 4
      assert :ok = Store.delete(path)
      assert File.ls!(ctx.tmp_dir) == []
    end

    test "list shows one recording", %{tmp_dir: root, path: path} do
      {:ok, writer} = Writer.create("lobby", root)
      :ok = Writer.close(writer)
      assert Store.list(root) == [path, writer.path]
      assert length(Store.list(root, segments: true)) == 7

      assert [%{path: first, count: 9, first: 1, last: 9, live?: false, closed?: true} | _] =
               Store.segments(Store.open!(path))

      assert first == path <> ".0000"
      assert Store.segments(Store.open!(writer.path)) == []
    end

    test "rename", %{tmp_dir: root, path: path} = ctx do
      assert {:ok, renamed} = Store.rename(path, "door")
      assert renamed == Path.join(root, "door")
      assert times(Store.open!(renamed), "N") == ctx.messages
      assert {:error, %{code: :no_store}} = Store.open(path)
      assert %{name: "door"} = Store.info(Store.open!(renamed))
      {:ok, _} = Store.copy(renamed, Path.join(root, "hall"))
      assert {:error, %{code: :store_exists}} = Store.rename(renamed, "hall")
    end

    test "a rename that is killed at any step is completed", %{tmp_dir: root, path: path} = ctx do
      plan = %{root: root, from: "hall", to: "door"}
      steps = length(SegmentRenaming.list_steps(plan))

      for done <- 0..steps, complete <- [:repair_old, :repair_new, :rename] do
        for step <- Enum.take(SegmentRenaming.list_steps(plan), done),
            do: :ok = SegmentRenaming.run_step(step, plan)

        door = Path.join(root, "door")

        # Each name is the complete recording, does not exist or says that it is incomplete.
        for name <- [path, door] do
          case Store.open(name) do
            {:ok, store} -> assert times(store, "N") == ctx.messages
            {:error, error} -> assert error.code in [:no_store, :rename_interrupted]
          end
        end

        result =
          case complete do
            :rename -> if done < steps, do: Store.rename(path, "door"), else: {:ok, door}
            :repair_old -> Store.repair(path)
            :repair_new -> Store.repair(door)
          end

        # Before the first note and after the last one, one of the names does not exist.
        unless match?({:ok, _}, result),
          do: assert(done in [0, steps - 1, steps], inspect(result))

        # The note of the new name is the first that is written, so the old name may be complete without it.
        if File.exists?(door <> ".renaming"), do: {:ok, _} = Store.repair(door)
        at = if done == 0 and complete != :rename, do: path, else: door
        assert times(Store.open!(at), "N") == ctx.messages
        assert Enum.reject(File.ls!(root), &(&1 =~ ~r/\.\d{4}\z/)) == []
        if at == door, do: {:ok, _} = Store.rename(door, "hall")
      end
    end
  end

  # One step: a message of a stream after a pause, a restart or a kill of the recorder.
  defp step do
    :proper_types.frequency([
      {12, {:append, :proper_types.oneof(["A", "B"]), :proper_types.oneof([1, 1, 2, 3, 8, 25])}},
      {1, :restart},
      {1, :kill},
      {2, :look}
    ])
  end

  defp split, do: :proper_types.oneof([10, 40, {:bytes, 3_000}])
  defp keep, do: :proper_types.oneof([nil, {:span, 30}, {:span, 200}, {:bytes, 200_000}])

  property "reads the acknowledged messages that are still kept",
    context: %{tmp_dir: tmp},
    numtests: 30 do
    forall {split, keep, steps} <- {split(), keep(), :proper_types.resize(120, list(step()))} do
      root = Path.join(tmp, "#{System.unique_integer([:positive])}")
      run = start_run(root, split, keep)

      world = %{
        run: run,
        root: root,
        model: [],
        times: %{"A" => 0, "B" => 0},
        reader: nil,
        options: {split, keep}
      }

      world = Enum.reduce(steps, world, &apply_step/2)
      check(world)
      stop_run(world.run)
      check(world)
      File.rm_rf!(root)
    end
  end

  defp apply_step({:append, name, pause}, world) do
    time = world.times[name] + pause
    run = append(world.run, name, time, {name, time, :binary.copy("x", 40)})
    %{world | run: run, times: %{world.times | name => time}, model: [{name, time} | world.model]}
  end

  defp apply_step(:look, world) do
    check(world)
    world
  end

  defp apply_step(end_run, world) do
    if end_run == :kill, do: kill_run(world.run), else: stop_run(world.run)
    # The locks of its writers end when they are garbage collected, as at the end of a program.
    world = %{world | run: nil}
    :erlang.garbage_collect()
    restart(world)
  end

  defp restart(%{options: {split, keep}} = world) do
    # All streams of the next run begin after all messages.
    latest = world.times |> Map.values() |> Enum.max()
    times = Map.new(world.times, fn {name, _} -> {name, latest} end)
    %{world | run: start_run(world.root, split, keep), times: times}
  end

  # The messages of the segments that exist, by reading each as a store, in the order in which they were acknowledged.
  defp check(%{model: []}), do: true

  defp check(world) do
    kept =
      for path <- Store.Folder.list_versions("hall", world.root),
          store = Store.open!(path),
          %{name: name} <- Store.streams(store),
          message <- Store.messages(store, name),
          into: MapSet.new(),
          do: {name, message.originating_time}

    store = open(world.root)

    for name <- ["A", "B"] do
      wanted = for {^name, time} <- Enum.reverse(world.model), {name, time} in kept, do: time

      if wanted == [] do
        refute Store.has_stream?(store, name) and Store.count(store, name) > 0
      else
        assert store |> Store.messages(name) |> Enum.map(& &1.originating_time) == wanted
        assert Store.count(store, name) == length(wanted)
        middle = Enum.at(wanted, div(length(wanted), 2))
        assert {:ok, ordinal} = Store.ordinal(store, name, middle)
        assert ordinal == Enum.find_index(wanted, &(&1 == middle))
        assert {:ok, %{originating_time: ^middle}} = Store.latest_at(store, name, middle)
        {:ok, info} = Store.stream_info(store, name)
        {first, last} = {hd(wanted), List.last(wanted)}
        assert {info.first, info.last} == {first, last}
        {:ok, counts, _} = Store.Summary.read_tracks(store, info, first, last, 3, 10)
        {:ok, folded, _} = Fold.fold_tracks(store, info, first, last, 3, 10)
        assert counts == folded
      end
    end
  end
end
