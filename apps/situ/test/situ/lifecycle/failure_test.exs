defmodule Situ.Lifecycle.FailureTest do
  use ExUnit.Case, async: true

  alias Situ.Pipeline
  alias Situ.Fixture.Count

  @moduletag :capture_log

  defmodule Sum do
    # Adds up its input, raises at the values in `raise_at`, and reports its pid and termination.
    use Situ.Component,
      inputs: [in: :integer],
      outputs: [out: :integer],
      options: [raise_at: [type: :list, default: []], tell: [type: :any]]

    @impl true
    def init(opts), do: {:ok, %{sum: 0, raise_at: opts[:raise_at], tell: opts[:tell]}}

    @impl true
    def handle_start(_context, state) do
      if state.tell, do: state.tell.({:pid, self()})
      {[], state}
    end

    @impl true
    def handle_message(:in, %{data: v} = message, _context, state) do
      state = %{state | sum: state.sum + v}
      if v in state.raise_at, do: raise(ArgumentError, "not #{v}")
      {[{:out, message.originating_time, state.sum}], state}
    end

    @impl true
    def terminate(reason, state),
      do: if(state.tell, do: state.tell.({:terminated, reason}), else: :ok)
  end

  defmodule Rubbish do
    use Situ.Component, inputs: [in: :any], outputs: [out: :any], options: [answer: [type: :any]]
    @impl true
    def handle_message(:in, _message, _context, opts), do: opts[:answer]
  end

  defmodule Told do
    # Raises on `:bad` and when its timer fires, and reports the timer and each `{:good, n}`.
    use Situ.Component, outputs: [out: :integer], options: [tell: [type: {:fun, 1}]]

    @impl true
    def init(opts), do: {:ok, opts[:tell]}

    @impl true
    def handle_start(context, tell) do
      tell.({:told, self()})
      {[{:timer, :soon, context.now}], tell}
    end

    @impl true
    def handle_info({:good, n}, context, tell) do
      tell.({:good, n})
      {if(n == 4, do: [{:complete, context.now}], else: []), tell}
    end

    def handle_info(bad, _context, tell) do
      if bad != :bad, do: tell.(:rang)
      raise ArgumentError, inspect(bad)
    end
  end

  defmodule Slow do
    # Starts after it has learned another component's pid, sent messages to it and received its reply.
    use Situ.Component, outputs: [out: :integer], options: [tell: [type: {:fun, 1}]]

    @impl true
    def init(opts), do: {:ok, opts[:tell]}

    @impl true
    def handle_start(context, tell) do
      tell.({:slow, self()})

      receive do
        {:other, pid} ->
          for message <- [:bad, {:good, 1}, :bad, {:good, 2}, {:good, 3}], do: send(pid, message)
          # The reply comes after the messages sent before it.
          {:error, _} = GenServer.call(pid, :anything)
      end

      {[{:complete, context.now}], tell}
    end
  end

  defmodule FailsAtStop do
    # Emits on two outputs, one of which ends long before the other, completes, and raises when it is stopped.
    use Situ.Component, outputs: [long: :integer, short: :integer], options: [tell: [type: :any]]

    @impl true
    def init(opts), do: {:ok, opts[:tell]}

    @impl true
    def handle_demand(_n, context, tell) do
      time = &(context.now + Situ.Time.ms(&1))
      long = for i <- 1..50, do: {:long, time.(i), i}
      {[{:short, time.(1), 1} | long] ++ [{:complete, time.(50)}], tell}
    end

    @impl true
    def handle_stop(_final_time, _context, tell) do
      send(tell, :raising)
      raise "damaged"
    end
  end

  test "a source that fails after it has completed loses none of its messages" do
    test = self()

    run =
      Task.async(fn ->
        Pipeline.run(fn p ->
          Pipeline.on(p, :error, fn _error -> send(test, :failed) end)
          node = Pipeline.add(p, FailsAtStop, tell: test, name: "FailsAtStop")
          Situ.each(Situ.Node.output(node, :short), &send(test, {:short, &1}))

          Situ.each(Situ.Node.output(node, :long), fn i ->
            if i == 5, do: wait_for_permission(test)
            send(test, {:long, i})
          end)
        end)
      end)

    assert_receive {:waiting, consumer}, 10_000
    assert_receive :raising, 10_000
    assert_receive :failed, 10_000
    send(consumer, :go_on)
    assert {:error, %Situ.Error{code: :component_failed}} = Task.await(run, 10_000)
    {:messages, received} = Process.info(self(), :messages)
    assert Enum.to_list(1..50) == for({:long, i} <- received, do: i)
  end

  defp wait_for_permission(test) do
    send(test, {:waiting, self()})
    receive do: (:go_on -> :ok)
  end

  describe "on_error" do
    test "applies to messages that arrive while the pipeline is starting, and keeps their order" do
      me = self()

      run =
        Task.async(fn ->
          Pipeline.run(fn p ->
            Situ.source(p, Told, tell: &send(me, &1), on_error: :skip, name: "Told")
            Situ.source(p, Slow, tell: &send(me, &1), name: "Slow")
          end)
        end)

      assert_receive {:told, told}, 10_000
      assert_receive {:slow, slow}, 10_000
      send(slow, {:other, told})
      assert_receive :rang, 10_000
      send(told, {:good, 4})
      assert {:ok, report} = Task.await(run, 10_000)
      assert report.skipped == %{"Told" => 3}
      {:messages, heard} = Process.info(self(), :messages)
      assert [1, 2, 3, 4] == for({:good, n} <- heard, do: n)
    end

    test ":skip keeps the state from before the message and counts the loss" do
      {values, {:ok, report}} = sums([raise_at: [2, 4]], on_error: :skip)
      assert values == [0, 1, 4, 9]
      assert report.skipped == %{"Sum" => 2}
    end

    test ":restart resets the state, continues with the next message and releases resources" do
      me = self()
      {values, {:ok, report}} = sums([raise_at: [3], tell: &send(me, &1)], on_error: :restart)
      assert values == [0, 1, 3, 4, 9]
      assert report.skipped == %{"Sum" => 1}
      assert_received {:terminated, %Situ.Error{code: :component_failed}}
    end

    test ":stop ends the pipeline after delivering earlier messages" do
      {values, {:error, error}} = sums([raise_at: [3]], on_error: :stop)
      assert values == [0, 1, 3]
      assert error.code == :component_failed

      assert %{component: "Sum", input: :in, originating_time: t, stacktrace: [_ | _]} =
               error.meta

      assert is_integer(t)
    end

    test ":skip applies to operators too" do
      me = self()

      {:ok, report} =
        Pipeline.run(fn p ->
          p
          |> Situ.source(Count, count: 5)
          |> Situ.map(&div(12, &1 - 2), on_error: :skip, name: "Divide")
          |> Situ.scan(0, &(&1 + &2), on_error: :skip)
          |> Situ.each(&send(me, {:got, &1}), on_error: :skip)
        end)

      assert got() == [-6, -18, -6, 0]
      assert report.skipped == %{"Divide" => 1}
    end
  end

  defmodule Broken do
    use Situ.Component, outputs: [out: :integer]
    @impl true
    def handle_demand(_n, context, nil), do: {[{:out, context.start_time, 1}], :raise}
    def handle_demand(_n, context, []), do: {[{:out, context.start_time, 1}], :raise}
    def handle_demand(_n, _context, :raise), do: raise("again")
  end

  test "a pull source that always raises is stopped under every on_error" do
    for {on_error, code} <- [
          stop: :component_failed,
          skip: :no_way_on,
          restart: :restarted_too_often
        ] do
      result =
        Pipeline.run(fn p ->
          p |> Situ.source(Broken, on_error: on_error) |> Situ.map(& &1)
        end)

      assert {:error, %{code: ^code}} = result
    end
  end

  describe "a component killed from outside" do
    test "with :stop fails the pipeline with an error that names it" do
      {p, pid} = running_sum(:stop)
      Process.exit(pid, :kill)

      assert {:error, %{code: :component_killed, meta: %{component: "Sum"}}} =
               Pipeline.await(p, 30_000)
    end

    test "with :restart is restarted on its edges" do
      {p, pid} = running_sum(:restart)
      Process.exit(pid, :kill)
      assert_receive {:pid, again} when again != pid
      flush_got()
      assert_receive {:got, _}
      assert {:ok, report} = Pipeline.stop(p)
      assert %{"Sum" => n} = report.skipped
      assert n >= 1
    end

    test "releases its resources and ends when the pipeline process is killed" do
      me = self()

      {:ok, p} =
        Pipeline.start(
          fn p ->
            p
            |> Situ.source(Count, count: :infinity, interval: 1_000_000)
            |> Situ.via(Sum, tell: &send(me, &1))
          end,
          []
        )

      assert_receive {:pid, pid}
      ref = Process.monitor(pid)
      Process.exit(p, :kill)
      assert_receive {:terminated, :killed}
      assert_receive {:DOWN, ^ref, :process, ^pid, _}
    end
  end

  test "a looping process of a killed pipeline is killed after a grace period" do
    me = self()
    {:ok, reaper} = Situ.Application.Reaper.start_link(name: nil, grace_ms: 10)

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.source(Count, count: 10)
          |> Situ.each(fn _ -> send(me, {:stuck, self()}) && receive(do: (:never -> :ok)) end)
        end,
        []
      )

    assert_receive {:stuck, pid}
    :ok = Situ.Application.Reaper.watch_pipeline(p, reaper)
    ref = Process.monitor(pid)
    Process.exit(p, :kill)
    assert_receive {:DOWN, ^ref, :process, ^pid, :killed}
  end

  test "a stuck component is named and killed when a stop makes no progress" do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.source(Count, count: 10)
          |> Situ.each(fn _ -> send(me, :stuck) && receive(do: (:never -> :ok)) end, name: "Stone")
        end,
        pipeline: [stop_timeout: 100]
      )

    assert_receive :stuck
    assert Situ.Diagnostics.format(Pipeline.info(p)) =~ "Stone"
    assert {:error, %{code: :stuck, what: what}} = Pipeline.stop(p)
    assert what =~ "Stone"
  end

  describe "invalid or unusual input" do
    test "returns an error for an invalid return value of a component" do
      for {answer, code} <- [
            {:rubbish, :bad_return},
            {{[:what], nil}, :bad_action},
            {{[{:nope, 1, 2}], nil}, :unknown_output},
            {{[{:out, "yesterday", 2}], nil}, :bad_action},
            {{[{:out, [message(5, 1), :rubbish]}], nil}, :bad_action},
            {{[{:out, [message(5, 1) | :rubbish]}], nil}, :bad_action},
            {{[{:out, [message(5, 1), message(5, 2)]}], nil}, :time_not_increasing},
            {{[{:nope, []}], nil}, :unknown_output},
            {{[{:out, 5, 1}, {:out, 5, 2}], nil}, :time_not_increasing}
          ] do
        result =
          Pipeline.run(fn p ->
            p |> Situ.source(Count, count: 3) |> Situ.via(Rubbish, answer: answer)
          end)

        assert {:error, %{code: ^code, meta: %{component: "Rubbish"}}} = result
      end
    end

    test "returns an error for an invalid graph" do
      assert code(fn p -> Pipeline.add(p, Sum) end) == :unconnected_input
      assert code(fn p -> Pipeline.add(p, String) end) == :not_a_component
      assert code(fn _ -> raise "no" end) == :build_failed
      assert code(fn _ -> throw(:no) end) == :build_failed
      assert code(fn _ -> exit(:no) end) == :build_failed

      assert code(fn p ->
               for _ <- 1..2, do: p |> Situ.source(Count) |> Situ.name("Same")
             end) == :duplicate_name

      assert code(fn p ->
               p |> Situ.source(Count) |> Situ.map(&to_string/1, type: :string) |> Situ.via(Sum)
             end) ==
               :type_mismatch

      assert {:error, error} =
               Pipeline.run(fn p ->
                 p |> Situ.source(Count) |> Situ.map(&"#{&1}", type: :string) |> Situ.via(Sum)
               end)

      for word <- ["Map", "string", "Sum.in", "integer"], do: assert(error.what =~ word)
    end

    test "returns an error for data that does not match its declared type" do
      assert code(fn p -> p |> Situ.source(Count) |> Situ.map(&"#{&1}") |> Situ.via(Sum) end) ==
               :wrong_data
    end

    test "returns an error for a cycle in which times do not increase" do
      error =
        error(fn p ->
          source = Situ.source(p, Count, count: 3)
          merge = Pipeline.add(p, Situ.Lifecycle.FailureTest.Loop)
          Pipeline.connect(source, merge, :first)
          merge |> Situ.Node.output(:out) |> Situ.map(& &1) |> Pipeline.connect(merge, :again)
        end)

      assert error.code == :time_not_increasing
      assert error.what =~ "Loop"
      assert error.fix =~ "cycle"
      assert error.why =~ "Loop -> Map -> Loop"
      assert error.meta.cycle == ["Loop", "Map", "Loop"]
    end

    test "returns an error for invalid settings and specs" do
      assert {:error, %{code: :not_a_pipeline}} = Pipeline.run(Enum)
      assert {:error, %{code: :not_a_pipeline}} = Pipeline.run(:nothing)

      assert {:error, %{code: :unknown_option}} =
               Pipeline.run(fn _ -> 1 end, pipeline: [nmae: "x"])

      assert {:error, %{code: :bad_interval}} =
               Pipeline.run(fn _ -> 1 end, pipeline: [replay: [interval: {5, 3}]])

      assert {:error, %{code: :bad_option}} =
               Pipeline.run(fn _ -> 1 end, pipeline: [replay: [speed: 0]])
    end

    test "handles repeated and concurrent stops while the pipeline is starting" do
      {:ok, p} =
        Pipeline.start(
          fn p -> for _ <- 1..50, do: Situ.source(p, Count, count: :infinity) end,
          []
        )

      results =
        1..10
        |> Enum.map(fn _ -> Task.async(fn -> Pipeline.stop(p) end) end)
        |> Task.await_many(30_000)

      assert Enum.all?(
               results,
               &(match?({:ok, _}, &1) or match?({:error, %{code: :not_running}}, &1))
             )

      assert {:error, %{code: :not_running}} = Pipeline.stop(p)
      assert {:ok, _} = Pipeline.await(p)
    end

    test "lets a component stop its own pipeline" do
      {:ok, report} =
        Pipeline.run(fn p ->
          p
          |> Situ.source(Count, count: :infinity)
          |> Situ.each(fn v -> if v == 100, do: Pipeline.stop(p) end)
        end)

      assert report.errors == []
    end
  end

  defmodule Loop do
    use Situ.Component, inputs: [first: :any, again: :any], outputs: [out: :any]
    @impl true
    def handle_message(_input, message, _context, state),
      do: {[{:out, message.originating_time, message.data}], state}
  end

  test "a supervised pipeline restarts after a failure, and its supervisor stops it in order" do
    me = self()
    runs = :counters.new(1, [])

    spec = fn p ->
      :counters.add(runs, 1, 1)
      n = :counters.get(runs, 1)

      p
      |> Situ.source(Count, count: :infinity, interval: 1_000_000)
      |> Situ.via(Sum, raise_at: if(n == 1, do: [3], else: []), tell: &send(me, {n, &1}))
    end

    {:ok, supervisor} = Supervisor.start_link([{Pipeline, {spec, []}}], strategy: :one_for_one)
    assert_receive {1, {:terminated, _}}
    assert_receive {2, {:pid, _}}
    Supervisor.stop(supervisor)
    assert_receive {2, {:terminated, :normal}}
  end

  defp sums(opts, common) do
    me = self()

    result =
      Pipeline.run(fn p ->
        p
        |> Situ.source(Count, count: 6)
        |> Situ.via(Sum, opts ++ common)
        |> Situ.each(&send(me, {:got, &1}))
      end)

    {got(), result}
  end

  defp running_sum(on_error) do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.source(Count, count: :infinity, interval: 1_000_000)
          |> Situ.via(Sum, tell: &send(me, &1), on_error: on_error)
          |> Situ.each(&send(me, {:got, &1}))
        end,
        []
      )

    assert_receive {:pid, pid}
    assert_receive {:got, _}
    {p, pid}
  end

  defp message(time, n),
    do: %Situ.Message{data: n, originating_time: time, creation_time: time, sequence_id: n}

  defp code(build), do: error(build).code

  defp error(build) do
    assert {:error, error} = Pipeline.run(build)
    error
  end

  defp got do
    receive do
      {:got, v} -> [v | got()]
    after
      0 -> []
    end
  end

  defp flush_got, do: got()
end
