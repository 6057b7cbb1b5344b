defmodule Situ.Pipeline.ClockTest do
  use ExUnit.Case, async: true

  alias Situ.{Clock, Pipeline}
  alias Situ.Fixture.Count

  @ms 1_000_000

  test "a replay delivers each message when the clock reaches its time, not before" do
    clock = Clock.manual(0)
    p = replay(clock, count: 5, interval: 10 * @ms)
    assert_receive {:got, 0}
    Clock.advance(clock, 9 * @ms)
    refute_receive {:got, _}, 20
    Clock.advance(clock, @ms)
    assert_receive {:got, 1}
    Clock.advance(clock, 100 * @ms)
    for n <- 2..4, do: assert_receive({:got, ^n})
    assert {:ok, report} = Pipeline.await(p, 30_000)
    assert report.final_time == 40 * @ms
  end

  test "a paused clock holds messages, a resumed clock releases them, and a higher speed delivers them sooner" do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.source(Count, count: :infinity, interval: 60_000 * @ms)
          |> Situ.each(&send(me, {:got, &1}))
        end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: 1.0]]
      )

    assert_receive {:got, 0}
    :ok = Pipeline.pause(p)
    now = Pipeline.now(p)
    assert Pipeline.now(p) == now
    refute_receive {:got, 1}, 150
    :ok = Pipeline.set_speed(p, 100_000)
    :ok = Pipeline.resume(p)
    assert_receive {:got, 50}
    assert Pipeline.now(p) >= 50 * 60_000 * @ms
    {:ok, _} = Pipeline.stop(p)
  end

  test "pausing a real clock returns an error that says why" do
    {:ok, p} =
      Pipeline.start(fn p -> Situ.source(p, Count, count: :infinity, interval: @ms) end, [])

    wait(p)
    assert {:error, %{code: :fixed_clock, fix: fix}} = Pipeline.pause(p)
    assert is_binary(fix)
    Pipeline.stop(p)
  end

  test "skips items before a proposed replay and before a requested one" do
    items = fn p -> Situ.from_enumerable(p, [{10, :x}, {60, :a}, {150, :b}, {250, :c}]) end

    proposed = fn p ->
      Pipeline.propose_replay(p, {100, 200})
      Pipeline.propose_replay(p, {50, 120})
      items.(p)
    end

    assert Situ.to_list(proposed, pipeline: [replay: [speed: :max]]) == [:a, :b]
    asked = [replay: [interval: {70, :unbounded}, speed: :max]]
    assert Situ.to_list(proposed, pipeline: asked) == [:b]
    # Without a replay the pipeline starts now, and old items are delivered immediately.
    assert Situ.to_list(items, pipeline: [replay: [speed: :max]]) == [:x, :a, :b, :c]

    assert {:error, %{meta: %{reason: %ArgumentError{message: "a proposed replay is" <> _}}}} =
             Pipeline.run(&Pipeline.propose_replay(&1, {:unbounded, 5}))
  end

  test "the replay interval is the union of the proposals, limited to the requested interval" do
    build = fn p ->
      Pipeline.propose_replay(p, {100, 900})
      Pipeline.propose_replay(p, {50, 500})
      Situ.source(p, Situ.Component.Empty)
      Pipeline.replay_interval(p)
    end

    assert {:ok, %{start_time: 50, result: {:unbounded, :unbounded}}} = Pipeline.run(build)

    assert {:ok, %{start_time: 200, result: {200, 600}}} =
             Pipeline.run(build, pipeline: [replay: [interval: {200, 600}]])
  end

  test "progress follows the delivered messages and is 1.0 only at the end" do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.source(Count, count: 1_001, interval: 1)
          |> Situ.each(fn n ->
            if n == 500, do: send(me, {:half, self()}) && receive(do: (:go -> :ok))
          end)
        end,
        pipeline: [replay: [interval: {0, 1_000}, speed: :max]]
      )

    assert_receive {:half, pid}
    half = Pipeline.progress(p)
    assert half >= 0.0 and half <= 0.51
    send(pid, :go)
    assert {:ok, report} = Pipeline.await(p, 30_000)
    assert report.snapshot.progress == 1.0
  end

  test "delivers the earliest originating time first among the inputs of a component" do
    me = self()

    {:ok, _} =
      Pipeline.run(
        fn p ->
          a = Situ.source(p, Count, count: 100, interval: 10)
          b = Situ.source(p, Count, count: 100, interval: 7)
          Situ.via([a: a, b: b], __MODULE__.Two, tell: &send(me, {:time, &1}))
        end,
        pipeline: [replay: [interval: {0, :unbounded}]]
      )

    times = times()
    assert length(times) == 200

    # Order is not guaranteed across arrivals, only among waiting messages: there are far fewer inversions than by
    # chance.
    inversions = times |> Enum.chunk_every(2, 1, :discard) |> Enum.count(fn [x, y] -> y < x end)
    assert inversions <= 10
  end

  defmodule Two do
    use Situ.Component, inputs: [a: :any, b: :any], options: [tell: [type: :any]]
    @impl true
    def handle_message(_input, message, _context, opts) do
      opts[:tell].(message.originating_time)
      {[], opts}
    end
  end

  defp replay(clock, opts) do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p -> p |> Situ.source(Count, opts) |> Situ.each(&send(me, {:got, &1})) end,
        pipeline: [clock: clock]
      )

    p
  end

  defp wait(p), do: if(Pipeline.state(p) == :running, do: :ok, else: wait(p))

  defp times do
    receive do
      {:time, t} -> [t | times()]
    after
      0 -> []
    end
  end
end
