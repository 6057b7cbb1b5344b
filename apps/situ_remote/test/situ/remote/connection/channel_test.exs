defmodule Situ.Remote.Connection.ChannelTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Remote.Connection.Channel
  doctest Channel

  defp channel(window), do: Channel.new(1, self(), %{name: "s", from: :start, window: window})

  property "room that is told never exceeds what was used up, and all of it is told in the end" do
    forall {window, sizes} <- {integer(1, 1_000), list(integer(1, 300))} do
      {channel, told} =
        sizes
        |> Enum.with_index(1)
        |> Enum.reduce({channel(window), 0}, fn {size, time}, {channel, told} ->
          {:ok, channel} = Channel.delivered(channel, size, time, 1)
          {bytes, channel} = channel |> Channel.taken(size, time) |> Channel.credit()
          assert told + bytes <= Enum.sum(sizes)
          {channel, told + bytes}
        end)

      # The credit not sent yet is less than a quarter of the window.
      assert channel.under_way == 0
      assert (Enum.sum(sizes) - told) * 4 < window
    end
  end

  property "pieces make the batch again, and are paid for but for the last" do
    forall pieces <- nonempty_list(binary()) do
      {last, before} = List.pop_at(pieces, -1)

      channel =
        Enum.reduce(before, channel(10), fn piece, channel ->
          {:more, channel} = Channel.part(channel, false, piece)
          channel
        end)

      {:whole, body, channel} = Channel.part(channel, true, last)
      assert body == IO.iodata_to_binary(pieces)
      assert channel.unpaid == IO.iodata_length(before)
    end
  end

  test "a server that ignores how much room there is is left" do
    {:ok, channel} = Channel.delivered(channel(10), 200 * 1024 * 1024, 1, 1)
    assert {:error, _} = Channel.delivered(channel, 1, 2, 1)
  end

  test "asked again: from behind what came, with the room that is left" do
    channel = channel(1_000)
    assert {%{"from" => "start", "window" => 1_000}, channel} = Channel.ask(channel)
    channel = Channel.subscribed(channel, -5)
    assert {%{"from" => %{"after" => -5}}, channel} = Channel.ask(channel)
    {:ok, channel} = Channel.delivered(channel, 400, 30, 3)
    assert {%{"from" => %{"after" => 30}, "window" => 600}, _} = Channel.ask(channel)
  end
end
