defmodule Situ.Fusion.InputsTest do
  # Adds and removes inputs of a fusion while it runs.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{Error, Fusion, Reproducible, Test}

  @moduletag :capture_log
  # The clock is later than every message, so nothing is held back.
  @later [start: 1_000_000]

  defp gathering(opts \\ []) do
    {interpolator, opts} = Keyword.pop(opts, :interpolator, Reproducible.exact())

    start([:p, :a, :b], fn s ->
      %{out: Situ.join(s.p, %{a: s.a}, interpolator, opts), b: s.b}
    end)
  end

  # Starts the pipeline and returns the values of its build function as handles.
  defp start(inputs, build) do
    me = self()

    test =
      Test.start(
        inputs,
        fn streams ->
          outputs = build.(streams)
          send(me, {:handles, outputs})
          outputs
        end,
        @later
      )

    assert_received {:handles, handles}
    {test, handles}
  end

  defp out(test), do: Test.outputs(test).out

  describe "join/4 over a map" do
    test "emits maps of values, and empty maps without inputs" do
      inputs = [p: [{0, 1}, {10, 2}], a: [{0, :x}, {10, :y}], b: [{10, :z}]]

      assert {:ok, [[{10, {2, %{a: :y, b: :z}}}], [{0, {1, %{}}}, {10, {2, %{}}}]]} =
               Test.run(inputs, fn s ->
                 [Situ.join(s.p, %{a: s.a, b: s.b}), Situ.join(s.p, %{}, [], name: "Alone")]
               end)
    end

    test "accepts with:, a tolerance and or_default" do
      inputs = [p: [{0, 1}, {10, 2}], a: [{1, :x}], b: [{11, :z}]]

      build = fn s ->
        nearest = Reproducible.nearest(3, or_default: :none)
        Situ.fuse(s.p, %{a: s.a, b: s.b}, nearest, with: fn p, m -> {p, m.a, m.b} end)
      end

      assert Test.run(inputs, build) == {:ok, [{0, {1, :x, :none}}, {10, {2, :none, :z}}]}
    end

    test "omits an ended input with ended: :leave, and drops unmatched primaries by default" do
      inputs = [p: Enum.map(0..3, &{&1 * 10, &1}), a: [{0, :x}, {10, :y}]]
      joined = [{0, {0, %{a: :x}}}, {10, {1, %{a: :y}}}]
      assert Test.run(inputs, &Situ.join(&1.p, %{a: &1.a})) == {:ok, joined}

      assert Test.run(inputs, &Situ.join(&1.p, %{a: &1.a}, [], ended: :leave)) ==
               {:ok, joined ++ [{20, {2, %{}}}, {30, {3, %{}}}]}
    end
  end

  describe "add_input/4" do
    test "the input takes part after the last primary that has arrived" do
      {test, s} = gathering()
      Test.feed(test, :p, [{1, 1}, {2, 2}])
      Test.feed(test, :a, [{1, :x}])
      assert {:ok, 3} = Situ.add_input(s.out, :b, s.b)
      Test.feed(test, :a, [{2, :x}, {3, :x}, {4, :x}])
      Test.feed(test, :p, [{3, 3}, {4, 4}])
      assert out(test) == [{1, {1, %{a: :x}}}, {2, {2, %{a: :x}}}]
      Test.feed(test, :b, [{2, :y}, {3, :y}, {4, :z}])
      assert out(test) == [{3, {3, %{a: :x, b: :y}}}, {4, {4, %{a: :x, b: :z}}}]
      assert {:ok, _} = Test.stop(test)
    end

    test "the input takes part after the last message it has missed" do
      {test, s} = gathering()
      Test.feed(test, :b, [{5, :early}])
      Test.feed(test, :p, [{1, 1}])
      assert {:ok, 6} = Situ.add_input(s.out, :b, s.b)
      Test.feed(test, :a, Enum.map(1..7, &{&1, :x}))
      Test.feed(test, :p, [{5, 5}, {6, 6}])
      Test.feed(test, :b, [{6, :y}])
      assert List.last(out(test)) == {6, {6, %{a: :x, b: :y}}}
      Test.stop(test)
    end

    test "returns :start before any message, and accepts a later time" do
      {test, s} = gathering()
      assert {:ok, :start} = Situ.add_input(s.out, "b", s.b)
      assert {:ok, :start} = Situ.remove_input(s.out, "b")
      assert {:ok, 30} = Situ.add_input(s.out, "b", s.b, from: 30)
      assert {:ok, :start} = Situ.remove_input(s.out, "b")
      assert {:ok, 20} = Situ.add_input({test.pipeline, "Join"}, "b", s.b.name, from: 20)
      Test.feed(test, :a, [{10, :x}, {20, :x}])
      Test.feed(test, :p, [{10, 1}, {20, 2}])
      assert out(test) == [{10, {1, %{a: :x}}}]
      Test.feed(test, :b, [{20, :y}])
      assert out(test) == [{20, {2, %{:a => :x, "b" => :y}}}]
      Test.stop(test)
    end

    test "refuses invalid inputs with a reason" do
      {test, s} = gathering()
      Test.feed(test, :p, [{7, 1}])

      assert {:error, %Error{code: :too_late, meta: %{earliest: 8}}} =
               Situ.add_input(s.out, :b, s.b, from: 7)

      assert {:error, %Error{code: :duplicate_input}} = Situ.add_input(s.out, :a, s.b)
      available = [interpolator: Situ.Available.last()]
      assert {:error, %Error{code: :not_reproducible}} = Situ.add_input(s.out, :b, s.b, available)
      assert {:error, %Error{code: :circle}} = Situ.add_input(s.out, :b, s.out)
      assert {:error, %Error{code: :unknown_stream}} = Situ.add_input(s.out, :b, "Inptu :b")
      assert {:error, %Error{code: :fixed_inputs}} = Situ.add_input(s.b, :x, s.out)
      assert {:error, %Error{code: :unknown_option}} = Situ.add_input(s.out, :b, s.b, form: 9)
      assert {:error, %Error{code: :unknown_input}} = Situ.remove_input(s.out, :b)

      # A refused input has no effect: its stream continues and the graph is unchanged.
      Test.feed(test, :b, [{1, :y}])
      assert %{b: [{1, :y}]} = Test.outputs(test)
      assert [_, _, _, _] = Situ.Pipeline.info(test.pipeline).edges
      Test.stop(test)
      assert {:error, %Error{code: :not_running}} = Situ.add_input(s.out, :b, s.b)
    end

    test "a stream inside a chain has no output to connect to" do
      {test, s} =
        start([:p, :b], fn s ->
          b = s.b |> Situ.map(& &1, name: "Middle") |> Situ.map(& &1)
          %{out: Situ.join(s.p, %{}), end: b}
        end)

      assert {:error, %Error{code: :inside_chain}} = Situ.add_input(s.out, :b, "Middle")
      assert {:ok, :start} = Situ.add_input(s.out, :b, s.end)
      Test.stop(test)
    end

    test "an input whose stream has ended counts as ended" do
      {test, s} = gathering(ended: :leave)
      Test.feed(test, :b, [{1, :y}])
      Test.close(test, :b)
      assert {:ok, 2} = Situ.add_input(s.out, :b, s.b)
      Test.feed(test, :a, [{1, :x}, {2, :x}])
      Test.feed(test, :p, [{1, 1}, {2, 2}])
      assert out(test) == [{1, {1, %{a: :x}}}, {2, {2, %{a: :x}}}]
      assert {:ok, _} = Test.stop(test)
    end

    test "the input is restored when the fusion is restarted" do
      boom = fn p, m -> if p == :boom, do: raise("boom"), else: {p, m} end
      {test, s} = gathering(on_error: :restart, with: boom)
      assert {:ok, 5} = Situ.add_input(s.out, :b, s.b, from: 5)
      assert {:ok, 8} = Situ.remove_input(s.out, :a, until: 8)
      Test.feed(test, :a, Enum.map(5..9, &{&1, :x}))
      Test.feed(test, :b, [{5, :y}, {6, :y}])
      Test.feed(test, :p, [{5, :boom}])
      Test.feed(test, :a, [{16, :x}])
      Test.feed(test, :p, [{16, 1}])
      Test.feed(test, :b, [{16, :z}])
      assert out(test) == [{16, {1, %{b: :z}}}]
      Test.stop(test)
    end

    test "the input is restored when the fusion's process is killed and restarted" do
      {test, s} = gathering(on_error: :restart)
      assert {:ok, 5} = Situ.add_input(s.out, :b, s.b, from: 5)
      assert {:ok, 8} = Situ.remove_input(s.out, :a, until: 8)
      {:links, links} = Process.info(test.pipeline, :links)

      [fusion] =
        for pid <- links,
            is_pid(pid),
            match?(
              %Situ.Stage.State{steps: {%{worker: %{module: Fusion.FuseComponent}}}},
              :sys.get_state(pid)
            ),
            do: pid

      monitor = Process.monitor(fusion)
      Process.exit(fusion, :kill)
      assert_receive {:DOWN, ^monitor, :process, _, :killed}
      Test.settle(test)
      Test.feed(test, :a, [{5, :x}, {10, :x}])
      Test.feed(test, :b, [{5, :y}, {10, :z}])
      Test.feed(test, :p, [{5, 5}, {10, 10}])
      assert out(test) == [{5, {5, %{a: :x, b: :y}}}, {10, {10, %{b: :z}}}]
      assert {:ok, _} = Test.stop(test)
    end

    test "the input is shown in the graph with its counters" do
      {test, s} = gathering()
      {:ok, _} = Situ.add_input(s.out, :b, s.b)
      Test.feed(test, :b, [{1, :y}, {2, :y}])
      info = Situ.Pipeline.info(test.pipeline)
      join = Enum.find(info.nodes, &(&1.path == "Join"))
      assert Enum.map(join.inputs, & &1.name) == ["primary", "s0", "s1"]
      assert %{emitted: 2} = Enum.find(info.edges, &(&1.to == join.id and &1.to_input == "s1"))
      assert {:ok, _} = Situ.remove_input(s.out, :b)
      Test.settle(test)
      join = Enum.find(Situ.Pipeline.info(test.pipeline).nodes, &(&1.path == "Join"))
      assert Enum.map(join.inputs, & &1.name) == ["primary", "s0"]
      Test.stop(test)
    end
  end

  describe "remove_input/3" do
    test "arrived primaries still wait for the input, later ones do not, and the connection is removed" do
      {test, s} = gathering()
      Test.feed(test, :p, [{1, 1}, {2, 2}])
      assert {:ok, 3} = Situ.remove_input(s.out, :a)
      Test.feed(test, :p, [{3, 3}])
      assert out(test) == []
      Test.feed(test, :a, [{1, :x}, {2, :y}])
      assert out(test) == [{1, {1, %{a: :x}}}, {2, {2, %{a: :y}}}, {3, {3, %{}}}]
      # Nothing holds the stream back now.
      Test.feed(test, :a, Enum.map(3..5_000, &{&1, :more}))
      Test.feed(test, :p, [{4, 4}])
      assert out(test) == [{4, {4, %{}}}]
      assert {:ok, _} = Test.stop(test)
    end

    test "the key can be reused immediately, from the time at which the removed input ends" do
      {test, s} = gathering()
      Test.feed(test, :p, [{1, 1}])
      assert {:ok, 5} = Situ.remove_input(s.out, :a, until: 5)

      assert {:error, %Error{code: :too_late, meta: %{earliest: 5}}} =
               Situ.add_input(s.out, :a, s.b, from: 4)

      assert {:ok, 5} = Situ.add_input(s.out, :a, s.b)
      Test.feed(test, :a, [{1, :old}, {4, :old}, {5, :old}])
      Test.feed(test, :b, [{1, :new}, {4, :new}, {5, :new}])
      Test.feed(test, :p, [{4, 4}, {5, 5}])
      assert out(test) == [{1, {1, %{a: :old}}}, {4, {4, %{a: :old}}}, {5, {5, %{a: :new}}}]
      Test.stop(test)
    end

    test "names are reused, so the number of atoms does not grow" do
      {test, s} = gathering()

      for n <- 1..50 do
        assert {:ok, _} = Situ.add_input(s.out, n, s.b)
        assert {:ok, _} = Situ.remove_input(s.out, n)
        Test.settle(test)
      end

      assert {:ok, _} = Situ.add_input(s.out, :last, s.b)
      join = Enum.find(Situ.Pipeline.info(test.pipeline).nodes, &(&1.path == "Join"))
      assert Enum.map(join.inputs, & &1.name) == ["primary", "s0", "s1"]
      Test.stop(test)
    end
  end

  describe "merge/3" do
    test "adds and removes inputs" do
      {test, s} =
        start([:a, :b], fn s ->
          %{out: Situ.map(Situ.merge([s.a]), & &1.data), b: s.b}
        end)

      merged = {test.pipeline, "Merge"}
      Test.feed(test, :b, [{1, :lost}])
      assert {:ok, 2} = Situ.add_input(merged, :b, s.b)
      Test.feed(test, :b, [{2, :b}])
      Test.feed(test, :a, [{1, :a}])
      assert {:ok, _} = Situ.remove_input(merged, 0)
      Test.feed(test, :a, [{2, :gone}])
      Test.feed(test, :b, [{3, :b}])
      # Merge assigns one time per nanosecond, starting at the clock's time.
      Test.advance(test, 10)
      assert Enum.map(out(test), &elem(&1, 1)) == [:b, :a, :b]
      assert {:error, %Error{code: :unknown_input}} = Situ.remove_input(merged, 0)
      Test.stop(test)
    end
  end

  describe "for any schedule" do
    # The reference fusion is built with the input but ignores its messages before `from` (for a removed input, its
    # messages from `until`).
    property "an input added at a time acts as if it had existed but was ignored before",
      numtests: 60 do
      forall {p, a, b, from, window, order, place} <-
               {timed_values(integer(), 5), timed_values(integer(), 5),
                timed_values(integer(), 5), integer(1, 60), integer(0, 8),
                list(integer(0, 2), 60), integer(0, 100)} do
        {test, s} = gathering(interpolator: Reproducible.nearest(window))
        {before, later} = schedule([p: p, a: a, b: b], from, order)
        {first, second} = Enum.split(before, div(length(before) * place, 100))

        feed(test, first)
        assert {:ok, ^from} = Situ.add_input(s.out, :b, s.b, from: from)
        feed(test, second ++ later)
        for input <- [:p, :a, :b], do: Test.close(test, input)
        got = out(test)
        Test.stop(test)

        {:ok, {early, late}} = expected(p, a, b, from, window)

        assert got ==
                 Enum.filter(early, &(elem(&1, 0) < from)) ++
                   Enum.filter(late, &(elem(&1, 0) >= from))
      end
    end

    property "an input removed at a time acts as if it were ignored from then on", numtests: 60 do
      forall {p, a, b, until, order, place} <-
               {timed_values(integer(), 5), timed_values(integer(), 5),
                timed_values(integer(), 5), integer(1, 60), list(integer(0, 2), 60),
                integer(0, 100)} do
        {test, s} =
          start([:p, :a, :b], fn s ->
            %{out: Situ.join(s.p, %{a: s.a, b: s.b}, Reproducible.last(), name: "Join")}
          end)

        {before, later} = schedule([p: p, a: a, b: b], until, order)
        {first, second} = Enum.split(before, div(length(before) * place, 100))
        feed(test, first)
        assert {:ok, ^until} = Situ.remove_input(s.out, :b, until: until)
        feed(test, second ++ later)
        for input <- [:p, :a, :b], do: Test.close(test, input)
        got = out(test)
        Test.stop(test)

        {:ok, {without, with_b}} =
          both(p, a, b, &Situ.join(&1.p, %{a: &1.a}, Reproducible.last()), fn s ->
            Situ.join(s.p, %{a: s.a, b: s.b}, Reproducible.last(), name: "Both")
          end)

        assert got ==
                 Enum.filter(with_b, &(elem(&1, 0) < until)) ++
                   Enum.filter(without, &(elem(&1, 0) >= until))
      end
    end

    defp expected(p, a, b, from, window) do
      nearest = Reproducible.nearest(window)
      b = Enum.filter(b, fn {time, _} -> time >= from end)

      both(p, a, b, &Situ.join(&1.p, %{a: &1.a}, nearest), fn s ->
        Situ.join(s.p, [s.a, s.b], nearest,
          with: fn p, [a, b] -> {p, %{a: a, b: b}} end,
          name: "Both"
        )
      end)
    end

    defp both(p, a, b, one, other) do
      with {:ok, [one, other]} <- Test.run([p: p, a: a, b: b], &[one.(&1), other.(&1)]),
           do: {:ok, {one, other}}
    end

    # Mixes single messages of the streams in random order and splits off those that must follow the change.
    defp schedule(streams, time, order) do
      mixed = mix(Map.new(streams), order, [])

      Enum.split_while(mixed, fn {stream, {at, _}} -> stream == :a or at < time end)
    end

    defp mix(streams, order, done) do
      case Enum.filter([:p, :a, :b], &(streams[&1] != [])) do
        [] ->
          Enum.reverse(done)

        open ->
          {n, order} = List.pop_at(order, 0, 0)
          stream = Enum.at(open, rem(n, length(open)))
          [message | rest] = streams[stream]
          mix(%{streams | stream => rest}, order, [{stream, message} | done])
      end
    end

    defp feed(test, messages), do: for({stream, m} <- messages, do: Test.feed(test, stream, m))
  end
end
