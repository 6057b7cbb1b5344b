defmodule Situ.TimeTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  doctest Situ.Time

  property "formats times as Elixir's calendar does, and parses them back", numtests: 2_000 do
    days =
      one_of([integer(-719_528, 2_932_896), integer(0, 2_932_896), one_of([0, 11_016, 19_782])])

    forall {day, second, ns} <- {days, integer(0, 86_399), integer(0, 999_999_999)} do
      seconds = day * 86_400 + second
      time = seconds * 1_000_000_000 + ns
      date = seconds |> DateTime.from_unix!() |> DateTime.to_naive() |> NaiveDateTime.to_iso8601()
      text = Situ.Time.to_iso8601(time)
      assert text == "#{date}.#{ns |> Integer.to_string() |> String.pad_leading(9, "0")}Z"
      assert Situ.Time.parse(text) == {:ok, time}
    end
  end
end
