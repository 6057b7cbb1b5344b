defmodule Situ.Broadway.GenStageTest do
  # The core's side of the protocol of GenStage against the real GenStage, Flow and Broadway.
  use ExUnit.Case, async: false
  use Situ.Test.Property

  alias Situ.{GenStage, Pipeline}
  alias Situ.Ports.Dispatcher.{Broadcast, Demand, Partition}

  @moduletag :capture_log
  @replay [replay: [interval: {0, :unbounded}, speed: :max]]

  defmodule Consumer do
    use Elixir.GenStage

    @impl true
    def init({test, opts}), do: {:consumer, test, opts}

    @impl true
    def handle_events(events, _from, test) do
      send(test, {:got, self(), Enum.map(events, & &1.data)})
      {:noreply, [], test}
    end

    @impl true
    def handle_cancel({_, reason}, _from, test) do
      send(test, {:ended, self(), reason})
      {:noreply, [], test}
    end
  end

  defmodule Producer do
    # A Broadway producer of the numbers of a list, which sends what is not acknowledged again to the next consumer.
    use Elixir.GenStage
    @behaviour Broadway.Producer
    @behaviour Broadway.Acknowledger

    @impl true
    def init(opts), do: {:producer, Map.new(opts) |> Map.merge(%{demand: 0, sent: %{}})}

    @impl Broadway.Acknowledger
    def ack(queue, good, bad) do
      numbers = &for(%Broadway.Message{acknowledger: {_, _, n}} = m <- &1, do: {n, m.status})
      Elixir.GenStage.call(queue, {:ack, numbers.(good), numbers.(bad)})
    end

    @impl true
    def handle_call({:ack, good, bad}, _from, state) do
      send(state.test, {:acked, good, bad})
      sent = Map.drop(state.sent, Enum.map(good ++ bad, &elem(&1, 0)))
      {:reply, :ok, [], %{state | sent: sent}}
    end

    @impl true
    def handle_demand(n, state), do: deliver(%{state | demand: state.demand + n})

    @impl true
    def handle_cancel(_reason, _from, state) do
      waiting = Enum.sort(Map.keys(state.sent)) ++ state.numbers
      {:noreply, [], %{state | numbers: waiting, sent: %{}, demand: 0}}
    end

    defp deliver(state) do
      {now, later} = Enum.split(state.numbers, state.demand)

      events = for n <- now, do: %Broadway.Message{data: n, acknowledger: {__MODULE__, self(), n}}

      sent = Map.merge(state.sent, Map.new(now, &{&1, true}))

      {:noreply, events,
       %{state | numbers: later, sent: sent, demand: state.demand - length(now)}}
    end
  end

  defp start(dispatcher, n, opts \\ []) do
    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.from_enumerable(1..n//1, every: 10)
          |> GenStage.dispatch(dispatcher, [name: "Out", demand: :accumulate] ++ opts)
        end,
        pipeline: @replay
      )

    {:ok, {pid, sub}} = GenStage.subscription(p, "Out")
    {p, pid, sub}
  end

  defp consumer({_p, pid, sub}, opts) do
    {:ok, consumer} = Elixir.GenStage.start(Consumer, {self(), []})

    {:ok, _} =
      Elixir.GenStage.sync_subscribe(consumer, [to: pid, cancel: :temporary] ++ opts ++ sub)

    consumer
  end

  defp collect(consumers, got \\ %{})
  defp collect([], got), do: got

  defp collect(consumers, got) do
    receive do
      {:got, consumer, data} ->
        collect(consumers, Map.update(got, consumer, data, &(&1 ++ data)))

      {:ended, consumer, _reason} ->
        collect(List.delete(consumers, consumer), got)
    after
      30_000 -> flunk("not closed: #{inspect(consumers)}")
    end
  end

  test "consumers share the messages of :demand" do
    out = {p, pid, _} = start(:demand, 10_000)
    consumers = for max <- [50, 50, 200], do: consumer(out, max_demand: max, min_demand: 10)
    Elixir.GenStage.demand(pid, :forward)
    got = collect(consumers)
    assert got |> Map.values() |> Enum.concat() |> Enum.sort() == Enum.to_list(1..10_000)
    assert {:ok, %{errors: []}} = Pipeline.await(p, 30_000)
  end

  test "consumers receive what they select of :broadcast" do
    out = {p, pid, _} = start(:broadcast, 5_000)
    a = consumer(out, max_demand: 30)
    b = consumer(out, selector: &(rem(&1.data, 4) == 0))
    Elixir.GenStage.demand(pid, :forward)
    got = collect([a, b])
    assert got[a] == Enum.to_list(1..5_000)
    assert got[b] == Enum.filter(1..5_000, &(rem(&1, 4) == 0))
    assert {:ok, %{errors: []}} = Pipeline.await(p, 30_000)
  end

  test "consumers receive their partitions" do
    out = {p, pid, _} = start({:partition, partitions: 3, hash: &{&1, rem(&1.data, 3)}}, 5_000)
    consumers = for i <- 0..2, do: consumer(out, partition: i, max_demand: 40)
    Elixir.GenStage.demand(pid, :forward)
    got = collect(consumers)

    for {consumer, i} <- Enum.with_index(consumers),
        do: assert(got[consumer] == Enum.filter(1..5_000, &(rem(&1, 3) == i)))

    assert {:ok, %{errors: []}} = Pipeline.await(p, 30_000)
  end

  test "a Flow reads an output with :demand in several stages" do
    {p, pid, _} = start(:demand, 2_000)

    me = self()

    {:ok, _flow} =
      [pid]
      |> Flow.from_stages(stages: 3, max_demand: 100)
      |> Flow.map(&send(me, {:flow, &1.data}))
      |> Flow.start_link()

    for n <- 1..2_000, do: assert_receive({:flow, ^n}, 10_000)
    assert {:ok, %{errors: []}} = Pipeline.await(p, 30_000)
  end

  # The real dispatchers as models: they send to this process, with the number of the consumer as reference.
  defp real(Demand), do: Elixir.GenStage.DemandDispatcher
  defp real(Broadcast), do: Elixir.GenStage.BroadcastDispatcher
  defp real(Partition), do: Elixir.GenStage.PartitionDispatcher

  defp dispatcher_options(Partition), do: [partitions: 3, hash: &{&1, rem(&1.data, 3)}]
  defp dispatcher_options(Demand), do: [max_demand: 1_000]
  defp dispatcher_options(Broadcast), do: []
  defp options(Partition, i), do: [partition: i]
  defp options(_module, _i), do: []

  # Broadcast knows consumers by their pids; these processes ignore what they receive.
  defp key(Broadcast, i) do
    with nil <- Process.get({:consumer, i}),
         do: Process.put({:consumer, i}, {spawn_link(fn -> Process.sleep(:infinity) end), i})

    Process.get({:consumer, i})
  end

  defp key(_module, i), do: {self(), i}

  defp received do
    receive do
      {:"$gen_consumer", {_, i}, events} -> [{i, Enum.map(events, & &1.data)} | received()]
    after
      0 -> []
    end
  end

  defp sum_up(parts),
    do:
      Enum.group_by(parts, &elem(&1, 0), &elem(&1, 1))
      |> Map.new(fn {i, p} -> {i, Enum.concat(p)} end)

  # The real one sends to pids, so a broadcast is compared by its room only.
  for module <- [Demand, Broadcast, Partition] do
    property "#{inspect(module)} gives consumers what GenStage's gives them", numtests: 300 do
      forall steps <- list({integer(0, 2), integer(1, 9)}) do
        module = unquote(module)

        {:ok, ours} =
          module.new(if module == Partition, do: dispatcher_options(Partition), else: [])

        {:ok, real} = real(module).init(dispatcher_options(module))

        {ours, real} =
          Enum.reduce(0..2, {ours, real}, fn i, {ours, real} ->
            {:ok, ours} = module.subscribe(ours, key(module, i), options(module, i))
            {:ok, 0, real} = real(module).subscribe(options(module, i), key(module, i), real)
            {ours, real}
          end)

        Enum.reduce(steps, {ours, real, 0, 0}, fn {i, n}, {ours, real, room, last} ->
          ours = module.add_demand(ours, key(module, i), n)
          {sent, [], ours} = module.take(ours)
          {:ok, more, real} = real(module).ask(n, key(module, i), real)
          room = room + more
          assert module.available_room(ours) == room
          # As a producer does that answers part of its demand.
          count = div(room * n, 9)
          events = for k <- 1..count//1, do: %Situ.Message{data: last + k, originating_time: k}

          {:ok, [], real} =
            if count > 0, do: real(module).dispatch(events, count, real), else: {:ok, [], real}

          {[], ours} = module.push(ours, events)
          {more, [], ours} = module.take(ours)
          parts = for {{_, i}, messages} <- sent ++ more, do: {i, Enum.map(messages, & &1.data)}
          if module != Broadcast, do: assert(sum_up(parts) == sum_up(received()))
          assert module.available_room(ours) == room - count
          {ours, real, room - count, last + count}
        end)
      end
    end
  end

  defp acked(good, bad) do
    receive do
      {:acked, more, worse} -> acked(good ++ more, bad ++ worse)
    after
      0 -> {Enum.map(good, &elem(&1, 0)), bad}
    end
  end

  defp await_acked(n, good \\ [], bad \\ []) do
    if length(Enum.uniq(good ++ bad)) >= n do
      {good, bad}
    else
      assert_receive {:acked, more, worse}, 10_000
      numbers = &Enum.map(&1, fn {n, _status} -> n end)
      await_acked(n, good ++ numbers.(more), bad ++ numbers.(worse))
    end
  end

  test "the messages of a Broadway producer are acknowledged, and those that fail are failed" do
    {:ok, queue} = Elixir.GenStage.start(Producer, numbers: Enum.to_list(1..2_000), test: self())

    {:ok, p} =
      Pipeline.start(
        fn p ->
          events = GenStage.from(p, queue)

          bad = fn %Broadway.Message{data: n} ->
            if rem(n, 100) == 7, do: raise("bang"), else: n
          end

          GenStage.acknowledge(events, Situ.map(events, bad, on_error: :skip))
        end,
        []
      )

    {good, bad} = await_acked(2_000)
    assert bad == for(i <- 0..19, do: i * 100 + 7)
    assert good == Enum.to_list(1..2_000) -- bad
    assert {:ok, _} = Pipeline.stop(p)
  end

  test "a Broadway producer delivers again what a killed pipeline had not acknowledged" do
    {:ok, queue} = Elixir.GenStage.start(Producer, numbers: Enum.to_list(1..5_000), test: self())

    table = :ets.new(:effects, [:public])

    build = fn p ->
      events = GenStage.from(p, queue, subscribe: [max_demand: 50])
      done = Situ.each(events, &:ets.insert(table, {&1.data}), async: true)
      GenStage.acknowledge(events, done)
    end

    for ms <- 1..8 do
      {:ok, p} = Pipeline.start(build, [])
      monitor = Process.monitor(p)
      Process.sleep(ms)
      Process.exit(p, :kill)
      assert_receive {:DOWN, ^monitor, _, _, _}
    end

    {early, []} = acked([], [])
    for n <- early, do: assert(:ets.member(table, n))
    {:ok, p} = Pipeline.start(build, [])
    # A killed pipeline may still have acknowledged events that were delivered again.
    {good, []} = await_acked(5_000, early)
    assert Enum.sort(Enum.uniq(good)) == Enum.to_list(1..5_000)
    assert :ets.info(table, :size) == 5_000
    assert {:ok, _} = Pipeline.stop(p)
  end

  test "Broadway's own acknowledger notifies its caller" do
    ref = make_ref()

    build = fn i ->
      %Broadway.Message{
        data: i,
        acknowledger: {Broadway.CallerAcknowledger, {self(), ref}, :ok}
      }
    end

    {:ok, stage} = Elixir.GenStage.from_enumerable(Enum.map(1..10, build), demand: :forward)

    assert {:ok, _} =
             Pipeline.run(fn p ->
               events = GenStage.from(p, stage)
               GenStage.acknowledge(events, Situ.map(events, & &1.data))
             end)

    assert_receive {:ack, ^ref, good, []}
    assert Enum.map(good, & &1.data) == Enum.take(1..10, length(good))
  end
end
