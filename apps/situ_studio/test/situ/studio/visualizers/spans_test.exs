defmodule Situ.Studio.Visualizers.SpansTest do
  # Draws time intervals inside messages.
  use ExUnit.Case, async: true

  import Situ.Studio.Asking
  alias Situ.Studio.StreamInfo
  alias Situ.Studio.Visualizers.Spans

  setup do: {:ok, session: session()}

  test "draws intervals that began before the window, or whose message is after it",
       %{session: session} do
    put(session, "speech", [
      {1_200_000_000, %{start: 1_100_000_000, stop: 1_200_000_000, text: "before"}},
      {1_500_000_000, %{start: 1_300_000_000, stop: 1_500_000_000, text: "begins before"}},
      {1_900_000_000, %{start: 1_600_000_000, stop: 1_900_000_000, text: "told after"}},
      {1_950_000_000, %{start: 1_940_000_000, stop: 1_950_000_000, text: "after"}}
    ])

    assert %{kind: 2, base: 1_300_000_000, payload: json} =
             shown(session, "speech", "spans", 1_400_000_000, 1_700_000_000)

    assert [
             [0, 200_000_000, "begins before", "span"],
             [300_000_000, 600_000_000, "told after", "span"]
           ] = json(json)
  end

  test "draws a recognized sentence over its span, and a draft until the next message",
       %{session: session} do
    said = fn text, to, final? ->
      %{text: text, from: 1_100_000_000, to: to, confidence: 0.9, final?: final?, words: []}
    end

    put(session, "said", [
      {1_400_000_000, said.("ten", 1_400_000_000, false)},
      {1_700_000_000, said.("ten of", 1_700_000_000, false)},
      {1_900_000_000, said.("ten of clubs", 1_900_000_000, true)},
      {2_300_000_000, %{said.("and", 2_300_000_000, false) | from: 2_000_000_000}}
    ])

    assert %{kind: 2, payload: json} =
             shown(session, "said", "spans", 1_000_000_000, 3_000_000_000)

    assert [[_, _, "ten of clubs", "span"], [_, _, "and", "span"]] = json(json)
  end

  test "numbers named from and to are times only next to a text" do
    assert StreamInfo.shape_of(%{from: 1, to: 2, weight: "heavy"}) == :value
    assert StreamInfo.shape_of(%{text: "hello", from: 1, to: 2}) == :spans
  end

  test "draws annotations, whose tracks are lanes", %{session: session} do
    ada = Situ.Annotation.new(1_100_000_000, 1_200_000_000, "Ada", %{"Speech" => "speaks"})
    assert StreamInfo.shape_of_type({:list, Situ.Annotation}) == :spans
    put(session, "speech", [{1_200_000_000, [ada]}])

    assert %{payload: json} = shown(session, "speech", "spans", 1_000_000_000, 1_300_000_000)
    assert [[_, _, "speaks", "span", "Ada"]] = json(json)
  end

  test "draws annotations of psi" do
    end_at = fn time -> %{"Bounded" => true, "Inclusive" => true, "Point" => time} end

    one = %{
      "Interval" => %{"LeftEndpoint" => end_at.(5), "RightEndpoint" => end_at.(20)},
      "Track" => "Ada",
      "AttributeValues" => %{"Who" => %{"Value" => "A"}}
    }

    set = %{"data" => %{"Ada" => one}}
    assert StreamInfo.shape_of(set) == :spans
    assert Spans.find_spans(set, 20) == [{5, 20, "A", "span", "Ada"}]
  end
end
