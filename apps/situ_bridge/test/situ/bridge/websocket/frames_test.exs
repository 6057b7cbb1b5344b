defmodule Situ.Bridge.WebSocket.FramesTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Bridge.WebSocket.Frames
  doctest Frames

  @most 1_000_000

  property "what is framed is split again, in pieces of any size, masked or not" do
    forall {payload, mask, at} <- {binary(), one_of([nil, binary(4)]), integer(0, 100)} do
      payload = :binary.copy(payload, 1 + rem(at, 7) * 20_000)

      bytes =
        IO.iodata_to_binary([Frames.frame(:binary, payload, mask), Frames.frame(:ping, "x", mask)])

      {one, two} = :erlang.split_binary(bytes, min(at, byte_size(bytes)))
      {:ok, first, rest, begun} = Frames.split(one, nil, mask != nil, 20_000_000)
      {:ok, second, "", nil} = Frames.split(rest <> two, begun, mask != nil, 20_000_000)
      assert first ++ second == [{:binary, payload}, {:ping, "x"}]
    end
  end

  test "messages in parts are joined, with pings between them" do
    bytes = <<0x01, 2, "ab", 0x89, 0, 0x80, 1, "c">>
    assert Frames.split(bytes, nil, false, @most) == {:ok, [{:ping, ""}, {:text, "abc"}], "", nil}
    assert {:error, _} = Frames.split(<<0x80, 1, "c">>, nil, false, @most)
    assert {:error, _} = Frames.split(<<0x01, 1, "a", 0x01, 1, "b">>, nil, false, @most)
    assert {:error, _} = Frames.split(<<0x09, 0>>, nil, false, @most)
    assert {:error, _} = Frames.split(<<0x81, 1, "a">>, nil, true, @most)
    assert {:error, _} = Frames.split(<<0xC1, 1, "a">>, nil, false, @most)
    assert {:error, _} = Frames.split(<<0x82, 127, 0xFFFFFFFFFFFFFFFF::64>>, nil, false, @most)
  end

  property "hostile bytes are refused or wait for more" do
    forall bytes <- binary() do
      case Frames.split(bytes, nil, true, 1_000) do
        {:ok, _events, rest, _begun} -> assert byte_size(rest) <= byte_size(bytes)
        {:error, why} -> assert is_binary(why)
      end
    end
  end
end
