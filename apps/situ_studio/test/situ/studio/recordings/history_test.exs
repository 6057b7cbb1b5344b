defmodule Situ.Studio.Recordings.HistoryTest do
  # Reads messages in memory while old ones are dropped and gaps are filled.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{Message, Store}
  alias Situ.Studio.{Gap, History, Recordings, StreamOverview, StreamReader}

  doctest Recordings.History

  defp put(history, time, data),
    do: History.put(history, "S", %Message{data: data, originating_time: time}, 8)

  property "a history is read like the list of its messages" do
    forall {times, gaps, time, n} <-
             {list(:proper_types.integer(-40, 40)), list(:proper_types.integer(-40, 40)),
              :proper_types.integer(-45, 45), :proper_types.integer(1, 9)} do
      history = History.new(live: false)
      for t <- times, do: put(history, t, t)
      for t <- gaps, times != [], do: History.mark_gap(history, "S", t)

      gaps = if times == [], do: [], else: Enum.map(gaps, &(&1 + 1)) -- times
      all = (times ++ gaps) |> Enum.uniq() |> Enum.sort()
      recording = Recordings.History.wrap(history)
      found = fn messages -> Enum.map(messages, & &1.originating_time) end
      {before, later} = Enum.split_with(all, &(&1 < time))

      assert found.(Store.messages(recording, "S")) == all
      assert Store.ordinal(recording, "S", time) == {:ok, length(before)}
      assert found.(Store.messages(recording, "S", from: time)) == later

      neighbours = StreamReader.list_neighbours(recording, "S", :before, time, n)
      assert found.(neighbours) == before |> Enum.reverse() |> Enum.take(n)
    end
  end

  test "the signal of many messages in memory contains every extreme value" do
    history = History.new(live: false)
    spikes = [77_777, 123_457, 200_001]
    for i <- 0..200_100, do: put(history, i * 1_000, if(i in spikes, do: i, else: 0))

    recording = Recordings.History.wrap(history)
    {:ok, points, false} = StreamOverview.read_series(recording, "S", 0, 200_100_000, 2_000_000)
    assert for({_, _, high, _, _} <- points, high > 0, do: high) == spikes
  end

  test "dropped messages are not read, and numbers go on" do
    history = History.new(live: true, seconds: 1)
    for i <- 0..99, do: put(history, i * 50_000_000, i)
    recording = Recordings.History.wrap(history)
    kept = Enum.to_list(79..99)

    assert Enum.map(Store.messages(recording, "S"), & &1.data) == kept
    assert Enum.map(Store.messages(recording, "S", index: 5), & &1.data) == kept
    assert {:ok, nil} = Store.latest_at(recording, "S", 78 * 50_000_000)
    assert {:ok, %{data: 79}} = Store.first_at(recording, "S", 0)
    assert {:ok, 100} = Store.ordinal(recording, "S", 5_000_000_000)
    before = StreamReader.list_neighbours(recording, "S", :before, 82 * 50_000_000, 16)
    assert Enum.map(before, & &1.data) == [81, 80, 79]

    assert {:ok, [_ | _] = sample} =
             StreamReader.sample_messages(recording, "S", 0, 5_000_000_000, 7)

    assert Enum.all?(sample, fn {_, message} -> message.data in kept end)
  end

  test "a message takes the place of a gap" do
    history = History.new(live: true)
    put(history, 10, 1)
    History.mark_gap(history, "S", 10)
    put(history, 20, 2)
    recording = Recordings.History.wrap(history)

    assert [%{data: 1}, %{data: %Gap{}}, %{data: 2}] =
             Enum.to_list(Store.messages(recording, "S"))

    put(history, 11, 3)
    assert [1, 3, 2] = for(m <- Store.messages(recording, "S"), do: m.data)
    assert {:ok, %{count: 3}} = Store.stream_info(recording, "S")
  end
end
