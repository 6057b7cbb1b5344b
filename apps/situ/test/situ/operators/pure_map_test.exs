defmodule Situ.Operators.PureMapTest do
  # `source |> map(identity) |> operator` equals `source |> operator` for every operator, wherever the map runs, and
  # while other streams of the pipeline continue for longer.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{Interval, Reproducible, Time}

  @unary [
    map: quote(do: &Situ.map(&1, fn n -> n * 2 end)),
    map_present: quote(do: &Situ.map_present(&1, fn n -> n * 2 end)),
    filter: quote(do: &Situ.filter(&1, fn n -> rem(n, 2) == 0 end)),
    each: quote(do: &Situ.each(&1, fn n -> n end)),
    scan: quote(do: &Situ.scan(&1, 0, fn n, acc -> n + acc end)),
    reduce: quote(do: &Situ.reduce(&1, fn n, acc -> n + acc end)),
    process:
      quote(
        do:
          &Situ.process(
            &1,
            0,
            fn m, n -> {[{m.originating_time, n}], n + 1} end,
            on_close: fn time, n -> [{time + 1, n}] end
          )
      ),
    first: quote(do: &Situ.first(&1, 3)),
    last: quote(do: &Situ.last(&1, 2)),
    time_of: quote(do: &Situ.time_of(&1)),
    delay: quote(do: &Situ.delay(&1, 20)),
    edit: quote(do: &Situ.edit(&1, [{5, {:put, 7}}, {500, {:put, 8}}, {3, :delete}])),
    reorder:
      quote(do: &Situ.reorder(&1, 10, time: fn m -> m.originating_time + rem(m.data, 7) end)),
    count: quote(do: &Situ.count(&1)),
    sum: quote(do: &Situ.sum(&1)),
    min: quote(do: &Situ.min(&1)),
    max: quote(do: &Situ.max(&1, over: {:last, 3})),
    average: quote(do: &Situ.average(&1, over: {:past, 9})),
    std: quote(do: &Situ.std(&1)),
    delta: quote(do: &Situ.delta(&1)),
    abs: quote(do: &Situ.abs(&1)),
    window: quote(do: &Situ.window(&1, -1..1)),
    window_ahead: quote(do: &Situ.window(&1, Interval.closed(0, 8))),
    sample: quote(do: &Situ.sample(&1, 5)),
    sample_within: quote(do: &Situ.sample(&1, 3, 2)),
    interpolate: quote(do: &Situ.sample(&1, 4, Reproducible.linear())),
    lowpass: quote(do: &Situ.lowpass(&1, rate: 2.0e8, cutoff: 1.0e7, order: 8)),
    denoise: quote(do: &Situ.denoise(&1, order: 3)),
    one_euro: quote(do: &Situ.one_euro(&1)),
    parallel:
      quote(
        do: fn s ->
          s
          |> Situ.map(fn n -> %{rem(n, 3) => n} end)
          |> Situ.parallel(fn _key, branch -> Situ.last(branch) end,
            or_default: 0,
            until: {:absent, 2}
          )
        end
      ),
    map_async: quote(do: &Situ.map_async(&1, fn n -> n + 1 end, max: 3))
  ]

  @binary [
    join: quote(do: &Situ.join(&1, &2, 7)),
    join_other: quote(do: &Situ.join(&2, &1, Reproducible.nearest(7, or_default: :none))),
    join_keyed: quote(do: &Situ.join(&2, %{a: &1}, Reproducible.last(or_default: :none))),
    join_leave: quote(do: &Situ.join(&2, %{a: &1}, 5, ended: :leave)),
    zip: quote(do: &Situ.zip(&1, &2)),
    clocked: quote(do: &Situ.sample(&1, &2)),
    clock: quote(do: &Situ.sample(&2, &1)),
    window_by:
      quote(
        do:
          &Situ.window_by(&1, &2, fn m ->
            {Interval.closed(m.originating_time - 9, m.originating_time), m.originating_time - 9}
          end)
      )
  ]

  # A third stream lasts longer than the operator's streams, so the pipeline ends long after them.
  defp outputs(streams, build) do
    inputs = Map.new(streams) |> Map.put(:long, [{0, :begin}, {Time.us(1), :end}])

    Situ.Test.run(inputs, fn s ->
      [out, _long] = [build.(s), Situ.each(s.long, & &1)]
      out
    end)
  end

  defp numbers, do: timed_values(integer(-20, 20), 12)
  defp through(s, false), do: Situ.map(s, & &1)
  defp through(s, true), do: Situ.map(s, & &1, async: true)

  for {name, operator} <- @unary do
    property "an identity map before #{name} changes nothing", numtests: 12 do
      operator = unquote(operator)

      forall {a, async} <- {numbers(), boolean()} do
        assert {:ok, plain} = outputs([a: a], &operator.(&1.a))
        assert {:ok, mapped} = outputs([a: a], &operator.(through(&1.a, async)))
        assert mapped == plain
      end
    end
  end

  for {name, operator} <- @binary do
    property "an identity map before #{name} changes nothing", numtests: 12 do
      operator = unquote(operator)

      forall {a, b, async} <- {numbers(), numbers(), boolean()} do
        streams = [a: a, b: b]
        assert {:ok, plain} = outputs(streams, &operator.(&1.a, &1.b))
        assert {:ok, mapped} = outputs(streams, &operator.(through(&1.a, async), &1.b))
        assert mapped == plain
      end
    end
  end
end
