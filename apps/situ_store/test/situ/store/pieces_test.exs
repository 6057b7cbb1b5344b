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
end
