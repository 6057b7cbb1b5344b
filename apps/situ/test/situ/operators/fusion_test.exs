defmodule Situ.Operators.FusionTest do
  # Options, waiting and memory of joins.
  use ExUnit.Case, async: true

  alias Situ.{Available, Interval, Message, Reproducible}

  @moduletag :capture_log

  defp run(inputs, build, opts \\ []) do
    {:ok, outputs} = Situ.Test.run(inputs, build, opts)
    outputs
  end

  defp messages(timed),
    do: for({t, v} <- timed, do: %Message{originating_time: t, sequence_id: t, data: v})

  describe "join/4" do
    test "flattens both sides according to their types, except with flatten: false" do
      inputs = [a: [{0, 1}], b: [{0, 2}], c: [{0, 3}], d: [{0, 4}]]

      build = fn s ->
        left = Situ.join(s.a, s.b)
        right = Situ.join(s.c, s.d)
        [Situ.join(left, right), Situ.join(left, right, flatten: false, name: "Nested")]
      end

      assert run(inputs, build) == [[{0, {1, 2, 3, 4}}], [{0, {{1, 2}, {3, 4}}}]]
    end

    test "a default of a different type than the stream keeps the output type valid" do
      inputs = [a: [{0, 1}, {10, 2}], b: [{10, 3}]]

      build = fn s ->
        listed = Situ.map(s.b, &[&1], type: {:list, :integer})
        s.a |> Situ.join(listed, Reproducible.exact(or_default: 0)) |> Situ.zip(s.b)
      end

      assert run(inputs, build) == [{0, [{1, 0}]}, {10, [{2, [3]}, 3]}]

      build = fn s ->
        tupled = Situ.map(s.b, &{&1, "x"}, type: {:tuple, [:integer, :string]})
        s.a |> Situ.join(tupled, Reproducible.exact(or_default: nil)) |> Situ.zip(s.b)
      end

      assert run(inputs, build) == [{0, [{1, nil, nil}]}, {10, [{2, 3, "x"}, 3]}]
    end

    test "linear interpolation between integers returns a float" do
      inputs = [a: [{5, 1}, {7, 1}], b: [{0, 1}, {10, 2}]]

      build = fn s ->
        b = Situ.map(s.b, & &1, type: :integer)
        s.a |> Situ.join(b, Reproducible.linear()) |> Situ.zip(s.b)
      end

      assert run(inputs, build) |> Enum.at(1) == {5, [{1, 1.5}]}
    end

    test "keeps data tuples as they are" do
      inputs = [point: [{0, {3, 4}}], name: [{0, "p"}]]
      assert run(inputs, &Situ.join(&1.point, &1.name)) == [{0, {{3, 4}, "p"}}]
    end

    test "accepts one interpolator per secondary" do
      inputs = [a: [{10, :a}], b: [{8, :b}], c: [{10, :c}]]

      build = fn s ->
        Situ.join(s.a, [s.b, s.c], [Reproducible.nearest(3), Reproducible.exact()])
      end

      assert run(inputs, build) == [{10, {:a, [:b, :c]}}]
    end

    test "refuses irreproducible interpolators, negative tolerances and inverted windows" do
      Situ.Pipeline.run(fn p ->
        [a, b] = [Situ.return(p, 1), Situ.return(p, 2)]
        error = assert_raise Situ.Error, fn -> Situ.join(a, b, Available.last()) end
        assert error.code == :not_reproducible
        assert_raise ArgumentError, ~r/tolerance/, fn -> Situ.join(a, b, -5) end
        window = Interval.closed(5, -5)
        assert_raise ArgumentError, ~r/ends before it begins/, fn -> Situ.join(a, b, window) end
        assert_raise ArgumentError, ~r/no streams/, fn -> Situ.join([]) end
        assert_raise ArgumentError, fn -> Situ.join(a, b, :nearest) end
        assert_raise Situ.Error, ~r/unknown option/, fn -> Situ.join(a, b, 5, tolerence: 3) end
      end)
    end

    test "a lossy policy drops messages before the join, and the rest is joined exactly" do
      inputs = [a: Enum.map(0..99, &{&1, &1}), b: Enum.map(0..99, &{&1, &1})]

      build =
        &Situ.join(&1.a, &1.b, [], policy: [Situ.Delivery.latest(), Situ.Delivery.unlimited()])

      outputs = run(inputs, build)
      assert List.last(outputs) == {99, {99, 99}}
      assert Enum.all?(outputs, fn {t, pair} -> pair == {t, t} end)
    end
  end

  defp core(interpolator, opts \\ []) do
    members = [{:s0, 0, interpolator, []}]
    Situ.Fusion.Core.new(&{&1, &2}, [members: members, values: :one] ++ opts)
  end

  describe "give_up_after:" do
    test "decides and counts a primary that waited too long" do
      core = core(Reproducible.exact(), give_up_after: 10)
      {[], core} = Situ.Fusion.Core.push_primary(core, messages([{0, :a}, {5, :b}]))
      {[], core} = Situ.Fusion.Core.push_primary(core, messages([{12, :c}]))
      assert %{primary: 2} = Situ.Fusion.Core.queue_lengths(core)
      assert core.given_up == 1
      {outputs, _} = Situ.Fusion.Core.push_secondary(core, :s0, messages([{5, :x}, {12, :y}]))
      assert outputs == [{:out, 5, {:b, :x}}, {:out, 12, {:c, :y}}]
    end
  end

  describe "max_queue:" do
    test "bounds both sides by deciding the oldest primary and dropping the oldest secondary message" do
      core = core(Reproducible.exact(or_default: :none), max_queue: 3)
      {[], core} = Situ.Fusion.Core.push_primary(core, messages(for(t <- 1..3, do: {t, t})))
      {outputs, core} = Situ.Fusion.Core.push_primary(core, messages([{4, 4}, {5, 5}]))
      assert outputs == [{:out, 1, {1, :none}}, {:out, 2, {2, :none}}]
      {outputs, core} = Situ.Fusion.Core.push_secondary(core, :s0, messages([{5, :x}]))
      assert List.last(outputs) == {:out, 5, {5, :x}}

      {[], core} =
        Situ.Fusion.Core.push_secondary(core, :s0, messages(for(t <- 6..12, do: {t, t})))

      assert Situ.Fusion.Core.queue_lengths(core) == %{primary: 0, secondary: [{0, 3}]}
      assert core.dropped == 5
      {outputs, _} = Situ.Fusion.Core.push_primary(core, messages([{9, 9}, {11, 11}]))
      assert outputs == [{:out, 9, {9, :none}}, {:out, 11, {11, 11}}]
    end
  end

  describe "nearest" do
    test "is decided by the first message after which none can be nearer" do
      nearest = Reproducible.nearest(5)
      ask = &Situ.Interpolator.interpolate(nearest, 40, messages(&1), nil)
      assert ask.([{22, :a}]) == {:wait, 40}
      assert ask.([{22, :a}, {44, :b}]) == {:created, :b, 44}
      assert ask.([{22, :a}, {36, :b}]) == {:wait, 40}
    end
  end

  describe "memory" do
    test "fusion keeps only messages that later primaries may need" do
      core = core(Reproducible.nearest())

      core =
        Enum.reduce(1..1_000, core, fn n, core ->
          {_, core} = Situ.Fusion.Core.push_secondary(core, :s0, messages([{n * 10, n}]))
          {_, core} = Situ.Fusion.Core.push_primary(core, messages([{n * 10, n}]))
          core
        end)

      assert %{primary: 0, secondary: [{0, kept}]} = Situ.Fusion.Core.queue_lengths(core)
      assert kept <= 2
    end

    test "a diamond whose paths differ by many messages does not deadlock" do
      build = fn p ->
        numbers = Situ.from_enumerable(p, 0..39_999, every: 1_000)
        rare = Situ.filter(numbers, &(rem(&1, 20_000) == 19_999), async: true)
        numbers |> Situ.join(rare, Reproducible.nearest()) |> Situ.count() |> Situ.last()
      end

      assert Situ.to_list(build) == [40_000]
    end

    test "ended branches leave no state even if keys never repeat" do
      core =
        Situ.Parallel.Branches.new(
          strategy: Situ.Parallel.Values,
          running:
            Situ.Parallel.Values.build_state(
              %{fun: &Situ.window(&1, 0..1), type: :any},
              %Situ.Component.Context{path: "P"}
            ),
          form: :sparse,
          termination: Situ.Parallel.Termination.parse_rule(:absent),
          missing: :drop,
          creator: & &1
        )

      core =
        Enum.reduce(1..2_000, core, fn n, core ->
          message = %Message{originating_time: n, data: nil}
          {_outputs, core} = Situ.Parallel.Branches.push_message(core, message, %{n => n})
          core
        end)

      assert map_size(core.branches) == 1
      assert Situ.Parallel.PendingOutputs.waiting_count(core.pending) <= 1
      assert core.started == 2_000
    end
  end
end
