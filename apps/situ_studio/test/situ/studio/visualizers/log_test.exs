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
    assert Enum.at(rows, at) == ["1500000000", "500.0", 0, ""]
    assert hd(rows) == ["1440000000", "440.0", 0, ""]
    assert List.last(rows) == ["1530000000", "530.0", 0, ""]
    assert rows == Enum.sort_by(rows, &String.to_integer(hd(&1)))
  end

  defp ask_lines(rows, at, props) do
    spec = %{"stream" => "log", "viz" => "log", "props" => props}
    session = "log" |> source(rows) |> Situ.Studio.DataSession.new()
    request = %{"open" => [[1, spec]], "instant" => [1], "at" => Integer.to_string(at)}
    {%{frames: [%{kind: 5, payload: json}]}, _} = ask(session, request)
    {:ok, answer} = Situ.JSON.decode(json)
    answer
  end

  test "selects lines by level and words, however far they are from the cursor" do
    rows =
      for i <- 1..5_000 do
        {level, text} =
          if rem(i, 1_000) == 0, do: {8, "Wheel #{i} STUCK"}, else: {2, "turning #{i}"}

        {i * 1_000_000, %{"level" => level, "name" => "/base", "msg" => text}}
      end

    at = 2_500 * 1_000_000
    answer = ask_lines(rows, at, %{"level" => "4"})
    assert [_, "Wheel 2000 STUCK", 4, "/base"] = Enum.at(answer["rows"], answer["at"])
    assert length(answer["rows"]) == 5
    assert answer["searched"] == nil

    assert [[_, "Wheel 3000 STUCK", 4, "/base"]] =
             ask_lines(rows, at, %{"words" => "3000 stuck"})["rows"]

    assert length(ask_lines(rows, at, %{"words" => "base"})["rows"]) == 91
    assert ask_lines(rows, at, %{"words" => "nowhere"})["rows"] == []
  end

  test "says that it has not searched everything" do
    rows = for i <- 1..21_000, do: {i * 1_000, "line #{i}"}
    assert %{"rows" => [], "searched" => 20_000} = ask_lines(rows, 20_900_000, %{"level" => "3"})
  end
end
