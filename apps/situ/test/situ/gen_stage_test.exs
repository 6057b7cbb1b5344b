defmodule Situ.GenStageTest do
  use ExUnit.Case, async: true
  doctest Situ.GenStage

  alias Situ.Fixture.Count
  alias Situ.{Clock, Delivery, GenStage, Pipeline}

  @moduletag :capture_log

  # These peers follow GenStage's documented protocol only, and send exactly what GenStage 1.3 sends.

  defmodule Producer do
    # Counts, emits no more events than were asked for (like a demand dispatcher), and reports the requests to the
    # test.
    use GenServer

    def start(opts), do: GenServer.start(__MODULE__, opts)

    @impl true
    def init(opts),
      do: {:ok, %{next: opts[:from] || 0, limit: opts[:limit], opts: opts, consumers: %{}}}

    @impl true
    def handle_info({:"$gen_producer", {pid, ref}, {:subscribe, nil, opts}}, state)
        when is_reference(ref) and is_list(opts) do
      Process.monitor(pid)
      send(state.opts[:watcher], {:subscribed, self(), opts})
      {:noreply, put_in(state.consumers[ref], pid)}
    end

    def handle_info({:"$gen_producer", {pid, ref}, {:ask, n}}, state)
        when is_map_key(state.consumers, ref) and is_integer(n) and n > 0 do
      send(state.opts[:watcher], {:asked, n})
      last = min(state.next + n, state.limit)
      events = Enum.map(state.next..(last - 1)//1, state.opts[:event] || (& &1))
      if events != [], do: send(pid, {:"$gen_consumer", {self(), ref}, events})
      if last == state.limit, do: finish(state.opts[:finish] || {:cancel, :normal}, {pid, ref})
      {:noreply, %{state | next: last}}
    end

    def handle_info({:"$gen_producer", {pid, ref}, {:cancel, reason}}, state) do
      send(pid, {:"$gen_consumer", {self(), ref}, {:cancel, reason}})
      send(state.opts[:watcher], {:cancelled, reason})
      {:noreply, state}
    end

    def handle_info(_other, state), do: {:noreply, state}

    defp finish({:cancel, reason}, {pid, ref}),
      do: send(pid, {:"$gen_consumer", {self(), ref}, {:cancel, reason}})

    defp finish({:exit, reason}, _from), do: Process.exit(self(), reason)
  end

  defp producer(opts) do
    {:ok, pid} = Producer.start(Keyword.put(opts, :watcher, self()))
    pid
  end

  defp run(producers, opts \\ []) do
    me = self()

    Pipeline.run(fn p ->
      p
      |> GenStage.from(producers, [type: :integer] ++ opts)
      |> Situ.each(fn v, m -> send(me, {:got, v, m.originating_time}) end)
    end)
  end

  describe "a producer as a source" do
    test "events become a stream that ends with the producer and are requested in bounded batches" do
      {:ok, _} = run(producer(limit: 5_000), subscribe: [partition: 1])
      got = drain()
      assert Enum.map(got, &elem(&1, 0)) == Enum.to_list(0..4_999)
      times = Enum.map(got, &elem(&1, 1))
      assert times == Enum.sort(Enum.uniq(times))
      assert_received {:subscribed, _, [partition: 1, max_demand: 1_000, min_demand: 500]}
      asks = asks()
      assert Enum.all?(asks, &(&1 <= 1_000))
      assert length(asks) <= 1 + 5_000 / 500
    end

    test "respects max_demand and min_demand" do
      {:ok, _} = run(producer(limit: 100), subscribe: [max_demand: 10, min_demand: 8])
      assert length(drain()) == 100
      assert [10 | asks] = asks()
      assert Enum.all?(asks, &(&1 in 2..10))
    end

    test "messages keep their times, and other events get a time after the previous one" do
      event = &%Situ.Message{data: &1, originating_time: 1_000 + &1}
      {:ok, _} = run(producer(limit: 20, event: event))
      assert drain() == for(i <- 0..19, do: {i, 1_000 + i})
    end

    test "the component reports messages that are out of order" do
      event = &%Situ.Message{data: &1, originating_time: 1_000 - &1}

      assert {:error, %{code: :time_not_increasing}} = run(producer(limit: 20, event: event))
    end

    test "several producers form one stream, which ends with the last producer" do
      a = producer(limit: 300)
      b = producer(from: 1_000, limit: 1_400)
      {:ok, _} = run([a, b])
      values = Enum.map(drain(), &elem(&1, 0))
      assert Enum.sort(values) == Enum.to_list(0..299) ++ Enum.to_list(1_000..1_399)
      assert Enum.filter(values, &(&1 < 1_000)) == Enum.to_list(0..299)
    end

    test "a function starts the producers with the source" do
      me = self()

      start = fn ->
        send(me, {:called_by, self()})
        [producer(limit: 3), producer(from: 10, limit: 12)]
      end

      # The producers report to the process that starts them.
      assert {:ok, _} = run(start)
      assert Enum.sort(Enum.map(drain(), &elem(&1, 0))) == [0, 1, 2, 10, 11]
      assert_received {:called_by, pid} when pid != me
      refute_received {:called_by, _}
    end

    test "a function that returns no producer fails the start with an error" do
      assert {:error, %Situ.Error{what: what}} = run(fn -> :no_such_process end)
      assert what =~ "cannot subscribe to :no_such_process: process not found"
    end

    test "a normal end completes the stream" do
      for finish <- [{:cancel, :normal}, {:cancel, {:shutdown, :done}}, {:exit, :shutdown}] do
        assert {:ok, _} = run(producer(limit: 3, finish: finish))
        assert length(drain()) == 3
      end
    end

    test "any other end fails the pipeline and reports the reason" do
      for finish <- [{:cancel, {:down, :disk_full}}, {:exit, :disk_full}, {:exit, :kill}] do
        assert {:error, error} = run(producer(limit: 3, finish: finish))
        assert error.code == :producer_failed
        assert error.what =~ if(finish == {:exit, :kill}, do: "killed", else: "disk_full")
        assert length(drain()) == 3
      end

      # A partition dispatcher sends this to a consumer that names no partition.
      refused = ArgumentError.exception("the :partition option is required")
      assert {:error, error} = run(producer(limit: 0, finish: {:cancel, refused}))
      assert error.what =~ "the :partition option is required"
      assert error.fix =~ "partition:"
    end

    test "with cancel: :temporary a failure ends only the subscription" do
      good = producer(limit: 5)
      bad = producer(limit: 5, from: 2, finish: {:exit, :disk_full})
      assert {:ok, _} = run([good, bad], subscribe: [cancel: :temporary])
      assert length(drain()) == 8
    end

    test "with on_error: :skip the stream completes after a failure" do
      assert {:ok, _} = run(producer(limit: 3, finish: {:exit, :disk_full}), on_error: :skip)
      assert length(drain()) == 3
    end

    test "stopping the pipeline cancels the subscription" do
      producer = producer(limit: 100_000_000)
      {:ok, p} = Pipeline.start(fn p -> p |> GenStage.from(producer) |> Situ.each(& &1) end, [])
      assert_receive {:asked, _}, 10_000
      {:ok, _} = Pipeline.stop(p)
      assert_receive {:cancelled, :normal}, 10_000
    end

    test "a slow pipeline requests no more than its window" do
      me = self()
      producer = producer(limit: 100_000)

      {:ok, p} =
        Pipeline.start(
          fn p ->
            p
            |> GenStage.from(producer, subscribe: [max_demand: 50])
            |> Situ.each(
              fn _ ->
                send(me, {:stuck, self()})
                receive do: (:go_on -> :ok)
              end,
              policy: Delivery.throttle(10)
            )
          end,
          []
        )

      assert_receive {:stuck, _}, 10_000
      {:ok, %{edges: _}} = {:ok, Pipeline.info(p)}
      assert Enum.sum(asks()) <= 50 + 10 + 10
      Process.exit(p, :kill)
    end

    test "a missing producer or a bad option fails the start with an error" do
      for {producer, opts, code} <- [
            {:nobody_here, [], :no_producer},
            {self(), [max_demand: 0], :bad_subscription},
            {self(), [max_demand: 3, min_demand: 3], :bad_subscription},
            {self(), [max_demand: :lots], :bad_subscription}
          ] do
        assert {:error, %{code: ^code}} =
                 Pipeline.run(fn p -> GenStage.from(p, producer, subscribe: opts) end)
      end
    end
  end

  describe "a source that waits for producers (Flow.into_stages)" do
    setup do
      me = self()

      {:ok, p} =
        Pipeline.start(
          fn p ->
            p |> GenStage.from([], name: "In") |> Situ.each(&send(me, {:got, &1, 0}), async: true)
          end,
          []
        )

      {:ok, {pid, _}} = GenStage.subscription(p, "In")
      %{p: p, pid: pid}
    end

    test "accepts producers named in a call or a cast", %{p: p, pid: pid} do
      a = producer(limit: 10)
      b = producer(from: 100, limit: 110)
      assert {:ok, ref} = GenServer.call(pid, {:"$subscribe", nil, a, [max_demand: 4]})
      assert is_reference(ref)
      GenServer.cast(pid, {:"$subscribe", nil, b, []})
      got = for _ <- 1..20, do: assert_receive({:got, _, _}, 10_000) |> elem(1)
      assert Enum.sort(got) == Enum.to_list(0..9) ++ Enum.to_list(100..109)
      assert_received {:subscribed, ^a, [max_demand: 4, min_demand: 2]}
      assert {:ok, _} = Pipeline.stop(p)
    end

    test "refuses an invalid producer or subscription", %{p: p, pid: pid} do
      assert {:error, %{code: :no_producer}} =
               GenServer.call(pid, {:"$subscribe", nil, :nobody_here, []})

      assert {:error, %{code: :bad_subscription}} =
               GenServer.call(pid, {:"$subscribe", nil, self(), :x})

      assert {:error, %{code: :unknown_request}} = GenServer.call(pid, :hello)
      GenServer.cast(pid, :hello)
      assert {:ok, _} = Pipeline.stop(p)
    end
  end

  # Makes this test process a consumer.
  defp subscribe(pid, opts, tag \\ make_ref()) do
    send(pid, {:"$gen_producer", {self(), tag}, {:subscribe, nil, opts}})
    tag
  end

  defp ask(pid, tag, n), do: send(pid, {:"$gen_producer", {self(), tag}, {:ask, n}})

  # Starts a counting source whose clock waits until the consumer has subscribed.
  defp count(n \\ 10) do
    clock = Clock.manual(0)

    {:ok, p} =
      Pipeline.start(
        fn p -> p |> Situ.source(Count, count: n, interval: 20_000_000, name: "C") end,
        pipeline: [clock: clock]
      )

    {:ok, {pid, opts}} = GenStage.subscription(p, "C")
    %{p: p, pid: pid, opts: opts, clock: clock}
  end

  describe "a consumer of an output" do
    test "receives at most the requested number of events, then the closing mark" do
      %{p: p, pid: pid, opts: opts, clock: clock} = count()
      ref = subscribe(pid, [max_demand: 3] ++ opts)
      refute_received {:"$gen_consumer", _, _}
      ask(pid, ref, 3)
      Clock.advance(clock, 1_000_000_000)
      got = events(pid, ref, 3)
      ask(pid, ref, 100)
      got = got ++ events(pid, ref, :closed)
      data = Enum.map(got, & &1.data)
      assert data == Enum.to_list(hd(data)..9)
      Pipeline.await(p, 30_000)
    end

    test "is identified by its pid and tag, so another consumer's demand does not count" do
      %{p: p, pid: pid, opts: opts, clock: clock} = count()
      subscribe(pid, opts, 2)
      me = self()

      other =
        spawn_link(fn ->
          subscribe(pid, opts, 2)
          ask(pid, 2, 5)
          # When this call returns, the producer has handled both requests.
          GenServer.call(pid, :"$estimate_buffered_count")
          send(me, :asked)
          send(me, {:other, events(pid, 2, 5)})
        end)

      monitor = Process.monitor(other)
      # A consumer receives no message that was emitted before it subscribed.
      assert_receive :asked, 30_000
      Clock.advance(clock, 1_000_000_000)
      assert_receive {:DOWN, ^monitor, _, _, _} when is_reference(monitor), 30_000
      assert_received {:other, five} when length(five) == 5
      assert GenServer.call(pid, :"$estimate_buffered_count") >= 0
      refute_received {:"$gen_consumer", {_, 2}, _}
      Process.exit(p, :kill)
    end

    test "cannot widen an edge of the pipeline by using the edge's number" do
      me = self()

      {:ok, p} =
        Pipeline.start(
          fn p ->
            p
            |> Situ.source(Count, count: 10_000, interval: 1, name: "C")
            |> Situ.each(
              fn _ ->
                send(me, {:stuck, self()})
                receive do: (:go_on -> :ok)
              end,
              policy: Delivery.throttle(10)
            )
          end,
          pipeline: [replay: [speed: :max]]
        )

      assert_receive {:stuck, _}, 10_000
      {:ok, {pid, _}} = GenStage.subscription(p, "C")
      for tag <- 0..5, do: ask(pid, tag, 5_000)
      GenServer.call(pid, :"$estimate_buffered_count")
      assert [%{queue: queue}] = Pipeline.info(p).edges
      assert queue <= 20
      Process.exit(p, :kill)
    end

    test "misses no event of an accumulating output when it subscribes late" do
      {:ok, p} =
        Pipeline.start(
          fn p ->
            p |> Situ.from_enumerable(0..1999, every: 10) |> GenStage.accumulate(name: "Out")
          end,
          pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
        )

      {:ok, {pid, opts}} = GenStage.subscription(p, "Out")
      assert GenServer.call(pid, :"$estimate_buffered_count") == 0
      ref = subscribe(pid, opts)
      ask(pid, ref, 5_000)
      assert Pipeline.state(p) == :running
      refute_received {:"$gen_consumer", _, _}
      # GenStage.demand(pid, :forward) sends this.
      GenServer.cast(pid, {:"$demand", :forward})
      assert Enum.map(events(pid, ref, :closed), & &1.data) == Enum.to_list(0..1_999)
      assert {:ok, _} = Pipeline.await(p, 30_000)
    end

    test "an accumulating output waits indefinitely for its consumer" do
      {:ok, p} =
        Pipeline.start(
          fn p ->
            p |> Situ.from_enumerable(0..99, every: 10) |> GenStage.accumulate(name: "Out")
          end,
          pipeline: [replay: [interval: {0, :unbounded}, speed: :max], stop_timeout: 50]
        )

      {:ok, {pid, opts}} = GenStage.subscription(p, "Out")
      monitor = Process.monitor(pid)
      # This is many times the stop timeout.
      refute_receive {:DOWN, ^monitor, _, _, _}, 300
      ref = subscribe(pid, opts)
      ask(pid, ref, 5_000)
      GenServer.cast(pid, {:"$demand", :forward})
      assert Enum.map(events(pid, ref, :closed), & &1.data) == Enum.to_list(0..99)
      assert {:ok, %{errors: []}} = Pipeline.await(p, 30_000)
    end

    test "a consumer may subscribe to an accumulating output after all sources have ended" do
      {:ok, p} =
        Pipeline.start(
          fn p ->
            p |> Situ.from_enumerable(0..4, every: 10) |> GenStage.accumulate(name: "Out")
          end,
          pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
        )

      await_stopping(p)
      {:ok, {pid, opts}} = GenStage.subscription(p, "Out")
      ref = subscribe(pid, opts)
      ask(pid, ref, 100)
      GenServer.cast(pid, {:"$demand", :forward})
      assert Enum.map(events(pid, ref, :closed), & &1.data) == [0, 1, 2, 3, 4]
      assert {:ok, %{errors: []}} = Pipeline.await(p, 30_000)
    end

    defp await_stopping(p), do: if(Pipeline.state(p) != :stopping, do: await_stopping(p))

    test "an accumulating output does not prevent a pipeline from ending" do
      {:ok, p} =
        Pipeline.start(
          fn p ->
            p |> Situ.from_enumerable(0..99, every: 10) |> GenStage.accumulate(name: "Out")
          end,
          pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
        )

      assert {:ok, _} = Pipeline.stop(p)
    end

    test "is notified when the component fails" do
      {:ok, p} =
        Pipeline.start(
          fn p ->
            p
            |> Situ.from_enumerable(0..999, every: 10)
            |> GenStage.accumulate(name: "Gate")
            |> Situ.map(fn v -> if v == 500, do: raise("bang"), else: v end,
              name: "Out",
              async: true
            )
          end,
          pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
        )

      {:ok, {pid, opts}} = GenStage.subscription(p, "Out")
      {:ok, {gate, _}} = GenStage.subscription(p, "Gate")
      ref = subscribe(pid, opts)
      ask(pid, ref, 5_000)
      GenServer.cast(gate, {:"$demand", :forward})
      assert_receive {:"$gen_consumer", {^pid, ^ref}, {:cancel, %Situ.Error{} = error}}, 10_000
      assert error.code == :component_failed
      assert {:error, _} = Pipeline.await(p, 30_000)
    end

    test "is notified when another part of the pipeline fails" do
      {:ok, p} =
        Pipeline.start(
          fn p ->
            # The other part gets no further than the window of the output that waits for its consumer.
            stream = Situ.from_enumerable(p, Stream.iterate(0, &(&1 + 1)), every: 10)
            Situ.each(stream, fn v -> if v == 5_000, do: raise("bang") end)
            GenStage.accumulate(stream, name: "Out")
          end,
          pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
        )

      {:ok, {pid, opts}} = GenStage.subscription(p, "Out")
      ref = subscribe(pid, opts)
      GenServer.cast(pid, {:"$demand", :forward})
      ask(pid, ref, 50_000)
      assert {:error, _} = Pipeline.await(p, 30_000)
      assert {:cancel, %Situ.Error{code: :component_failed}} = last_word(pid, ref)
    end

    defp last_word(pid, ref) do
      receive do
        {:"$gen_consumer", {^pid, ^ref}, {:cancel, _} = word} -> word
        {:"$gen_consumer", {^pid, ^ref}, _events} -> last_word(pid, ref)
      after
        10_000 -> flunk("no end")
      end
    end

    test "an unknown output is refused with a reason, and every cancel is acknowledged" do
      %{p: p, pid: pid, opts: opts} = count()
      subscribe(pid, [output: :nope], :a)
      assert_receive {:"$gen_consumer", {^pid, :a}, {:cancel, %Situ.Error{code: :unknown_output}}}
      subscribe(pid, opts, :b)
      send(pid, {:"$gen_producer", {self(), :b}, {:cancel, :enough}})
      assert_receive {:"$gen_consumer", {^pid, :b}, {:cancel, :enough}}

      ref = subscribe(pid, opts)
      # GenStage.cancel/2, called by another process, sends this.
      spawn_link(fn -> send(pid, {:"$gen_producer", {self(), ref}, {:cancel, :enough}}) end)
      assert_receive {:"$gen_consumer", {^pid, ^ref}, {:cancel, :enough}}
      {:ok, _} = Pipeline.stop(p)
    end

    test "malformed messages are refused or ignored and never crash the stage" do
      %{p: p, pid: pid, opts: opts} = count()
      stage = Process.monitor(pid)

      subscribe(pid, :x, :bad)
      assert_receive {:"$gen_consumer", {^pid, :bad}, {:cancel, %{code: :bad_subscription}}}
      ask(pid, :nobody, 3)
      assert_receive {:"$gen_consumer", {^pid, :nobody}, {:cancel, :unknown_subscription}}

      for bad <- [:lots, -5, 1.5, nil] do
        ref = subscribe(pid, opts)
        ask(pid, ref, bad)
        assert_receive {:"$gen_consumer", {^pid, ^ref}, {:cancel, %{code: :bad_request}}}
      end

      ref = subscribe(pid, opts)
      subscribe(pid, opts, ref)
      assert_receive {:"$gen_consumer", {^pid, ^ref}, {:cancel, :duplicated_subscription}}
      ask(pid, ref, 0)

      for strange <- [
            {:"$gen_producer", :x, :y},
            {:"$gen_consumer", :x, :y},
            {:"$gen_consumer", {self(), :t}, :z},
            {:"$gen_producer", {self(), 7}, {:ask, 1}},
            :hello
          ],
          do: send(pid, strange)

      assert {:error, %{code: :unknown_request}} = GenServer.call(pid, :hello)
      assert GenServer.call(pid, {:"$info", :hello}) == :ok
      assert GenServer.call(pid, :"$estimate_buffered_count") == 0
      GenServer.cast(pid, :hello)
      GenServer.cast(pid, {:"$info", :hello})
      GenServer.cast(pid, {:"$demand", :sometimes})
      GenServer.cast(pid, {:"$demand", :accumulate})
      GenServer.cast(pid, {:"$demand", :forward})
      assert GenServer.call(pid, :"$estimate_buffered_count") == 0
      refute_received {:DOWN, ^stage, _, _, _}
      assert Pipeline.state(p) == :running
      {:ok, _} = Pipeline.stop(p)
    end
  end

  defp events(pid, ref, n), do: events(pid, ref, n, [])
  defp events(_pid, _ref, 0, acc), do: acc

  defp events(pid, ref, n, acc) do
    receive do
      {:"$gen_consumer", {^pid, ^ref}, {:cancel, {:shutdown, {:closed, _}}}} ->
        acc

      {:"$gen_consumer", {^pid, ^ref}, list} when is_list(list) ->
        events(pid, ref, less(n, length(list)), acc ++ list)
    after
      30_000 -> flunk("no more events after #{length(acc)}")
    end
  end

  defp less(:closed, _), do: :closed
  defp less(n, got) when got <= n, do: n - got

  defp drain do
    receive do
      {:got, v, t} -> [{v, t} | drain()]
    after
      0 -> []
    end
  end

  defp asks do
    receive do
      {:asked, n} -> [n | asks()]
    after
      0 -> []
    end
  end
end
