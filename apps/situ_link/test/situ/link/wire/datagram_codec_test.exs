defmodule Situ.Link.Wire.DatagramCodecTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Link.Wire.DatagramCodec
  doctest DatagramCodec

  @key <<5::128>>

  defp sent(frames, size) do
    {datagrams, _} =
      Enum.flat_map_reduce(frames, DatagramCodec.new_sender(@key, size), fn {frame, messages},
                                                                            sender ->
        {sent, sender} = DatagramCodec.split_frame(sender, frame, messages)
        {Enum.map(sent, &{frame, &1}), sender}
      end)

    datagrams
  end

  defp received(datagrams) do
    Enum.flat_map_reduce(datagrams, DatagramCodec.new_receiver(@key), fn datagram, receiver ->
      DatagramCodec.receive_datagram(receiver, datagram)
    end)
    |> elem(0)
  end

  defp frames, do: list({binary(), integer(0, 5)})

  property "a frame of any size survives datagrams of any size", numtests: 300 do
    forall {frames, size} <- {frames(), integer(46, 200)} do
      datagrams = for {_, datagram} <- sent(frames, size), do: datagram

      Enum.all?(datagrams, &(byte_size(&1) <= size)) and
        received(datagrams) == for({f, _} <- frames, do: {0, f})
    end
  end

  # The sizes at which the reference truncated messages.
  test "sends frames about as long as one and two datagrams" do
    for size <- [46, 1_200, 65_507],
        times <- 1..2,
        around <- -50..50,
        n = size * times + around,
        n >= 0 do
      frame = :binary.copy("x", n)
      datagrams = for {_, datagram} <- sent([{frame, 1}], size), do: datagram
      assert received(datagrams) == [{0, frame}]
    end
  end

  property "with lost, duplicated and swapped datagrams, frames arrive intact and losses are reported",
    numtests: 300 do
    forall {numbers, chances, size} <- {list(integer(1, 4)), list(integer(0, 9)), integer(46, 90)} do
      frames =
        for {n, i} <- Enum.with_index(numbers),
            do: {<<i::32, :binary.copy("y", i * 7)::binary>>, n}

      datagrams = for {_, datagram} <- sent(frames, size), do: datagram
      out = datagrams |> disturbed(chances) |> received()
      indices = for {_, <<i::32, _::binary>>} <- out, do: i
      messages = Enum.map(frames, &elem(&1, 1))

      # Up to the last frame received, the received and the reported lost frames are all frames.
      came = indices |> Enum.map(&Enum.at(messages, &1)) |> Enum.sum()
      lost = out |> Enum.map(&elem(&1, 0)) |> Enum.sum()
      last = List.last(indices)

      indices == Enum.sort(Enum.uniq(indices)) and
        Enum.all?(out, fn {_, <<i::32, _::binary>> = frame} ->
          frame == elem(Enum.at(frames, i), 0)
        end) and
        (last == nil or came + lost == messages |> Enum.take(last + 1) |> Enum.sum())
    end
  end

  defp disturbed(datagrams, []), do: datagrams

  defp disturbed(datagrams, chances) do
    datagrams
    |> Enum.zip(Stream.cycle(chances))
    |> Enum.flat_map(fn
      {_, 0} -> []
      {datagram, 1} -> [datagram, datagram]
      {datagram, _} -> [datagram]
    end)
    |> Enum.chunk_every(2)
    |> Enum.zip(Stream.cycle(tl(chances) ++ [hd(chances)]))
    |> Enum.flat_map(fn {pair, chance} -> if chance > 6, do: Enum.reverse(pair), else: pair end)
  end

  property "any datagram is accepted or ignored, and never raises", numtests: 300 do
    forall {bytes, size} <- {binary(), integer(46, 200)} do
      {[], receiver} = DatagramCodec.receive_datagram(DatagramCodec.new_receiver(@key), bytes)

      other =
        DatagramCodec.split_frame(DatagramCodec.new_sender(<<9::128>>, size), "of another key", 1)
        |> elem(0)

      Enum.all?(other, &match?({[], _}, DatagramCodec.receive_datagram(receiver, &1))) and
        not DatagramCodec.hello?(@key, bytes)
    end
  end

  test "a sender that never completes its frames does not fill memory" do
    datagrams =
      for {frame, datagram} <- sent(for(i <- 1..1_000, do: {<<i::16, 0::400>>, 1}), 60),
          frame != nil,
          do: datagram

    firsts = datagrams |> Enum.chunk_every(4) |> Enum.map(&hd/1)

    receiver =
      Enum.reduce(
        firsts,
        DatagramCodec.new_receiver(@key),
        &elem(DatagramCodec.receive_datagram(&2, &1), 1)
      )

    assert map_size(receiver.sets) <= 16
  end
end
