defmodule Situ.Store.PiecesTest do
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

    Store.list(root)
  end

  # Of a stream that was ahead there may be none in the last piece.
  defp numbers(path) do
    store = Store.open!(path)

    if Store.has_stream?(store, "N"),
      do: store |> Store.messages("N") |> Enum.map(& &1.data),
      else: []
  end

  test "a recording is cut at multiples of the time asked for, and nothing is lost", %{
    tmp_dir: root
  } do
    pieces = record(root, 100, split: 30_000)
    assert Enum.map(pieces, &Path.basename/1) == ~w(hall.0000 hall.0001 hall.0002 hall.0003)
    assert Enum.flat_map(pieces, &numbers/1) == Enum.to_list(0..99)
    # A stream that is late by more than a piece goes on in the oldest that is open.
    assert Enum.all?(numbers(hd(pieces)), &(&1 < 30))
    assert Enum.all?(pieces, &Store.closed?(Store.open!(&1)))
    {:ok, whole} = Store.concat(pieces, Path.join(root, "whole"))
    assert numbers(whole) == Enum.to_list(0..99)
    assert Store.count(Store.open!(whole), "Pairs") == 100
  end

  test "of a ring the latest pieces stay", %{tmp_dir: root} do
    pieces = record(root, 100, split: 10_000, keep: {:span, 20_000})
    # So much before the newest piece, however short that one is.
    assert length(pieces) == 3
    assert latest(pieces) <= 70
    other = Path.join(root, "other")
    pieces = record(other, 100, split: 10_000, keep: {:bytes, 1})
    assert length(pieces) == 2
    assert latest(pieces) <= 80
  end

  # All that is there is there up to the end: from where on? Numbers that came late lie in a piece after their own.
  defp latest(pieces) do
    numbers = Enum.flat_map(pieces, &numbers/1)
    assert numbers == Enum.to_list(hd(numbers)..99)
    hd(numbers)
  end

  test "a recording is cut where a piece has got so many bytes, and nothing is lost", %{
    tmp_dir: root
  } do
    pieces = record(root, 20_000, split: {:bytes, 100_000})
    assert length(pieces) > 3

    # Two streams: each of its own is whole and in order, and they are cut at about the same places.
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

  test "what is late goes into the oldest piece that is open", %{tmp_dir: root} do
    {:ok, pieces} = Store.Pieces.start_link({"late", root, []}, Store.Pieces.Cut.new(10), nil)
    assert {:ok, 5, _} = Store.Pieces.stream(pieces, 5, "S", [])
    assert {:ok, 6, _} = Store.Pieces.stream(pieces, 6, "S", [])
    assert {:ok, 7, seven} = Store.Pieces.stream(pieces, 7, "S", [])
    assert {:ok, 6, _} = Store.Pieces.stream(pieces, 3, "T", [])
    assert {:ok, 7, ^seven} = Store.Pieces.stream(pieces, 7, "S", [])
    :ok = Store.Pieces.close(pieces)
    assert [_, _, _] = Store.list(root)
  end

  describe "a message stamped in the future" do
    @far 3 * 365 * 86_400_000_000_000

    defp record_with(root, times, opts) do
      {:ok, _} =
        Pipeline.run(
          fn p ->
            store = Store.create(p, "hall", root, opts)
            p |> Situ.from_enumerable(for(t <- times, do: {t, t})) |> Store.write(store, "N")

            # One sound message, and one that is not.
            p |> Situ.from_enumerable([{1, 0}, {@far, 1}]) |> Store.write(store, "B")
          end,
          pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
        )

      root |> Store.list() |> Enum.flat_map(&numbers/1) |> Enum.sort()
    end

    test "deletes nothing of the others, and is reported", %{tmp_dir: root} do
      times = Enum.map(0..299, &(&1 * 1_000))

      log =
        ExUnit.CaptureLog.capture_log(fn ->
          kept = record_with(root, times, split: 10_000, keep: {:span, 100_000})
          # So much before the newest piece, each message once.
          assert kept == Enum.take(times, -length(kept))
          assert length(kept) >= 100 and length(kept) < 300
        end)

      assert log =~ ~s(hall: "B" is) and log =~ ~s(ahead of "N")
    end

    test "of the only stream, too", %{tmp_dir: root} do
      times = Enum.map(0..99, &(&1 * 1_000)) ++ [@far]
      kept = record_with(root, times, split: 10_000, keep: {:span, 50_000})
      assert kept == Enum.take(times, -length(kept)) and length(kept) >= 50
    end

    test "does not keep a piece that is cut by size from ending", %{tmp_dir: root} do
      cut = Store.Pieces.Cut.new({:bytes, 100_000})
      opts = [first_extent: 65_536, max_extent: 65_536]
      {:ok, pieces} = Store.Pieces.start_link({"big", root, opts}, cut, nil)
      message = &%Situ.Message{data: &2, originating_time: &1, creation_time: &1, sequence_id: &1}

      append = fn name, time, data ->
        number = Store.Pieces.Cut.number(cut, time)
        {:ok, real, stream} = Store.Pieces.stream(pieces, number, name, [])
        {:ok, _} = Store.Writer.append(stream, [message.(time, data)])
        :ok = Store.Pieces.appended(pieces, cut, real, time)
        # The cast is done before the call.
        {:ok, _, _} = Store.Pieces.stream(pieces, number, name, [])
      end

      append.("B", @far, "far ahead")
      for i <- 1..200, do: append.("N", i, :crypto.strong_rand_bytes(5_000))
      :ok = Store.Pieces.close(pieces)
      found = Store.list(root)
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
    test "what earlier runs left counts for `keep:`, and is deleted", %{tmp_dir: root} do
      {:ok, other} = Store.Writer.create("hall", root)
      :ok = Store.Writer.close(other)

      for run <- 1..4 do
        bytes = [split: {:bytes, 100_000}, keep: {:bytes, 250_000}, max_extent: 100_000]
        pieces = record(root, 10_000 + run, [first_extent: 65_536] ++ bytes) -- [other.path]
        size = pieces |> Enum.map(&Store.Folder.size/1) |> Enum.sum()
        assert size < 250_000 + 100_000, "run #{run}: #{size} bytes"
        assert List.last(numbers(List.last(pieces))) == 9_999 + run
      end

      # A recording of that name that is no piece is somebody's.
      assert File.dir?(other.path)
    end

    test "short runs do not delete what a long one has recorded", %{tmp_dir: root} do
      keep = [split: 10_000, keep: {:span, 50_000}]
      long = record(root, 100, keep)
      # Each begins a piece, and ends before it is whole.
      for _ <- 1..10, do: record(root, 3, keep)
      assert Enum.drop(long, 2) -- Store.list(root) == []
      # Another long one takes its place.
      record(root, 100, keep)
      assert Enum.filter(long, &File.exists?/1) == []
      assert length(Store.list(root)) < 12
    end
  end
end
