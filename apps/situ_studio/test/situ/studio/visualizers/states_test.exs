defmodule Situ.Studio.Visualizers.StatesTest do
  # Draws booleans and maps of states as lanes.
  use ExUnit.Case, async: true

  import Situ.Studio.Asking
  alias Situ.Studio.StreamOverview

  setup do: {:ok, session: session()}

  test "merges states, including the one in force at the left edge", %{session: session} do
    {reply, _} =
      ask(session, %{
        "open" => [[1, %{"stream" => "on", "viz" => "states"}]],
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

  test "draws maps of states as named lanes, and ends the lane of a removed key", %{
    session: session
  } do
    put(session, "talk", [
      {1_100_000_000, %{0 => false}},
      {1_200_000_000, %{0 => true, 1 => false}},
      {1_300_000_000, %{1 => false}},
      {1_400_000_000, %{1 => true}}
    ])

    # The newest message in the window is also reported.
    assert %{kind: 2, base: base, own: 300_000_000, payload: json} =
             shown(session, "talk", "states", 1_150_000_000, 1_500_000_000)

    rows = for [a, b | rest] <- json(json), do: [base + a, b && base + b | rest]

    assert rows == [
             [1_100_000_000, 1_200_000_000, "false", "false", "0"],
             [1_200_000_000, 1_300_000_000, "true", "true", "0"],
             [1_200_000_000, 1_400_000_000, "false", "false", "1"],
             [1_400_000_000, nil, "true", "true", "1"]
           ]
  end

  test "shows the gap in a window inside it, like in a wide one", %{session: session} do
    rows = for i <- Enum.concat(0..50, 200..250), do: {1_000_000_000 + i * 10_000_000, true}
    put(session, "pulse", rows)

    for {from, to} <- [{900_000_000, 4_000_000_000}, {1_700_000_000, 1_800_000_000}] do
      %{base: base, payload: json} = shown(session, "pulse", "states", from, to)
      rows = for [a, b | _] <- json(json), do: {base + a, b && base + b}

      refute Enum.any?(rows, fn {a, b} ->
               a < 1_750_000_000 and (b == nil or b > 1_750_000_000)
             end)
    end

    # The same holds for a line, where the messages next to the window show the rate.
    put(session, "wave", for({t, _} <- rows, do: {t, 1.0}))

    {:ok, points, true} =
      StreamOverview.read_series(session.source, "wave", 1_700_000_000, 1_800_000_000, 1_000)

    assert length(points) == 32
  end

  test "merges an hour of states into as many as can be distinguished", %{session: session} do
    put(
      session,
      "flicker",
      for(i <- 0..19_999, do: {1_000_000_000 + i * 40_000_000, rem(i, 2) == 0})
    )

    {reply, _} =
      ask(session, %{
        "open" => [[1, %{"stream" => "flicker", "viz" => "states"}]],
        "series" => [[1, "0", "900000000000", 1_000_000_000]]
      })

    assert [%{kind: 2, payload: json}] = reply.frames
    rows = json(json)
    assert length(rows) < 10
    assert [[_, _, label, "many"] | _] = rows
    assert label =~ ~r/\A\d+ changes\z/
  end

  test "draws only known states if there are too many messages to read", %{
    session: session
  } do
    put(session, "long", for(i <- 0..250_000, do: {1_000_000_000 + i * 400_000, i > 125_000}))

    assert %{kind: 2, flags: 2, payload: json} =
             shown(session, "long", "states", 0, 102_000_000_000)

    assert [[0, until, label, "many"], [until, nil, "true", "true"]] = json(json)
    assert label =~ ~r/\A\d+ messages\z/
  end
end
