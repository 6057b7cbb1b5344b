defmodule Situ.Bridge.WebSocket.FramesTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Bridge.WebSocket.Frames
  doctest Frames

  @most 1_000_000

  property "splits frames in chunks of any size, masked or not" do
    forall {payload, mask, at} <- {binary(), one_of([nil, binary(4)]), integer(0, 100)} do
      payload = :binary.copy(payload, 1 + rem(at, 7) * 20_000)

      bytes =
        IO.iodata_to_binary([
          Frames.encode_frame(:binary, payload, mask),
          Frames.encode_frame(:ping, "x", mask)
        ])

      {one, two} = :erlang.split_binary(bytes, min(at, byte_size(bytes)))
      {:ok, first, rest, begun} = Frames.split_messages(one, nil, mask != nil, 20_000_000)
      {:ok, second, "", nil} = Frames.split_messages(rest <> two, begun, mask != nil, 20_000_000)
      assert first ++ second == [{:binary, payload}, {:ping, "x"}]
    end
  end

  test "joins fragmented messages with pings between the fragments" do
    bytes = <<0x01, 2, "ab", 0x89, 0, 0x80, 1, "c">>

    assert Frames.split_messages(bytes, nil, false, @most) ==
             {:ok, [{:ping, ""}, {:text, "abc"}], "", nil}

    assert {:error, _} = Frames.split_messages(<<0x80, 1, "c">>, nil, false, @most)
    assert {:error, _} = Frames.split_messages(<<0x01, 1, "a", 0x01, 1, "b">>, nil, false, @most)
    assert {:error, _} = Frames.split_messages(<<0x09, 0>>, nil, false, @most)
    assert {:error, _} = Frames.split_messages(<<0x81, 1, "a">>, nil, true, @most)
    assert {:error, _} = Frames.split_messages(<<0xC1, 1, "a">>, nil, false, @most)

    assert {:error, _} =
             Frames.split_messages(<<0x82, 127, 0xFFFFFFFFFFFFFFFF::64>>, nil, false, @most)
  end

  property "rejects hostile bytes or waits for more" do
    forall bytes <- binary() do
      case Frames.split_messages(bytes, nil, true, 1_000) do
        {:ok, _events, rest, _begun} -> assert byte_size(rest) <= byte_size(bytes)
        {:error, why} -> assert is_binary(why)
      end
    end
  end
end
