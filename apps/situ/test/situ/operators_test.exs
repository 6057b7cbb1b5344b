defmodule Situ.OperatorsTest do
  # What the conformance files do not ask: options, sources, waiting, and bad input.
  use ExUnit.Case, async: true

  alias Situ.{Available, Interval, Message, Reproducible, Time}

  @moduletag :capture_log

  defp run(inputs, build, opts \\ []) do
    {:ok, outputs} = Situ.Test.run(inputs, build, opts)
    outputs
  end

  defp messages(timed), do: for({t, v} <- timed, do: %Message{originating_time: t, data: v})

  describe "join/4" do
    test "flattens both sides by their types, and not with flatten: false" do
      inputs = [a: [{0, 1}], b: [{0, 2}], c: [{0, 3}], d: [{0, 4}]]

      build = fn s ->
        left = Situ.join(s.a, s.b)
        right = Situ.join(s.c, s.d)
        [Situ.join(left, right), Situ.join(left, right, flatten: false, name: "Nested")]
      end

      assert run(inputs, build) == [[{0, {1, 2, 3, 4}}], [{0, {{1, 2}, {3, 4}}}]]
    end

    test "a default of another type than the stream's is no lie about the output's" do
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

    test "a line through whole numbers is no whole number" do
      inputs = [a: [{5, 1}, {7, 1}], b: [{0, 1}, {10, 2}]]

      build = fn s ->
        b = Situ.map(s.b, & &1, type: :integer)
        s.a |> Situ.join(b, Reproducible.linear()) |> Situ.zip(s.b)
      end

      assert run(inputs, build) |> Enum.at(1) == {5, [{1, 1.5}]}
    end

    test "leaves tuples alone that are data" do
      inputs = [point: [{0, {3, 4}}], name: [{0, "p"}]]
      assert run(inputs, &Situ.join(&1.point, &1.name)) == [{0, {{3, 4}, "p"}}]
    end

    test "takes one interpolator per secondary" do
      inputs = [a: [{10, :a}], b: [{8, :b}], c: [{10, :c}]]

      build = fn s ->
        Situ.join(s.a, [s.b, s.c], [Reproducible.nearest(3), Reproducible.exact()])
      end

      assert run(inputs, build) == [{10, {:a, [:b, :c]}}]
    end

    test "refuses interpolators that are not reproducible, negative tolerances and windows that end before they begin" do
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

    test "a lossy policy drops before the join sees it; what is left is joined exactly" do
      inputs = [a: Enum.map(0..99, &{&1, &1}), b: Enum.map(0..99, &{&1, &1})]

      build =
        &Situ.join(&1.a, &1.b, [], policy: [Situ.Delivery.latest(), Situ.Delivery.unlimited()])

      outputs = run(inputs, build)
      assert List.last(outputs) == {99, {99, 99}}
      assert Enum.all?(outputs, fn {t, pair} -> pair == {t, t} end)
    end
  end

  describe "give_up_after:" do
    test "decides a primary that waited too long, and counts it" do
      core = Situ.Fusion.Core.new([Reproducible.exact()], &{&1, &2}, give_up_after: 10)
      {[], core} = Situ.Fusion.Core.primary(core, messages([{0, :a}, {5, :b}]))
      {[], core} = Situ.Fusion.Core.primary(core, messages([{12, :c}]))
      assert %{primary: 2, given_up: 1} = Situ.Fusion.Core.queued(core)
      {outputs, _} = Situ.Fusion.Core.secondary(core, 0, messages([{5, :x}, {12, :y}]))
      assert outputs == [{:out, 5, {:b, :x}}, {:out, 12, {:c, :y}}]
    end
  end

  describe "nearest" do
    test "is settled by the first message from where none can be nearer" do
      nearest = Reproducible.nearest(5)
      ask = &Situ.Interpolator.interpolate(nearest, 40, messages(&1), nil)
      assert ask.([{22, :a}]) == {:wait, 40}
      assert ask.([{22, :a}, {44, :b}]) == {:created, :b, 44}
      assert ask.([{22, :a}, {36, :b}]) == {:wait, 40}
    end
  end

  describe "memory" do
    test "fusion keeps only what later primaries may need" do
      core = Situ.Fusion.Core.new([Reproducible.nearest()], &{&1, &2})

      core =
        Enum.reduce(1..1_000, core, fn n, core ->
          {_, core} = Situ.Fusion.Core.secondary(core, 0, messages([{n * 10, n}]))
          {_, core} = Situ.Fusion.Core.primary(core, messages([{n * 10, n}]))
          core
        end)

      assert %{primary: 0, secondary: [kept]} = Situ.Fusion.Core.queued(core)
      assert kept <= 2
    end

    test "a diamond whose ways differ by many messages is no deadlock" do
      build = fn p ->
        numbers = Situ.range(p, 0, 40_000, 1_000)
        rare = Situ.filter(numbers, &(rem(&1, 20_000) == 19_999), async: true)
        numbers |> Situ.join(rare, Reproducible.nearest()) |> Situ.count() |> Situ.last()
      end

      assert Situ.to_list(build) == [40_000]
    end

    test "branches that end leave nothing behind, though keys never repeat" do
      core =
        Situ.Parallel.Core.new(
          start: fn _ -> Situ.Branch.start(&Situ.window(&1, 0..1)) end,
          form: :sparse,
          termination: {:after_absent, 0},
          missing: :drop,
          creator: & &1
        )

      core =
        Enum.reduce(1..2_000, core, fn n, core ->
          message = %Message{originating_time: n, data: nil}
          {_outputs, core} = Situ.Parallel.Core.push(core, message, %{n => n})
          core
        end)

      assert map_size(core.branches) == 1
      assert Situ.Parallel.Entries.size(core.entries) <= 1
      assert core.started == 2_000
    end
  end

  describe "windows" do
    test "with the left end after the right are put in order" do
      inputs = [n: Enum.map(1..4, &{&1, &1})]
      assert run(inputs, &Situ.window(&1.n, 0..-1//-1)) == [{2, [1, 2]}, {3, [2, 3]}, {4, [3, 4]}]
      window = Interval.new(0, true, -1, true)
      assert [{1, [1]}, {2, [1, 2]} | _] = run(inputs, &Situ.window(&1.n, window))
    end

    test "after the anchor hold exactly the messages at their indices, stamped with the anchor" do
      inputs = [n: Enum.map(1..5, &{&1 * 10, &1})]
      assert run(inputs, &Situ.window(&1.n, 1..2)) == [{10, [2, 3]}, {20, [3, 4]}, {30, [4, 5]}]
    end

    test "keep their look-back when the stream ends" do
      inputs = [n: Enum.map(0..3, &{&1, &1})]
      window = Interval.closed(-2, 2)
      assert List.last(run(inputs, &Situ.window(&1.n, window))) == {3, [1, 2, 3]}
    end

    test "refuse what is no window" do
      Situ.Pipeline.run(fn p ->
        s = Situ.return(p, 1)
        assert_raise ArgumentError, ~r/a window is/, fn -> Situ.window(s, 5) end

        assert_raise ArgumentError, ~r/whole ns/, fn ->
          Situ.window(s, Interval.closed(-1, 0.5))
        end
      end)
    end

    test "by a stream answer window messages that come after the source has ended" do
      test =
        Situ.Test.start(
          [:n, :w],
          fn s -> Situ.window_by(s.n, s.w, &{Interval.closed(0, &1.data), 0}) end,
          start: 1_000
        )

      Situ.Test.feed(test, :n, [{1, :a}, {2, :b}])
      Situ.Test.close(test, :n)
      Situ.Test.feed(test, :w, {5, 100})
      assert Situ.Test.outputs(test) == [{5, [:a, :b]}]
      Situ.Test.stop(test)
    end

    test "by a stream refuse windows that nobody could answer" do
      inputs = [n: [{1, 1}], w: [{0, Interval.left_bounded(0)}]]

      assert {:error, %{code: :window_not_finite}} =
               Situ.Test.run(inputs, &Situ.window_by(&1.n, &1.w, fn m -> {m.data, 0} end))

      inputs = [n: [{1, 1}], w: [{0, Interval.closed(3, 1)}]]

      assert {:error, %{code: :window_negative}} =
               Situ.Test.run(inputs, &Situ.window_by(&1.n, &1.w, fn m -> {m.data, 0} end))
    end
  end

  describe "statistics" do
    test "mix whole numbers, floats, NaN and nil" do
      inputs = [n: [{0, 1}, {1, 2.5}, {2, nil}, {3, :nan}]]
      assert run(inputs, &Situ.sum(&1.n)) == [{0, 1}, {1, 3.5}, {2, 3.5}, {3, :nan}]
      assert run(inputs, &Situ.max(&1.n)) == [{0, 1}, {1, 2.5}, {2, 2.5}, {3, :nan}]
    end

    test "of an empty list are an error that names the way out" do
      assert {:error, %{code: :empty_list, fix: fix}} =
               Situ.Test.run([n: [{0, []}]], &Situ.average(&1.n, over: :list))

      assert fix =~ "nullable: true"
      assert run([n: [{0, []}]], &Situ.average(&1.n, over: :list, nullable: true)) == [{0, nil}]
      assert run([n: [{0, []}]], &Situ.sum(&1.n, over: :list)) == [{0, 0}]
    end

    test "of what is no number are an error" do
      assert {:error, %{code: :not_a_number}} = Situ.Test.run([n: [{0, "1"}]], &Situ.sum(&1.n))
    end

    test "do not overflow: too large is infinite" do
      assert run([n: [{0, 1.0e308}, {1, 1.0e308}]], &Situ.sum(&1.n)) == [
               {0, 1.0e308},
               {1, :infinity}
             ]
    end

    test "compare by a function" do
      dates = [~D[2024-05-01], ~D[2024-02-28], ~D[2024-12-03]]
      inputs = [d: Enum.with_index(dates, fn d, i -> {i, d} end)]
      earlier = &(Date.compare(&1, &2) != :gt)
      assert List.last(run(inputs, &Situ.min(&1.d, compare: earlier))) == {2, ~D[2024-02-28]}
    end

    test "lines and filters compute with NaN, infinities and nil as statistics do" do
      inputs = [
        n: [{0, 1}, {10, 3}, {20, :nan}, {30, nil}, {40, 2}, {50, :infinity}, {60, 1.0e308}]
      ]

      ticks = [t: Enum.map(1..11, &{&1 * 5, :tick})]
      line = &Situ.interpolate(&1.n, &1.t, Reproducible.linear())

      assert Enum.map(run(inputs ++ ticks, line), &elem(&1, 1)) ==
               [2.0, 3, :nan, :nan, nil, nil, nil, 2, :infinity, :infinity, :nan]

      assert Enum.map(run(inputs, &Situ.denoise(&1.n, order: 3)), &elem(&1, 1)) ==
               [1, 2.0, :nan, nil, :nan, :nan, 1.0e308]

      assert [1, _, :nan, nil, :nan, :nan, :nan] =
               Enum.map(run(inputs, &Situ.one_euro(&1.n)), &elem(&1, 1))
    end

    test "a finite filter forgets NaN once it has left the taps, an infinite one does not" do
      values = [1.0, :nan] ++ List.duplicate(1.0, 40)
      inputs = [n: Enum.with_index(values, &{&2 * 10_000_000, &1})]
      lowpass = fn opts -> &Situ.lowpass(&1.n, 100, [cutoff: 10, order: 8] ++ opts) end
      taps = Situ.Filter.Fir.taps(:lowpass, 100, [10], 8)

      {strange, plain} = inputs |> run(lowpass.([])) |> Enum.map(&elem(&1, 1)) |> Enum.split(10)
      assert [first | nans] = strange
      assert first == hd(taps)
      assert Enum.all?(nans, &(&1 == :nan)) and length(nans) == length(taps)
      assert length(plain) == 32
      assert Enum.all?(plain, &(abs(&1 - 1.0) < 1.0e-9))

      assert [first | nans] =
               inputs |> run(lowpass.(response: :infinite)) |> Enum.map(&elem(&1, 1))

      assert is_float(first)
      assert Enum.all?(nans, &(&1 == :nan))
    end

    test "filters refuse what is no number, and are infinite where a float is too small" do
      for filter <- [
            &Situ.denoise(&1.n),
            &Situ.one_euro(&1.n),
            &Situ.lowpass(&1.n, 100, cutoff: 10)
          ] do
        inputs = [n: [{0, "1"}, {20_000_000, "2"}]]
        assert {:error, %{code: :not_a_number}} = Situ.Test.run(inputs, filter)
      end

      filter = Situ.Filter.Fir.new(:highpass, 100, [10], 8)
      # Each as large as can be, with the sign that adds up.
      worst = for tap <- Enum.reverse(filter.taps), do: if(tap < 0, do: -1.79e308, else: 1.79e308)
      step = fn sample, {_, filter} -> Situ.Filter.Fir.step(filter, sample) end
      assert {:infinity, filter} = Enum.reduce(worst, {nil, filter}, step)
      assert {out, _} = Enum.reduce(1..9, {nil, filter}, fn _, state -> step.(0.0, state) end)
      assert out == 0.0
    end

    test "logarithms of 0 and below have values" do
      assert run([n: [{0, 8}, {1, 0}, {2, -1}]], &Situ.log(&1.n, base: 2)) ==
               [{0, 3.0}, {1, :neg_infinity}, {2, :nan}]
    end
  end

  describe "parallel/3" do
    test "names the branch that raised" do
      inputs = [m: [{0, %{ok: 1, bad: 0}}]]

      build =
        &Situ.parallel(&1.m, fn _key, s -> Situ.map(s, fn n -> 1 / n end, name: "Invert") end)

      assert {:error, error} = Situ.Test.run(inputs, build)
      assert error.meta.component =~ "Parallel"
      assert error.what =~ "[:bad].Invert"
    end

    test "begins a raising branch anew with on_branch_error: :restart" do
      inputs = [m: [{0, %{a: 1, b: 1}}, {1, %{a: :x, b: 2}}, {2, %{a: 3, b: 3}}]]

      build =
        &Situ.parallel(&1.m, fn _key, s -> Situ.sum(s) end,
          on_branch_error: :restart,
          or_default: 0
        )

      assert run(inputs, build) == [{0, %{a: 1, b: 1}}, {1, %{b: 3}}, {2, %{a: 3, b: 6}}]
    end

    test "holds components that look ahead, in the order of time" do
      inputs = [m: Enum.map(0..3, &{&1, %{a: &1, b: &1 * 10}})]
      build = &Situ.parallel(&1.m, fn _key, s -> Situ.delta(s) end)
      assert run(inputs, build) == [{0, %{a: 1, b: 10}}, {1, %{a: 1, b: 10}}, {2, %{a: 1, b: 10}}]
    end

    test "counts what a branch gives while it ends" do
      inputs = [m: [{0, %{a: 1}}, {1, %{a: 2}}, {2, %{}}]]
      build = &Situ.parallel(&1.m, fn _key, s -> Situ.last(s) end)
      assert run(inputs, build) == [{1, %{a: 2}}, {2, %{}}]
    end

    test "variable: as long as the input, empty lists too" do
      inputs = [l: [{0, [1, 2]}, {1, []}, {2, [3, 4, 5]}, {3, [6]}]]
      build = &Situ.parallel(&1.l, fn s -> Situ.sum(s) end, of: :lists)
      assert run(inputs, build) == [{0, [1, 2]}, {1, []}, {2, [4, 6, 5]}, {3, [10]}]
    end

    test "fixed: the first branch may drop, and another length is an error" do
      build =
        &Situ.parallel(&1.l, fn s -> Situ.filter(s, fn n -> n > 1 end) end, size: 2, or_default: 0)

      assert run([l: [{0, [1, 2]}]], build) == [{0, [0, 2]}]
      assert {:error, %{code: :wrong_length}} = Situ.Test.run([l: [{0, [1]}]], build)
    end

    test "after n absences in a row, which a presence ends" do
      maps = [%{a: 1}, %{}, %{a: 1}, %{}, %{a: 1}, %{}, %{}]
      inputs = [m: Enum.with_index(maps, fn m, i -> {i, m} end)]

      build =
        &Situ.parallel(&1.m, fn _k, s -> Situ.sum(s) end, until: {:absent, 1}, or_default: 0)

      assert Enum.map(run(inputs, build), &elem(&1, 1)) ==
               [%{a: 1}, %{a: 0}, %{a: 2}, %{a: 0}, %{a: 3}, %{a: 0}, %{}]
    end

    test "refuses sources inside of a branch" do
      build = &Situ.parallel(&1.m, fn _k, s -> Situ.join(s, Situ.repeat(s.pipeline, 1, 1)) end)
      assert {:error, %{code: :not_in_branch}} = Situ.Test.run([m: [{0, %{a: 1}}]], build)
    end
  end

  describe "sources" do
    test "refuse intervals that let times stand still, and negative counts" do
      Situ.Pipeline.run(fn p ->
        assert_raise ArgumentError, fn -> Situ.range(p, 0, 3, 0) end
        assert_raise ArgumentError, fn -> Situ.range(p, 0, 3, -5) end
        assert_raise ArgumentError, fn -> Situ.repeat(p, 1, 10, count: -1) end
      end)

      assert Situ.to_list(&Situ.range(&1, 0, 0, 10)) == []
    end

    test "pass over items before the replay's start and stop at its end" do
      replay = [interval: {10, 30}, speed: :max]
      items = for t <- 0..50//5, do: {t, t}
      opts = [pipeline: [replay: replay]]
      assert Situ.to_list(&Situ.from_enumerable(&1, items), opts) == [10, 15, 20, 25, 30]

      assert Situ.to_list(&Situ.repeat(&1, 1, 10), [times: true] ++ opts) == [
               {10, 1},
               {20, 1},
               {30, 1}
             ]
    end

    test "give what came before an item that is out of order" do
      assert {:error, %{code: :time_not_increasing, meta: %{time: 2, last_time: 3}}} =
               Situ.Test.run([n: [{1, :a}, {3, :b}, {2, :c}]], & &1.n)
    end

    test "read enumerables lazily, and let go of them" do
      me = self()

      endless =
        Stream.resource(
          fn -> 0 end,
          fn n -> {[n], n + 1} end,
          fn n -> send(me, {:closed, n}) end
        )

      stream = Situ.to_stream(&Situ.from_enumerable(&1, endless, interval: 10))
      assert Enum.take(stream, 3) == [0, 1, 2]
      assert_receive {:closed, n} when n < 200_000
    end

    test "an error in the middle of reading reaches the reader" do
      stream = Situ.to_stream(fn p -> p |> Situ.range(0, 5, 10) |> Situ.map(&(6 / (&1 - 3))) end)

      assert_raise Situ.Error, ~r/Map failed/, fn -> Enum.to_list(stream) end
    end

    test "events of one instant are nudged, dropped or refused" do
      for {policy, expected} <- [nudge: [{0, :a}, {1, :b}], drop: [{0, :a}]] do
        me = self()

        test =
          Situ.Test.start([], fn _, p ->
            Situ.event_source(p, &send(me, {:post, &1}), fn _ -> send(me, :left) end,
              on_same_time: policy
            )
          end)

        assert_receive {:post, post}
        post.(:a)
        post.(:b)
        Situ.Test.settle(test)
        Situ.Test.advance(test, 1)
        assert Situ.Test.outputs(test) == expected
        Situ.Test.stop(test)
        assert_receive :left
      end
    end

    test "timers tick by the clock and make nothing up for" do
      test = Situ.Test.start([], fn _, p -> Situ.timer(p, Time.ms(10)) end)
      for _ <- 1..3, do: Situ.Test.advance(test, Time.ms(10))
      Situ.Test.advance(test, Time.ms(35))
      times = for {t, _} <- Situ.Test.outputs(test), do: div(t, Time.ms(1))
      assert times == [10, 20, 30, 65]
      Situ.Test.stop(test)
    end
  end

  describe "selection" do
    test "delay/3 holds messages by the clock and keeps their times" do
      test = Situ.Test.start([:n], &Situ.delay(&1.n, 50))
      Situ.Test.feed(test, :n, [{0, :a}, {10, :b}])
      assert Situ.Test.outputs(test) == []
      Situ.Test.advance(test, 50)
      assert Situ.Test.outputs(test) == [{0, :a}]
      Situ.Test.advance(test, 50)
      assert Situ.Test.outputs(test) == [{10, :b}]
      Situ.Test.stop(test)
    end

    test "process/4 gives any number of messages, and some at the end" do
      build = fn s ->
        Situ.process(
          s.text,
          0,
          fn m, n ->
            {Enum.with_index(String.split(m.data), &{m.originating_time + &2, &1}), n + 1}
          end,
          on_close: fn time, n -> [{time + 100, n}] end
        )
      end

      assert [{0, "a"}, {1, "b"}, {10, "c"} | _] =
               run([text: [{0, "a b"}, {10, "c"}, {20, ""}]], build)
    end

    test "reorder/3 brings late messages into order, up to its bound" do
      arrivals = Enum.with_index([5, 3, 9, 8, 20, 2], &{100 + &2, &1})
      build = &Situ.reorder(&1.n, 4, time: fn m -> m.data end)
      assert run([n: arrivals], build) == [{3, 3}, {5, 5}, {8, 8}, {9, 9}, {20, 20}]
      build = &Situ.reorder(&1.n, 4, time: fn m -> m.data end, late: :error)
      assert {:error, %{code: :late}} = Situ.Test.run([n: arrivals], build)
    end

    test "a tap tells its subscribers, and only them" do
      me = self()

      test =
        Situ.Test.start(
          [:n],
          fn s ->
            {stream, tap} = Situ.tap(s.n)
            send(me, {:tap, tap})
            stream
          end,
          start: 100
        )

      assert_receive {:tap, tap}
      Situ.Test.feed(test, :n, {1, :unheard})
      :ok = Situ.Tap.subscribe(tap)
      Situ.Test.feed(test, :n, {2, :heard})
      assert_receive {:situ_tap, ^tap, %Message{data: :heard}}
      :ok = Situ.Tap.unsubscribe(tap)
      Situ.Test.feed(test, :n, {3, :unheard})
      refute_received {:situ_tap, _, _}
      assert Situ.Test.outputs(test) == [{1, :unheard}, {2, :heard}, {3, :unheard}]
      Situ.Test.stop(test)
    end
  end

  describe "filters" do
    # 2 Hz and 30 Hz together, sampled at 200 Hz for 2 s.
    defp tones do
      for n <- 0..399 do
        t = n / 200
        {n * Time.ms(5), {:math.sin(2 * :math.pi() * 2 * t), :math.sin(2 * :math.pi() * 30 * t)}}
      end
    end

    defp power(outputs),
      do: Enum.sum(for {t, v} <- outputs, t > Time.ms(500), do: v * v) / length(outputs)

    test "pass what they should and stop the rest" do
      low = [s: for({t, {low, _}} <- tones(), do: {t, low})]
      high = [s: for({t, {_, high}} <- tones(), do: {t, high})]

      for response <- [:finite, :infinite] do
        lowpass = &Situ.lowpass(&1.s, 200, cutoff: 8, response: response)
        highpass = &Situ.highpass(&1.s, 200, cutoff: 15, response: response)
        assert power(run(low, lowpass)) > 50 * power(run(high, lowpass))
        assert power(run(high, highpass)) > 50 * power(run(low, highpass))
        bandpass = &Situ.bandpass(&1.s, 200, band: {20, 40}, response: response)
        assert power(run(high, bandpass)) > 20 * power(run(low, bandpass))
        bandstop = &Situ.bandstop(&1.s, 200, band: {20, 45}, response: response, order: 64)
        assert power(run(low, bandstop)) > 20 * power(run(high, bandstop))
      end
    end

    test "refuse edges that the rate cannot have" do
      Situ.Pipeline.run(fn p ->
        s = Situ.return(p, 1.0)
        assert_raise ArgumentError, ~r/half the rate/, fn -> Situ.lowpass(s, 100, cutoff: 60) end
        assert_raise ArgumentError, fn -> Situ.bandpass(s, 100, band: {30, 20}) end
        assert_raise Situ.Error, ~r/required/, fn -> Situ.lowpass(s, 100, []) end
      end)
    end

    test "denoise/2 takes a single outlier away" do
      inputs = [s: Enum.with_index([1, 1, 99, 1, 1], &{&2, &1})]

      assert Enum.map(run(inputs, &Situ.denoise(&1.s, order: 3)), &elem(&1, 1)) == [
               1,
               1.0,
               1,
               1,
               1
             ]
    end
  end
end
