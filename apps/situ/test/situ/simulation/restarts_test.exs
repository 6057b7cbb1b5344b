defmodule Situ.Simulation.RestartsTest do
  # Components die at every point of a pipeline's life. Nothing is lost, and nothing is delivered twice.
  use ExUnit.Case, async: true

  alias Situ.{Delivery, Pipeline, Simulation, Test.Budget}
  alias Situ.Fixture.{Pass, Simulated}

  @moduletag timeout: Situ.Test.Budget.time_limit_ms()
  @schedules 300 * Budget.repeat_factor()
  @killed [name: "Killed", on_error: :restart]

  defp numbers(p, opts \\ []), do: Situ.from_enumerable(p, 1..20, [every: 1] ++ opts)

  defp check(build),
    do:
      Simulation.check(fn -> Simulated.check_values(build, 1..20) end,
        schedules: @schedules,
        kill: ["Killed", "Killed"]
      )

  test "of a component" do
    check(&(numbers(&1) |> Situ.via(Pass, @killed) |> Situ.map(fn n -> n end, async: true)))
  end

  test "of a component with a short queue" do
    policy = Delivery.throttle(2)

    check(fn p ->
      p
      |> numbers()
      |> Situ.via(Pass, [policy: policy] ++ @killed)
      |> Situ.map(& &1, async: true, policy: policy)
    end)
  end

  test "of a chain of operators" do
    check(fn p ->
      p |> numbers() |> Situ.map(& &1, [async: true] ++ @killed) |> Situ.map(& &1, async: true)
    end)
  end

  test "of a component with operators in its process" do
    check(fn p ->
      p
      |> numbers()
      |> Situ.via(Pass, @killed)
      |> Situ.map(& &1, policy: Delivery.synchronous(), on_error: :restart)
    end)
  end

  test "of a source" do
    check(&(numbers(&1, @killed) |> Situ.map(fn n -> n end, async: true)))
  end

  test "of an input of a join" do
    check(fn p ->
      other = p |> numbers() |> Situ.via(Pass, @killed)
      p |> numbers() |> Situ.join(other) |> Situ.map(&elem(&1, 0))
    end)
  end

  test "of two neighbours" do
    build = fn p ->
      p
      |> numbers()
      |> Situ.via(Pass, @killed)
      |> Situ.via(Pass, name: "Next", on_error: :restart, policy: Delivery.throttle(2))
      |> Situ.map(& &1, async: true)
    end

    Simulation.check(fn -> Simulated.check_order(build, 1..20) end,
      schedules: @schedules,
      kill: ["Killed", "Next", "Killed", "Next"]
    )
  end

  # If the consumer died after the closing mark of its source, the source's new process did not know that it needed the
  # mark again, and the pipeline did not end.
  test "of a source and its consumer" do
    build = fn p ->
      p |> numbers(@killed) |> Situ.via(Pass, name: "Next", on_error: :restart)
    end

    # This schedule is one of about 10,000 in which it happened.
    Simulation.check(fn -> Simulated.check_order(build, 1..20) end,
      seed: 5707,
      schedules: @schedules,
      kill: ["Killed", "Next", "Next"]
    )
  end

  test "of a chain of operators and the component after it" do
    build = fn p ->
      p
      |> numbers()
      |> Situ.map(& &1, [async: true] ++ @killed)
      |> Situ.via(Pass, name: "Next", on_error: :restart)
    end

    Simulation.check(fn -> Simulated.check_order(build, 1..20) end,
      schedules: @schedules,
      kill: ["Killed", "Next", "Next"]
    )
  end

  test "while two other processes change the pipeline" do
    Simulation.check(fn -> change_pipeline(&add_part/3) end,
      schedules: div(@schedules, 2),
      kill: ["Map", "A.Map", "A.Sink", "B.Sink"]
    )
  end

  test "while two other processes change parts that restart as a whole" do
    Simulation.check(fn -> change_pipeline(&add_unit/3) end,
      schedules: div(@schedules, 2),
      kill: ["A.Source", "A.Source", "A.Map", "B.Source", "B.Sink"]
    )
  end

  # A paused source took the demand of a new consumer before it knew its process, so the demand was lost.
  test "of a consumer while checkpoints are taken" do
    Simulation.check(&take_checkpoints/0, schedules: @schedules, kill: ["Map", "Map", "Map"])
  end

  defp take_checkpoints do
    me = self()
    {:ok, p} = Pipeline.start(&build(&1, me), pipeline: [max_restarts: 1_000])

    Simulation.spawn_process("Changes", fn ->
      for _ <- 1..5, do: Pipeline.checkpoint(p, fn _snapshot -> :ok end)
      send(me, {:changed, "Changes"})
    end)

    receive do: ({:changed, "Changes"} -> :ok)
    check_main_stream(Pipeline.await(p), drain([]))
  end

  # The request to stop reached the new process of the source before the pipeline's clock did. The source raised, its
  # consumers had no closing mark, and the removal never ended.
  test "of a source whose part is removed" do
    Simulation.check(fn -> remove_part(fn p -> Pipeline.remove(p, "Own") end) end,
      schedules: @schedules,
      kill: ["Own.Source", "Own.Source", "Own.Sink"]
    )
  end

  test "of a source whose pipeline is stopped" do
    Simulation.check(fn -> remove_part(fn _p -> :ok end) end,
      schedules: @schedules,
      kill: ["Own.Source", "Own.Source", "Own.Sink"]
    )
  end

  # A kill while the part is being added, removed or stopped is an error, and the only one.
  defp remove_part(remove) do
    me = self()

    {:ok, p} =
      Pipeline.start(
        &Situ.from_enumerable(&1, Stream.iterate(0, fn n -> n + 1 end), every: 1_000_000),
        pipeline: [max_restarts: 1_000]
      )

    if ok_or_killed(Pipeline.extend(p, &add_unit(&1, me, "Own"))) == :ok do
      receive do: ({"Own", n} when n >= 3 -> :ok)
      ok_or_killed(remove.(p))
    end

    ok_or_killed(Pipeline.stop(p, catch_up: 0))
  end

  defp ok_or_killed({:error, error}), do: assert(%{reason: :killed} = error.meta)
  defp ok_or_killed({:ok, _}), do: :ok
  defp ok_or_killed(:ok), do: :ok

  defp change_pipeline(add) do
    me = self()
    {:ok, p} = Pipeline.start(&build(&1, me), pipeline: [max_restarts: 1_000])

    for {name, from} <- [{"A", :checkpoint}, {"B", :fresh}],
        do:
          Simulation.spawn_process(name, fn -> change(p, &add.(&1, me, name), name, from, me) end)

    for name <- ["A", "B"], do: receive(do: ({:changed, ^name} -> :ok))
    check_main_stream(Pipeline.await(p), drain([]))
  end

  defp build(p, me) do
    p
    |> Situ.from_enumerable(0..40, every: 1_000_000)
    |> Situ.map(& &1, async: true, name: "Map", on_error: :restart)
    |> Situ.name("main")
    |> Situ.each(&send(me, {:main, &1}), async: true)
  end

  defp change(p, add, name, from, me) do
    for _ <- 1..2 do
      result = Pipeline.extend(p, add)
      refused(result, [:not_running, :duplicate_name, :component_killed])

      result = Pipeline.stop_part(p, name, checkpoint: from == :checkpoint)
      refused(result, [:not_running, :unknown_component, :component_killed])

      result = Pipeline.start_part(p, name, from: from)

      codes = [
        :not_running,
        :unknown_component,
        :component_killed,
        :still_running,
        :no_checkpoint
      ]

      refused(result, codes)
      refused(Pipeline.remove(p, name), [:not_running, :unknown_component, :component_killed])
    end

    send(me, {:changed, name})
  end

  defp add_part(p, me, name) do
    Situ.composite(Pipeline.stream(p, "main"), name, fn stream ->
      stream
      |> Situ.map(& &1, async: true, on_error: :restart, name: "Map")
      |> Situ.each(&send(me, {name, &1}), async: true, name: "Sink")
    end)

    :ok
  end

  # A part with a source: if one of its stages is killed, all start again.
  defp add_unit(p, me, name) do
    Situ.composite(
      p,
      name,
      fn p ->
        p
        |> Situ.from_enumerable(Stream.iterate(0, &(&1 + 1)), every: 1_000_000, name: "Source")
        |> Situ.map(& &1, async: true, name: "Map")
        |> Situ.each(&send(me, {name, &1}), async: true, name: "Sink")
      end,
      on_error: :restart
    )

    :ok
  end

  defp refused({:error, %{code: code}}, codes), do: assert(code in codes)
  defp refused(_done, _codes), do: :ok

  defp check_main_stream({:ok, _report}, seen), do: assert(seen == Enum.to_list(0..40))

  defp check_main_stream({:error, error}, seen) do
    assert error.code == :component_killed
    assert seen == Enum.take(0..40, length(seen))
  end

  defp drain(seen) do
    receive do
      {:main, n} -> drain([n | seen])
    after
      0 -> Enum.reverse(seen)
    end
  end
end
