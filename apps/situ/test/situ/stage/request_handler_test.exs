defmodule Situ.Stage.RequestHandlerTest do
  use ExUnit.Case, async: true
  @moduletag :capture_log

  alias Situ.{Delivery, Pipeline}

  # Each message, and each plain message `:work`, takes until the test releases it. The number of messages handled
  # before a reply is therefore exact, however busy the machine is.
  defmodule Slow do
    use Situ.Component,
      inputs: [in: :any],
      outputs: [out: :any],
      options: [test: [type: :pid], k: [type: :integer, default: 0]]

    @impl true
    def init(opts), do: {:ok, opts}
    @impl true
    def handle_message(:in, message, _context, opts) do
      work(opts)
      {[{:out, message.originating_time, message.data}], opts}
    end

    @impl true
    def handle_info(:work, _context, opts) do
      work(opts)
      {[], opts}
    end

    def handle_info(_other, _context, opts), do: {[], opts}

    defp work(opts) do
      send(opts[:test], {:at_work, self()})

      receive do
        :go_on -> :ok
      end
    end

    @impl true
    def migrate(_state, _old, new), do: {:ok, new}
  end

  # Fails on every whole batch, so that its messages are handled one by one.
  defmodule Failing do
    use Situ.Component,
      inputs: [in: :any],
      outputs: [out: :any],
      options: [test: [type: :pid], k: [type: :integer]]

    @impl true
    defdelegate init(opts), to: Slow
    @impl true
    def handle_messages(:in, messages, _context, _opts), do: raise("not #{length(messages)}")
    @impl true
    defdelegate handle_message(input, message, context, opts), to: Slow
    @impl true
    defdelegate migrate(state, old, new), to: Slow
  end

  defp start(opts \\ []) do
    test = self()
    module = opts[:module] || Slow

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.from_enumerable(0..999_999, every: 10)
          |> Situ.via(module,
            test: test,
            name: "Slow",
            policy: opts[:policy] || Delivery.unlimited(window: 10_000)
          )
          |> Situ.each(fn _ -> :ok end, name: "Sink", async: true)
        end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )

    assert_receive {:at_work, slow}, 10_000
    {p, slow}
  end

  # Releases messages one by one until the request gets a reply, and returns their number.
  defp messages_until(slow, request), do: slow |> perform_request(request) |> elem(0)

  # Returns the process, too: a slow stage leaves a process that it shares with others.
  defp perform_request(slow, request) do
    task = Task.async(request)
    {answer, n, slow} = let_go(slow, task, 0)
    assert match?(:ok, answer) or match?({:ok, _}, answer)
    {n, slow}
  end

  # Releases a message only after the request has reached the stage, so that the stage can reply after it.
  defp let_go(slow, task, n) do
    assert n < 40, "not answered after #{n} messages"

    case Task.yield(task, 5) do
      {:ok, answer} ->
        {answer, n, slow}

      nil ->
        if asked?(slow) do
          send(slow, :go_on)
          assert_receive {:at_work, slow}, 10_000
          let_go(slow, task, n + 1)
        else
          let_go(slow, task, n)
        end
    end
  end

  defp asked?(pid) do
    {:messages, messages} = Process.info(pid, :messages)
    Enum.any?(messages, &match?({:situ, _}, &1))
  end

  defp requests(p) do
    [
      tap: fn -> Situ.attach_tap({p, "Slow"}, fn _ -> :ok end) end,
      replace: fn -> Pipeline.replace(p, "Slow", test: self_of(p), k: 1) end,
      stop_part: fn -> Pipeline.stop_part(p, "Sink") end
    ]
  end

  defp self_of(_p), do: hd(Process.get(:"$callers") || [self()])

  for policy <- [:window, :throttle, :lossy] do
    test "a request waits for at most two of thousands of waiting messages (#{policy})" do
      policy =
        case unquote(policy) do
          :window -> Delivery.unlimited(window: 10_000)
          :throttle -> Delivery.throttle(100)
          :lossy -> Delivery.max_queue(10_000)
        end

      {p, slow} = start(policy: policy)
      assert %{edges: [_ | _]} = Pipeline.info(p)

      for {name, request} <- requests(p) do
        n = messages_until(slow, request)
        assert n <= 2, "#{name} was answered after #{n} messages"
      end

      Process.exit(p, :kill)
    end
  end

  test "a request waits for at most two messages of a failed batch" do
    {p, slow} = start(module: Failing)

    for {name, request} <- requests(p) do
      n = messages_until(slow, request)
      assert n <= 2, "#{name} was answered after #{n} messages"
    end

    Process.exit(p, :kill)
  end

  test "a request waits for at most two of thousands of plain messages" do
    {p, slow} = start()
    for _ <- 1..10_000, do: send(slow, :work)

    for {name, request} <- requests(p) do
      n = messages_until(slow, request)
      assert n <= 2, "#{name} was answered after #{n} messages"
    end

    Process.exit(p, :kill)
  end

  test "a request waits for few messages of an operator that becomes slow" do
    test = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.from_enumerable(0..999_999, every: 10)
          |> Situ.map(
            fn v ->
              if v > 5_000 do
                send(test, {:at_work, self()})
                receive do: (:go_on -> v)
              else
                v
              end
            end,
            name: "Slow",
            async: true
          )
          |> Situ.each(fn _ -> :ok end, name: "Sink", async: true)
        end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )

    assert_receive {:at_work, slow}, 10_000

    for request <- [
          fn -> Situ.attach_tap({p, "Slow"}, fn _ -> :ok end) end,
          fn -> Pipeline.stop_part(p, "Sink") end
        ] do
      assert messages_until(slow, request) <= 6
    end

    Process.exit(p, :kill)
  end

  # The operators share the process of the stage before them.
  for kind <- [:source, :merge] do
    test "a request waits for few messages of slow operators after a #{kind}" do
      test = self()

      work = fn v ->
        if v > 5_000 do
          send(test, {:at_work, self()})
          receive do: (:go_on -> v)
        else
          v
        end
      end

      {:ok, p} =
        Pipeline.start(
          fn p ->
            source = Situ.from_enumerable(p, 0..999_999, every: 10)

            Situ.map(
              if(unquote(kind) == :source, do: source, else: Situ.merge([source])),
              if(unquote(kind) == :source, do: work, else: &work.(&1.data)),
              name: "Slow",
              policy: Delivery.synchronous()
            )
            |> Situ.each(fn _ -> :ok end, name: "Sink", async: true)
          end,
          pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
        )

      assert_receive {:at_work, slow}, 10_000

      requests = [
        fn -> Situ.attach_tap({p, "Slow"}, fn _ -> :ok end) end,
        fn -> Pipeline.replace(p, "Slow", {:map, work}) end,
        fn -> Pipeline.stop_part(p, "Sink") end
      ]

      Enum.reduce(requests, slow, fn request, slow ->
        {n, slow} = perform_request(slow, request)
        # The time is checked after every fourth message.
        assert n <= 8
        slow
      end)

      Process.exit(p, :kill)
    end
  end

  # This happens while a unit upstream restarts.
  test "light operators that are asked to stop keep running" do
    {p, slow} = start()
    [sink] = for {"Sink", pid, _, _} <- Supervisor.which_children(p), do: pid
    monitor = Process.monitor(sink)
    send(sink, {:situ, {:stop, 1_000_000}})
    assert %{steps: {%{phase: :running, source: %{stopping: :done}}}} = :sys.get_state(sink)
    refute_received {:DOWN, ^monitor, :process, _, _}
    assert Pipeline.state(p) == :running
    Process.exit(p, :kill)
    Process.exit(slow, :kill)
  end
end
