defmodule Situ.ReproducibleTest do
  # Checks the promise of the reproducible operators. Random graphs over random inputs emit the same values at the
  # same times for every schedule: batch sizes, delays, chained or in separate processes, at maximum speed or by the
  # clock.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{Interval, Reproducible}
  alias Situ.Fixture.Schedule

  @inputs 3
  @schedules 200
  @graphs String.to_integer(System.get_env("SITU_GRAPHS", "8"))

  @tag timeout: 3_000_000
  test "#{@schedules} random schedules of each of #{@graphs} random graphs emit equal outputs and times" do
    for round <- 1..@graphs do
      {graph, inputs} = picked({graph(), list(timed_values(integer(-50, 50), 6), @inputs)})
      runs = Stream.repeatedly(fn -> run(graph, picked(schedule(inputs))) end)
      [reference | others] = Enum.take(runs, @schedules)
      assert {:ok, outputs} = reference

      for other <- others do
        assert other == {:ok, outputs},
               "round #{round}: the schedule changed the outputs of #{inspect(graph)} over #{inspect(inputs)}"
      end
    end
  end

  # Picks a value from a generator, larger than PropEr would start with.
  defp picked(generator) do
    {:ok, value} = :proper_gen.pick(generator, 25)
    value
  end

  # Represents graphs as terms: each node has an operation and its inputs.

  defp graph, do: list_of(integer(2, 5), &node_at/1)

  defp list_of(length, fun) do
    map(length, fn n -> Enum.map(0..(n - 1), fun) end)
  end

  # Node `i` takes from the inputs and from all earlier nodes.
  defp node_at(i) do
    from = integer(0, @inputs + i - 1)
    one_of([{unary(), from}, {binary_operator(), from, from}])
  end

  defp unary do
    one_of([
      {:map, integer(-3, 3)},
      {:filter, integer(1, 4)},
      :sum,
      {:max_of, integer(1, 4)},
      {:window, {integer(-3, 3), integer(-3, 3)}},
      {:time_window, window()},
      :delta,
      {:first, integer(0, 8)},
      {:last, integer(1, 4)},
      {:sample, integer(1, 15), window()},
      {:smooth, integer(1, 3)},
      {:parallel, one_of([:scan, :filter, :last, :window])},
      {:delay, integer(0, 60)},
      {:lowpass, integer(1, 9)},
      {:sliding, one_of([:average, :std, :min]), integer(1, 12)},
      :cycle,
      :time
    ])
  end

  defp binary_operator do
    one_of([
      {:join, interpolator()},
      {:join_or_default, interpolator()},
      {:join_keyed, interpolator()},
      :zip,
      {:interpolate, interpolator()},
      {:window_by, integer(0, 10)}
    ])
  end

  defp interpolator do
    one_of([
      {:exact},
      {:nearest, window()},
      {:first, bounded()},
      {:last, window()},
      {:linear}
    ])
  end

  defp window, do: one_of([:infinite, :past, :future, bounded()])

  defp bounded do
    {integer(-12, 12), boolean(), integer(0, 12), boolean()}
  end

  # A schedule has batches and pauses for each input, a placement for each node, and a speed.
  defp schedule(inputs) do
    {Enum.map(inputs, &batched/1), list(boolean(), 6), one_of([:max, 1_000_000])}
  end

  defp batched(messages) do
    map(random_batches(messages), fn batches ->
      Enum.map(batches, fn batch -> {integer(0, 40), constant(batch)} end)
    end)
  end

  defp run(graph, {scheduled, async, speed}) do
    build = fn p ->
      sources =
        for {batches, i} <- Enum.with_index(scheduled),
            do: Situ.source(p, Schedule, batches: batches, name: "Input#{i}")

      streams =
        graph
        |> Enum.with_index()
        |> Enum.reduce(sources, fn {node, i}, streams ->
          streams ++ [place(node, streams, async: Enum.at(async, i))]
        end)

      Enum.drop(streams, @inputs)
    end

    opts = [times: true, pipeline: [replay: [interval: {0, :unbounded}, speed: speed]]]
    {:ok, Situ.to_list(build, opts)}
  rescue
    error -> {:error, error}
  end

  defp place({operator, from}, streams, opts), do: one(operator, Enum.at(streams, from), opts)

  defp place({operator, a, b}, streams, opts),
    do: two(operator, Enum.at(streams, a), Enum.at(streams, b), opts)

  defp one({:map, n}, s, opts), do: Situ.map(s, &(number(&1) * n), opts)
  defp one({:filter, n}, s, opts), do: Situ.filter(s, &(rem(number(&1), n) == 0), opts)
  defp one(:sum, s, opts), do: Situ.sum(s, [by: &number/1] ++ opts)
  defp one({:max_of, n}, s, opts), do: Situ.max(s, [over: {:last, n}, by: &number/1] ++ opts)
  defp one({:window, {a, b}}, s, opts), do: Situ.window(s, a..b//1, nil, opts)
  defp one({:time_window, w}, s, opts), do: Situ.window(s, interval(w), nil, opts)

  defp one(:delta, s, opts),
    do: s |> Situ.map(&number/1) |> Situ.delta(opts)

  defp one({:first, n}, s, opts), do: Situ.first(s, n, opts)
  defp one({:last, n}, s, opts), do: Situ.last(s, n, opts)
  defp one({:sample, every, w}, s, opts), do: Situ.sample(s, every, interval(w), opts)

  defp one({:smooth, n}, s, opts),
    do: s |> Situ.map(&number/1) |> Situ.denoise([order: n] ++ opts)

  defp one(:time, s, opts), do: Situ.time_of(s, opts)
  defp one({:delay, ns}, s, opts), do: Situ.delay(s, ns, opts)

  defp one({:lowpass, every}, s, opts) do
    s
    |> Situ.map(&number/1)
    |> Situ.lowpass([rate: 1.0e9 / every, cutoff: 1.0e8 / every, order: 4] ++ opts)
    |> Situ.map(&Float.round(&1, 6))
  end

  defp one({:sliding, kind, span}, s, opts) do
    apply(Situ, kind, [s, [over: {:past, span}, by: &number/1] ++ opts])
    |> Situ.map(&Float.round(&1 / 1, 6))
  end

  # y(t) = x(t) + y(t - 1); the second term comes back through another process.
  defp one(:cycle, s, _opts) do
    loop = Situ.Pipeline.add(s.pipeline, Situ.Fixture.Feedback)
    out = Situ.Node.output(loop, :out)
    :ok = Situ.Pipeline.connect(Situ.map(s, &number/1), loop, :in)
    :ok = Situ.Pipeline.connect(Situ.map(out, &rem(&1, 97), async: true), loop, :back)
    out
  end

  defp one({:parallel, kind}, s, opts) do
    s
    |> Situ.map(fn data -> %{rem(number(data), 3) => number(data), same: 1} end)
    |> Situ.parallel(&branch(kind, &1), [of: :maps, until: {:absent, 1}, or_default: 0] ++ opts)
  end

  defp branch(:scan, s), do: Situ.sum(s)
  defp branch(:filter, s), do: Situ.filter(s, &(rem(&1, 2) == 0))
  defp branch(:last, s), do: Situ.last(s, 2)
  defp branch(:window, s), do: Situ.window(s, 0..1, &Enum.sum/1)

  defp two({:join, i}, a, b, opts), do: Situ.join(a, b, interpolator(i, []), opts)

  defp two({:join_or_default, i}, a, b, opts),
    do: Situ.join(a, b, interpolator(i, or_default: 0), opts)

  defp two({:join_keyed, i}, a, b, opts),
    do: Situ.join(a, %{b: b, same: a}, interpolator(i, or_default: 0), opts)

  defp two(:zip, a, b, opts), do: Situ.zip(a, b, opts)
  defp two({:interpolate, i}, a, b, opts), do: Situ.sample(a, b, interpolator(i, []), opts)

  defp two({:window_by, n}, a, b, opts) do
    Situ.window_by(
      a,
      b,
      fn m ->
        {Interval.closed(m.originating_time - n, m.originating_time), m.originating_time - n}
      end,
      opts
    )
  end

  defp interpolator({:exact}, opts), do: Reproducible.exact(opts)
  defp interpolator({:nearest, w}, opts), do: Reproducible.nearest(interval(w), opts)
  defp interpolator({:first, w}, opts), do: Reproducible.first(interval(w), opts)
  defp interpolator({:last, w}, opts), do: Reproducible.last(interval(w), opts)

  defp interpolator({:linear}, opts),
    do: Reproducible.adjacent(fn a, b, ratio -> {a, b, Float.round(ratio, 6)} end, opts)

  defp interval(:infinite), do: Interval.infinite()
  defp interval(:past), do: Interval.past()
  defp interval(:future), do: Interval.future()
  defp interval({left, li, length, ri}), do: Interval.new(left, li, left + length, ri)

  # Maps any output of a node to an integer that identifies it.
  defp number(n) when is_integer(n), do: n
  defp number(other), do: :erlang.phash2(other, 1_000)
end
