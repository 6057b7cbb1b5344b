defmodule Situ.Ports.ProgressRingTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Ports.ProgressRing

  @ms 1_000_000

  defp trail(notes) do
    ref = :atomics.new(ProgressRing.word_count(), signed: true)
    for {time, at} <- notes, do: ProgressRing.record_passage(ref, 1, time, at)
    ref
  end

  test "an empty trail returns nil" do
    assert ProgressRing.find_passage(trail([]), 1, 0) == nil
  end

  test "returns when the requested time, or the first time after it, was passed" do
    ref = trail([{0, 10 * @ms}, {100, 20 * @ms}, {200, 30 * @ms}])
    assert ProgressRing.find_passage(ref, 1, -5) == 10 * @ms
    assert ProgressRing.find_passage(ref, 1, 0) == 10 * @ms
    assert ProgressRing.find_passage(ref, 1, 1) == 20 * @ms
    assert ProgressRing.find_passage(ref, 1, 200) == 30 * @ms
    assert ProgressRing.find_passage(ref, 1, 201) == nil
  end

  property "is accurate to one millisecond" do
    forall steps <- list({integer(1, 20), integer(0, 20)}) do
      {notes, _} =
        Enum.map_reduce(steps, {0, 0}, fn {ahead, later}, {time, at} ->
          {{time + ahead, at + later * 100_000}, {time + ahead, at + later * 100_000}}
        end)

      ref = trail(notes)
      last = with [_ | _] <- notes, do: elem(List.last(notes), 0), else: (_ -> 0)

      for time <- 0..(last + 1) do
        wanted = Enum.find_value(notes, fn {t, at} -> t >= time && at end)

        case ProgressRing.find_passage(ref, 1, time) do
          nil -> assert wanted == nil
          at -> assert at >= wanted and at - wanted < @ms
        end
      end
    end
  end

  test "reports old entries as forgotten" do
    ref = trail(for n <- 1..200, do: {n, n * @ms})
    assert ProgressRing.find_passage(ref, 1, 10) == :forgotten
    assert ProgressRing.find_passage(ref, 1, 150) == 150 * @ms
    assert ProgressRing.find_passage(ref, 1, 201) == nil
  end
end
