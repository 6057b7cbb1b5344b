defmodule Situ.Simulation.ChangesTest do
  # Three processes add, stop, start and remove parts of a running pipeline and take checkpoints, while components are
  # killed. The pipeline always ends, and its main stream loses nothing. The programs of changes are random, but the
  # same in every run.
  use ExUnit.Case, async: true

  alias Situ.{Pipeline, Simulation, Test.Budget}
  alias Situ.Fixture.Pass

  @moduletag timeout: Situ.Test.Budget.time_limit_ms()
  @programs 12
  @schedules 15 * Budget.repeat_factor()
  @changes 7

  # No two neighbours are killed: messages between them would be lost.
  @killed ~w(Pass Pass Unit.Source Unit.Map Unit.Join Unit.Sink) ++
            ~w(Open.Map Open.Join Open.Sink Single.Map Single.Map)

  # The errors of a change that meets another one, or a component that has just been killed.
  @refusals [
    :not_running,
    :unknown_component,
    :component_killed,
    :component_failed,
    :component_restarted,
    :still_running,
    :no_checkpoint,
    :not_settled,
    :duplicate_name
  ]

  test "random changes by three processes" do
    for program <- 1..@programs do
      Simulation.check(fn -> change_and_end(program) end, schedules: @schedules, kill: @killed)
    end
  end

  defp change_and_end(program) do
    me = self()
    {:ok, p} = Pipeline.start(&build(&1, me), pipeline: [max_restarts: 1_000])
    parts = ["Unit", "Open", "Single"]

    for part <- parts do
      Simulation.spawn_process("Changes #{part}", fn ->
        for i <- 1..@changes, do: change(:erlang.phash2({program, part, i}, 12), p, part, me)
        send(me, {:changed, part})
      end)
    end

    for part <- parts, do: receive(do: ({:changed, ^part} -> :ok))
    for part <- parts, do: ok_or_refused(Pipeline.remove(p, part))
    check_end(end_pipeline(p, rem(program, 3)))
    seen = drain([])
    assert seen == Enum.take(0..30, length(seen))
  end

  defp end_pipeline(p, 0), do: Pipeline.await(p)
  defp end_pipeline(p, n), do: Pipeline.stop(p, catch_up: (n - 1) * 1_000)

  # A part that is being stopped or started does not restart when one of its components is killed.
  defp check_end({:ok, report}), do: assert(report.errors == [])
  defp check_end({:error, %{code: :not_running}}), do: :ok
  defp check_end({:error, error}), do: assert(error.meta.reason == :killed)

  defp build(p, me) do
    first =
      p
      |> Situ.from_enumerable(0..30, every: 1_000_000)
      |> Situ.via(Pass, name: "Pass", on_error: :restart)

    main = first |> Situ.map(& &1, async: true) |> Situ.name("main")

    first
    |> Situ.join(main, Situ.Reproducible.exact())
    |> Situ.each(fn {n, n} -> send(me, {:main, n}) end, async: true)
  end

  defp change(n, p, part, me) when n in [0, 1, 2],
    do: ok_or_refused(Pipeline.extend(p, &add_part(&1, part, me)))

  defp change(3, p, part, _me), do: ok_or_refused(Pipeline.stop_part(p, part, checkpoint: true))
  defp change(4, p, part, _me), do: ok_or_refused(Pipeline.stop_part(p, part))
  defp change(5, p, part, _me), do: ok_or_refused(Pipeline.stop_part(p, part, catch_up: 0))
  defp change(6, p, part, _me), do: ok_or_refused(Pipeline.start_part(p, part, from: :checkpoint))
  defp change(7, p, part, _me), do: ok_or_refused(Pipeline.start_part(p, part))
  defp change(8, p, part, _me), do: ok_or_refused(Pipeline.remove(p, part))
  defp change(9, p, _part, _me), do: ok_or_refused(Pipeline.checkpoint(p, fn _ -> :ok end))
  defp change(10, p, _part, _me), do: ok_or_refused(Pipeline.replace(p, "Pass", []))

  defp change(11, p, _part, me) do
    with {:ok, tap} <- Situ.attach_tap({p, "main"}, &send(me, {:tap, &1.data})),
         do: Situ.detach_tap(tap)
  end

  # All stages of the part restart together.
  defp add_part(p, "Unit" = name, me) do
    build = fn p ->
      numbers = add_numbers(p, Stream.iterate(0, &(&1 + 1)), [])

      numbers
      |> Situ.join(numbers, Situ.Reproducible.exact(), name: "Join")
      |> add_sink(name, me, [])
    end

    Situ.composite(p, name, build, on_error: :restart)
    :ok
  end

  # The part closes when one of its stages fails.
  defp add_part(p, "Open" = name, me) do
    build = fn stream ->
      other = Situ.map(stream, & &1, async: true, name: "Map", on_error: :restart)

      stream
      |> Situ.join(other, Situ.Reproducible.exact(), name: "Join")
      |> add_sink(name, me, [])
    end

    Situ.composite(Pipeline.stream(p, "main"), name, build, on_error: :close)
    :ok
  end

  # Each stage of the part restarts alone.
  defp add_part(p, "Single" = name, me) do
    opts = [on_error: :restart]
    Situ.composite(p, name, &(&1 |> add_numbers(0..10, opts) |> add_sink(name, me, opts)))
    :ok
  end

  defp add_numbers(p, numbers, opts) do
    p
    |> Situ.from_enumerable(numbers, [every: 1_000_000, name: "Source"] ++ opts)
    |> Situ.map(& &1, [async: true, name: "Map"] ++ opts)
  end

  defp add_sink(stream, part, me, opts),
    do: Situ.each(stream, &send(me, {part, &1}), [async: true, name: "Sink"] ++ opts)

  defp ok_or_refused({:error, error}), do: assert(error.code in @refusals, inspect(error))
  defp ok_or_refused(_done), do: :ok

  defp drain(seen) do
    receive do
      {:main, n} -> drain([n | seen])
    after
      0 -> Enum.reverse(seen)
    end
  end
end
