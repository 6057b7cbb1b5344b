defmodule Situ.Stage.LossyTest do
  use ExUnit.Case, async: true
  @moduletag :capture_log

  alias Situ.{Delivery, Pipeline}

  # A push source that emits the times sent to it.
  defmodule Push do
    use Situ.Component, outputs: [out: :any], options: [test: [type: :pid, required: true]]
    @impl true
    def init(opts), do: {:ok, opts[:test]}

    @impl true
    def handle_start(_context, test) do
      send(test, {:source, self()})
      {[{:complete, :infinity}], test}
    end

    @impl true
    def handle_info({:emit, times}, _context, test), do: {for(t <- times, do: {:out, t, t}), test}
    def handle_info({:sync, from}, _context, test), do: send(from, :synced) && {[], test}
    def handle_info(_other, _context, test), do: {[], test}
  end

  # Reports each message and waits for permission to continue.
  defmodule Slow do
    use Situ.Component, inputs: [in: :any], options: [test: [type: :pid, required: true]]
    @impl true
    def init(opts), do: {:ok, opts[:test]}

    @impl true
    def handle_message(:in, message, _context, test) do
      send(test, {:taken, self(), message.data})
      receive do: (:go_on -> :ok)
      {[], test}
    end
  end

  defp start(policy, source) do
    test = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p |> source.(test) |> Situ.via(Slow, test: test, policy: policy, name: "Slow")
        end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )

    p
  end

  defp push(p, test), do: Situ.source(p, Push, test: test)

  defp source do
    assert_receive {:source, pid}, 10_000
    pid
  end

  defp emit(source, times) do
    send(source, {:emit, times})
    send(source, {:sync, self()})
    assert_receive :synced, 10_000
  end

  defp taken do
    assert_receive {:taken, pid, data}, 10_000
    {pid, data}
  end

  defp waiting(pid), do: pid |> Process.info(:message_queue_len) |> elem(1)

  test "a busy consumer holds at most its queue size, and the producer drops the rest" do
    p = start(Delivery.max_queue(3), &push/2)
    source = source()
    emit(source, [1])
    {slow, 1} = taken()

    for t <- 2..200, do: emit(source, [t])
    assert waiting(slow) <= 3
    assert [%{queue: queue, dropped: dropped}] = Pipeline.info(p).edges
    assert queue <= 7
    assert dropped >= 190

    send(slow, :go_on)

    got =
      for _ <- 1..3 do
        {slow, data} = taken()
        send(slow, :go_on)
        data
      end

    assert got == [198, 199, 200]
    assert [%{queue: 0, dropped: 196, processed: 4}] = at_rest(p)
    {:ok, _} = Pipeline.stop(p)
  end

  test "latest takes the newest message emitted while the consumer was busy" do
    p = start(Delivery.latest(), &push/2)
    source = source()
    emit(source, [1])
    {slow, 1} = taken()
    for t <- 2..50, do: emit(source, [t])
    assert waiting(slow) <= 1
    wait_a_moment()
    send(slow, :go_on)
    assert {_, 50} = taken()
    send(slow, :go_on)
    {:ok, _} = Pipeline.stop(p)
  end

  test "a pull source with a slow lossy consumer uses bounded memory" do
    source = fn p, _ ->
      p
      |> Situ.from_enumerable(0..1_999_999, every: 1)
      |> Situ.map(&{&1, :binary.copy(<<0>>, 100)})
    end

    p = start(Delivery.latest(), source)
    {slow, _} = taken()
    for _ <- 1..20, do: Pipeline.info(p)
    assert waiting(slow) <= 1
    Process.exit(p, :kill)
  end

  test "throttle: true makes a pull source wait and drops nothing" do
    test = self()

    {:ok, report} =
      Pipeline.run(fn p ->
        p
        |> Situ.from_enumerable(0..499, every: 1)
        |> Situ.each(&send(test, {:got, &1}),
          policy: Delivery.max_queue(3, throttle: true),
          async: true
        )
      end)

    assert [%{dropped: 0, processed: 500}] = report.snapshot.edges
    assert got() == Enum.to_list(0..499)
  end

  test "throttle: true drops messages of a push source while the queue is full" do
    p = start(Delivery.max_queue(3, throttle: true), &push/2)
    source = source()
    emit(source, [1])
    {slow, 1} = taken()
    for t <- 2..50, do: emit(source, [t])
    assert waiting(slow) <= 3
    send(slow, :go_on)
    assert {_, 2} = taken()
    Process.exit(p, :kill)
  end

  # Produces one message per demand, and announces its end together with the last one.
  defmodule Numbers do
    use Situ.Component, outputs: [out: :any]
    @impl true
    def init(_opts), do: {:ok, 0}
    @impl true
    def handle_demand(_n, _context, 9), do: {[{:out, 9_000_000, 9}, {:complete, 9_000_000}], 10}
    def handle_demand(_n, _context, n) when n > 9, do: {[], n}
    def handle_demand(_n, _context, n), do: {[{:out, n * 1_000_000, n}], n + 1}
  end

  test "a stream that ends while its consumer asks for newer messages is received to its end" do
    even? = &(rem(&1, 2) == 0)

    for policy <- [Delivery.latest(), Delivery.max_queue(2, guarantee: even?)] do
      test = self()

      build = fn p ->
        p
        |> Situ.source(Numbers)
        |> Situ.each(fn n -> Process.sleep(3) && send(test, {:got, n}) end, policy: policy)
      end

      replay = [interval: {0, :unbounded}, speed: 1.0]
      assert {:ok, _} = Pipeline.run(build, pipeline: [replay: replay])
      received = got()

      if policy.guarantee,
        do: assert(Enum.filter(received, even?) == [0, 2, 4, 6, 8]),
        else: assert(List.last(received) == 9)
    end
  end

  test "messages waiting at the producer are delivered when the stream ends" do
    p = start(Delivery.max_queue(5), &push/2)
    source = source()
    emit(source, [1])
    {slow, 1} = taken()
    emit(source, [2, 3, 4, 5, 6, 7, 8])
    stopping = Task.async(fn -> Pipeline.stop(p) end)
    send(slow, :go_on)

    got =
      for _ <- 1..5 do
        {slow, data} = taken()
        send(slow, :go_on)
        data
      end

    assert got == [4, 5, 6, 7, 8]
    assert {:ok, _} = Task.await(stopping, 30_000)
  end

  defp at_rest(p) do
    case Pipeline.info(p).edges do
      [%{queue: 0}] = edges -> edges
      _ -> at_rest(p)
    end
  end

  # A handler counts as slow after one millisecond.
  defp wait_a_moment do
    till = :erlang.monotonic_time(:millisecond) + 3
    spin(till)
  end

  defp spin(till), do: if(:erlang.monotonic_time(:millisecond) < till, do: spin(till), else: :ok)

  defp got do
    receive do
      {:got, n} -> [n | got()]
    after
      0 -> []
    end
  end
end
