defmodule Situ.Lifecycle.StartPartTest do
  # Starts parts again that were stopped or have ended, while the rest of the pipeline keeps running.
  use ExUnit.Case, async: true

  import Situ.Test.Eventually

  alias Situ.{Clock, Pipeline, Reproducible, Time}

  @moduletag :capture_log

  defmodule Fails do
    # Forwards to the test, and fails to initialize on request.
    use Situ.Component, inputs: [in: :any], options: [fails: [type: :any], to: [type: :pid]]

    @impl true
    def init(opts),
      do: if(:atomics.get(opts[:fails], 1) == 1, do: raise("not now"), else: {:ok, opts})

    @impl true
    def handle_message(:in, message, _context, opts) do
      send(opts[:to], {:part, message.data})
      {[], opts}
    end
  end

  # Posts a number every ms; "Side" counts them, and has a source that posts numbers, too.
  defp start(me, clock, side) do
    {:ok, p} =
      Pipeline.start(
        fn p ->
          numbers =
            Situ.from_enumerable(p, Stream.iterate(0, &(&1 + 1)),
              every: Time.ms(1),
              name: "Numbers"
            )

          Situ.composite(numbers, "Side", side)
          Situ.each(numbers, &send(me, {:main, &1}), name: "Main")
        end,
        pipeline: [clock: clock]
      )

    # The source takes the clock's time when it starts.
    assert Pipeline.clock(p) == clock
    {:ok, p}
  end

  defp receive_until(tag, last, seen \\ []) do
    receive do
      {^tag, ^last} -> Enum.reverse([last | seen])
      {^tag, value} -> receive_until(tag, last, [value | seen])
    after
      10_000 -> flunk("#{inspect(tag)}: no #{inspect(last)}, only #{inspect(Enum.reverse(seen))}")
    end
  end

  defp count(me),
    do:
      &(&1
        |> Situ.scan([], fn n, seen -> [n | seen] end, name: "Scan")
        |> Situ.each(fn s -> send(me, {:side, Enum.reverse(s)}) end, async: true))

  test "a part continues with its state, or afresh" do
    clock = Clock.manual(0)
    {:ok, p} = start(self(), clock, count(self()))
    Clock.set(clock, Time.ms(3))
    receive_until(:main, 3)
    :ok = Pipeline.stop_part(p, "Side", checkpoint: true)
    Clock.set(clock, Time.ms(5))
    receive_until(:main, 5)
    :ok = Pipeline.start_part(p, "Side", from: :checkpoint)
    Clock.set(clock, Time.ms(7))
    assert receive_until(:side, [0, 1, 2, 3, 6, 7])
    receive_until(:main, 7)
    :ok = Pipeline.stop_part(p, "Side")
    assert {:error, %{code: :no_checkpoint}} = Pipeline.start_part(p, "Side", from: :checkpoint)
    assert :ok = Pipeline.start_part(p, "Side")
    assert {:error, %{code: :still_running}} = Pipeline.start_part(p, "Side")
    Clock.set(clock, Time.ms(9))
    assert receive_until(:side, [8, 9])
    assert {:error, %{code: :unknown_component}} = Pipeline.start_part(p, "Nobody")
    assert {:ok, %{errors: []} = report} = Pipeline.stop(p)
    assert report.closed == Enum.uniq(report.closed)
    for e <- report.snapshot.edges, do: assert(e.emitted == e.processed + e.dropped)
  end

  test "a source continues after its last message, or begins again" do
    me = self()
    clock = Clock.manual(0)

    side = fn numbers ->
      numbers.pipeline
      |> Situ.from_enumerable(Stream.iterate(0, &(&1 + 1)), every: Time.ms(1), name: "Own")
      |> Situ.each(&send(me, {:own, &1}))
    end

    {:ok, p} = start(me, clock, side)
    Clock.set(clock, Time.ms(3))
    receive_until(:own, 3)
    :ok = Pipeline.stop_part(p, "Side", checkpoint: true)
    refute_receive {:own, _}, 20
    :ok = Pipeline.start_part(p, "Side", from: :checkpoint)
    Clock.set(clock, Time.ms(6))
    assert receive_until(:own, 6) == [4, 5, 6]
    :ok = Pipeline.stop_part(p, "Side")
    :ok = Pipeline.start_part(p, "Side", from: :fresh)
    Clock.set(clock, Time.ms(9))
    assert receive_until(:own, 3) == [0, 1, 2, 3]
    assert {:ok, %{errors: []}} = Pipeline.stop(p)
  end

  test "operators that join streams work again" do
    me = self()
    clock = Clock.manual(0)

    side = fn numbers ->
      double = Situ.map(numbers, &(&1 * 2), async: true)
      Situ.join(numbers, double, Reproducible.exact()) |> Situ.each(&send(me, {:join, &1}))
      Situ.zip(numbers, double) |> Situ.each(&send(me, {:zip, &1}))
      Situ.sample(numbers, Time.ms(2)) |> Situ.each(&send(me, {:sample, &1}))
      span = fn %{originating_time: t} -> {Situ.Interval.closed(t, t), t} end
      Situ.window_by(numbers, double, span) |> Situ.each(&send(me, {:window, &1}))
    end

    {:ok, p} = start(me, clock, side)
    Clock.set(clock, Time.ms(3))
    assert {3, 6} in receive_until(:join, {3, 6})
    :ok = Pipeline.stop_part(p, "Side", checkpoint: true)
    flush()
    :ok = Pipeline.start_part(p, "Side", from: :checkpoint)
    Clock.set(clock, Time.ms(8))
    assert receive_until(:join, {8, 16}) == for(n <- 4..8, do: {n, 2 * n})
    assert receive_until(:zip, [8, 16]) == for(n <- 4..8, do: [n, 2 * n])
    assert receive_until(:sample, 8) == [4, 6, 8]
    assert receive_until(:window, [8]) == for(n <- 4..8, do: [n])
    assert {:ok, %{errors: []}} = Pipeline.stop(p)
  end

  defp flush, do: receive(do: ({_, _} -> flush()), after: (0 -> :ok))

  test "a part that died starts again, and its name is free after its removal" do
    me = self()
    clock = Clock.manual(0)

    {:ok, p} =
      start(
        me,
        clock,
        &Situ.each(&1, fn n -> send(me, {:side, n, self()}) end,
          async: true,
          on_error: :skip,
          name: "Each"
        )
      )

    _ = p
    Clock.set(clock, Time.ms(1))
    assert_receive {:side, 1, pid}
    :ok = Pipeline.stop_part(p, "Side")
    assert eventually(fn -> not Process.alive?(pid) end)
    :ok = Pipeline.start_part(p, "Side.Each")
    Clock.set(clock, Time.ms(2))
    assert_receive {:side, 2, other}
    assert other != pid
    :ok = Pipeline.remove(p, "Side")
    assert {:error, %{code: :unknown_component}} = Pipeline.start_part(p, "Side")

    {:ok, _} =
      Pipeline.extend(p, fn p ->
        Situ.composite(Pipeline.stream(p, "Numbers"), "Side", fn n ->
          Situ.each(n, &send(me, {:new, &1}))
        end)

        :ok
      end)

    Clock.set(clock, Time.ms(3))
    assert_receive {:new, 3}
    assert {:ok, %{errors: []}} = Pipeline.stop(p)
  end

  test "a part that fails to start stays stopped" do
    me = self()
    clock = Clock.manual(0)
    fails = :atomics.new(1, [])

    side = fn numbers ->
      numbers
      |> Situ.map(& &1, async: true)
      |> Situ.via(Fails, fails: fails, to: me, name: "Part")
    end

    {:ok, p} = start(me, clock, side)
    Clock.set(clock, Time.ms(1))
    assert_receive {:part, 1}
    :ok = Pipeline.stop_part(p, "Side")
    :atomics.put(fails, 1, 1)
    assert {:error, %{code: :component_failed}} = Pipeline.start_part(p, "Side")
    assert Pipeline.state(p) == :running
    :atomics.put(fails, 1, 0)
    assert :ok = Pipeline.start_part(p, "Side")
    Clock.set(clock, Time.ms(2))
    assert_receive {:part, 2}
    assert {:ok, %{errors: []}} = Pipeline.stop(p)
  end

  test "the state of a component must be plain data" do
    clock = Clock.manual(0)
    me = self()
    {:ok, p} = start(me, clock, &Situ.scan(&1, nil, fn _, _ -> me end))
    Clock.set(clock, Time.ms(1))
    receive_until(:main, 1)
    :ok = Pipeline.stop_part(p, "Side", checkpoint: true)
    assert {:error, %{code: :no_snapshot}} = Pipeline.start_part(p, "Side", from: :checkpoint)
    assert :ok = Pipeline.start_part(p, "Side")
    assert {:ok, %{errors: []}} = Pipeline.stop(p)
  end

  test "a part that is being stopped starts after it has ended" do
    me = self()
    clock = Clock.manual(0)

    slow = fn numbers ->
      Situ.each(
        numbers,
        fn n ->
          send(me, {:slow, n, self()})
          receive do: (:go -> :ok)
        end,
        async: true
      )
    end

    {:ok, p} = start(me, clock, slow)
    assert_receive {:slow, 0, pid}
    stop = Task.async(fn -> Pipeline.stop_part(p, "Side") end)
    assert eventually(fn -> :sys.get_state(p).life.parts != %{} end)
    again = Task.async(fn -> Pipeline.start_part(p, "Side") end)
    assert eventually(fn -> match?([%{state: :waiting} | _], Pipeline.list_changes(p)) end)
    later = Task.async(fn -> Pipeline.start_part(p, "Side") end)
    assert eventually(fn -> length(Pipeline.list_changes(p)) == 3 end)
    send(pid, :go)
    assert :ok = Task.await(stop)
    assert :ok = Task.await(again)
    assert {:error, %{code: :still_running}} = Task.await(later)
    Clock.set(clock, Time.ms(1))
    assert_receive {:slow, 1, pid} when is_pid(pid)
    stop = Task.async(fn -> Pipeline.stop(p) end)
    send(pid, :go)
    assert {:ok, %{errors: []}} = Task.await(stop)
  end
end
