defmodule Situ.Bridge.MessagePackTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Bridge.MessagePack
  doctest MessagePack

  defp bytes(term), do: term |> MessagePack.encode() |> IO.iodata_to_binary()

  test "encodes each number and length in its smallest form" do
    for {n, hex} <- [
          {0, "00"},
          {127, "7F"},
          {128, "CC80"},
          {256, "CD0100"},
          {65_536, "CE00010000"},
          {-1, "FF"},
          {-32, "E0"},
          {-33, "D0DF"},
          {-129, "D1FF7F"},
          {-32_769, "D2FFFF7FFF"},
          {0xFFFFFFFFFFFFFFFF, "CFFFFFFFFFFFFFFFFF"}
        ],
        do: assert(Base.encode16(bytes(n)) == hex)

    assert <<0xD9, 32, _::binary>> = bytes(String.duplicate("x", 32))
    assert <<0xDA, 256::16, _::binary>> = bytes(String.duplicate("x", 256))
    assert <<0xDC, 16::16, _::binary>> = bytes(List.duplicate(1, 16))
    assert <<0xDE, 16::16, _::binary>> = bytes(Map.new(1..16, &{&1, 1}))
    assert <<0xC4, 1, 0xFF>> = bytes(<<0xFF>>)
  end

  property "decodes encoded terms" do
    forall term <- term() do
      try do
        assert {:ok, back, ""} = MessagePack.decode(bytes(term), objects: :pairs)
        assert bytes(back) == bytes(term)
      catch
        {:not_writable, _} -> true
      end
    end
  end

  test "supports extensions and timestamps" do
    assert MessagePack.decode(bytes({:timestamp, -1})) == {:ok, {:timestamp, -1}, ""}
    assert MessagePack.decode(<<0xD6, 0xFF, 5::32>>) == {:ok, {:timestamp, 5_000_000_000}, ""}
    assert MessagePack.decode(bytes({:ext, 7, "abc"})) == {:ok, {:ext, 7, "abc"}, ""}
    assert MessagePack.decode(<<0xCB, 0xFFF0::16, 0::48>>) == {:ok, :neg_infinity, ""}
  end

  test "rejects false lengths and excessive depth immediately" do
    assert {:error, _} = MessagePack.decode(<<0xDD, 0xFFFFFFFF::32>>)
    assert {:error, _} = MessagePack.decode(<<0xDF, 0xFFFFFFFF::32, 0>>)
    assert {:error, _} = MessagePack.decode(<<0xDB, 0xFFFFFFFF::32, "abc">>)
    assert {:error, why} = MessagePack.decode(:binary.copy(<<0x91>>, 100_000))
    assert why =~ "512 levels"
  end
end
