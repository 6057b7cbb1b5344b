defmodule Situ.Studio.Visualizers.LogTest do
  # Lists the messages around the cursor.
  use ExUnit.Case, async: true

  import Situ.Studio.Asking

  test "lists messages before and after the cursor, each with its time" do
    session = session()

    {reply, _} =
      ask(session, %{
        "open" => [[1, %{"stream" => "level", "viz" => "log"}]],
        "instant" => [1],
        "at" => "1500400000"
      })

    assert [%{kind: 5, payload: json}] = reply.frames
    {:ok, %{"rows" => rows, "at" => at}} = Situ.JSON.decode(json)
    assert Enum.at(rows, at) == ["1500000000", "500.0"]
    assert hd(rows) == ["1440000000", "440.0"]
    assert List.last(rows) == ["1530000000", "530.0"]
    assert rows == Enum.sort_by(rows, &String.to_integer(hd(&1)))
  end
end
