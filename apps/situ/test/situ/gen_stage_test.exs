defmodule Situ.GenStageTest do
  use ExUnit.Case, async: true
  doctest Situ.GenStage

  alias Situ.Fixture.Count
  alias Situ.Pipeline

  # Peers written after GenStage's documented protocol alone.

  defmodule Producer do
    # Counts; hands out no more than it was asked for; remembers what it was told.
    use GenServer

    def start_link(opts), do: GenServer.start_link(__MODULE__, opts)
    @impl true
    def init(opts),
      do:
        {:ok, %{next: 0, limit: opts[:limit], consumer: nil, demand: 0, watcher: opts[:watcher]}}

    @impl true
    def handle_info({:"$gen_producer", {pid, ref} = from, {:subscribe, nil, opts}}, state) do
      Process.monitor(pid)
      send(state.watcher, {:subscribed, opts})
      {:noreply, %{state | consumer: {from, ref}}}
    end

    def handle_info({:"$gen_producer", {pid, ref}, {:ask, n}}, state) do
      send(state.watcher, {:asked, n})
      last = min(state.next + n, state.limit)
      events = Enum.to_list(state.next..(last - 1)//1)
      if events != [], do: send(pid, {:"$gen_consumer", {self(), ref}, events})
      if last == state.limit, do: send(pid, {:"$gen_consumer", {self(), ref}, {:cancel, :normal}})
      {:noreply, %{state | next: last}}
    end

    def handle_info({:"$gen_producer", {pid, ref}, {:cancel, reason}}, state) do
      send(pid, {:"$gen_consumer", {self(), ref}, {:cancel, reason}})
      send(state.watcher, {:cancelled, reason})
      {:noreply, state}
    end

    def handle_info(_other, state), do: {:noreply, state}
  end

  test "a producer's events become a stream that ends with it, asked for in bounded portions" do
    {:ok, producer} = Producer.start_link(limit: 5_000, watcher: self())
    me = self()

    {:ok, _} =
      Pipeline.run(fn p ->
        p
        |> Situ.GenStage.from(producer, type: :integer, subscribe: [partition: 1])
        |> Situ.each(fn v, m -> send(me, {:got, v, m.originating_time}) end)
      end)

    got = drain()
    assert Enum.map(got, &elem(&1, 0)) == Enum.to_list(0..4_999)
    times = Enum.map(got, &elem(&1, 1))
    assert times == Enum.sort(Enum.uniq(times))
    assert_received {:subscribed, [partition: 1]}
    assert Enum.all?(asks(), &(&1 <= 1_000))
  end

  test "a producer that dies ends the stream" do
    {:ok, producer} = Producer.start_link(limit: 1_000_000_000, watcher: self())
    Process.unlink(producer)

    {:ok, p} =
      Pipeline.start(fn p -> p |> Situ.GenStage.from(producer) |> Situ.each(& &1) end, [])

    assert_receive {:asked, _}
    Process.exit(producer, :kill)
    assert {:ok, _} = Pipeline.await(p, 30_000)
  end

  test "stopping the pipeline cancels the subscription" do
    {:ok, producer} = Producer.start_link(limit: 100_000_000, watcher: self())

    {:ok, p} =
      Pipeline.start(fn p -> p |> Situ.GenStage.from(producer) |> Situ.each(& &1) end, [])

    assert_receive {:asked, _}
    {:ok, _} = Pipeline.stop(p)
    assert_receive {:cancelled, :normal}
  end

  test "a missing producer fails the start with its name" do
    ExUnit.CaptureLog.capture_log(fn ->
      assert {:error, %{code: :no_producer}} =
               Pipeline.run(fn p -> Situ.GenStage.from(p, :nobody_here) end)
    end)
  end

  test "a consumer gets what it asks for, never more, and then the closing mark" do
    # The clock waits until the consumer is there.
    clock = Situ.Clock.manual(0)

    {:ok, p} =
      Pipeline.start(
        fn p -> p |> Situ.source(Count, [count: 10, interval: 20_000_000], name: "C") end,
        pipeline: [clock: clock]
      )

    {:ok, {pid, opts}} = Situ.GenStage.subscription(p, "C")
    ref = Process.monitor(pid)
    send(pid, {:"$gen_producer", {self(), ref}, {:subscribe, nil, [max_demand: 3] ++ opts}})
    refute_received {:"$gen_consumer", _, _}
    send(pid, {:"$gen_producer", {self(), ref}, {:ask, 3}})
    Situ.Clock.advance(clock, 1_000_000_000)
    got = events(pid, ref, 3)
    send(pid, {:"$gen_producer", {self(), ref}, {:ask, 100}})
    got = got ++ events(pid, ref, :closed)
    data = Enum.map(got, & &1.data)
    assert data == Enum.to_list(hd(data)..9)
    Pipeline.await(p, 30_000)
  end

  test "an unknown output is refused with a reason; a cancel is answered" do
    {:ok, p} =
      Pipeline.start(
        fn p -> p |> Situ.source(Count, [count: :infinity, interval: 1_000_000], name: "C") end,
        []
      )

    {:ok, {pid, opts}} = Situ.GenStage.subscription(p, "C")
    send(pid, {:"$gen_producer", {self(), :a}, {:subscribe, nil, [output: :nope]}})
    assert_receive {:"$gen_consumer", {^pid, :a}, {:cancel, %Situ.Error{code: :unknown_output}}}
    send(pid, {:"$gen_producer", {self(), :b}, {:subscribe, nil, opts}})
    send(pid, {:"$gen_producer", {self(), :b}, {:cancel, :enough}})
    assert_receive {:"$gen_consumer", {^pid, :b}, {:cancel, :enough}}
    {:ok, _} = Pipeline.stop(p)
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
