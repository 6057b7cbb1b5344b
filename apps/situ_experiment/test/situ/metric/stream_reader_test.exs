defmodule Situ.Metric.StreamReaderTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{Annotation, Message, Rect}
  alias Situ.Metric.StreamReader

  defp message(time, data),
    do: %Message{data: data, originating_time: time, creation_time: time, sequence_id: 1}

  defp messages(pairs), do: for({time, data} <- pairs, do: message(time, data))

  test "a state holds until the next message" do
    states = messages([{0, false}, {10, true}, {20, true}, {30, false}, {40, true}])
    assert StreamReader.read_intervals(states) == %{"" => [{10, 30}]}
    faces = messages([{0, %{a: true, b: false}}, {10, %{a: false}}, {20, %{}}])
    assert StreamReader.read_intervals(faces) == %{"a" => [{0, 10}], "b" => []}
    assert StreamReader.read_intervals([]) == %{}
  end

  test "annotations have their own intervals and labels" do
    a = Annotation.new(0, 10, "P1", %{"Speech" => "speaks"})
    b = Annotation.new(5, 10, "P2", %{})
    stream = Annotation.to_messages([a, b])
    assert StreamReader.read_intervals(stream) == %{"P1" => [{0, 10}], "P2" => [{5, 10}]}
    assert StreamReader.read_segments(stream)["P1"] == [{0, 10, "speaks"}]
  end

  test "labels change with the values" do
    stream = messages([{0, :idle}, {10, "walk"}, {15, "walk"}, {20, nil}, {30, 1}])
    assert StreamReader.read_segments(stream) == %{"" => [{0, 10, "idle"}, {10, 20, "walk"}]}
  end

  test "utterances have speakers, times and texts" do
    said = Annotation.new(0, 10, "Ada", %{"Words" => "good morning"})
    assert StreamReader.read_utterances([message(10, [said])]) == [{"Ada", 0, 10, "good morning"}]
    by_name = message(5, %{"Ben" => "hello", 2 => %{text: "yes", from: 1, to: 3}})
    found = [by_name] |> StreamReader.read_utterances() |> Enum.sort()
    assert found == [{"2", 1, 3, "yes"}, {"Ben", 5, 5, "hello"}]
    own = message(7, %{speaker: :cat, text: "meow"})
    assert StreamReader.read_utterances([own]) == [{"cat", 7, 7, "meow"}]

    for wrong <- ["hello", %{"Ada" => 3}, 5, [nil]],
        do: assert_raise(Situ.Error, fn -> StreamReader.read_utterances([message(0, wrong)]) end)
  end

  test "messages are paired with the nearest one within the tolerance" do
    pair = fn truth, output, tolerance ->
      for {a, b} <- StreamReader.pair_messages(messages(truth), messages(output), tolerance),
          do: {a.data, b && b.data}
    end

    assert pair.([{0, 1}, {10, 2}, {20, 3}], [{1, :a}, {9, :b}, {40, :c}], 2) == [
             {1, :a},
             {2, :b},
             {3, nil}
           ]

    assert pair.([{0, 1}], [{3, :a}], 2) == [{1, nil}]
    assert pair.([{0, 1}, {2, 2}], [{1, :a}, {2, :b}], 5) == [{1, :a}, {2, :b}]
  end

  property "equal times are always paired, and no message twice" do
    forall steps <- list(integer(1, 9)) do
      times = Enum.scan(steps, &(&1 + &2))
      stream = messages(Enum.map(times, &{&1, &1}))
      pairs = StreamReader.pair_messages(stream, stream, 0)
      assert Enum.all?(pairs, fn {a, b} -> a == b end)
      assert length(pairs) == length(times)

      loose = StreamReader.pair_messages(stream, messages(Enum.map(times, &{&1 + 1, &1})), 9)
      found = for {_, b} <- loose, b != nil, do: b
      assert found == Enum.uniq(found)
    end
  end

  test "boxes, tracks and texts are read, and other data is an error" do
    rect = Rect.new!(0, 0, 5, 5)

    assert StreamReader.read_boxes(message(0, [rect, %{rect: rect, label: "a", score: 0.5}])) == [
             {rect, "", 1.0},
             {rect, "a", 0.5}
           ]

    assert StreamReader.read_tracks(message(0, %{3 => %{rect: rect}})) == %{3 => rect}
    assert StreamReader.read_tracks(message(0, [%{id: 4, rect: rect}])) == %{4 => rect}
    assert StreamReader.read_text(messages([{0, "go"}, {1, %{text: "forward"}}])) == "go forward"

    for read <- [
          &StreamReader.read_boxes/1,
          &StreamReader.read_tracks/1,
          &StreamReader.read_number/1
        ],
        do: assert_raise(Situ.Error, fn -> read.(message(0, "text")) end)
  end
end
