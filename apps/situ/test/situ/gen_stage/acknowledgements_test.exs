defmodule Situ.GenStage.AcknowledgementsTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.GenStage.Acknowledgements

  # Events have the times 1, 2, ...; `kept` are those with a message in `done`, which also has messages in between.
  # Both inputs arrive in parts, in any interleaving.
  defp deliver([], [], _order, state, got), do: {state, got}

  defp deliver(events, times, [side | order], state, got) do
    {state, got, events, times} =
      if times == [] or (side < 5 and events != []) do
        {part, rest} = Enum.split(events, side + 1)
        {good, bad, state} = Acknowledgements.add_events(state, part)
        {state, add(got, good, bad), rest, times}
      else
        {part, rest} = Enum.split(times, side + 1)
        {good, bad, state} = Acknowledgements.add_times(state, part)
        {state, add(got, good, bad), events, rest}
      end

    assert_safe(got, times, events)
    deliver(events, times, order, state, got)
  end

  defp add({good, bad}, more_good, more_bad), do: {good ++ more_good, bad ++ more_bad}

  # Nothing counts before everything up to its time has arrived at the end.
  defp assert_safe({good, bad}, times, _events) do
    case times do
      [next | _] -> assert Enum.all?(good ++ bad, &(&1 * 10 < next))
      [] -> :ok
    end
  end

  for missing <- [:failed, :successful] do
    property "with missing: #{missing}, events succeed if and only if they have a message, and no later",
      numtests: 400 do
      forall {kept, others, order} <-
               {list(boolean()), list(boolean()), list(integer(0, 9))} do
        events = for {_, i} <- Enum.with_index(kept, 1), do: {i * 10, i, i}
        done = for {true, i} <- Enum.with_index(kept, 1), do: i * 10

        between =
          for {true, i} <- Enum.with_index(others, 1), i * 10 < length(kept) * 10, do: i * 10 + 5

        times = Enum.sort(done ++ between)
        state = Acknowledgements.new(unquote(missing))

        order =
          Stream.concat(order, Stream.cycle([3, 7, 0, 9])) |> Enum.take(length(kept) * 4 + 20)

        {state, {good, bad}} = deliver(events, times, order, state, {[], []})
        last = List.last(times) || 0
        reached = for {time, i, _} <- events, time <= last, do: i
        present = for i <- reached, (i * 10) in done, do: i

        if unquote(missing) == :failed,
          do: assert({good, bad} == {present, reached -- present}),
          else: assert({good, bad} == {reached, []})

        assert Acknowledgements.count_events(state) == length(events) - length(reached)
      end
    end
  end

  test "events that wait too long fail, and a late result changes nothing" do
    state = Acknowledgements.new(:successful)
    {[], [], state} = Acknowledgements.add_events(state, [{1, :a, 100}, {2, :b, 200}])
    assert Acknowledgements.first_arrival(state) == 100
    {[], [:a], state} = Acknowledgements.fail_events(state, 150)
    assert {[:b], [], state} = Acknowledgements.add_times(state, [1, 2])
    assert Acknowledgements.count_events(state) == 0
    assert Acknowledgements.first_arrival(state) == nil
  end
end
