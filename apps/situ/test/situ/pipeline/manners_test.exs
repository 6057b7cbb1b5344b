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
      # Lets every message pass.
      driver = spawn_link(fn -> pass() end)

      {:ok, p} =
        Pipeline.start(fn p ->
          p
          |> Situ.source(Count, count: :infinity, interval: Time.ms(1))
          |> Situ.via(Slow, to: driver, name: "Slow")
        end)

      tasks =
        for k <- 1..5, do: Task.async(fn -> Pipeline.replace(p, "Slow", k: k, to: driver) end)

      assert Task.await_many(tasks, 30_000) == List.duplicate(:ok, 5)
      assert Pipeline.state(p) == :running
      Process.exit(p, :kill)
    end

    defp pass do
      receive do
        {:at, pid, _} ->
          send(pid, :go)
          pass()
      end
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

    test "may extend the pipeline, but not add to it" do
      me = self()

      {:ok, p} =
        Pipeline.start(fn p ->
          Pipeline.on(p, :error, fn _ ->
            {:ok, _} =
              Pipeline.extend(
                p,
                &(&1 |> Pipeline.stream("Count") |> Situ.each(fn v -> send(me, {:more, v}) end))
              )
          end)

          Pipeline.on(p, :component_completed, fn _ -> Situ.return(p, 1) end)
          Situ.return(p, :x)

          p
          |> Situ.source(Count, count: :infinity, interval: Time.ms(1), name: "Count")
          |> Situ.each(fn v -> if v == 1, do: raise("odd") end, on_error: :skip, async: true)

          Situ.source(p, Situ.Fixture.Silent)
        end)

      assert_receive {:more, _}
      assert {:error, %{code: :pipeline_running} = error} = Pipeline.stop(p)
      assert error.what =~ "component_completed"
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

  describe "names" do
    defp ticking(name) do
      Pipeline.start(fn p -> Situ.timer(p, every: Time.ms(1), name: "Ticks") end,
        pipeline: [name: name]
      )
    end

    test "an atom is registered, and every function takes it" do
      assert {:ok, p} = ticking(:manners_lobby)
      assert Process.whereis(:manners_lobby) == p
      assert Pipeline.info(:manners_lobby).pipeline == "manners_lobby"
      assert {:error, %{code: :name_taken}} = ticking(:manners_lobby)
      assert_raise Situ.Error, fn -> Pipeline.new(name: :manners_lobby) end
      assert {:ok, _} = Pipeline.stop(:manners_lobby)
      assert {:ok, _} = ticking(:manners_lobby)
      assert {:ok, _} = Pipeline.stop(:manners_lobby)
    end

    test "a label finds its pipeline, if it is the only one" do
      label = "Lobby #{System.unique_integer()}"
      assert {:ok, p} = ticking(label)
      assert [%{pid: ^p, state: state}] = Enum.filter(Situ.pipelines(), &(&1.name == label))
      assert state in [:starting, :running]
      assert Pipeline.clock(label) == Pipeline.clock(p)
      assert {:ok, other} = ticking(label)
      error = assert_raise Situ.Error, fn -> Pipeline.info(label) end
      assert error.code == :ambiguous_name
      assert {:ok, _} = Pipeline.stop(other)
      assert {:ok, _} = Pipeline.stop(label)
      assert {:error, %{code: :not_running}} = Pipeline.stop(label)
    end

    test "a snapshot names the processes" do
      {:ok, p} = ticking("Pids")
      [{"Ticks", pid, _, _}] = Supervisor.which_children(p)
      assert Pipeline.clock(p)
      assert [%{pid: text}] = Pipeline.info(p).processes
      assert text == inspect(pid)
      assert {:ok, _} = Pipeline.stop(p)
    end
  end

  test "progress is told again and again, and once at the end" do
    me = self()
    clock = Clock.manual(0)

    {:ok, p} =
      Pipeline.start(
        fn p ->
          Pipeline.on(p, :progress, &send(me, {:progress, &1}))
          Situ.timer(p, every: Time.ms(1))
        end,
        pipeline: [
          clock: clock,
          replay: [interval: {0, Time.ms(1_000)}, speed: 1.0],
          progress_every: 1
        ]
      )

    assert_receive {:progress, 0.0}
    Clock.set(clock, Time.ms(500))
    assert_receive {:progress, 0.5}
    Clock.set(clock, Time.ms(1_000))
    assert {:ok, _} = Pipeline.stop(p)
    seen = progress()
    assert seen == Enum.sort(seen)
    assert List.last(seen) == 1.0
    assert Enum.count(seen, &(&1 == 1.0)) == 1
  end

  defp progress do
    receive do
      {:progress, n} -> [n | progress()]
    after
      0 -> []
    end
  end

  describe "Situ.Tap tells the end" do
    defp tapped(fun) do
      me = self()

      {:ok, p} =
        Pipeline.start(fn p ->
          {stream, tap} =
            p |> Situ.event_source(&send(me, {:post, &1})) |> Situ.map(fun) |> Situ.Tap.new()

          send(me, {:tap, tap})
          Situ.each(stream, & &1)
        end)

      assert_receive {:tap, tap}
      :ok = Situ.Tap.subscribe(tap)
      assert_receive {:post, post}
      {p, tap, post}
    end

    test "and when" do
      {p, tap, post} = tapped(& &1)
      post.(1)
      assert_receive {:situ_tap, ^tap, %{data: 1, originating_time: time}}
      assert {:ok, report} = Pipeline.stop(p)
      assert_received {:situ_tap_end, ^tap, {:closed, closed}}
      assert closed >= time and closed == report.final_time
      refute_received {:situ_tap_end, _, _}
    end

    test "and why" do
      {p, tap, post} = tapped(fn v -> if v == 2, do: raise("two"), else: v end)
      for v <- 1..2, do: post.(v)
      assert {:error, %{code: :component_failed}} = Pipeline.await(p)
      assert_received {:situ_tap_end, ^tap, %Situ.Error{code: :component_failed}}
    end

    test "also of one whose pipeline is killed" do
      {p, tap, _post} = tapped(& &1)
      Process.exit(p, :kill)
      assert_receive {:situ_tap_end, ^tap, %Situ.Error{code: :crashed}}
    end
  end
end
