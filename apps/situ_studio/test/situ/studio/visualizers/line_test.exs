defmodule Situ.Studio.Visualizers.LineTest do
  # Draws signals, aggregated and message by message.
  use ExUnit.Case, async: true

  import Situ.Studio.Asking

  setup do: {:ok, session: session()}

  test "aggregates a wide window and keeps the extremes", %{session: session} do
    {reply, _} =
      ask(session, %{
        "open" => [[1, %{"stream" => "level", "viz" => "line"}]],
        "series" => [[1, "1000000000", "1999000000", 100_000_000]]
      })

    assert [%{kind: 1, channel: 1, flags: 0} = frame] = reply.frames
    assert frame.rows in 9..12
    assert Enum.min(column(frame, 1)) == 0.0
    assert Enum.max(column(frame, 2)) == 999.0
    assert Enum.sum(column(frame, 4)) == 1000.0
  end

  test "draws single messages in a narrow window, with their neighbors outside", %{
    session: session
  } do
    {reply, _} =
      ask(session, %{
        "open" => [[1, %{"stream" => "level", "viz" => "line"}]],
        "series" => [[1, "1500000000", "1502000000", 1_000]]
      })

    assert [%{kind: 1, flags: 1} = frame] = reply.frames
    # Sixteen are added on both sides, because so few messages do not show their rate.
    assert column(frame, 3) == Enum.map(484..518, &(&1 / 1))
  end
end
