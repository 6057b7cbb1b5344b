defmodule Situ.Bridge.Psi.BytesTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Bridge.Psi.Bytes
  doctest Bytes

  property "the kind of a time changes nothing" do
    forall {ticks, kind} <- {integer(0, 3_155_378_975_999_999_999), integer(0, 3)} do
      assert Bytes.time(ticks + Bitwise.bsl(kind, 62)) == Bytes.time(ticks)
    end
  end

  test "the end of time is no time" do
    assert Bytes.time_or_nil(3_155_378_975_999_999_999) == nil
    assert Bytes.time_or_nil(621_355_968_000_000_000) == 0
  end

  property "strings come back with what follows them" do
    forall {text, rest} <- {text(), binary()} do
      assert Bytes.string(<<byte_size(text)::little-32, text::binary, rest::binary>>) ==
               {:ok, text, rest}
    end
  end

  test "a length beyond the bytes or below -1 is no string" do
    assert Bytes.string(<<5::little-32, "abc">>) == :error
    assert Bytes.string(<<-2::little-signed-32, "abc">>) == :error
    assert Bytes.string(<<-1::little-signed-32, "abc">>) == {:ok, nil, "abc"}
  end
end
