defmodule Situ.Operators.LiveReplayTest do
  # A live source is not reproducible, but everything derived from it is. Replaying its recorded stream at any speed
  # returns the values and times of the live run.
  use ExUnit.Case, async: true

  alias Situ.{Pipeline, Reproducible, Time}

  defp graph(events) do
    ticks = Situ.sample(events, Time.ms(2), Time.ms(1), align: 0)

    [
      Situ.delay(events, Time.ms(3)),
      Situ.join(events, ticks, Reproducible.nearest(Time.ms(1), or_default: :none)),
      events |> Situ.map(& &1, async: true) |> Situ.average(over: {:past, Time.ms(4)}),
      Situ.window(events, -1..1),
      events |> Situ.sample(Time.ms(1), Reproducible.linear(), align: 0)
    ]
  end

  defp collected(ref, count) do
    for i <- 0..(count - 1), do: drain({ref, i}, [])
  end

  defp drain(tag, got) do
    receive do
      {^tag, time, data} -> drain(tag, [{time, data} | got])
    after
      0 -> Enum.reverse(got)
    end
  end

  defp watched(streams, me, ref) do
    for {stream, i} <- Enum.with_index(streams),
        do: Situ.each(stream, fn data, m -> send(me, {{ref, i}, m.originating_time, data}) end)
  end

  test "a replay returns the same values and times as the live run" do
    me = self()
    live = make_ref()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          events = Situ.event_source(p, &send(me, {:post, &1}))
          watched([events | graph(events)], me, live)
        end,
        []
      )

    assert_receive {:post, post}, 5_000

    for n <- 1..60 do
      post.(n)
      if rem(n, 5) == 0, do: :timer.sleep(rem(n, 4))
    end

    assert {:ok, report} = Pipeline.stop(p)
    [events | wanted] = collected(live, 6)
    assert length(events) == 60
    start = report.start_time

    for speed <- [:max, 2.0] do
      ref = make_ref()

      {:ok, _} =
        Pipeline.run(fn p -> p |> Situ.from_enumerable(events) |> graph() |> watched(me, ref) end,
          pipeline: [replay: [interval: {start, :unbounded}, speed: speed]]
        )

      # The live stream continued silently until the stop, so outputs that depend on its end are not compared.
      last = (events |> List.last() |> elem(0)) - Time.ms(3)
      until = fn outputs -> Enum.filter(outputs, &(elem(&1, 0) <= last)) end
      assert Enum.map(collected(ref, 5), until) == Enum.map(wanted, until)
    end
  end
end
