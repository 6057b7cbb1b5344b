defmodule Situ.Studio.Source.DerivedStreamsTest do
  # Derives streams from others by expressions while reading.
  use ExUnit.Case, async: true

  alias Situ.{Expression, Message}
  alias Situ.Studio.{History, Source}
  alias Situ.Studio.Source.DerivedStreams

  doctest DerivedStreams

  defp source(streams) do
    history = History.new(live: false, seconds: 3_600)

    for {name, rows} <- streams, {time, data} <- rows do
      message = %Message{data: data, originating_time: time, creation_time: time + 3}
      History.put(history, name, message, 8)
    end

    DerivedStreams.wrap({Source.History, history})
  end

  defp rows(source, name, from, to, limit \\ 1_000) do
    {:ok, messages, more} = Source.call(source, :messages, [name, from, to, limit])
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
    assert {:ok, %{data: 12, originating_time: 20}} = Source.call(source, :latest_at, [name, 29])
    assert {:ok, %{data: 23, originating_time: 30}} = Source.call(source, :next_after, [name, 20])
    assert :none = Source.call(source, :next_after, [name, 30])
    assert :none = Source.call(source, :latest_at, [name, 5])
    # Other streams are unchanged.
    assert rows(source, "A", 0, 40) == {[{10, 1}, {20, 2}, {30, 3}], :all}
  end

  test "a line has the values of the messages at any zoom level" do
    source = source(%{"A" => for(i <- 0..999, do: {i * 10, i})})
    {:ok, points, true} = Source.call(source, :series, ["= A * A", 100, 150, 1])

    assert for({t, v, _, _, _} <- points, t in 100..150, do: {t, v}) ==
             for(i <- 10..15, do: {i * 10, i * i})

    {:ok, points, false} = Source.call(source, :series, ["= A * A", 0, 9_990, 1_000])
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
    assert {:error, %{code: :bad_expression}} = Source.call(source, :latest_at, ["= (", 5])
  end

  test "returns the values of an evaluation by hand" do
    values = for i <- 0..199, do: {i * 7, rem(i * 37, 11) - 5}
    source = source(%{"A" => values})
    text = "A * A - 3 * A"
    expression = Expression.parse!(text)
    wanted = for {t, v} <- values, do: {t, Expression.eval(expression, %{"A" => v})}
    assert rows(source, "= " <> text, 0, 10_000) == {wanted, :all}
  end
end
