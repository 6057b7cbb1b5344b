defmodule Situ.Component.FunctionSwapTest do
  use ExUnit.Case, async: true
  doctest Situ.Component.FunctionSwap

  alias Situ.Component.FunctionSwap

  test "finds functions by their position in nested options" do
    old = [fun: &String.upcase/1, more: %{at: {1, [(&String.trim/1) | &String.length/1]}}]
    new = [fun: &String.downcase/1, more: %{at: {2, [(&String.reverse/1) | &byte_size/1]}}]
    pairs = FunctionSwap.pair_functions(old, new)
    assert map_size(pairs) == 3

    state = %{queue: :queue.from_list([{1, &String.trim/1}]), n: 7, seen: MapSet.new([1])}
    renewed = FunctionSwap.replace_functions(state, pairs)
    assert :queue.to_list(renewed.queue) == [{1, &String.reverse/1}]
    assert {renewed.n, renewed.seen} == {7, MapSet.new([1])}
  end

  test "finds nothing if the options have a different shape" do
    assert FunctionSwap.pair_functions([fun: &String.upcase/1], []) == %{}
    assert FunctionSwap.pair_functions([a: &String.upcase/1, b: 1], [{:a, nil}]) == %{}
  end
end
