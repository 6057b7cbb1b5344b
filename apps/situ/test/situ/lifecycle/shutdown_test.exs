defmodule Situ.Lifecycle.ShutdownTest do
  # Streams end without losing existing messages and without inventing new ones.
  use ExUnit.Case, async: true

  alias Situ.{Clock, Pipeline, Reproducible, Time}

  @moduletag :capture_log

  defmodule Later do
    # Feeds the cycle back: re-emits each message 1,000 ns later.
    use Situ.Component, inputs: [in: :any], outputs: [out: :any]
    @impl true
    def handle_message(:in, m, _context, state),
      do: {[{:out, m.originating_time + 1_000, m.data}], state}
  end

  defmodule Sum do
    # y(t) = x(t) + y(t - 1,000).
    use Situ.Component, inputs: [in: :any, back: {:any, optional: true}], outputs: [out: :any]
    @impl true
    def init(_opts), do: {:ok, %{waiting: :queue.new(), back: %{}, first: true}}

    @impl true
    def handle_message(:in, m, _context, %{first: true} = s),
      do: {[{:out, m.originating_time, m.data}], %{s | first: false}}

    def handle_message(:in, m, _context, s), do: go(%{s | waiting: :queue.in(m, s.waiting)}, [])

    def handle_message(:back, m, _context, s),
      do: go(%{s | back: Map.put(s.back, m.originating_time, m.data)}, [])

    defp go(s, actions) do
      case :queue.peek(s.waiting) do
        {:value, %{originating_time: t} = m} when is_map_key(s.back, t) ->
          {y, back} = Map.pop(s.back, t)
          s = %{s | waiting: :queue.drop(s.waiting), back: back}
          go(s, [{:out, t, m.data + y} | actions])

        _ ->
          {Enum.reverse(actions), s}
      end
    end
  end

  defmodule Button do
    # A push source that stamps each message when it handles it.
    use Situ.Component, outputs: [out: :integer], options: [owner: [type: :pid, required: true]]
    @impl true
    def init(opts), do: {:ok, {opts[:owner], 0}}

    @impl true
    def handle_start(_context, {owner, 0}) do
      send(owner, {:button, self()})
      {[{:complete, :infinity}], {owner, 0}}
    end

    @impl true
    def handle_info(:pressed, context, {owner, n}),
      do: {[{:out, context.now, n + 1}], {owner, n + 1}}
  end

  @replay [replay: [interval: {0, 100}, speed: :max]]

  defp times(build, opts \\ []),
    do: Situ.to_list(build, [times: true] ++ Keyword.put_new(opts, :pipeline, @replay))

  defp received(tag) do
    receive do
      {^tag, what} -> [what | received(tag)]
    after
      0 -> []
    end
  end

  test "a cycle drains as long as its counters move" do
    n = 20_000

    sums =
      Situ.to_list(fn p ->
        # The first round waits longer than any reasonable fixed timeout for a cycle.
        x = Situ.from_enumerable(p, Enum.map(1..n, &{&1 * 1_000, 1}))
        node = Pipeline.add(p, Sum, name: "Sum")
        Pipeline.connect(x, node, :in)
        y = Situ.Node.output(node, :out)
        slow = Situ.each(y, fn v -> if v == 2, do: Process.sleep(1_500) end, async: true)
        Pipeline.connect(Situ.via(slow, Later), node, :back)
        y
      end)

    assert length(sums) == n
    assert List.last(sums) == n
  end

  test "a stage closes after all its inputs, and an operator in between changes nothing" do
    source = fn p -> Situ.from_enumerable(p, [{0, 1}, {10, 2}]) end
    # Keeps the pipeline running until 40.
    longer = fn p -> p |> Situ.from_enumerable([{0, :x}, {40, :x}]) |> Situ.each(& &1) end

    for operator <- [
          &Situ.sample(&1, 5),
          &Situ.last(&1, 1),
          &Situ.sample(
            &1,
            Situ.from_enumerable(&1.pipeline, [{5, :t}, {15, :t}, {25, :t}]),
            Reproducible.nearest(100)
          )
        ] do
      straight = times(fn p -> longer.(p) && operator.(source.(p)) end)

      for between <- [
            &Situ.map(&1, fn v -> v end),
            &Situ.map(&1, fn v -> v end, async: true),
            &Situ.via(&1, Situ.Fixture.Pass)
          ] do
        assert times(fn p -> longer.(p) && p |> source.() |> between.() |> operator.() end) ==
                 straight
      end
    end
  end

  test "messages held for a finite stream are released at its end, not at the pipeline's" do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          finite =
            p |> Situ.from_enumerable([{0, :a}]) |> Situ.map(& &1) |> Situ.map(& &1, async: true)

          Situ.each(finite, fn _ -> :ok end, async: true, name: "Sink")
          p |> Situ.from_enumerable([{0, :x}, {40, :x}]) |> Situ.each(& &1)
          Situ.via(finite, Situ.Fixture.Closing, to: me)
        end,
        pipeline: [clock: Clock.manual(0)]
      )

    assert_receive {:closed, :in, 0}
    assert Pipeline.state(p) == :running
    assert {:ok, _} = Pipeline.stop(p)
  end

  test "nothing is invented after the time at which a branch failed" do
    for async <- [true, false], _ <- 1..3 do
      me = self()

      assert {:error, %{code: :component_failed}} =
               Pipeline.run(fn p ->
                 s = Situ.from_enumerable(p, Enum.map(0..4_999, &{&1 * 10, &1}))

                 a =
                   s
                   |> Situ.map(fn i -> if i == 100, do: raise("boom"), else: i end, async: true)
                   |> Situ.map(& &1, async: async)

                 b = Situ.map(s, & &1, async: true)
                 b |> Situ.zip(a) |> Situ.each(&send(me, {:zip, &1}))

                 b
                 |> Situ.join(a, Reproducible.exact(or_default: :missing))
                 |> Situ.each(&send(me, {:join, &1}))
               end)

      assert Enum.filter(received(:zip), &(length(&1) != 2)) == []
      joined = received(:join)
      assert Enum.filter(joined, &(elem(&1, 1) == :missing)) == []
      assert Enum.all?(joined, &(elem(&1, 0) < 100))
    end
  end

  test "everything a source emitted before it failed is delivered" do
    me = self()

    assert {:error, %{code: :component_failed}} =
             Pipeline.run(fn p ->
               numbers = fn i -> if i == 50, do: raise("boom"), else: {i * 10, i} end
               a = Situ.from_enumerable(p, Stream.map(0..99, numbers))
               b = Situ.from_enumerable(p, Enum.map(0..99, &{&1 * 10, &1}))
               a |> Situ.zip(b) |> Situ.each(&send(me, {:zip, &1}))
             end)

    zipped = received(:zip)
    assert Enum.filter(zipped, &(length(&1) != 2)) == []
  end

  test "posted events are delivered on stop with the times at which they were posted" do
    for n <- [10, 5_000] do
      me = self()

      {:ok, p} =
        Pipeline.start(fn p ->
          p
          |> Situ.event_source(fn post -> send(me, {:post, post}) end)
          |> Situ.each(fn v, m -> send(me, {:got, {v, m.originating_time}}) end)
        end)

      assert_receive {:post, post}
      for v <- 1..n, do: post.(v)
      posted = Time.now()
      assert {:ok, _} = Pipeline.stop(p)
      got = received(:got)
      assert Enum.map(got, &elem(&1, 0)) == Enum.to_list(1..n)
      # Events with equal times are nudged apart.
      assert Enum.all?(got, fn {_, t} -> t <= posted + n end)
    end
  end

  test "messages that a push source stamps itself are delivered on stop" do
    me = self()

    {:ok, p} =
      Pipeline.start(fn p ->
        p
        |> Situ.source(Button, owner: me, on_same_time: :nudge)
        |> Situ.each(&send(me, {:got, &1}))
      end)

    assert_receive {:button, button}
    for _ <- 1..2_000, do: send(button, :pressed)
    assert {:ok, _} = Pipeline.stop(p)
    assert received(:got) == Enum.to_list(1..2_000)
  end

  test "a gap of half a century does not prevent a pipeline from stopping" do
    me = self()
    gap = fn _, m -> if m.originating_time == Time.ms(2), do: send(me, :gap) end

    build = fn p ->
      p
      |> Situ.from_enumerable([{0, 1.0}, {Time.ms(50 * 365 * 86_400_000), 2.0}])
      |> Situ.sample(Time.ms(1), Reproducible.nearest())
      |> Situ.each(gap, async: true)
    end

    replay = [interval: {0, :unbounded}, speed: :max]
    {:ok, p} = Pipeline.start(build, pipeline: [replay: replay, stop_timeout: 100])
    assert_receive :gap

    assert {:error, %{code: :stuck}} = Pipeline.stop(p, catch_up: 10, timeout: 20_000)
  end
end
