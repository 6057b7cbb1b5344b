defmodule Situ.BroadwayTest do
  use ExUnit.Case, async: true

  alias OffBroadwayMemory.Buffer
  alias Situ.Pipeline

  @moduletag :capture_log
  @replay [replay: [interval: {0, :unbounded}, speed: :max]]

  defmodule Topology do
    use Broadway

    @impl true
    def handle_message(_processor, message, %{test: test} = context) do
      send(test, {:handled, message.data, message.metadata.situ})
      context[:check] && context.check.(message.data)
      message
    end
  end

  # Numbers that wait for their first consumer, so no test depends on the moment of the subscription.
  defp start_numbers(name, dispatcher, last) do
    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.from_enumerable(1..last, every: Situ.Time.ms(1))
          |> Situ.GenStage.dispatch(dispatcher, name: "Numbers")
        end,
        pipeline: [name: name] ++ @replay
      )

    p
  end

  defp start_topology(name, context, opts \\ []) do
    {producer, opts} = Keyword.pop(opts, :producer, [])
    {concurrency, producer} = Keyword.pop(producer, :concurrency, 1)

    start_supervised!(
      {Broadway,
       [
         name: Module.concat(__MODULE__, Macro.camelize(name)),
         producer: [
           module:
             {Situ.Broadway.Producer,
              Keyword.merge([pipeline: name, stream: "Numbers", retry: 5], producer)},
           concurrency: concurrency
         ],
         processors: [default: [concurrency: 2, max_demand: 10]],
         context: Map.put(context, :test, self())
       ] ++ opts}
      |> then(fn {module, opts} ->
        %{id: opts[:name], start: {module, :start_link, [Topology, opts]}, type: :supervisor}
      end)
    )
  end

  defp handled(n) do
    for _ <- 1..n//1 do
      assert_receive {:handled, data, _message}, 10_000
      data
    end
  end

  test "Broadway handles every message of a stream once, with its times" do
    p = start_numbers("once", :demand, 500)
    start_topology("once", %{})

    for _ <- 1..500 do
      assert_receive {:handled, n, %Situ.Message{data: n, originating_time: time}}, 10_000
      assert time == Situ.Time.ms(n - 1)
      send(self(), {:number, n})
    end

    for n <- 1..500, do: assert_received({:number, ^n})
    assert {:ok, %{errors: []}} = Pipeline.await(p, 10_000)
  end

  test "several producers share the messages of :demand, and take their own of a partition" do
    start_numbers("shared", :demand, 300)
    start_topology("shared", %{}, producer: [concurrency: 3])
    assert Enum.sort(handled(300)) == Enum.to_list(1..300)
    refute_received {:handled, _, _}

    start_numbers("parted", {:partition, partitions: 2, hash: &{&1, rem(&1.data, 2)}}, 300)
    start_topology("parted", %{}, producer: [concurrency: 2, partition: :index])
    assert Enum.sort(handled(300)) == Enum.to_list(1..300)
  end

  test "the function receives successful and failed messages" do
    me = self()
    start_numbers("failing", :demand, 100)

    start_topology("failing", %{check: &(rem(&1, 10) == 0 && raise("bang"))},
      producer: [acknowledge: &send(me, {:acknowledged, &1, &2})]
    )

    handled(100)
    {good, bad} = collect_acknowledged(100, [], [])
    assert bad == Enum.map(1..10, &(&1 * 10))
    assert good == Enum.to_list(1..100) -- bad
  end

  defp collect_acknowledged(n, good, bad) when length(good) + length(bad) == n,
    do: {Enum.sort(good), Enum.sort(bad)}

  defp collect_acknowledged(n, good, bad) do
    assert_receive {:acknowledged, more, worse}, 10_000
    data = &Enum.map(&1, fn %Broadway.Message{data: data} -> data end)
    collect_acknowledged(n, good ++ data.(more), bad ++ data.(worse))
  end

  test "the producer waits for its pipeline, and for the next one of this name" do
    start_topology("later", %{})
    first = start_numbers("later", :demand, 10)
    assert Enum.sort(handled(10)) == Enum.to_list(1..10)
    assert {:ok, _} = Pipeline.await(first, 10_000)
    start_numbers("later", :demand, 10)
    assert Enum.sort(handled(10)) == Enum.to_list(1..10)
  end

  test "Broadway handles all received messages before it stops, and the pipeline waits for the next consumer" do
    p = start_numbers("drained", :demand, 1_000)
    start_topology("drained", %{})
    first = handled(200)
    :ok = stop_supervised(Module.concat(__MODULE__, "Drained"))
    first = first ++ flush()
    start_topology("drained", %{})
    rest = handled(1_000 - length(first))
    assert Enum.sort(first ++ rest) == Enum.to_list(1..1_000)
    assert {:ok, _} = Pipeline.await(p, 10_000)
  end

  defp flush do
    receive do
      {:handled, n, _} -> [n | flush()]
    after
      0 -> []
    end
  end

  test "a wrong name of a stream is in the log" do
    start_numbers("misspelled", :demand, 1)
    opts = [pipeline: "misspelled", stream: "Nubmers", subscribe: [], retry: 60_000]

    log =
      ExUnit.CaptureLog.capture_log(fn ->
        {:ok, subscriber} = Situ.Broadway.Subscriber.start_link(self(), opts)
        # It has tried when it responds.
        :sys.get_state(subscriber)
      end)

    assert log =~ "Nubmers"
  end

  describe "from/3" do
    test "makes a stream of a published producer, whose messages are acknowledged" do
      {:ok, buffer} = Buffer.start_link()
      Buffer.push(buffer, Enum.to_list(1..500))
      me = self()

      {:ok, p} =
        Pipeline.start(
          fn p ->
            orders =
              Situ.Broadway.from(
                p,
                {OffBroadwayMemory.Producer, buffer: buffer, on_failure: :requeue},
                broadway: [name: __MODULE__.Orders]
              )

            done =
              orders
              |> Situ.map(& &1.data)
              |> Situ.each(&send(me, {:order, &1}))

            Situ.GenStage.acknowledge(orders, done)
          end,
          []
        )

      for n <- 1..500, do: assert_receive({:order, ^n}, 10_000)
      Buffer.push(buffer, [501])
      assert_receive {:order, 501}, 10_000
      assert Buffer.length(buffer) == 0
      assert {:ok, %{errors: []}} = Pipeline.stop(p)
    end

    test "messages that fail go back to the queue" do
      {:ok, buffer} = Buffer.start_link()
      Buffer.push(buffer, Enum.to_list(1..20))
      {:ok, seen} = Agent.start_link(fn -> MapSet.new() end)
      me = self()

      # Each number fails the first time.
      pass = fn n ->
        if Agent.get_and_update(seen, &{n in &1, MapSet.put(&1, n)}), do: n, else: raise("bang")
      end

      {:ok, p} =
        Pipeline.start(
          fn p ->
            orders =
              Situ.Broadway.from(
                p,
                {OffBroadwayMemory.Producer,
                 buffer: buffer, on_failure: :requeue, resolve_pending_timeout: 1},
                broadway: [name: __MODULE__.Requeued],
                concurrency: 2
              )

            done =
              orders
              |> Situ.map(&pass.(&1.data), on_error: :skip)
              |> Situ.each(&send(me, {:order, &1}))

            Situ.GenStage.acknowledge(orders, done, fail_after: Situ.Time.ms(20))
          end,
          []
        )

      for n <- 1..20, do: assert_receive({:order, ^n}, 10_000)
      assert {:ok, _} = Pipeline.stop(p)
    end

    defmodule Counter do
      use GenStage
      @behaviour Broadway.Producer

      @impl true
      def prepare_for_start(_module, opts) do
        {[{Agent, fn -> opts[:name] end}], opts}
      end

      @impl true
      def init(opts) do
        send(opts[:test], {:started, self(), opts[:broadway][:index], opts[:broadway][:name]})
        {:producer, 0}
      end

      @impl true
      def handle_demand(n, count), do: {:noreply, Enum.to_list(count..(count + n - 1)), count + n}

      @impl true
      def handle_info(:crash, _state), do: raise("bang")

      def wrap(n, extra),
        do: %Broadway.Message{
          data: n + extra[:add],
          acknowledger: Broadway.NoopAcknowledger.init()
        }
    end

    test "passes the topology's options, starts children, applies the transformer and ends the processes" do
      me = self()

      {:ok, p} =
        Pipeline.start(
          fn p ->
            p
            |> Situ.Broadway.from({Counter, test: me},
              concurrency: 2,
              transformer: {Counter, :wrap, add: 100}
            )
            |> Situ.each(&send(me, {:got, &1}))
          end,
          []
        )

      assert_receive {:started, first, 0, Situ.Broadway.Situ.BroadwayTest.Counter}, 10_000
      assert_receive {:started, second, 1, _}, 10_000
      assert_receive {:got, %Broadway.Message{data: 100}}
      monitors = for pid <- [first, second], do: Process.monitor(pid)
      assert {:ok, _} = Pipeline.stop(p)
      for ref <- monitors, do: assert_receive({:DOWN, ^ref, _, _, _})
    end

    defp drain_numbers do
      receive do
        {:got, _number} -> drain_numbers()
      after
        0 -> :ok
      end
    end

    test "a failure of a producer is an error of the source, and a restart starts new producers" do
      me = self()

      build = fn on_error ->
        fn p ->
          p
          |> Situ.Broadway.from({Counter, test: me}, on_error: on_error)
          |> Situ.each(&send(me, {:got, &1}))
        end
      end

      {:ok, p} = Pipeline.start(build.(:stop), [])
      assert_receive {:started, pid, _, _}, 10_000
      assert_receive {:got, _number}, 10_000
      send(pid, :crash)
      assert {:error, %Situ.Error{code: :producer_failed}} = Pipeline.await(p, 10_000)

      drain_numbers()
      {:ok, p} = Pipeline.start(build.(:restart), [])
      assert_receive {:started, pid, _, _}, 10_000
      assert_receive {:got, _number}, 10_000
      send(pid, :crash)
      assert_receive {:started, _again, _, _}, 10_000
      assert {:ok, _} = Pipeline.stop(p)
    end
  end

  test "a producer that does not start is an error of the pipeline" do
    assert {:error, %Situ.Error{code: :producer_failed, why: why}} =
             Pipeline.run(fn p -> Situ.Broadway.from(p, {OffBroadwayMemory.Producer, []}) end)

    assert why =~ "required :buffer option not found"
  end

  describe "Flow" do
    test "reads a stream in several stages" do
      start_numbers("flow", :demand, 1_000)
      {:ok, flow} = Situ.Broadway.flow("flow", "Numbers", stages: 3, max_demand: 20)
      assert flow |> Flow.map(& &1.data) |> Enum.sort() == Enum.to_list(1..1_000)

      assert {:error, %Situ.Error{code: :not_running}} =
               Situ.Broadway.flow("flow-none", "Numbers")
    end

    test "is the source of a stream" do
      me = self()

      {:ok, p} =
        Pipeline.start(
          fn p -> p |> Situ.GenStage.from([], name: "In") |> Situ.each(&send(me, {:got, &1})) end,
          []
        )

      {:ok, _flow} =
        1..200
        |> Flow.from_enumerable(stages: 2)
        |> Flow.map(&(&1 * 2))
        |> Situ.Broadway.connect_flow(p, "In", max_demand: 10)

      for n <- 1..200, double = 2 * n, do: assert_receive({:got, ^double}, 10_000)
      assert {:ok, _} = Pipeline.stop(p)
    end
  end
end
