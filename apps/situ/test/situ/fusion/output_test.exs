defmodule Situ.Fusion.OutputTest do
  # The next input (here: zip) checks outputs against their declared type.
  use ExUnit.Case, async: true

  alias Situ.Reproducible

  @moduletag :capture_log

  defp zipped(build, late \\ [x: [{50, 1}], y: [{50, 2}]]) do
    inputs = [a: [{1, :a1}, {50, :a50}], c: [{1, :c}]] ++ late

    with {:ok, groups} <-
           Situ.Test.run(inputs, fn s ->
             pair = Situ.join(s.x, s.y)
             Situ.zip(build.(s.a, pair), s.c)
           end),
         do: for({1, [value, :c]} <- groups, do: value)
  end

  @none Reproducible.nearest(3, or_default: :none)

  test "a default matches the output type in every form" do
    assert zipped(&Situ.join(&1, &2, @none, flatten: false)) == [{:a1, :none}]
    assert zipped(&Situ.join(&1, &2, @none)) == [{:a1, :none, :none}]
    assert zipped(&Situ.join(&1, [&2, &2], @none)) == [{:a1, [:none, :none]}]
    assert zipped(&Situ.join([&1, &2], @none)) == [[:a1, :none]]
    assert zipped(&Situ.join(&1, %{k: &2}, @none)) == [{:a1, %{k: :none}}]

    assert zipped(&Situ.join(&1, &2, Reproducible.nearest(3, or_default: nil))) == [
             {:a1, nil, nil}
           ]

    for {default, wanted} <- [{{1, 2}, {:a1, 1, 2}}, {{1}, {:a1, 1}}, {{nil, :x}, {:a1, nil, :x}}] do
      assert zipped(&Situ.join(&1, &2, Reproducible.nearest(3, or_default: default))) == [wanted]
    end

    assert zipped(&Situ.sample(&2, &1, @none)) == [:none]
  end

  test "values computed by an interpolator may have any shape" do
    three = Reproducible.adjacent(&{&1, &2, &3})
    inputs = [a: [{25, :a}], x: [{0, 1}, {50, 2}], c: [{25, :c}]]

    assert {:ok, [{25, [{:a, {{1, 1}, {2, 2}, 0.5}}, :c]}]} =
             Situ.Test.run(inputs, fn s ->
               s.a |> Situ.join(Situ.join(s.x, s.x), three) |> Situ.zip(s.c)
             end)
  end

  test "the initial value of pair may have any shape" do
    for {opts, wanted} <- [
          {[initial: :nothing, flatten: false], {:a1, :nothing}},
          {[initial: :nothing], {:a1, :nothing, :nothing}},
          {[initial: {0, 0}], {:a1, 0, 0}}
        ] do
      # A pair uses the latest message, and a message at 50 might arrive before the one at 1.
      assert zipped(&Situ.pair(&1, &2, opts), x: [], y: []) == [wanted]
    end
  end

  test "the output of parallel may contain a default" do
    inputs = [l: [{1, [1, 2]}], c: [{1, :c}]]

    assert {:ok, [{1, [[:none, :none], :c]}]} =
             Situ.Test.run(inputs, fn s ->
               s.l
               |> Situ.Stream.with_type({:list, :integer})
               |> Situ.parallel(&Situ.filter(&1, fn n -> n > 5 end), or_default: :none, size: 2)
               |> Situ.zip(s.c)
             end)
  end
end
