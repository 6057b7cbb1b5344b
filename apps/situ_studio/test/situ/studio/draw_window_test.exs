defmodule Situ.Studio.DrawWindowTest do
  # What is drawn of an interval: signals, states, intervals, maps of them.
  use ExUnit.Case, async: true

  import Situ.Studio.Asking
  alias Situ.Studio.History

  setup do: {:ok, session: session()}

  test "a wide window is summed up and keeps the extremes", %{session: session} do
    {reply, _} =
      ask(session, %{
        "open" => [[1, %{"stream" => "level", "draw" => "line"}]],
        "series" => [[1, "1000000000", "1999000000", 100_000_000]]
      })

    assert [%{kind: 1, channel: 1, flags: 0} = frame] = reply.frames
    assert frame.rows in 9..12
    assert Enum.min(column(frame, 1)) == 0.0
    assert Enum.max(column(frame, 2)) == 999.0
    assert Enum.sum(column(frame, 4)) == 1000.0
  end

  test "a narrow window has single messages, with the neighbours outside of it", %{
    session: session
  } do
    {reply, _} =
      ask(session, %{
        "open" => [[1, %{"stream" => "level", "draw" => "line"}]],
        "series" => [[1, "1500000000", "1502000000", 1_000]]
      })

    assert [%{kind: 1, flags: 1} = frame] = reply.frames
    assert column(frame, 3) == [499.0, 500.0, 501.0, 502.0, 503.0]
  end

  test "states are merged, the one in force at the left edge included", %{session: session} do
    {reply, _} =
      ask(session, %{
        "open" => [[1, %{"stream" => "on", "draw" => "segments"}]],
        "series" => [[1, "1150000000", "1350000000", 100_000]]
      })

    assert [%{kind: 2, payload: json}] = reply.frames

    assert Situ.JSON.decode(json) ==
             {:ok,
              [
                [0, 51_000_000, "false", "false"],
                [51_000_000, 151_000_000, "true", "true"],
                [151_000_000, 202_000_000, "false", "false"]
              ]}
  end

  defp json(text) do
    {:ok, value} = Situ.JSON.decode(text)
    value
  end

  defp put(session, stream, rows) do
    {_, history} = session.source

    for {{t, data}, i} <- Enum.with_index(rows),
        do: History.put(history, stream, message(t, data, i), 8)
  end

  test "maps of states are lanes with names; a key that is gone ends its lane", %{
    session: session
  } do
    put(session, "talk", [
      {1_100_000_000, %{0 => false}},
      {1_200_000_000, %{0 => true, 1 => false}},
      {1_300_000_000, %{1 => false}},
      {1_400_000_000, %{1 => true}}
    ])

    # the newest message within the window is told too
    assert %{kind: 2, base: base, own: 300_000_000, payload: json} =
             shown(session, "talk", "segments", 1_150_000_000, 1_500_000_000)

    rows = for [a, b | rest] <- json(json), do: [base + a, b && base + b | rest]

    assert rows == [
             [1_100_000_000, 1_200_000_000, "false", "false", "0"],
             [1_200_000_000, 1_300_000_000, "true", "true", "0"],
             [1_200_000_000, 1_400_000_000, "false", "false", "1"],
             [1_400_000_000, nil, "true", "true", "1"]
           ]
  end

  test "intervals are drawn over their span, also when they began before the window or are told of after it",
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

  test "maps of numbers are lines with names and gaps", %{session: session} do
    put(session, "opening", [
      {1_100_000_000, %{"left" => 1.0}},
      {1_200_000_000, %{"left" => 2.0, "right" => 5.0}},
      {1_300_000_000, %{"right" => nil}}
    ])

    assert %{kind: 10, rows: 2, flags: 1, base: 1_100_000_000, payload: payload} =
             shown(session, "opening", "lines", 1_000_000_000, 1_500_000_000)

    nan = <<0, 0, 0, 0, 0, 0, 0xF8, 0x7F>>

    assert <<4::little-32, 3::little-32, "left", 0::32, left::binary-size(120), rest::binary>> =
             payload

    assert <<5::little-32, 2::little-32, "right", 0::24, right::binary-size(80)>> = rest

    assert <<+0.0::little-float-64, 1.0e8::little-float-64, 2.0e8::little-float-64, _::binary>> =
             left

    assert <<1.0::little-float-64, 2.0::little-float-64, ^nan::binary-8>> =
             binary_part(left, 72, 24)

    assert <<5.0::little-float-64, ^nan::binary-8>> = binary_part(right, 48, 16)
  end

  test "an hour of states is bounded by what can be told apart", %{session: session} do
    put(
      session,
      "flicker",
      for(i <- 0..19_999, do: {1_000_000_000 + i * 40_000_000, rem(i, 2) == 0})
    )

    {reply, _} =
      ask(session, %{
        "open" => [[1, %{"stream" => "flicker", "draw" => "segments"}]],
        "series" => [[1, "0", "900000000000", 1_000_000_000]]
      })

    assert [%{kind: 2, payload: json}] = reply.frames
    rows = json(json)
    assert length(rows) < 10
    assert Enum.any?(rows, &match?([_, _, "", "many"], &1))
  end

  test "more messages than can be read at once are a sample of the whole window", %{
    session: session
  } do
    put(session, "long", for(i <- 0..250_000, do: {1_000_000_000 + i * 400_000, i > 125_000}))

    assert %{kind: 2, payload: json} = shown(session, "long", "segments", 0, 102_000_000_000)

    assert [[0, half, "false", "false"], [half, nil, "true", "true"]] = json(json)

    assert_in_delta half, 50_000_000_000, 150_000_000
  end
end
