defmodule Situ.Studio.Recordings.ComparisonTest do
  # Puts two sources on one time axis. Every request to the second one has shifted times.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{Interval, Message}
  alias Situ.Studio.{History, Recordings, StreamOverview, StreamReader}
  alias Situ.Studio.Recordings.Comparison

  doctest Comparison

  defp source(streams) do
    history = History.new(live: false, seconds: 3_600)

    for {name, rows} <- streams, {time, data} <- rows do
      message = %Message{data: data, originating_time: time, creation_time: time + 3}
      History.put(history, name, message, 8)
    end

    Recordings.History.wrap(history)
  end

  property "the shifted second source equals the source alone at other times" do
    times = list({:proper_types.integer(0, 200), :proper_types.integer(-9, 9)})

    forall {rows, offset, a, w} <-
             {times, integer(), :proper_types.integer(-50, 250), :proper_types.integer(0, 99)} do
      rows = rows |> Map.new() |> Enum.sort()
      alone = source(%{"S" => [{-1, 0} | rows]})
      beside = Comparison.combine_recordings(source(%{"T" => [{0, 1}]}), alone, offset)
      {from, to} = {a + offset, a + w + offset}

      shifted = fn {:ok, messages, more} ->
        {for(m <- messages, do: {m.originating_time - offset, m.creation_time - offset, m.data}),
         more}
      end

      plain = fn {:ok, messages, more} ->
        {for(m <- messages, do: {m.originating_time, m.creation_time, m.data}), more}
      end

      {:ok, points, _} = StreamOverview.read_series(beside, "Compared.S", from, to, 1)
      {:ok, own, _} = StreamOverview.read_series(alone, "S", a, a + w, 1)

      shifted.(StreamReader.read_messages(beside, "Compared.S", from, to, 50)) ==
        plain.(StreamReader.read_messages(alone, "S", a, a + w, 50)) and
        for(p <- points, do: put_elem(p, 0, elem(p, 0) - offset)) == own
    end
  end

  test "shifts intervals inside messages, but no other numbers" do
    second =
      source(%{
        "S" => [
          {5, [%{start: 1, stop: 4, text: "a"}]},
          {6, %{"Ada" => Interval.closed(2, 3)}},
          {7, %{start: 9}},
          {8, {Interval.closed(1, 2), "b"}}
        ]
      })

    beside = Comparison.combine_recordings(source(%{"T" => [{0, 1}]}), second, 100)
    {:ok, messages, :all} = StreamReader.read_messages(beside, "Compared.S", 0, 200, 9)

    assert Enum.map(messages, & &1.data) == [
             [%{start: 101, stop: 104, text: "a"}],
             %{"Ada" => Interval.closed(102, 103)},
             %{start: 9},
             {Interval.closed(101, 102), "b"}
           ]

    assert {:ok, %{from: 0, to: 108}} = StreamReader.fetch_extent(beside)
    {:ok, infos} = StreamOverview.list_streams(beside)
    assert [%{name: "Compared.S", first: 105, last: 108}, %{name: "T", first: 0}] = infos
    assert :none = StreamReader.latest_at(beside, "Compared.None", 5)
  end

  test "shifts a drawn signal without changing its bins" do
    alone = source(%{"S" => for(i <- 0..999, do: {i * 10, :math.sin(i / 50)})})
    {:ok, points, raw?} = StreamOverview.read_series(alone, "S", 0, 9_990, 64)

    both = Comparison.combine_recordings(source(%{"T" => [{0, 1}]}), alone, 2_500)

    assert StreamOverview.read_series(both, "Compared.S", 2_500, 12_490, 64) ==
             {:ok, for(point <- points, do: put_elem(point, 0, elem(point, 0) + 2_500)), raw?}
  end

  test "hides a stream of the first source with a name of the second" do
    beside =
      Comparison.combine_recordings(
        source(%{"Compared.S" => [{1, :own}]}),
        source(%{"S" => [{2, :other}]}),
        0
      )

    assert {:ok, %{data: :other}} = StreamReader.latest_at(beside, "Compared.S", 9)
    {:ok, infos} = StreamOverview.list_streams(beside)
    assert Enum.map(infos, & &1.name) == ["Compared.S"]
  end
end
