defmodule Situ.Diagnostics.AveragesTest do
  use ExUnit.Case, async: true
  alias Situ.Diagnostics.{Averages, Window}
  alias Situ.Ports.Counters

  doctest Window

  # Each second, `n` messages are emitted into an edge at an age of `age` ns and handled in `handling` ns each.
  defp second(ref, n, age, handling) do
    Counters.count_emitted(ref, n, age, age + 1_000)
    Counters.count_processed(ref, n, age + 2_000, n * handling)
    %{1 => Counters.read_totals(ref)}
  end

  test "a window covers everything since the newest mark that is old enough" do
    ref = Counters.new()
    averages = Averages.new(1_000, 0)
    averages = Averages.add_mark(averages, 1_000, second(ref, 100, 50_000, 5))
    averages = Averages.add_mark(averages, 2_000, second(ref, 10, 70_000, 9))
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
           } = Averages.build_windows(averages, 3_000, now)

    # The last mark is less than one span old, so the mark before it is used.
    assert %{1 => %{span: 1_900, emitted: 40, created: 85_000}} =
             Averages.build_windows(averages, 2_900, now)
  end

  test "immediately after the start the window is short, and a mean of no values is nil" do
    averages = Averages.new(1_000, 500)
    nothing = %{1 => Counters.read_totals(Counters.new())}

    assert %{1 => %Window{span: 100, emitted: 0, latency: nil, queue: nil}} =
             Averages.build_windows(averages, 600, nothing)

    assert %{1 => %{span: 0}} = Averages.build_windows(averages, 500, nothing)
  end

  test "an edge that was added later starts from zero" do
    averages = Averages.new(1_000, 0) |> Averages.add_mark(1_000, %{})
    now = second(Counters.new(), 3, 0, 0)
    assert %{1 => %{emitted: 3}} = Averages.build_windows(averages, 2_000, now)
  end

  test "keeps few marks and never a window shorter than the span, however often marks are set" do
    averages = Enum.reduce(1..10_000, Averages.new(1_000, 0), &Averages.add_mark(&2, &1, %{}))

    assert length(averages.marks) in 10..20
    assert %{1 => %{span: span}} = Averages.build_windows(averages, 10_000, %{1 => zero()})
    assert span in 1_000..1_100
  end

  defp zero, do: Counters.read_totals(Counters.new())
end
