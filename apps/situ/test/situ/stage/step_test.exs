defmodule Situ.Stage.StepTest do
  # A component and the operators after it are two steps of one stage. They behave as in two processes.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{Delivery, Pipeline}
  alias Situ.Fixture.{Count, Pass}

  @moduletag :capture_log

  defp operators(stream, opts) do
    stream
    |> Situ.map(&(&1 * 2), opts)
    |> Situ.filter(&(rem(&1, 3) != 0), opts)
    |> Situ.scan(0, &(&1 + &2), opts)
  end

  defp source(p, 0, n), do: Situ.from_enumerable(p, numbers(0, n), every: 10)
  defp source(p, 1, n), do: Situ.source(p, Count, count: n)
  defp source(p, 2, n), do: p |> source(0, n) |> Situ.via(Pass)

  defp numbers(1, n), do: Enum.to_list(0..(n - 1)//1)
  defp numbers(_kind, n), do: Enum.to_list(1..n//1)

  property "operators in the process of a component receive every message, whatever their number",
    numtests: 60 do
    forall {kind, n} <- {integer(0, 2), integer(0, 1_300)} do
      expected = kind |> numbers(n) |> Enum.map(&(&1 * 2)) |> Enum.filter(&(rem(&1, 3) != 0))

      for opts <- [[policy: Delivery.synchronous()], [async: true]] do
        values = Situ.to_list(&(&1 |> source(kind, n) |> operators(opts)))
        assert values == Enum.scan(expected, &+/2)
      end
    end
  end

  test "messages that wait for their time pass through the operators after them" do
    build = fn p ->
      [
        Situ.from_enumerable(p, 0..2, every: 10_000_000),
        Situ.from_enumerable(p, 3..5, every: 15_000_000)
      ]
      |> Situ.merge()
      |> Situ.map(& &1.data, policy: Delivery.synchronous())
    end

    # In real time, the last messages are posted before their time.
    for opts <- [[], [replay: [speed: :max]]],
        do: assert(build |> Situ.to_list(pipeline: opts) |> Enum.sort() == [0, 1, 2, 3, 4, 5])
  end

  test "a failing operator in the process of a source ends the pipeline with its error" do
    build = fn p ->
      p
      |> Situ.from_enumerable(1..100, every: 10)
      |> Situ.map(&(1 / (&1 - 50)), policy: Delivery.synchronous(), name: "Divide")
      |> Situ.each(& &1)
    end

    assert {:error, %{meta: %{component: "Divide"}}} = Pipeline.run(build)
  end
end
