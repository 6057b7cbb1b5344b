defmodule Situ.GenStage.DispatchTest do
  use ExUnit.Case, async: true

  alias Situ.{GenStage, Pipeline}

  @moduletag :capture_log
  @replay [replay: [interval: {0, :unbounded}, speed: :max]]

  defmodule Consumer do
    # Asks like a GenStage consumer: `max` first, and again what it has handled.
    use GenServer

    def start(pid, opts, max \\ 10),
      do: GenServer.start(__MODULE__, {pid, opts, max, self()})

    @impl true
    def init({pid, opts, max, test}) do
      ref = Process.monitor(pid)
      send(pid, {:"$gen_producer", {self(), ref}, {:subscribe, nil, [max_demand: max] ++ opts}})
      if max > 0, do: send(pid, {:"$gen_producer", {self(), ref}, {:ask, max}})
      {:ok, %{pid: pid, ref: ref, test: test, owed: max}}
    end

    @impl true
    def handle_info({:"$gen_consumer", {pid, ref}, {:cancel, reason}}, %{ref: ref} = state) do
      send(state.test, {:ended, self(), reason})
      {:noreply, %{state | pid: pid}}
    end

    def handle_info({:"$gen_consumer", {pid, ref}, messages}, %{ref: ref} = state) do
      n = length(messages)
      if n > state.owed, do: send(state.test, {:too_many, self()})
      send(state.test, {:got, self(), Enum.map(messages, & &1.data)})
      send(pid, {:"$gen_producer", {self(), ref}, {:ask, n}})
      {:noreply, state}
    end

    def handle_info(_other, state), do: {:noreply, state}
  end

  defp start(dispatcher, n, opts \\ []) do
    {opts, settings} = Keyword.split(opts, [:demand, :on_error])

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.from_enumerable(1..n//1, every: 10)
          |> GenStage.dispatch(dispatcher, [name: "Out"] ++ opts)
        end,
        pipeline: @replay ++ settings
      )

    {:ok, {pid, sub}} = GenStage.subscription(p, "Out")
    %{p: p, pid: pid, sub: sub}
  end

  defp consumer(%{pid: pid, sub: sub}, opts \\ [], max \\ 10) do
    {:ok, consumer} = Consumer.start(pid, opts ++ sub, max)
    consumer
  end

  # What each consumer has received, once all of these have ended.
  defp collect(consumers, got \\ %{})

  defp collect([], got),
    do: Map.new(got, fn {c, parts} -> {c, parts |> Enum.reverse() |> Enum.concat()} end)

  defp collect(consumers, got) do
    receive do
      {:got, consumer, data} ->
        collect(consumers, Map.update(got, consumer, [data], &[data | &1]))

      {:ended, consumer, {:shutdown, {:closed, _}}} ->
        collect(List.delete(consumers, consumer), got)

      {:too_many, _} ->
        flunk("more than was asked for")
    after
      30_000 -> flunk("not closed: #{inspect(consumers)}")
    end
  end

  test ":demand gives each message to one consumer" do
    out = start(:demand, 5_000)
    consumers = for max <- [10, 10, 100], do: consumer(out, [], max)
    got = collect(consumers)
    assert got |> Map.values() |> Enum.concat() |> Enum.sort() == Enum.to_list(1..5_000)
    assert map_size(got) == 3
    for {_, data} <- got, do: assert(data == Enum.sort(data))
    assert {:ok, %{errors: []}} = Pipeline.await(out.p, 30_000)
  end

  test ":demand loses nothing that was not sent to a consumer that dies" do
    out = start(:demand, 3_000)
    a = consumer(out)
    assert_receive {:got, ^a, first}
    Process.exit(a, :kill)
    before = first ++ drain(a)
    b = consumer(out)
    %{^b => data} = collect([b])
    # At most what the dead consumer had asked for is lost.
    missing = Enum.to_list(1..3_000) -- Enum.uniq(before ++ data)
    assert length(missing) <= 20
    assert before -- before -- data == []
    assert {:ok, %{errors: []}} = Pipeline.await(out.p, 30_000)
  end

  defp drain(consumer) do
    ref = Process.monitor(consumer)
    assert_receive {:DOWN, ^ref, _, _, _}
    drain_got(consumer)
  end

  defp drain_got(consumer) do
    receive do
      {:got, ^consumer, data} -> data ++ drain_got(consumer)
    after
      0 -> []
    end
  end

  test ":broadcast gives each message to every consumer that selects it" do
    out = start(:broadcast, 2_000, demand: :accumulate)
    a = consumer(out)
    b = consumer(out, [selector: &(rem(&1.data, 3) == 0)], 7)
    GenServer.cast(out.pid, {:"$demand", :forward})
    got = collect([a, b])
    assert got[a] == Enum.to_list(1..2_000)
    assert got[b] == Enum.filter(1..2_000, &(rem(&1, 3) == 0))
    assert {:ok, %{errors: []}} = Pipeline.await(out.p, 30_000)
  end

  test ":broadcast waits for the slowest consumer" do
    out = start(:broadcast, 2_000)
    slow = consumer(out, [], 0)
    GenServer.call(out.pid, :"$estimate_buffered_count")
    fast = consumer(out)
    refute_receive {:got, ^fast, _}, 100
    Process.exit(slow, :kill)
    assert %{^fast => data} = collect([fast])
    assert data == Enum.to_list(1..2_000)
    assert {:ok, _} = Pipeline.await(out.p, 30_000)
  end

  test "{:partition, ...} gives each message to the consumer of its partition" do
    out = start({:partition, partitions: [:odd, :even], hash: &split/1}, 4_000)
    refused = consumer(out)
    assert_receive {:ended, ^refused, %Situ.Error{code: :bad_subscription}}
    odd = consumer(out, partition: :odd)
    again = consumer(out, partition: :odd)
    assert_receive {:ended, ^again, %Situ.Error{code: :bad_subscription}}
    even = consumer(out, [partition: :even], 3)
    got = collect([odd, even])
    assert got[odd] == Enum.filter(1..4_000, &(rem(&1, 2) == 1 and rem(&1, 5) != 0))
    assert got[even] == Enum.filter(1..4_000, &(rem(&1, 2) == 0 and rem(&1, 5) != 0))
    assert {:ok, %{errors: []}} = Pipeline.await(out.p, 30_000)
  end

  defp split(%{data: n}) when rem(n, 5) == 0, do: :none
  defp split(%{data: n} = message) when rem(n, 2) == 1, do: {message, :odd}
  defp split(message), do: {message, :even}

  test "messages with equal data go to the same partition without hash:" do
    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.from_enumerable(Stream.cycle(~w[a b c d e f]) |> Stream.take(600), every: 10)
          |> GenStage.dispatch({:partition, partitions: 3}, name: "Out")
        end,
        pipeline: @replay
      )

    {:ok, {pid, sub}} = GenStage.subscription(p, "Out")
    consumers = for i <- 0..2, do: consumer(%{pid: pid, sub: sub}, partition: i)
    got = consumers |> collect() |> Map.values()
    assert got |> Enum.concat() |> length() == 600

    for {data, i} <- Enum.with_index(got), {other, j} <- Enum.with_index(got), i != j do
      assert MapSet.disjoint?(MapSet.new(data), MapSet.new(other))
    end
  end

  test "the pipeline waits for a consumer, but not when it is stopped" do
    out = start(:demand, 500, stop_timeout: 2_000)
    refute_receive {:DOWN, _, _, _, _}, 200
    assert Pipeline.state(out.p) != :stopped
    assert {:ok, %{errors: []}} = Pipeline.stop(out.p)
  end

  test "messages of a partition without a consumer wait, until the pipeline is stopped" do
    out = start({:partition, partitions: 2, hash: &{&1, rem(&1.data, 2)}}, 20)
    a = consumer(out, [partition: 0], 100)
    assert %{^a => data} = collect([a])
    assert data == Enum.filter(1..20, &(rem(&1, 2) == 0))
    assert GenServer.call(out.pid, :"$estimate_buffered_count") == 10
    b = consumer(out, [partition: 1], 3)
    assert %{^b => data} = collect([b])
    assert data == Enum.filter(1..20, &(rem(&1, 2) == 1))
    assert {:ok, %{errors: []}} = Pipeline.await(out.p, 30_000)

    out = start({:partition, partitions: 2, hash: &{&1, rem(&1.data, 2)}}, 20)
    a = consumer(out, [partition: 0], 100)
    collect([a])
    assert {:ok, %{errors: []}} = Pipeline.stop(out.p)
  end

  test "an error of hash: is an error of the component" do
    hash = fn message -> if message.data == 5, do: raise("bang"), else: {message, 0} end

    out = start({:partition, partitions: [0], hash: hash}, 10, on_error: :skip)
    a = consumer(out, partition: 0)
    assert collect([a]) == %{a => [1, 2, 3, 4, 6, 7, 8, 9, 10]}
    assert {:ok, _} = Pipeline.await(out.p, 30_000)

    out = start({:partition, partitions: [0], hash: hash}, 10)
    consumer(out, partition: 0)
    assert {:error, %{code: :bad_partition}} = Pipeline.await(out.p, 30_000)
  end

  test "inputs in the pipeline receive every message" do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.from_enumerable(1..300, every: 10)
          |> GenStage.dispatch(:demand, name: "Out")
          |> Situ.each(&send(me, {:inside, &1}), async: true)
        end,
        pipeline: @replay
      )

    {:ok, {pid, sub}} = GenStage.subscription(p, "Out")
    consumers = for _ <- 1..2, do: consumer(%{pid: pid, sub: sub})
    got = collect(consumers)
    assert got |> Map.values() |> Enum.concat() |> Enum.sort() == Enum.to_list(1..300)
    assert {:ok, _} = Pipeline.await(p, 30_000)
    for n <- 1..300, do: assert_received({:inside, ^n})
  end

  test "a dispatcher that is killed and restarted loses nothing that it had not sent" do
    out = start(:demand, 2_000, on_error: :restart)
    a = consumer(out, [], 10)
    assert_receive {:got, ^a, first}
    Process.exit(a, :kill)
    before = first ++ drain(a)
    monitor = Process.monitor(out.pid)
    Process.exit(out.pid, :kill)
    assert_receive {:DOWN, ^monitor, _, _, _}
    b = consumer(restarted(out))
    %{^b => data} = collect([b])
    last = Enum.max(before)
    assert Enum.all?((last + 20)..2_000, &(&1 in data))
    assert {:ok, _} = Pipeline.await(out.p, 30_000)
  end

  defmodule SlowRestart do
    # Passes messages on. Each `init/1` but the first reports its process and waits for `:go`.
    use Situ.Component, inputs: [in: :any], outputs: [out: :any], options: [test: [type: :any]]

    @impl true
    def init(opts) do
      {test, starts} = opts[:test]
      :counters.add(starts, 1, 1)

      if :counters.get(starts, 1) > 1 do
        send(test, {:init, self()})
        receive do: (:go -> {:ok, nil})
      else
        {:ok, nil}
      end
    end

    @impl true
    def handle_message(:in, message, _context, state), do: {[{:out, message}], state}
  end

  test "a consumer that subscribes to a stage before that has started again receives its messages" do
    test = {self(), :counters.new(1, [])}

    {:ok, p} =
      Pipeline.start(fn p ->
        p
        |> Situ.timer(every: 1_000_000)
        |> Situ.via(SlowRestart, test: test, name: "Slow", on_error: :restart)
      end)

    {:ok, {first, sub}} = GenStage.subscription(p, "Slow")
    Process.exit(first, :kill)
    assert_receive {:init, second}, 5_000
    consumer = consumer(%{pid: second, sub: sub})
    # Its requests are sent.
    :sys.get_state(consumer)
    send(second, :go)
    assert_receive {:got, ^consumer, [_ | _]}, 5_000
    assert {:ok, _} = Pipeline.stop(p)
  end

  defp restarted(%{p: p, pid: old} = out) do
    case GenStage.subscription(p, "Out") do
      {:ok, {pid, sub}} when pid != old -> %{out | pid: pid, sub: sub}
      _ -> restarted(out)
    end
  end

  test "an unknown dispatcher is refused when the pipeline is built" do
    for spec <- [:roundrobin, {:partition, partitions: 0}] do
      assert {:error, %{code: :bad_dispatcher}} =
               Pipeline.run(fn p ->
                 p |> Situ.from_enumerable(1..3) |> GenStage.dispatch(spec)
               end)
    end
  end
end
