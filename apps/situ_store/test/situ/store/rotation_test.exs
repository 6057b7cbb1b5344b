defmodule Situ.Store.RotationTest do
  use ExUnit.Case, async: true
  alias Situ.{Pipeline, Store}

  @moduletag :tmp_dir

  defp record(root, n, opts) do
    {:ok, _} =
      Pipeline.run(
        fn p ->
          store = Store.create(p, "hall", root, opts)
          numbers = Situ.from_enumerable(p, 0..(n - 1), every: 1_000)
          Store.write(numbers, store, "N")
          numbers |> Situ.map(&{&1, "text"}) |> Store.write(store, "Pairs")
        end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )

    Store.list(root, segments: true)
  end

  # The last segment may contain no messages of a stream that was ahead.
  defp numbers(path) do
    store = Store.open!(path)

    if Store.has_stream?(store, "N"),
      do: store |> Store.messages("N") |> Enum.map(& &1.data),
      else: []
  end

  test "splits a recording at multiples of the duration and loses nothing", %{tmp_dir: root} do
    pieces = record(root, 100, split: 30_000)
    assert Enum.map(pieces, &Path.basename/1) == ~w(hall.0000 hall.0001 hall.0002 hall.0003)
    assert Enum.flat_map(pieces, &numbers/1) == Enum.to_list(0..99)
    # A stream that is late by more than one segment continues in the oldest open segment.
    assert Enum.all?(numbers(hd(pieces)), &(&1 < 30))
    assert Enum.all?(pieces, &Store.closed?(Store.open!(&1)))
    {:ok, whole} = Store.concat(pieces, Path.join(root, "whole"))
    assert numbers(whole) == Enum.to_list(0..99)
    assert Store.count(Store.open!(whole), "Pairs") == 100
  end

  test "keeps only the latest segments", %{tmp_dir: root} do
    pieces = record(root, 100, split: 10_000, keep: {:span, 20_000})
    # The span counts before the newest segment, however short that one is.
    assert length(pieces) == 3
    assert latest(pieces) <= 70
    other = Path.join(root, "other")
    pieces = record(other, 100, split: 10_000, keep: {:bytes, 1})
    assert length(pieces) == 2
    assert latest(pieces) <= 80
  end

  # Checks that the numbers are complete up to the end and returns the first; late numbers are in a later segment.
  defp latest(pieces) do
    numbers = Enum.flat_map(pieces, &numbers/1)
    assert numbers == Enum.to_list(hd(numbers)..99)
    hd(numbers)
  end

  test "splits a recording at the given size and loses nothing", %{tmp_dir: root} do
    pieces = record(root, 20_000, split: {:bytes, 100_000})
    assert length(pieces) > 3

    # Both streams are complete and in order, and are split at about the same times.
    assert Enum.flat_map(pieces, &numbers/1) == Enum.to_list(0..19_999)
    {:ok, whole} = Store.concat(pieces, Path.join(root, "whole"))
    assert numbers(whole) == Enum.to_list(0..19_999)
    pairs = whole |> Store.open!() |> Store.messages("Pairs") |> Enum.map(& &1.data)
    assert pairs == for(i <- 0..19_999, do: {i, "text"})

    for path <- Enum.drop(pieces, -1),
        do:
          assert(
            path |> Store.open!() |> Store.streams() |> Enum.map(& &1.stored) |> Enum.sum() >=
              50_000
          )

    other = Path.join(root, "ring")
    pieces = record(other, 20_000, split: {:bytes, 100_000}, keep: {:span, 1_000_000})
    kept = Enum.flat_map(pieces, &numbers/1)
    assert List.last(kept) == 19_999 and kept == Enum.to_list(hd(kept)..19_999)
    assert hd(kept) > 0 and length(kept) >= 1_000
  end

  test "late messages go into the oldest open segment", %{tmp_dir: root} do
    {:ok, pieces} =
      Store.Rotation.start_link({"late", root, []}, Store.Rotation.SplitPoint.new(10), nil)

    assert {:ok, 5, _} = Store.Rotation.open_stream(pieces, 5, "S", [])
    assert {:ok, 6, _} = Store.Rotation.open_stream(pieces, 6, "S", [])
    assert {:ok, 7, seven} = Store.Rotation.open_stream(pieces, 7, "S", [])
    assert {:ok, 6, _} = Store.Rotation.open_stream(pieces, 3, "T", [])
    assert {:ok, 7, ^seven} = Store.Rotation.open_stream(pieces, 7, "S", [])
    :ok = Store.Rotation.close_all(pieces)
    assert [_, _, _] = Store.list(root, segments: true)
  end

  describe "a message stamped in the future" do
    @far 3 * 365 * 86_400_000_000_000

    defp record_with(root, times, opts) do
      {:ok, _} =
        Pipeline.run(
          fn p ->
            store = Store.create(p, "hall", root, opts)
            p |> Situ.from_enumerable(for(t <- times, do: {t, t})) |> Store.write(store, "N")

            # The first message is valid, and the second is far in the future.
            p |> Situ.from_enumerable([{1, 0}, {@far, 1}]) |> Store.write(store, "B")
          end,
          pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
        )

      root |> Store.list(segments: true) |> Enum.flat_map(&numbers/1) |> Enum.sort()
    end

    test "keeps the latest messages of other streams and is logged", %{tmp_dir: root} do
      times = Enum.map(0..299, &(&1 * 1_000))

      log =
        ExUnit.CaptureLog.capture_log(fn ->
          kept = record_with(root, times, split: 10_000, keep: {:span, 100_000})
          # At least the span before the newest segment is kept, with each message once.
          assert kept == Enum.take(times, -length(kept))
          assert length(kept) >= 100 and length(kept) < 300
        end)

      assert log =~ ~s(hall: "B" is) and log =~ ~s(ahead of "N")
    end

    test "keeps the latest messages of its stream", %{tmp_dir: root} do
      times = Enum.map(0..99, &(&1 * 1_000)) ++ [@far]
      kept = record_with(root, times, split: 10_000, keep: {:span, 50_000})
      assert kept == Enum.take(times, -length(kept)) and length(kept) >= 50
    end

    test "does not prevent a segment that is split by size from ending", %{tmp_dir: root} do
      cut = Store.Rotation.SplitPoint.new({:bytes, 100_000})
      opts = [first_extent: 65_536, max_extent: 65_536]
      {:ok, pieces} = Store.Rotation.start_link({"big", root, opts}, cut, nil)
      message = &%Situ.Message{data: &2, originating_time: &1, creation_time: &1, sequence_id: &1}

      append = fn name, time, data ->
        number = Store.Rotation.SplitPoint.segment_number(cut, time)
        {:ok, real, stream} = Store.Rotation.open_stream(pieces, number, name, [])
        {:ok, _} = Store.Writer.append(stream, [message.(time, data)])
        :ok = Store.Rotation.report_append(pieces, cut, real, time)
        # The cast is handled before this call.
        {:ok, _, _} = Store.Rotation.open_stream(pieces, number, name, [])
      end

      append.("B", @far, "far ahead")
      for i <- 1..200, do: append.("N", i, :crypto.strong_rand_bytes(5_000))
      :ok = Store.Rotation.close_all(pieces)
      found = Store.list(root, segments: true)
      assert length(found) in 7..12
      assert Enum.flat_map(found, &times(&1, "N")) == Enum.to_list(1..200)
      for path <- found, do: assert(path |> Store.open!() |> Store.count("N") |> Kernel.<(40))
    end

    defp times(path, name) do
      store = Store.open!(path)
      store |> Store.messages(name) |> Enum.map(& &1.originating_time)
    end
  end

  describe "after a restart" do
    test "segments of earlier runs count toward `keep:` and are deleted", %{tmp_dir: root} do
      {:ok, other} = Store.Writer.create("hall", root)
      :ok = Store.Writer.close(other)

      for run <- 1..4 do
        bytes = [split: {:bytes, 100_000}, keep: {:bytes, 250_000}, max_extent: 100_000]
        pieces = record(root, 10_000 + run, [first_extent: 65_536] ++ bytes) -- [other.path]
        size = pieces |> Enum.map(&Store.Folder.total_size/1) |> Enum.sum()
        assert size < 250_000 + 100_000, "run #{run}: #{size} bytes"
        # The last segment may hold only the other stream.
        newest = pieces |> Enum.map(&numbers/1) |> Enum.reject(&(&1 == [])) |> List.last()
        assert List.last(newest) == 9_999 + run
      end

      # A recording with the same name that is not a segment belongs to somebody else.
      assert File.dir?(other.path)
    end

    test "short runs do not delete the recording of a long run", %{tmp_dir: root} do
      keep = [split: 10_000, keep: {:span, 50_000}]
      long = record(root, 100, keep)
      # Each run starts a segment and ends before it is complete.
      for _ <- 1..10, do: record(root, 3, keep)
      assert Enum.drop(long, 2) -- Store.list(root, segments: true) == []
      # Another long run replaces it.
      record(root, 100, keep)
      assert Enum.filter(long, &File.exists?/1) == []
      assert length(Store.list(root, segments: true)) < 12
    end
  end
end
