defmodule Situ.Bridge.DatagramTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Bridge.Datagram
  doctest Datagram

  property "reassembles a payload from chunks in any order and with duplicates" do
    forall {payload, most, seed} <- {binary(), integer(41, 60), integer()} do
      chunks = Datagram.split_payload(payload, 3, most)
      assert Enum.all?(chunks, &(byte_size(&1) <= most))
      :rand.seed(:exsss, seed)
      {got, state} = receive_all(Enum.shuffle(chunks ++ chunks))
      assert got == [payload]
      assert {state.started, state.abandoned} == {1, 0}
    end
  end

  test "transmits payloads whose size is at the limit of a datagram" do
    for size <- [65_493, 65_494, 65_495, 65_500, 65_533, 65_534, 130_988, 131_067] do
      payload = :binary.copy("x", size)
      assert {[^payload], _} = receive_all(Datagram.split_payload(payload, 1))
    end
  end

  test "abandons incomplete sets and keeps only a few" do
    {[], state} = receive_all(for set <- 1..100, do: hd(Datagram.split_payload("abc", set, 41)))
    assert {state.started, state.abandoned, map_size(state.sets)} == {100, 84, 16}
  end

  property "ignores noise" do
    forall bytes <- binary() do
      {payload, state} = Datagram.push(Datagram.new(), bytes)
      assert payload == nil or state.received == 1
    end
  end

  defp receive_all(chunks) do
    Enum.reduce(chunks, {[], Datagram.new()}, fn chunk, {got, state} ->
      {payload, state} = Datagram.push(state, chunk)
      {if(payload, do: got ++ [payload], else: got), state}
    end)
  end

  test "abandons a set when a chunk of another one arrives and there is room for one" do
    sets = for set <- 1..2, do: Datagram.split_payload(:binary.copy("x", 30), set, 50)
    interleaved = sets |> Enum.zip() |> Enum.flat_map(&Tuple.to_list/1)

    {got, state} =
      Enum.map_reduce(interleaved, Datagram.new(open: 1), fn chunk, state ->
        Datagram.push(state, chunk)
      end)
      |> then(fn {got, state} -> {Enum.reject(got, &is_nil/1), state} end)

    assert {got, state.started, state.abandoned} == {[], 6, 5}
  end
end
