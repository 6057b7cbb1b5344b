defmodule Situ.Store.SegmentedRecording.TimelineTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Store.SegmentedRecording.Timeline
  alias Situ.Store.SegmentedRecording.Timeline.Part

  # A part of consecutive times, so the number of messages before a time is a difference.
  defp part(number, run, first, count),
    do: %Part{
      number: number,
      run: run,
      id: 1,
      count: count,
      first: first,
      last: first + count - 1
    }

  defp count_before(part, time), do: min(max(time - part.first, 0), part.count)
  defp add(timeline, part, dense?), do: Timeline.add_part(timeline, part, &count_before/2, dense?)

  test "later ordinals do not change when parts are hidden or removed" do
    timeline = %Timeline{} |> add(part(0, "a", 1, 9), true) |> add(part(1, "a", 11, 9), true)
    timeline = add(timeline, part(2, "b", 5, 3), false)
    assert [%{number: 2, base: 18}, %{number: 0, base: 0, count: 4, until: 5}] = timeline.parts
    assert timeline.hidden == 5 + 9
    # The hidden part is not added again.
    assert Timeline.known_part?(timeline, 1)
    timeline = Timeline.remove_part(timeline, 0)
    assert [%{number: 2, base: 18}] = timeline.parts
    assert Timeline.next_ordinal(timeline) == 21
    assert Timeline.next_ordinal(Timeline.remove_part(timeline, 2)) == 21
  end

  test "ordinals are dense when a recording is opened" do
    timeline = %Timeline{} |> add(part(0, "a", 1, 9), true) |> add(part(1, "b", 5, 3), true)
    assert [%{base: 4}, %{base: 0, count: 4}] = timeline.parts
  end

  property "shows the message of the latest run for every time, in order" do
    run = list({integer(0, 60), integer(1, 20)})

    forall runs <- list(run) do
      # Within a run, times increase.
      parts = for {run, name} <- Enum.with_index(runs), do: {name, Enum.sort(run) |> separate([])}

      numbered = for {name, run} <- parts, {first, count} <- run, do: {name, first, count}

      timeline =
        for {{name, first, count}, number} <- Enum.with_index(numbered), reduce: %Timeline{} do
          timeline -> add(timeline, part(number, name, first, count), true)
        end

      shown =
        for %{run: run, first: first, count: count} <- Enum.reverse(timeline.parts),
            time <- first..(first + count - 1)//1,
            do: {time, run}

      assert shown == model(parts)
      tuple = timeline.parts |> Enum.reverse() |> List.to_tuple()

      for {{time, run}, ordinal} <- Enum.with_index(shown) do
        found = elem(tuple, Timeline.find_ordinal(tuple, ordinal))
        assert found.run == run and found.base <= ordinal
        assert time in found.first..(found.first + found.count - 1)
        assert elem(tuple, Timeline.find_time(tuple, time)).last >= time
      end
    end
  end

  # Each run replaces everything from its first message on.
  defp model(parts) do
    Enum.reduce(parts, [], fn
      {_, []}, shown ->
        shown

      {name, [{start, _} | _] = run}, shown ->
        times = for {first, count} <- run, time <- first..(first + count - 1), do: {time, name}
        Enum.filter(shown, fn {time, _} -> time < start end) ++ times
    end)
  end

  defp separate([], done), do: Enum.reverse(done)

  defp separate([{first, count} | rest], [{before, n} | _] = done) when first < before + n,
    do: separate(rest, [{before + n, count} | done])

  defp separate([part | rest], done), do: separate(rest, [part | done])
end
