defmodule Situ.Operators.ModelsTest do
  # Compares operators that keep little and decide early with models that keep everything and decide at the end.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{Interpolator, Interval, Message, Reproducible}
  alias Situ.Fusion.{Core, Zip}
  alias Situ.Window.{ByIndex, ByTime}

  defp messages(timed), do: for({t, v} <- timed, do: %Message{originating_time: t, data: v})

  defp stream, do: timed_values(integer(0, 9), 6)

  defp window do
    map({integer(-12, 12), boolean(), integer(0, 12), boolean()}, fn {left, li, length, ri} ->
      constant(Interval.new(left, li, left + length, ri))
    end)
  end

  defp window_or_half,
    do: one_of([window(), Interval.past(), Interval.future(), Interval.infinite()])

  # Deals out two lists of messages in batches, in random order.
  defp deal, do: list({one_of([:primary, :secondary]), integer(1, 5)})

  defp dealt(core, deal, primary, secondary) do
    {outputs, {core, primary, secondary}} =
      Enum.flat_map_reduce(deal, {core, primary, secondary}, fn
        {:primary, n}, {core, primary, secondary} ->
          {now, later} = Enum.split(primary, n)
          {outputs, core} = Core.push_primary(core, now)
          {outputs, {core, later, secondary}}

        {:secondary, n}, {core, primary, secondary} ->
          {now, later} = Enum.split(secondary, n)
          {outputs, core} = Core.push_secondary(core, :s0, now)
          {outputs, {core, primary, later}}
      end)

    {more, core} = Core.push_primary(core, primary)
    {even_more, core} = Core.push_secondary(core, :s0, secondary)
    {last, _core} = Core.close_secondary(core, :s0, 1_000)
    outputs ++ more ++ even_more ++ last
  end

  defp joined(interpolator, deal, primary, secondary) do
    core = Core.new(&{&1, &2}, members: [{:s0, 0, interpolator, []}], values: :one)
    for {:out, t, {_, v}} <- dealt(core, deal, messages(primary), messages(secondary)), do: {t, v}
  end

  defp inside(secondary, window, time),
    do: Enum.filter(secondary, fn {t, _} -> Interval.contains_point?(window, t - time) end)

  defp expected(primary, fun) do
    for {t, _} <- primary, {_, v} <- List.wrap(fun.(t)), do: {t, v}
  end

  for {name, build} <- [nearest: :nearest, first: :first, last: :last] do
    property "#{name} matches the model over the whole streams, for every order of arrival",
      numtests: 300 do
      windows = if unquote(name) == :first, do: window(), else: window_or_half()

      forall {window, primary, secondary, deal} <- {windows, stream(), stream(), deal()} do
        interpolator = apply(Reproducible, unquote(build), [window])
        got = joined(interpolator, deal, primary, secondary)
        assert got == expected(primary, &model(unquote(name), inside(secondary, window, &1), &1))
      end
    end
  end

  defp model(_kind, [], _time), do: []
  defp model(:first, found, _time), do: hd(found)
  defp model(:last, found, _time), do: List.last(found)
  # Of two equally near messages, the later wins.
  defp model(:nearest, found, time), do: Enum.min_by(found, fn {t, _} -> {abs(t - time), -t} end)

  property "linear interpolates between the neighbours", numtests: 300 do
    forall {primary, secondary, deal} <- {stream(), stream(), deal()} do
      got = joined(Reproducible.linear(), deal, primary, secondary)

      model = fn time ->
        before = secondary |> Enum.filter(fn {t, _} -> t <= time end) |> List.last()
        next = Enum.find(secondary, fn {t, _} -> t >= time end)

        case {before, next} do
          {nil, _} -> []
          {_, nil} -> []
          {{t, v}, {t, _}} -> {t, v}
          {{t0, v0}, {t1, v1}} -> {time, v0 + (v1 - v0) * (time - t0) / (t1 - t0)}
        end
      end

      wanted = expected(primary, model)
      assert length(got) == length(wanted)

      for {{t, a}, {u, b}} <- Enum.zip(got, wanted) do
        assert t == u
        assert_in_delta a, b, 1.0e-9
      end
    end
  end

  property "zip groups all messages by time", numtests: 200 do
    forall {a, b, c, order} <-
             {stream(), stream(), stream(), list({integer(0, 2), integer(1, 5)})} do
      inputs = Enum.map([a, b, c], &messages/1)

      {outputs, {zip, rest}} =
        Enum.flat_map_reduce(order, {Zip.new(3), inputs}, fn {i, n}, {zip, inputs} ->
          {now, later} = inputs |> Enum.at(i) |> Enum.split(n)
          {outputs, zip} = Zip.push(zip, i, now)
          {outputs, {zip, List.replace_at(inputs, i, later)}}
        end)

      {tail, _zip} =
        rest
        |> Enum.with_index()
        |> Enum.flat_map_reduce(zip, fn {messages, i}, zip ->
          {outputs, zip} = Zip.push(zip, i, messages)
          {more, zip} = Zip.close(zip, i)
          {outputs ++ more, zip}
        end)

      times = [a, b, c] |> Enum.concat() |> Enum.map(&elem(&1, 0)) |> Enum.uniq() |> Enum.sort()
      at = fn t -> for s <- [a, b, c], {^t, v} <- s, do: v end
      assert outputs ++ tail == for(t <- times, do: {:out, t, at.(t)})
    end
  end

  property "index windows contain the messages at their indices", numtests: 200 do
    forall {stream, from, to, cut} <- {stream(), integer(-4, 4), integer(-4, 4), integer(0, 10)} do
      {first, second} = stream |> messages() |> Enum.split(cut)
      {a, window} = ByIndex.push(ByIndex.new(from..to//1, nil), first)
      {b, _window} = if second == [], do: {[], window}, else: ByIndex.push(window, second)
      {low, high} = {min(from, to), max(from, to)}
      values = Enum.map(stream, &elem(&1, 1))

      wanted =
        for {{t, _}, i} <- Enum.with_index(stream),
            i + low >= 0 and i + high < length(stream),
            do: {:out, t, Enum.slice(values, (i + low)..(i + high))}

      assert a ++ b == wanted
    end
  end

  property "time windows contain the messages inside, including look-back", numtests: 300 do
    forall {stream, interval, batches} <-
             map({stream(), window_or_half()}, fn {s, w} ->
               {constant(s), constant(w), random_batches(s)}
             end) do
      {outputs, window} =
        Enum.flat_map_reduce(
          batches,
          ByTime.new(interval, nil),
          &ByTime.push(&2, messages(&1))
        )

      {tail, _window} = ByTime.close(window)

      wanted =
        for {t, _} <- stream, do: {:out, t, Enum.map(inside(stream, interval, t), &elem(&1, 1))}

      assert outputs ++ tail == wanted
    end
  end

  property "sampling interpolates at every tick up to the end", numtests: 200 do
    forall {stream, every, window, batches} <-
             map({stream(), integer(1, 9), window_or_half()}, fn {s, n, w} ->
               {constant(s), n, constant(w), random_batches(s)}
             end) do
      interpolator = Reproducible.nearest(window)
      sampling = Situ.Sampling.new(interpolator, every, 0)

      {outputs, sampling} =
        Enum.flat_map_reduce(batches, sampling, &Situ.Sampling.push(&2, messages(&1)))

      last = if stream == [], do: 0, else: stream |> List.last() |> elem(0)
      {tail, _} = if stream == [], do: {[], sampling}, else: Situ.Sampling.close(sampling, last)

      wanted =
        for t <- 0..last//every,
            stream != [],
            {:created, v, _} <- [
              Interpolator.interpolate(interpolator, t, messages(stream), last)
            ],
            do: {:out, t, v}

      assert outputs ++ tail == wanted
    end
  end
end
