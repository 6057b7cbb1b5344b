defmodule Situ.Diagnostics.AveragesTest do
  use ExUnit.Case, async: true
  alias Situ.Diagnostics.{Averages, Window}
  alias Situ.Ports.Counters

  doctest Window

  # An edge to which each second `n` messages are handed, `age` ns old, and from which they are taken `handling` ns
  # each.
  defp second(ref, n, age, handling) do
    Counters.emitted(ref, n, age, age + 1_000)
    Counters.processed(ref, n, age + 2_000, n * handling)
    %{1 => Counters.totals(ref)}
  end

  test "a window holds what came since the newest mark that is old enough" do
    ref = Counters.new()
    averages = Averages.new(1_000, 0)
    averages = Averages.mark(averages, 1_000, second(ref, 100, 50_000, 5))
    averages = Averages.mark(averages, 2_000, second(ref, 10, 70_000, 9))
    now = second(ref, 30, 90_000, 15)

    assert %{
             1 => %Window{
               span: 1_000,
               emitted: 30,
               processed: 30,
               dropped: 0,
               created: 90_000,
               posted: 91_000,
               latency: 92_000,
               handling: 15,
               queue: 0.0,
               size: nil
             }
           } = Averages.windows(averages, 3_000, now)

    # Less than a span after the last mark: the one before counts.
    assert %{1 => %{span: 1_900, emitted: 40, created: 85_000}} =
             Averages.windows(averages, 2_900, now)
  end

  test "just after the start the window is what there is; a mean of nothing is nil" do
    averages = Averages.new(1_000, 500)
    nothing = %{1 => Counters.totals(Counters.new())}

    assert %{1 => %Window{span: 100, emitted: 0, latency: nil, queue: nil}} =
             Averages.windows(averages, 600, nothing)

    assert %{1 => %{span: 0}} = Averages.windows(averages, 500, nothing)
  end

  test "an edge that came later begins with nothing" do
    averages = Averages.new(1_000, 0) |> Averages.mark(1_000, %{})
    now = second(Counters.new(), 3, 0, 0)
    assert %{1 => %{emitted: 3}} = Averages.windows(averages, 2_000, now)
  end

  test "however often it looks, few marks are kept and the window never gets shorter than the span" do
    averages = Enum.reduce(1..10_000, Averages.new(1_000, 0), &Averages.mark(&2, &1, %{}))

    assert length(averages.marks) in 10..20
    assert %{1 => %{span: span}} = Averages.windows(averages, 10_000, %{1 => zero()})
    assert span in 1_000..1_100
  end

  defp zero, do: Counters.totals(Counters.new())
end
