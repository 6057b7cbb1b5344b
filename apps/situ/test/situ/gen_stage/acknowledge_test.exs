defmodule Situ.GenStage.AcknowledgeTest do
  use ExUnit.Case, async: true

  alias Situ.{GenStage, Pipeline}

  @moduletag :capture_log

  defmodule Message do
    # The fields of a Broadway message that concern its acknowledgement.
    defstruct [:data, :acknowledger, status: :ok]
  end

  defmodule Queue do
    # A producer that sends what has not been acknowledged again to its next consumer, as a message queue does.
    use GenServer

    def start(items, opts \\ []), do: GenServer.start(__MODULE__, {items, opts})
    def report(queue), do: GenServer.call(queue, :report)

    # The callback of an acknowledger.
    def ack(queue, successful, failed) do
      ids = &for(%{acknowledger: {_, _, id}} = m <- &1, do: {id, m.status})
      GenServer.call(queue, {:ack, ids.(successful), ids.(failed)})
    end

    @impl true
    def init({items, opts}) do
      waiting = for i <- items, do: {i, i}

      {:ok,
       %{waiting: waiting, sent: %{}, acked: [], failed: [], demand: 0, sub: nil, opts: opts}}
    end

    @impl true
    def handle_call({:ack, good, bad}, _from, state) do
      ids = Enum.map(good ++ bad, &elem(&1, 0))
      true = Enum.all?(ids, &is_map_key(state.sent, &1)) or state.opts[:loose] == true
      sent = Map.drop(state.sent, ids)
      state = %{state | sent: sent, acked: state.acked ++ good, failed: state.failed ++ bad}
      {:reply, :ok, deliver(state)}
    end

    def handle_call(:report, _from, state),
      do: {:reply, Map.take(state, [:acked, :failed, :sent, :waiting]), state}

    @impl true
    def handle_info({:"$gen_producer", {pid, ref}, {:subscribe, _, _}}, state) do
      Process.monitor(pid)
      {:noreply, %{state | sub: {pid, ref}, demand: 0}}
    end

    def handle_info({:"$gen_producer", sub, {:ask, n}}, %{sub: sub} = state),
      do: {:noreply, deliver(%{state | demand: state.demand + n})}

    def handle_info({:"$gen_producer", sub, {:cancel, _}}, %{sub: sub} = state),
      do: {:noreply, redeliver(state)}

    def handle_info({:DOWN, _, _, pid, _}, %{sub: {pid, _}} = state),
      do: {:noreply, redeliver(state)}

    def handle_info(_other, state), do: {:noreply, state}

    defp redeliver(state) do
      again = Enum.sort(Map.to_list(state.sent))
      %{state | sub: nil, sent: %{}, waiting: again ++ state.waiting}
    end

    defp deliver(%{sub: nil} = state), do: state

    defp deliver(%{sub: {pid, ref}} = state) do
      most = min(state.demand, (state.opts[:prefetch] || 1_000_000) - map_size(state.sent))
      {now, later} = Enum.split(state.waiting, max(most, 0))

      events =
        for {id, data} <- now, do: %Message{data: data, acknowledger: {__MODULE__, self(), id}}

      if events != [], do: send(pid, {:"$gen_consumer", {self(), ref}, events})
      state = %{state | waiting: later, sent: Map.merge(state.sent, Map.new(now))}
      state = %{state | demand: state.demand - length(now)}

      if state.opts[:finish] && state.waiting == [] && state.sent == %{},
        do: send(pid, {:"$gen_consumer", {self(), ref}, {:cancel, :normal}})

      state
    end
  end

  defp queue(items, opts \\ [finish: true]) do
    {:ok, queue} = Queue.start(items, opts)
    queue
  end

  defp ids(list), do: Enum.map(list, &elem(&1, 0))

  defp await_report(queue, ready?, tries \\ 2_000) do
    report = Queue.report(queue)

    cond do
      ready?.(report) ->
        report

      tries == 0 ->
        flunk("not acknowledged: #{inspect(report, limit: 30)}")

      true ->
        Process.sleep(5)
        await_report(queue, ready?, tries - 1)
    end
  end

  test "events are acknowledged in order once they have passed the pipeline" do
    queue = queue(1..3_000)
    me = self()

    assert {:ok, %{errors: []}} =
             Pipeline.run(fn p ->
               events = GenStage.from(p, queue)

               done =
                 events |> Situ.map(& &1.data) |> Situ.each(&send(me, {:done, &1}), async: true)

               GenStage.acknowledge(events, done)
             end)

    assert %{acked: acked, failed: [], sent: sent} = Queue.report(queue)
    assert ids(acked) == Enum.to_list(1..3_000)
    assert sent == %{}
    for n <- 1..3_000, do: assert_received({:done, ^n})
  end

  test "an event is not acknowledged before its function has returned" do
    queue = queue(1..10, prefetch: 5)
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          events = GenStage.from(p, queue)

          done =
            Situ.each(
              events,
              fn %{data: n} ->
                send(me, {:at, n, self()})
                receive do: (:go_on -> :ok)
              end,
              async: true
            )

          GenStage.acknowledge(events, done)
        end,
        []
      )

    assert_receive {:at, 1, pid}
    assert Queue.report(queue).acked == []
    send(pid, :go_on)
    assert_receive {:at, 2, ^pid}
    send(pid, :go_on)

    for n <- 3..10,
        do:
          (
            assert_receive {:at, ^n, ^pid}
            send(pid, :go_on)
          )

    await_report(queue, &(ids(&1.acked) == Enum.to_list(1..10)))
    assert {:ok, _} = Pipeline.stop(p)
  end

  test "events are acknowledged as soon as the pipeline has taken them, on request" do
    queue = queue(1..50)

    assert {:ok, _} =
             Pipeline.run(fn p ->
               events = GenStage.from(p, queue)
               GenStage.acknowledge(events, events)
             end)

    assert ids(Queue.report(queue).acked) == Enum.to_list(1..50)
  end

  test "an event that a component with on_error: :skip drops has failed" do
    queue = queue(1..100, [])

    {:ok, p} =
      Pipeline.start(
        fn p ->
          events = GenStage.from(p, queue)
          bad = &if(rem(&1.data, 10) == 3, do: raise("bang"), else: &1.data)
          done = Situ.map(events, bad, on_error: :skip)
          GenStage.acknowledge(events, done)
        end,
        []
      )

    %{acked: acked, failed: failed} = await_report(queue, &(&1.sent == %{} and &1.waiting == []))
    assert ids(failed) == for(i <- 0..9, do: i * 10 + 3)
    assert Enum.all?(failed, &match?({_, {:failed, _}}, &1))
    assert ids(acked) == Enum.to_list(1..100) -- ids(failed)
    assert {:ok, _} = Pipeline.stop(p)
  end

  test "with missing: :successful, an event that a filter drops has succeeded" do
    queue = queue(1..101)

    assert {:ok, _} =
             Pipeline.run(fn p ->
               events = GenStage.from(p, queue)
               done = Situ.filter(events, &(rem(&1.data, 10) == 1))
               GenStage.acknowledge(events, done, missing: :successful)
             end)

    assert %{failed: [], acked: acked} = Queue.report(queue)
    assert ids(acked) == Enum.to_list(1..101)
  end

  test "with fail_after:, an event without a result fails, so that the producer goes on" do
    queue = queue(1..4, prefetch: 1, finish: true, loose: true)

    assert {:ok, _} =
             Pipeline.run(fn p ->
               events = GenStage.from(p, queue)
               done = Situ.filter(events, &(rem(&1.data, 2) == 0))
               GenStage.acknowledge(events, done, fail_after: Situ.Time.ms(30))
             end)

    assert %{acked: acked, failed: failed} = Queue.report(queue)
    assert {ids(acked), ids(failed)} == {[2, 4], [1, 3]}
  end

  test "with: receives the events of other producers" do
    me = self()

    assert {:ok, _} =
             Pipeline.run(fn p ->
               events = Situ.from_enumerable(p, 1..20, every: 10)
               done = Situ.map(events, &if(&1 == 7, do: raise("bang"), else: &1), on_error: :skip)
               GenStage.acknowledge(events, done, with: &send(me, {:ack, &1, &2}))
             end)

    assert received({[], []}) == {Enum.to_list(1..20) -- [7], [7]}
  end

  defp received({good, bad}) do
    receive do
      {:ack, more, worse} -> received({good ++ more, bad ++ worse})
    after
      0 -> {good, bad}
    end
  end

  test "an event without an acknowledger is an error" do
    assert {:error, %{code: :no_acknowledger, fix: fix}} =
             Pipeline.run(fn p ->
               events = Situ.from_enumerable(p, 1..20, every: 10)
               GenStage.acknowledge(events, events)
             end)

    assert fix =~ "with:"
  end

  # Effects outside the pipeline: a table that outlives it.
  defp pipeline(queue, table, map_opts) do
    fn p ->
      events = GenStage.from(p, queue, subscribe: [max_demand: 40])

      done =
        events
        |> Situ.map(& &1.data, [async: true] ++ map_opts)
        |> Situ.each(&:ets.update_counter(table, &1, 1, {&1, 0}), async: true)

      GenStage.acknowledge(events, done)
    end
  end

  test "after kills at any moment, nothing is acknowledged without its effect, and the rest comes again" do
    table = :ets.new(:effects, [:public, :ordered_set])
    # A killed pipeline may still acknowledge events that the queue has already taken back.
    queue = queue(1..20_000, loose: true)

    kills =
      Enum.reduce_while(Stream.iterate(1, &(&1 + 1)), 0, fn round, _kills ->
        {:ok, p} = Pipeline.start(pipeline(queue, table, []), [])
        monitor = Process.monitor(p)
        Process.sleep(rem(round * 7, 23))
        Process.exit(p, :kill)
        assert_receive {:DOWN, ^monitor, _, _, _}
        %{acked: acked, waiting: waiting} = Queue.report(queue)
        for {id, _} <- acked, do: assert(:ets.member(table, id))
        if round >= 40 or waiting == [], do: {:halt, round}, else: {:cont, round}
      end)

    assert kills > 3
    {:ok, p} = Pipeline.start(pipeline(queue, table, []), [])
    %{acked: acked} = await_report(queue, &(&1.waiting == [] and &1.sent == %{}))
    assert ids(acked) |> Enum.uniq() |> Enum.sort() == Enum.to_list(1..20_000)
    assert :ets.info(table, :size) == 20_000
    assert {:ok, _} = Pipeline.stop(p)
  end

  test "after kills of its components, which are restarted, everything is handled and acknowledged" do
    table = :ets.new(:effects, [:public, :ordered_set])
    queue = queue(1..8_000, [])
    settings = [pipeline: [max_restarts: 1_000]]
    {:ok, p} = Pipeline.start(pipeline(queue, table, on_error: :restart), settings)
    kill_some(p, 15)
    %{acked: acked, failed: []} = await_report(queue, &(&1.waiting == [] and &1.sent == %{}))
    assert ids(acked) |> Enum.uniq() |> Enum.sort() == Enum.to_list(1..8_000)
    assert :ets.info(table, :size) == 8_000
    assert {:ok, _} = Pipeline.stop(p)
  end

  defp kill_some(_p, 0), do: :ok

  defp kill_some(p, n) do
    case GenStage.subscription(p, "Map") do
      {:ok, {pid, _}} -> Process.exit(pid, :kill)
      _ -> :ok
    end

    Process.sleep(7)
    kill_some(p, n - 1)
  end
end
