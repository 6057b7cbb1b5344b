defmodule Situ.SimulationTest do
  use ExUnit.Case, async: true
  doctest Situ.Simulation

  alias Situ.{Pipeline, Simulation, Time}
  alias Situ.Simulation.{Failure, Result}

  defmodule Race do
    # Pairs each message of `b` with the last one of `a` that has arrived.
    use Situ.Component, inputs: [a: :any, b: :any], outputs: [out: :any]

    @impl true
    def init(_opts), do: {:ok, nil}

    @impl true
    def handle_message(:a, message, _context, _last), do: {[], message.data}

    def handle_message(:b, message, _context, last),
      do: {[{:out, message.originating_time, {message.data, last}}], last}
  end

  defp numbers(p, name \\ "Numbers"), do: Situ.from_enumerable(p, 1..5, every: 10, name: name)

  defp zip(p),
    do: Situ.zip([numbers(p), p |> numbers("Others") |> Situ.map(&(&1 * 10), async: true)])

  defp race(p) do
    node = Pipeline.add(p, Race, name: "Race")
    p |> numbers() |> Pipeline.connect(node, :a)
    p |> numbers("Others") |> Situ.map(&(&1 * 10), async: true) |> Pipeline.connect(node, :b)
    Situ.Node.output(node, :out)
  end

  defp failure(fun, opts) do
    Simulation.check(fun, opts)
    flunk("nothing has failed")
  rescue
    failure in Failure -> failure
  end

  # The first use of a module loads it, which may take seconds on a busy machine.
  setup_all do
    for seed <- 0..3,
        do: Simulation.run(fn -> Situ.to_list(&zip/1) end, seed: seed, kill: ["Zip"])

    Simulation.run(fn -> Situ.to_list(&(numbers(&1) |> Situ.map_async(fn n -> n end))) end)
    :ok
  end

  describe "a schedule" do
    test "is the same whenever its seed or its choices are run" do
      for seed <- 1..40 do
        result = Simulation.run(fn -> Situ.to_list(&zip/1) end, seed: seed)
        assert result.value == for(n <- 1..5, do: [n, n * 10])
        assert result == Simulation.run(fn -> Situ.to_list(&zip/1) end, seed: seed)

        again = Simulation.run(fn -> Situ.to_list(&zip/1) end, choices: result.choices)
        assert again == result
      end
    end

    test "differs between seeds" do
      traces =
        for seed <- 1..20, do: Simulation.run(fn -> Situ.to_list(&zip/1) end, seed: seed).steps

      assert length(Enum.uniq(traces)) == 20
    end

    test "is also the same with failures of components and with jobs" do
      fun = fn ->
        Situ.collect(
          fn p ->
            p
            |> Situ.from_enumerable(1..20, every: 1)
            |> Situ.map_async(& &1, max: 3)
            |> Situ.map(& &1, async: true, on_error: :restart, name: "Killed")
          end,
          pipeline: [max_restarts: 10]
        )
      end

      for seed <- 1..20 do
        run = fn -> Simulation.run(fun, seed: seed, kill: ["Killed", "Killed"]) end
        assert run.().steps == run.().steps
      end
    end

    test "names the components, and what they take from whom" do
      result = Simulation.run(fn -> Situ.to_list(&zip/1) end, choices: %{})

      # Zip shares the process of the first source.
      assert %{process: "Numbers", event: "handles 5 messages from Map", unusual?: false} in result.steps

      assert Result.format_steps(result) =~ ~r/^ +1   test starts, and waits$/m
    end
  end

  describe "time" do
    test "is virtual" do
      fun = fn ->
        me = self()
        {:ok, p} = Pipeline.start(fn p -> p |> ticks() |> Situ.each(&send(me, {:tick, &1})) end)
        for _ <- 1..24, do: receive(do: ({:tick, _} -> :ok))
        Pipeline.stop(p)
      end

      result = Simulation.run(fun, seed: 3)
      assert {:ok, %{errors: []}} = result.value
      assert result.time >= 23 * Time.h(1)
    end

    test "passes for clocks that are created in the simulation" do
      fun = fn ->
        clock = Situ.Clock.virtual(0, 2.0)
        assert Situ.Clock.now(clock) == 0
        assert [1, 2, 3] = Situ.to_list(&Situ.from_enumerable(&1, 1..3, every: 1))
        {Situ.Clock.now(clock), Situ.Clock.now(Situ.Clock.real())}
      end

      %{value: {virtual, real}, time: time} = Simulation.run(fun)
      assert virtual in 1..(2 * time)

      assert Time.to_iso8601(real) =~ "2020-01-01T00:00:00"
    end

    defp ticks(p), do: Situ.timer(p, every: Time.h(1))
  end

  describe "check" do
    test "finds a race, shrinks it, and both schedules repeat it" do
      usual = Simulation.run(fn -> Situ.to_list(&race/1) end, choices: %{}).value
      fun = fn -> assert Situ.to_list(&race/1) == usual end
      failure = failure(fun, schedules: 300)

      assert failure.kind == :raised
      assert %ExUnit.AssertionError{} = failure.reason
      assert map_size(failure.choices) in 1..6

      assert %{kind: :raised} = Simulation.run(fun, choices: failure.choices).failure
      assert %{kind: :raised} = Simulation.run(fun, seed: failure.seed).failure

      text = Exception.message(failure)
      assert text =~ "Assertion with == failed"
      assert text =~ "Race handles 5 messages from Map"
      assert text =~ "Found with seed: #{failure.seed}."
      assert text =~ "Situ.Simulation.run(fun, choices: %{"
    end

    test "finds a race through a process that is not simulated" do
      fun = fn ->
        {:ok, agent} = Agent.start_link(fn -> [] end)
        note = fn n -> Agent.update(agent, &[n | &1]) end
        a = fn p -> p |> numbers() |> Situ.each(note, async: true, name: "A") end
        b = fn p -> p |> numbers("Others") |> Situ.each(&note.(-&1), async: true, name: "B") end
        {:ok, _} = Pipeline.run(fn p -> {a.(p), b.(p)} end)
        seen = Agent.get(agent, &Enum.reverse/1)
        Agent.stop(agent)
        assert hd(seen) == hd(Enum.sort_by(seen, &(-&1)))
      end

      assert %{kind: :raised} = failure(fun, schedules: 200)
    end

    test "returns :ok if nothing fails" do
      fun = fn -> assert length(Situ.to_list(&zip/1)) == 5 end
      assert Simulation.check(fun, schedules: 50) == :ok
    end

    test "does not count the wait for information about a busy process as a deadlock" do
      # While it is in such a function, a process does not answer `Process.info/2`.
      spin = fn began ->
        list = Enum.to_list(1..3_000_000)
        :atomics.put(began, 1, 1)
        for _ <- 1..1_000_000, do: {:erts_debug.flat_size(list), :erlang.yield()}
      end

      inspect_busy = fn ->
        began = :atomics.new(1, [])
        busy = spawn(fn -> spin.(began) end)
        await_value(began, 1)
        for _ <- 1..5, do: assert({:reductions, _n} = Process.info(busy, :reductions))
        Process.exit(busy, :kill)
      end

      assert Simulation.check(inspect_busy, schedules: 2) == :ok
    end

    defp await_value(cell, value),
      do: if(:atomics.get(cell, 1) != value, do: await_value(cell, value))

    test "reports a deadlock with the state of every process" do
      fun = fn ->
        wait = fn _n -> receive(do: (:never -> :ok)) end
        endless = Stream.iterate(0, &(&1 + 1))

        Pipeline.run(fn p ->
          p
          |> Situ.from_enumerable(endless, every: 1, name: "Numbers")
          |> Situ.each(wait, name: "Waits", async: true)
        end)
      end

      failure = failure(fun, schedules: 1)
      assert failure.kind == :deadlock
      processes = Map.new(failure.processes)
      assert processes["Numbers"] == "waits for a message"
      assert processes["Waits"] =~ ~r/^waits in .*SimulationTest/
      assert processes["test"] =~ "waits in Situ.Pipeline.Launcher.run/2"
      assert Exception.message(failure) =~ "Waits waits in"
    end

    test "reports a function that waits for a message that nobody sends" do
      failure = failure(fn -> receive(do: (:never -> :ok)) end, schedules: 1)
      assert failure.kind == :deadlock
      assert [{"test", "waits in " <> _}] = failure.processes
    end

    test "reports a simulation that does not end" do
      fun = fn -> Pipeline.run(&ticks/1) end
      assert %{kind: :endless} = failure(fun, schedules: 1, max_steps: 500, shrink: 5)
    end

    test "reports an exit of the function and of a process that is linked to it" do
      assert %{kind: :raised, how: :exit, reason: :over} =
               failure(fn -> exit(:over) end, schedules: 1)

      linked = fn ->
        Simulation.spawn_process("other", fn -> exit(:broken) end)
        receive(do: (:never -> :ok))
      end

      assert %{kind: :raised, how: :exit, reason: :broken} = failure(linked, schedules: 1)
    end
  end

  describe "kill" do
    test "ends each listed component at most once, at different steps" do
      fun = fn ->
        Situ.collect(
          fn p ->
            p |> numbers() |> Situ.map(& &1, async: true, on_error: :restart, name: "Killed")
          end,
          []
        )
      end

      kills =
        for seed <- 1..60 do
          steps = Simulation.run(fun, seed: seed, kill: ["Killed"]).steps
          for {%{event: "is killed"}, i} <- Enum.with_index(steps), do: i
        end

      assert Enum.all?(kills, &(length(&1) <= 1))
      assert kills |> List.flatten() |> Enum.uniq() |> length() > 10
    end
  end

  test "processes that the function starts take part" do
    fun = fn ->
      me = self()
      for name <- ["a", "b"], do: Simulation.spawn_process(name, fn -> send(me, name) end)
      for _ <- 1..2, do: receive(do: (name -> name))
    end

    orders = for seed <- 1..30, uniq: true, do: Simulation.run(fun, seed: seed).value
    assert Enum.sort(orders) == [["a", "b"], ["b", "a"]]
  end

  test "nothing is left when a simulation has ended" do
    fun = fn ->
      {:ok, p} =
        Pipeline.start(fn p -> p |> ticks() |> Situ.each(fn _ -> :ok end, async: true) end)

      p
    end

    pipeline = Simulation.run(fun).value
    refute Process.alive?(pipeline)
    refute Enum.any?(Pipeline.list(), &(&1.pid == pipeline))
  end
end
