defmodule Situ.Studio.Recordings.DerivedStreamsTest do
  # Derives streams from others by expressions while reading.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{Expression, Message}
  alias Situ.Studio.{History, StreamOverview, StreamReader, Recordings}
  alias Situ.Studio.Recordings.DerivedStreams

  doctest DerivedStreams

  defp source(streams) do
    history = History.new(live: false, seconds: 3_600)

    for {name, rows} <- streams, {time, data} <- rows do
      message = %Message{data: data, originating_time: time, creation_time: time + 3}
      History.put(history, name, message, 8)
    end

    DerivedStreams.wrap(Recordings.History.wrap(history))
  end

  defp rows(source, name, from, to, limit \\ 1_000) do
    {:ok, messages, more} = StreamReader.read_messages(source, name, from, to, limit)
    {for(m <- messages, do: {m.originating_time, m.data}), more}
  end

  test "combines each message of either stream with the latest value of the other" do
    source = source(%{"A" => [{10, 1}, {20, 2}, {30, 3}], "B.C" => [{15, 10}, {30, 20}]})
    name = "= A + `B.C`"

    assert rows(source, name, 0, 40) ==
             {[{10, nil}, {15, 11}, {20, 12}, {30, 23}], :all}

    # The value in force at the window's start counts.
    assert rows(source, name, 18, 25) == {[{20, 12}], :all}
    assert rows(source, name, 0, 40, 2) == {[{10, nil}, {15, 11}], :more}
    assert {:ok, %{data: 12, originating_time: 20}} = StreamReader.latest_at(source, name, 29)
    assert {:ok, %{data: 23, originating_time: 30}} = StreamReader.next_after(source, name, 20)
    assert :none = StreamReader.next_after(source, name, 30)
    assert :none = StreamReader.latest_at(source, name, 5)
    # Other streams are unchanged.
    assert rows(source, "A", 0, 40) == {[{10, 1}, {20, 2}, {30, 3}], :all}
  end

  test "a line has the values of the messages at any zoom level" do
    source = source(%{"A" => for(i <- 0..999, do: {i * 10, i})})
    {:ok, points, true} = StreamOverview.read_series(source, "= A * A", 100, 150, 1)

    assert for({t, v, _, _, _} <- points, t in 100..150, do: {t, v}) ==
             for(i <- 10..15, do: {i * 10, i * i})

    {:ok, points, false} = StreamOverview.read_series(source, "= A * A", 0, 9_990, 1_000)
    assert points |> Enum.map(&elem(&1, 2)) |> Enum.max() == 999 * 999
  end

  test "derives its kind from its values" do
    source = source(%{"A" => for(i <- 0..99, do: {i * 10, i})})

    for {text, shape} <- [
          {"A + 1", :signal},
          {"A > 50", :boolean},
          {"if(A > 3, 'b', 'c')", :text}
        ] do
      assert {:ok, %{shape: ^shape, count: 100}} = DerivedStreams.derive_stream(source, text)
    end
  end

  test "rejects invalid and constant expressions, and unknown streams" do
    source = source(%{"A" => [{1, 1}]})
    assert {:error, %{code: :bad_expression}} = DerivedStreams.derive_stream(source, "A +")
    assert {:error, %{code: :constant}} = DerivedStreams.derive_stream(source, "1 + 1")

    assert {:error, %{code: :no_stream, what: what}} =
             DerivedStreams.derive_stream(source, "A + B")

    assert what =~ "B"
    assert {:error, %{code: :bad_expression}} = StreamReader.latest_at(source, "= (", 5)
  end

  test "returns the values of an evaluation by hand" do
    values = for i <- 0..199, do: {i * 7, rem(i * 37, 11) - 5}
    source = source(%{"A" => values})
    text = "A * A - 3 * A"
    expression = Expression.parse!(text)
    wanted = for {t, v} <- values, do: {t, Expression.eval(expression, %{"A" => v})}
    assert rows(source, "= " <> text, 0, 10_000) == {wanted, :all}
  end

  property "several streams are read like the list of all their derived messages" do
    times = list(:proper_types.integer(-50, 50))

    forall {a, b, from, w, n} <-
             {times, times, :proper_types.integer(-60, 60), :proper_types.integer(0, 99),
              :proper_types.integer(1, 20)} do
      rows = for {name, times} <- [{"A", a}, {"B", b}], t <- Enum.uniq(times), do: {t, name}
      streams = Enum.group_by(Enum.sort(rows), &elem(&1, 1), fn {t, _} -> {t, t} end)
      source = source(streams)
      name = "= if(A == nil, 0, A) * 1000 + if(B == nil, 0, B)"
      to = from + w

      value = fn name, t ->
        case for({at, x} <- streams[name] || [], at <= t, do: x) do
          [] -> 0
          values -> List.last(values)
        end
      end

      all =
        for t <- rows |> Enum.map(&elem(&1, 0)) |> Enum.uniq() |> Enum.sort(),
            do: {t, value.("A", t) * 1_000 + value.("B", t)}

      pair = fn message -> {message.originating_time, message.data} end

      single = fn
        {:ok, message} -> pair.(message)
        :none -> nil
      end

      {before, later} = Enum.split_with(all, &(elem(&1, 0) < from))
      within = Enum.filter(all, fn {t, _} -> t in from..to end)

      neighbours = fn side, time ->
        Enum.map(StreamReader.list_neighbours(source, name, side, time, n), pair)
      end

      {:ok, sample} = StreamReader.sample_messages(source, name, from, to, n)

      assert elem(rows(source, name, from, to), 0) == within
      assert elem(rows(source, name, from, to, n), 0) == Enum.take(within, n)
      assert neighbours.(:before, from) == before |> Enum.reverse() |> Enum.take(n)
      assert neighbours.(:after, from - 1) == Enum.take(later, n)
      assert single.(StreamReader.latest_at(source, name, from - 1)) == List.last(before)
      assert single.(StreamReader.next_after(source, name, from - 1)) == List.first(later)
      assert Enum.all?(sample, fn {_, message} -> pair.(message) in within end)
      assert length(sample) <= n
    end
  end
end
