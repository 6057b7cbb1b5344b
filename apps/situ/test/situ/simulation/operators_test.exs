defmodule Situ.Simulation.OperatorsTest do
  # Operators give the same results under every schedule.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{Delivery, Interval, Reproducible, Simulation}
  alias Situ.Fixture.Simulated

  @moduletag timeout: Situ.Test.Budget.time_limit_ms()

  # Each run of a property is one graph, under some schedules.
  @schedules 12

  defp stream, do: timed_values(integer(0, 9), 6)

  defp results(inputs, build) do
    case Situ.Test.run(inputs, build, pipeline: [replay: [interval: {0, :unbounded}]]) do
      {:ok, outputs} -> outputs
      {:error, error} -> raise error
    end
  end

  defp same_results(inputs, build) do
    usual = Simulation.run(fn -> results(inputs, build) end, choices: %{}).value
    assert is_list(usual)
    Simulation.check(fn -> assert results(inputs, build) == usual end, schedules: @schedules)
  end

  property "join", numtests: 40 do
    forall {a, b, left, length} <- {stream(), stream(), integer(-12, 12), integer(0, 12)} do
      window = Interval.new(left, true, left + length, true)

      for interpolator <- [Reproducible.nearest(window), Reproducible.last(window)],
          do: same_results(%{a: a, b: b}, &Situ.join(&1.a, &1.b, interpolator))
    end
  end

  property "zip, and operators in processes of their own", numtests: 40 do
    forall {a, b, c} <- {stream(), stream(), stream()} do
      same_results(%{a: a, b: b, c: c}, fn %{a: a, b: b, c: c} ->
        Situ.zip([Situ.map(a, & &1, async: true), b, Situ.filter(c, &(&1 > 3))])
      end)
    end
  end

  property "windows and statistics", numtests: 40 do
    forall {a, left, length} <- {stream(), integer(-12, 0), integer(0, 12)} do
      window = Interval.new(left, true, left + length, true)

      same_results(
        %{a: a},
        &(&1.a |> Situ.window(window) |> Situ.map(fn list -> length(list) end))
      )

      same_results(%{a: a}, &(&1.a |> Situ.map(fn n -> n end, async: true) |> Situ.sum()))
    end
  end

  for branches <- [:values, :processes] do
    test "parallel with branches as #{branches}" do
      build = fn p ->
        p
        |> Situ.from_enumerable(1..12, every: 1)
        |> Situ.map(&%{rem(&1, 3) => &1, :all => &1})
        |> Situ.parallel(fn _key, s -> Situ.map(s, & &1, async: true) end,
          branches: unquote(branches)
        )
        |> Situ.map(& &1.all)
      end

      Simulation.check(fn -> Simulated.check_values(build, 1..12) end, schedules: 60)
    end
  end

  test "map_async" do
    build = &(Situ.from_enumerable(&1, 1..20, every: 1) |> Situ.map_async(fn n -> n end, max: 3))
    Simulation.check(fn -> Simulated.check_values(build, 1..20) end, schedules: 150)
  end

  test "map_async loses and repeats nothing if it is killed" do
    build =
      &(Situ.from_enumerable(&1, 1..20, every: 1)
        |> Situ.map_async(fn n -> n end, max: 3, on_error: :restart, name: "Killed"))

    Simulation.check(fn -> Simulated.check_values(build, 1..20) end,
      schedules: 150,
      kill: ["Killed", "Killed"]
    )
  end

  for {name, policy} <- [
        latest: Delivery.latest(),
        max_queue: Delivery.max_queue(2),
        throttled: Delivery.max_queue(2, throttle: true)
      ] do
    test "a lossy input (#{name}) loses only what it counts, and never the newest" do
      policy = unquote(Macro.escape(policy))

      build =
        &(Situ.from_enumerable(&1, 1..20, every: 1)
          |> Situ.map(fn n -> n end, async: true, policy: policy))

      Simulation.check(
        fn ->
          {seen, {:ok, report}} = Simulated.run(build)
          values = Enum.map(seen, &elem(&1, 1))
          assert values == values |> Enum.sort() |> Enum.uniq()
          assert List.last(values) == 20

          for edge <- report.snapshot.edges,
              do: assert(edge.emitted == edge.processed + edge.dropped)
        end,
        schedules: 150
      )
    end
  end
end
