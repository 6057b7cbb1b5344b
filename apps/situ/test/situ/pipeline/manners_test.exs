defmodule Situ.Pipeline.MannersTest do
  # What any process of OTP may expect of a pipeline: answers, restarts within bounds, handlers that hold nobody up.
  use ExUnit.Case, async: true
  import ExUnit.CaptureLog

  alias Situ.{Clock, Pipeline, Time}
  alias Situ.Fixture.Count

  @moduletag :capture_log

  defmodule Slow do
    # Waits for a word with every message.
    use Situ.Component,
      inputs: [in: :any],
      outputs: [out: :any],
      options: [to: [type: :pid, required: true], k: [type: :integer, default: 0]]

    @impl true
    def init(opts), do: {:ok, {opts[:to], opts[:k]}}

    @impl true
    def handle_message(:in, m, _context, {to, k} = state) do
      send(to, {:at, self(), k})

      receive do
        :go -> {[{:out, m.originating_time, {k, m.data}}], state}
      end
    end

    @impl true
    def migrate({to, _k}, _old, new), do: {:ok, {to, new[:k]}}
  end

  defmodule Dying do
    # Dies in handle_start/2, but for the first time.
    use Situ.Component, outputs: [out: :any], options: [tries: [type: :any], to: [type: :pid]]
    @impl true
    def init(opts), do: {:ok, opts}

    @impl true
    def handle_start(_context, opts) do
      :counters.add(opts[:tries], 1, 1)

      if :counters.get(opts[:tries], 1) > 1,
        do: Process.exit(self(), :kill),
        else: send(opts[:to], {:up, self()})

      {[{:complete, :infinity}], opts}
    end
  end

  defp slow(opts \\ []) do
    me = self()

    {:ok, p} =
      Pipeline.start(fn p ->
        p
        |> Situ.source(Count, count: :infinity, interval: Time.ms(1))
        |> Situ.via(Slow, [to: me, name: "Slow"] ++ opts)
        |> Situ.map(& &1, name: "Map", async: true)
        |> Situ.each(&send(me, {:out, &1}))
      end)

    assert_receive {:at, pid, 0}
    {p, pid}
  end

  # Lets it go on until it says that it has become `k`.
  defp until(k) do
    receive do
      {:at, _pid, ^k} ->
        :ok

      {:at, pid, _} ->
        send(pid, :go)
        until(k)
    after
      5_000 -> flunk("never became #{k}")
    end
  end

  describe "replace/4" do
    test "several at once come one after another" do
      {p, pid} = slow()
      tasks = for k <- 1..5, do: Task.async(fn -> Pipeline.replace(p, "Slow", k: k, to: pid) end)
      assert Enum.all?(tasks, &(Task.yield(&1, 0) == nil))
      for _ <- 1..20, do: send(pid, :go)
      assert Task.await_many(tasks, 10_000) == List.duplicate(:ok, 5)
      assert Pipeline.state(p) == :running
      Process.exit(p, :kill)
    end

    test "two operators of one chain at once" do
      me = self()

      {:ok, p} =
        Pipeline.start(fn p ->
          p
          |> Situ.source(Count, count: :infinity, interval: Time.ms(1))
          |> Situ.map(& &1, name: "A")
          |> Situ.map(& &1, name: "B")
          |> Situ.each(&send(me, &1))
        end)

      tasks =
        for name <- ~w(A B A B),
            do: Task.async(fn -> Pipeline.replace(p, name, {:map, fn _ -> :new end}) end)

      assert Task.await_many(tasks) == [:ok, :ok, :ok, :ok]
      assert_receive :new
      assert {:ok, _} = Pipeline.stop(p)
    end

    test "is answered when the component dies before it has done it" do
      {p, pid} = slow(on_error: :restart)
      tasks = for k <- 1..3, do: Task.async(fn -> Pipeline.replace(p, "Slow", k: k, to: pid) end)
      tap = Task.async(fn -> Situ.attach_tap({p, "Slow"}, fn _ -> :ok end) end)
      # All have been asked.
      waiting(p, 3)
      Process.exit(pid, :kill)

      for task <- [tap | tasks],
          do: assert({:error, %{code: :component_restarted}} = Task.await(task))

      assert_receive {:at, again, 0} when again != pid
      assert Pipeline.state(p) == :running
      Process.exit(p, :kill)
    end

    test "gives up waiting after its timeout" do
      {p, pid} = slow()

      assert {:error, %{code: :timeout}} =
               Pipeline.replace(p, "Slow", [k: 7, to: self()], timeout: 20)

      send(pid, :go)
      # It goes on all the same.
      until(7)
      Process.exit(p, :kill)
    end

    defp waiting(p, n) do
      %{dynamic: %{replaces: replaces, taps: taps}} = :sys.get_state(p)

      case Map.values(replaces) do
        [{_, queue}] when map_size(taps) == 1 ->
          if :queue.len(queue) == n - 1, do: :ok, else: waiting(p, n)

        _ ->
          waiting(p, n)
      end
    end
  end

  describe "restarts" do
    test "a component that dies again and again ends the pipeline" do
      me = self()
      tries = :counters.new(1, [])

      {:ok, p} =
        Pipeline.start(fn p -> Situ.source(p, Dying, tries: tries, to: me, on_error: :restart) end)

      assert_receive {:up, pid}
      Process.exit(pid, :kill)
      assert {:error, %{code: :restarted_too_often} = error} = Pipeline.await(p, 30_000)
      assert error.meta.component == "Dying"
      assert :counters.get(tries, 1) == 1 + 3
    end

    test "as often as the settings say" do
      me = self()
      tries = :counters.new(1, [])
      settings = [max_restarts: 7, max_seconds: 60]

      {:ok, p} =
        Pipeline.start(
          fn p -> Situ.source(p, Dying, tries: tries, to: me, on_error: :skip) end,
          pipeline: settings
        )

      assert_receive {:up, pid}
      Process.exit(pid, :kill)
      assert {:error, %{code: :restarted_too_often}} = Pipeline.await(p, 30_000)
      assert :counters.get(tries, 1) == 1 + 7
    end

    test "a kill while the pipeline starts is survived" do
      me = self()

      {:ok, p} =
        Pipeline.start(fn p ->
          p
          |> Situ.source(Count, count: :infinity, interval: Time.ms(1), on_error: :restart)
          |> Situ.each(&send(me, {:got, &1}))

          Situ.source(p, Situ.Fixture.Held, to: me)
        end)

      # Count has started, Held has not.
      assert_receive {:held, held}
      assert Pipeline.state(p) == :starting
      Process.exit(pid(p, "Count"), :kill)
      send(held, :go)
      assert_receive {:got, 0}, 5_000
      assert Pipeline.state(p) == :running
      assert {:ok, _} = Pipeline.stop(p)
    end

    test "every error that is skipped is in the log, once" do
      log =
        capture_log(fn ->
          assert {:ok, %{skipped: %{"Map" => 5}}} =
                   Pipeline.run(fn p ->
                     p
                     |> Situ.from_enumerable(Enum.map(1..10, &{&1, &1}))
                     |> Situ.map(fn v -> if rem(v, 2) == 0, do: raise("odd #{v}."), else: v end,
                       on_error: :restart
                     )
                   end)
        end)

      for n <- [2, 4, 6, 8, 10], do: assert(length(String.split(log, "odd #{n}.")) == 2)
    end
  end

  defp pid(p, path) do
    Enum.find_value(:sys.get_state(p).stages, fn {_, stage} ->
      Enum.any?(stage.vertices, &(&1.path == path)) && stage.pid
    end)
  end

  describe "calls from anywhere" do
    test "stray calls and casts are answered, or pass by" do
      {:ok, p} =
        Pipeline.start(fn p ->
          Situ.source(p, Count, count: :infinity, interval: Time.ms(1))
        end)

      assert Pipeline.clock(p)
      assert {:error, %{code: :unknown_request}} = GenServer.call(p, :what_is_this)
      assert {:error, %{code: :unknown_request}} = GenServer.call(p, {1, 2, 3})
      GenServer.cast(p, :nothing)
      send(p, :nothing)
      assert Pipeline.state(p) == :running
      assert {:ok, %{errors: []}} = Pipeline.stop(p)
    end

    test "it answers as the supervisor that it is declared to be" do
      {:ok, p} =
        Pipeline.start(fn p ->
          p |> Situ.source(Count, count: :infinity, interval: Time.ms(1)) |> Situ.map(& &1)
        end)

      assert Pipeline.clock(p)

      assert [{"Count", a, :worker, [Count]}, {"Map", b, :worker, _}] =
               Supervisor.which_children(p)

      assert Process.alive?(a) and Process.alive?(b)
      assert %{active: 2, specs: 2, workers: 2} = Supervisor.count_children(p)
      assert {:ok, _} = Pipeline.stop(p)
    end

    test "a clock that cannot be paused says so" do
      {:ok, p} =
        Pipeline.start(fn p -> Situ.source(p, Count, count: :infinity, interval: Time.ms(1)) end,
          pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
        )

      assert Pipeline.clock(p)
      assert {:error, %{code: :unpaced}} = Pipeline.pause(p)
      assert {:error, %{code: :unpaced}} = Pipeline.set_speed(p, 2.0)
      assert {:ok, _} = Pipeline.stop(p)
    end
  end

  describe "handlers" do
    test "may look at the pipeline, and take their time" do
      me = self()

      {:ok, p} =
        Pipeline.start(fn p ->
          Pipeline.on(p, :error, fn error ->
            send(me, {:seen, error.code, Pipeline.info(p).state})
            receive do: (:go -> send(me, :gone))
          end)

          p
          |> Situ.source(Count, count: :infinity, interval: Time.ms(1))
          |> Situ.each(fn v -> if v == 1, do: raise("odd") end, on_error: :skip)
        end)

      assert_receive {:seen, :component_failed, :running}
      # Nobody waits for the handler.
      assert Pipeline.info(p).state == :running
      stop = Task.async(fn -> Pipeline.stop(p) end)
      assert Task.yield(stop, 50) == nil
      send(:sys.get_state(p).handlers, :go)
      assert_receive :gone
      assert {:ok, _} = Task.await(stop)
    end

    test "of :run may still build" do
      me = self()

      assert {:ok, report} =
               Pipeline.run(fn p ->
                 one = Situ.return(p, 1)

                 Pipeline.on(p, :run, fn _ ->
                   p
                   |> Situ.from_enumerable([{1, :a}, {2, :b}])
                   |> Situ.each(&send(me, {:got, &1}))

                   Situ.each(one, &send(me, {:got, &1}))
                 end)
               end)

      assert length(report.closed) == 4
      for what <- [:a, :b, 1], do: assert_received({:got, ^what})
    end

    test "of :run may build a pipeline that was opened empty" do
      me = self()
      p = Pipeline.new()
      Situ.return(p, 1)

      Pipeline.on(p, :run, fn _ ->
        p |> Situ.from_enumerable([{1, :a}]) |> Situ.each(&send(me, {:got, &1}))
      end)

      assert :ok = Pipeline.launch(p)
      assert {:ok, _} = Pipeline.await(p)
      assert_received {:got, :a}
    end
  end

  test "the clock of a paused pipeline stands still" do
    clock = Clock.virtual(0)

    {:ok, p} =
      Pipeline.start(fn p -> Situ.timer(p, every: Time.ms(1)) end, pipeline: [clock: clock])

    assert :ok = Pipeline.pause(p)
    assert Pipeline.now(p) == Pipeline.now(p)
    assert {:ok, _} = Pipeline.stop(p)
  end
end
