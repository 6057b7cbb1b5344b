defmodule Situ.Link.Connection.ChannelTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Link.Connection.Channel
  doctest Channel

  defp channel(window), do: Channel.new(1, self(), %{name: "s", from: :start, window: window})

  property "announced room never exceeds the used room, and all is announced in the end" do
    forall {window, sizes} <- {integer(1, 1_000), list(integer(1, 300))} do
      {channel, told} =
        sizes
        |> Enum.with_index(1)
        |> Enum.reduce({channel(window), 0}, fn {size, time}, {channel, told} ->
          {:ok, channel} = Channel.accept_batch(channel, size, time, 1)

          {bytes, channel} =
            channel |> Channel.record_consumed(size, time, time) |> Channel.take_credit()

          assert told + bytes <= Enum.sum(sizes)
          {channel, told + bytes}
        end)

      # The credit that was not sent yet is less than a quarter of the window.
      assert channel.backlog == 0
      assert (Enum.sum(sizes) - told) * 4 < window
    end
  end

  property "chunks form the batch again, and all but the last are paid for" do
    forall parts <- nonempty_list(binary()) do
      {last, before} = List.pop_at(parts, -1)

      channel =
        Enum.reduce(before, channel(10), fn piece, channel ->
          {:more, channel} = Channel.add_part(channel, false, piece)
          channel
        end)

      {:complete, body, channel} = Channel.add_part(channel, true, last)
      assert body == IO.iodata_to_binary(parts)
      assert channel.credit_due == IO.iodata_length(before)
    end
  end

  test "disconnects from a server that ignores the available room" do
    {:ok, channel} = Channel.accept_batch(channel(10), 200 * 1024 * 1024, 1, 1)
    assert {:error, _} = Channel.accept_batch(channel, 1, 2, 1)
  end

  test "a repeated request continues after the last message with the remaining room" do
    channel = channel(1_000)
    assert {%{"from" => "start", "window" => 1_000}, channel} = Channel.build_request(channel)
    channel = Channel.mark_subscribed(channel, -5)
    assert {%{"from" => %{"after" => -5}}, channel} = Channel.build_request(channel)
    {:ok, channel} = Channel.accept_batch(channel, 400, 30, 3)
    assert {%{"from" => %{"after" => 30}, "window" => 600}, _} = Channel.build_request(channel)
  end
end
