defmodule Situ.Pipeline.TransactionsTest do
  # Three processes change a real pipeline at random moments, kill its processes, and stop parts and start them again,
  # while messages flow through slow and raising operators. A pure model (Situ.Fixture.ChangeModel) predicts every
  # message at every sink. `mix test --seed S` repeats the same changes; their order depends on the scheduling.
  use ExUnit.Case, async: true

  alias Situ.Fixture.ChangeModel, as: Model
  alias Situ.{Clock, Pipeline, Time}

  @moduletag :capture_log
  @moduletag timeout: Situ.Test.Budget.time_limit_ms()

  # 10,000 rounds with `bin/test --long`.
  @rounds if(Situ.Test.Budget.repeat_factor() > 1, do: 500, else: 250) *
            Situ.Test.Budget.repeat_factor()
  @workers 3
  @changes 8
  @count 150
  @parts ~w(A B Own)
  @kinds [:checkpoint, :extend, :kill, :remove, :replace, :stop, :tap]
  @settings [max_restarts: 1_000_000, stop_timeout: 20_000]

  # The errors with which each change may be refused.
  @refusals %{
    extend: [:not_running, :duplicate_name, :component_killed],
    broken: [:component_failed, :not_running, :duplicate_name],
    remove: [:not_running, :unknown_component, :component_killed],
    stop: [:not_running, :unknown_component, :component_killed],
    start: [:not_running, :unknown_component, :still_running, :no_checkpoint, :component_killed],
    tap: [:not_running, :component_restarted],
    replace: [:not_running, :component_restarted],
    checkpoint: [:not_running, :not_settled, :component_failed],
    pause: [:not_running, :fixed_clock]
  }

  defmodule Gain do
    use Situ.Component, inputs: [in: :any], outputs: [out: :any], options: [k: [type: :integer]]

    @impl true
    def init(opts), do: {:ok, {opts[:k], 0}}

    @impl true
    def handle_message(:in, message, _context, {k, n}),
      do: {[{:out, message.originating_time, {message.data, n, k}}], {k, n + 1}}

    @impl true
    def migrate({_k, n}, _old, new), do: {:ok, {new[:k], n}}
  end

  defmodule Broken do
    use Situ.Component, inputs: [in: :any]

    @impl true
    def init(_opts), do: raise("never starts")
  end

  test "every message at every sink is the one that the model predicts" do
    seed = ExUnit.configuration()[:seed]
    changes = Enum.flat_map(1..@rounds, &run_round({seed, &1}))

    # Every kind of change took effect at least once.
    done =
      for {kind, _name, result} <- changes, not match?({:error, _}, result), uniq: true, do: kind

    assert Enum.sort(done) == Enum.sort([{:start, :fresh}, {:start, :checkpoint} | @kinds])
  end

  defp run_round({seed, round} = key) do
    clock = Clock.manual(0)
    me = self()
    {:ok, p} = Pipeline.start(&build(&1, me, key), pipeline: [{:clock, clock} | @settings])
    assert Pipeline.clock(p) == clock

    changes =
      1..@workers
      |> Enum.map(&Task.async(fn -> make_changes(p, clock, {seed, round, &1}) end))
      |> Task.yield_many(60_000)
      |> Enum.flat_map(&fetch_changes!(&1, p, key))

    {result, count, kills} = finish(p, clock, rem(round, 4))
    changes = changes ++ kills
    check_result(result, changes, key)

    for {kind, _name, {:error, error}} <- changes,
        do: assert(error.code in refusals(kind), describe(key, {kind, error}, changes))

    problems = Model.find_problems(collect(%{}), changes, count)
    assert problems == [], describe(key, problems, changes)
    changes
  end

  defp fetch_changes!({_task, {:ok, changes}}, _p, _key), do: changes

  defp fetch_changes!({task, nil}, p, key) do
    place = Process.info(task.pid, :current_stacktrace)
    flunk(describe(key, {:no_reply, place, pending(p)}, []))
  end

  # A process that is killed loses the messages that it has received.
  defp check_result(result, changes, key) do
    assert {:ok, %{errors: []} = report} = result, describe(key, result, changes)
    killed? = Enum.any?(changes, &match?({:kill, _, _}, &1))

    for edge <- report.snapshot.edges, handled = edge.processed + edge.dropped do
      assert edge.emitted == handled or (killed? and edge.emitted > handled),
             describe(key, edge, changes)
    end
  end

  defp pending(p) do
    %{life: life} = :sys.get_state(p)

    stages = for {id, m} <- life.stages, m.added?, do: {id, m.path, m.status, m.alive?, m.open?}

    {life.phase, life.step, life.growths, life.parts, life.operations, life.links.active, stages}
  end

  # Ends by hand in every fourth round, which delivers the messages up to then.
  defp finish(p, clock, 0) do
    result = with {:error, %{code: :not_running}} <- Pipeline.stop(p), do: Pipeline.await(p)
    {result, min(@count, div(Clock.now(clock), Time.ms(1)) + 1), []}
  end

  defp finish(p, clock, kind) do
    # Its source has no end.
    Pipeline.remove(p, "Own")
    Clock.jump(clock, Time.ms(@count + 10))
    # The pipeline drains.
    kills = if kind == 1, do: for(_ <- 1..3, do: kill_victim(p)), else: []
    result = Pipeline.await(p, 60_000)
    if match?({:error, %{code: :timeout}}, result), do: flunk(inspect(pending(p), limit: 400))
    {result, @count, kills}
  end

  defp kill_victim(p) do
    for {"Victim", pid} <- list_processes(p), do: kill(pid)
    {:kill, "Victim", :ok}
  end

  defp describe({seed, round}, what, changes) do
    {what, changes} = {inspect(what, limit: 400), inspect(changes, limit: 400)}
    "seed #{seed}, round #{round}: #{what}\nchanges: #{changes}"
  end

  defp refusals({kind, _from}), do: @refusals[kind]
  defp refusals(kind), do: @refusals[kind]

  defp collect(seen) do
    receive do
      {:sink, name, from, value} ->
        collect(Map.update(seen, name, [{from, value}], &[{from, value} | &1]))
    after
      0 -> Map.new(seen, fn {name, values} -> {name, Enum.reverse(values)} end)
    end
  end

  # The main streams must not be affected by any change.
  defp build(p, me, key) do
    :rand.seed(:exsss, Tuple.append(key, 0))

    s0 =
      p
      |> Situ.from_enumerable(0..(@count - 1), every: Time.ms(1), name: "Numbers")
      |> Situ.map(& &1, async: true)
      |> Situ.name("s0")

    s1 = s0 |> Situ.via(Gain, k: 1, name: "Gain") |> Situ.name("s1")

    s2 =
      s0
      |> Situ.scan(Model.new_state(), &Model.step/2, async: true, name: "Scan")
      |> Situ.name("s2")

    s3 = s0 |> Situ.join(s2, Situ.Reproducible.exact()) |> Situ.name("s3")
    skips = Situ.map(s0, &Model.raise_at/1, on_error: :skip, async: true)

    restarts =
      Situ.scan(s0, Model.new_state(), &Model.raise_or_step/2, on_error: :restart, async: true)

    slow =
      Situ.map(s0, &wait_sometimes/1,
        policy: Situ.Delivery.throttle(Enum.random([1, 3, 100])),
        async: true
      )

    victim =
      Situ.scan(s0, Model.new_state(), &Model.step/2,
        name: "Victim",
        on_error: :restart,
        async: true
      )

    streams = [s0: s0, s1: s1, s2: s2, s3: s3, skips: skips, restarts: restarts, slow: slow]

    for {name, stream} <- [{:victim, victim} | streams],
        do: add_sink(stream, me, name, "Sink #{name}")
  end

  defp add_sink(stream, me, name, path \\ "Sink"),
    do: Situ.each(stream, &send(me, {:sink, name, self(), &1}), name: path, async: true)

  defp wait_sometimes(n) do
    if rem(n, 40) == 7, do: Process.sleep(1)
    n
  end

  # Each change lets more messages through; the last ones wait until all changes have been made.
  defp make_changes(p, clock, key) do
    :rand.seed(:exsss, key)

    for _ <- 1..@changes do
      change = make_change(:rand.uniform(15), p, Enum.random(@parts))
      advance(clock)
      change
    end
  end

  defp make_change(kind, p, name) when kind in [1, 2, 3] do
    {me, shape, on_error} = {parent(), :rand.uniform(4), Enum.random([:restart, :close])}

    result =
      Pipeline.extend(p, fn p ->
        stream = Pipeline.stream(p, "s0")
        Situ.composite(stream, name, &build_part(&1, me, name, shape), on_error: on_error)
        :ok
      end)

    {:extend, name, result}
  end

  defp make_change(4, p, _name) do
    result =
      Pipeline.extend(p, fn p ->
        Situ.composite(Pipeline.stream(p, "s2"), "Broken", fn stream ->
          stream |> Situ.map(& &1, async: true) |> Situ.via(Broken, [])
        end)
      end)

    {:broken, "Broken", result}
  end

  defp make_change(5, p, name), do: {:remove, name, Pipeline.remove(p, name)}

  defp make_change(kind, p, name) when kind in [6, 7],
    do: {:stop, name, Pipeline.stop_part(p, name, checkpoint: kind == 6)}

  defp make_change(kind, p, name) when kind in [8, 9] do
    from = if kind == 8, do: :checkpoint, else: :fresh
    {{:start, from}, name, Pipeline.start_part(p, name, from: from)}
  end

  defp make_change(10, p, _name) do
    {me, tap} = {parent(), {:tap, make_ref()}}

    result =
      with {:ok, tap} <- Situ.attach_tap({p, "s0"}, &send(me, {:sink, tap, self(), &1.data})) do
        for _ <- 0..:rand.uniform(300), do: :erlang.yield()
        Situ.detach_tap(tap)
      end

    {:tap, nil, result}
  end

  defp make_change(11, p, _name),
    do: {:replace, nil, Pipeline.replace(p, "Gain", k: :rand.uniform(9))}

  # In a consistent checkpoint, both operators have handled the same messages.
  defp make_change(12, p, _name) do
    handled = fn memories ->
      [{0, {_i, n, _hash}}] = memories["Scan"].steps
      {:plain, {_k, m}} = memories["Gain"].core
      [n, m]
    end

    {:checkpoint, nil, Pipeline.checkpoint(p, handled, timeout: 100)}
  end

  # A manual clock cannot be paused. The request still takes its place in the order of the changes.
  defp make_change(13, p, _name), do: {:pause, nil, Pipeline.pause(p)}

  # Kills a process of the part, or another one that may restart.
  defp make_change(_kind, p, name) do
    name = Enum.random([name, "Victim"])
    for {^name, pid} <- list_processes(p), do: kill(pid)
    {:kill, name, :ok}
  end

  defp kill(pid) do
    monitor = Process.monitor(pid)
    Process.exit(pid, :kill)
    receive do: ({:DOWN, ^monitor, _, _, _} -> :ok)
  end

  defp list_processes(p) do
    children =
      for {path, pid, _, _} <- Supervisor.which_children(p),
          is_pid(pid),
          do: {hd(String.split(path, ".")), pid}

    children |> Enum.shuffle() |> Enum.uniq_by(&elem(&1, 0))
  catch
    :exit, _ -> []
  end

  defp parent, do: hd(Process.get(:"$callers"))

  # Every shape passes the number of each message on.
  defp build_part(stream, me, "Own" = name, _shape) do
    stream.pipeline
    |> Situ.from_enumerable(Stream.iterate(0, &(&1 + 1)), every: Time.ms(1))
    |> Situ.scan(Model.new_state(), &Model.step/2, async: true)
    |> add_sink(me, name)
  end

  defp build_part(stream, me, name, shape) do
    stream
    |> shape_part(shape)
    |> Situ.scan(Model.new_state(), &Model.step/2, async: shape == 1)
    |> add_sink(me, name)
  end

  defp shape_part(stream, 1), do: stream

  defp shape_part(stream, 2),
    do: Situ.map(stream, &wait_sometimes/1, policy: Situ.Delivery.throttle(2), async: true)

  defp shape_part(stream, 3), do: stream |> Situ.map(& &1, async: true) |> Situ.map(& &1)

  defp shape_part(stream, 4) do
    other = Situ.map(stream, & &1, async: true)
    stream |> Situ.join(other, Situ.Reproducible.exact()) |> Situ.map(&elem(&1, 0))
  end

  defp advance(clock) do
    Clock.advance(clock, Time.ms(:rand.uniform(div(@count - 1, @workers * @changes))))
  end
end
