defmodule Situ.Ports.TrailTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Ports.Trail

  @ms 1_000_000

  defp trail(notes) do
    ref = :atomics.new(Trail.words(), signed: true)
    for {time, at} <- notes, do: Trail.note(ref, 1, time, at)
    ref
  end

  test "an empty one knows of nothing" do
    assert Trail.passed(trail([]), 1, 0) == nil
  end

  test "the time that was asked for, or the first behind it" do
    ref = trail([{0, 10 * @ms}, {100, 20 * @ms}, {200, 30 * @ms}])
    assert Trail.passed(ref, 1, -5) == 10 * @ms
    assert Trail.passed(ref, 1, 0) == 10 * @ms
    assert Trail.passed(ref, 1, 1) == 20 * @ms
    assert Trail.passed(ref, 1, 200) == 30 * @ms
    assert Trail.passed(ref, 1, 201) == nil
  end

  property "is right within a millisecond, and says when it has forgotten" do
    forall steps <- list({integer(1, 20), integer(0, 20)}) do
      {notes, _} =
        Enum.map_reduce(steps, {0, 0}, fn {ahead, later}, {time, at} ->
          {{time + ahead, at + later * 100_000}, {time + ahead, at + later * 100_000}}
        end)

      ref = trail(notes)
      last = with [_ | _] <- notes, do: elem(List.last(notes), 0), else: (_ -> 0)

      for time <- 0..(last + 1) do
        wanted = Enum.find_value(notes, fn {t, at} -> t >= time && at end)

        case Trail.passed(ref, 1, time) do
          nil -> assert wanted == nil
          at -> assert at >= wanted and at - wanted < @ms
        end
      end
    end
  end

  test "what is long ago is forgotten, and told so" do
    ref = trail(for n <- 1..200, do: {n, n * @ms})
    assert Trail.passed(ref, 1, 10) == :forgotten
    assert Trail.passed(ref, 1, 150) == 150 * @ms
    assert Trail.passed(ref, 1, 201) == nil
  end
end
