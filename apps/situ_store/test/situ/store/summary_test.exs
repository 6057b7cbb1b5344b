defmodule Situ.Store.SummaryTest do
  use ExUnit.Case, async: true
  alias Situ.Store
  alias Situ.Store.Summary
  alias Situ.Store.Test.Record

  doctest Situ.Store.StreamInfo
  doctest Situ.Store.Summary

  @moduletag :tmp_dir

  defp store(root, values, opts \\ []),
    do: Store.open!(Record.store(root, [{"S", Record.messages(values), opts}]))

  defp read!(store, from, to, pixels, opts \\ []) do
    {:ok, summary} = Summary.read(store, "S", from, to, pixels, opts)
    summary
  end

  test "summarizes few states as changes and many as counts", %{tmp_dir: root} do
    states = for i <- 0..99, do: if(rem(div(i, 10), 2) == 0, do: :idle, else: :busy)
    store = store(root, states)
    assert %{tracks: [{nil, {:changes, changes}}]} = read!(store, 15_000, 45_000, 2)

    assert changes == [
             {15_000, :busy},
             {20_000, :idle},
             {30_000, :busy},
             {40_000, :idle}
           ]

    assert %{width: 16_384, tracks: [{nil, {:states, [first | _] = bins}}]} =
             read!(store, 0, 99_000, 5, changes: 3)

    assert first == {0, :busy, [{:idle, 10}, {:busy, 7}]}
    assert bins |> Enum.flat_map(&elem(&1, 2)) |> Enum.map(&elem(&1, 1)) |> Enum.sum() == 100
  end

  test "includes the state at the start of the interval, even if its message is earlier", %{
    tmp_dir: root
  } do
    store = store(root, ["a", "b", "b", "c"])
    assert %{tracks: [{nil, {:changes, changes}}]} = read!(store, 1_500, 9_000, 1)
    assert changes == [{1_000, "b"}, {3_000, "c"}]
  end

  test "maps have one track per key, of numbers or states", %{tmp_dir: root} do
    maps = for i <- 0..9, do: %{x: i, who: if(i < 5, do: "ann", else: :nobody), pose: [i]}
    store = store(root, maps)
    %{tracks: tracks, counts: counts} = read!(store, 0, 9_000, 1)
    assert Enum.sum(for {_, n} <- counts, do: n) == 10
    tracks = Map.new(tracks)
    assert Enum.sort(Map.keys(tracks)) == [:who, :x]
    assert {:changes, [{0, "ann"}, {5_000, :nobody}]} = tracks.who
    assert {:numbers, [{0, 0.0, 8.0, 8.0, 9}, {8_192, 9.0, 9.0, 9.0, 1}]} = tracks.x
  end

  test "values that are neither numbers nor states have counts only", %{tmp_dir: root} do
    store = store(root, for(i <- 1..50, do: {i, String.duplicate("long", 40)}))
    assert %{tracks: [], counts: counts} = read!(store, 0, 49_000, 4)
    assert Enum.sum(for {_, n} <- counts, do: n) == 50
  end

  test "returns an error for an unknown stream or option", %{tmp_dir: root} do
    store = store(root, [1])
    assert {:error, %{code: :no_stream}} = Summary.read(store, "T", 0, 1, 1)
    assert {:error, %{code: :unknown_option}} = Summary.read(store, "S", 0, 1, 1, chnages: 1)
  end
end
