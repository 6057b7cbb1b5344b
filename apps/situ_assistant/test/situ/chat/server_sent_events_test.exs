defmodule Situ.Chat.ServerSentEventsTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  doctest Situ.Chat.ServerSentEvents

  alias Situ.Chat.ServerSentEvents

  defp all(parts) do
    Enum.reduce(parts, {[], ServerSentEvents.new()}, fn part, {found, events} ->
      {:ok, more, events} = ServerSentEvents.push(events, part)
      {found ++ more, events}
    end)
    |> elem(0)
  end

  property "the result does not depend on how the bytes are cut" do
    letters = one_of([97, 233, 10, 32, 58])

    forall {texts, line, size} <-
             {list(list(letters)), one_of(Enum.map(["\r\n", "\n", "\r"], &constant/1)),
              integer(1, 7)} do
      texts = texts |> Enum.map(&List.to_string/1) |> Enum.reject(&(&1 == ""))

      bytes =
        for text <- texts, into: "" do
          for(part <- String.split(text, "\n"), into: "", do: "data: " <> part <> line) <> line
        end

      parts =
        for i <- 0..byte_size(bytes)//size,
            do: binary_part(bytes, i, min(size, byte_size(bytes) - i))

      all([bytes]) == texts and all(parts) == texts and all(["\uFEFF" <> bytes]) == texts
    end
  end

  test "ignores unknown fields, comments and events without data" do
    assert all([": hello\n\nevent: x\nid: 1\n\nretry: 9\ndata\ndata:1\n\n"]) == ["\n1"]
  end

  test "rejects an event without an end" do
    long = String.duplicate("x", 600_000)
    assert {:ok, [], events} = ServerSentEvents.push(ServerSentEvents.new(), "data: " <> long)
    assert {:error, :too_long} = ServerSentEvents.push(events, long)
  end
end
