defmodule Situ.Bridge.Psi.BytesTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Bridge.Psi.Bytes
  doctest Bytes

  property "ignores the kind of a time" do
    forall {ticks, kind} <- {integer(0, 3_155_378_975_999_999_999), integer(0, 3)} do
      assert Bytes.parse_time(ticks + Bitwise.bsl(kind, 62)) == Bytes.parse_time(ticks)
    end
  end

  test "reads the maximum time as nil" do
    assert Bytes.parse_optional_time(3_155_378_975_999_999_999) == nil
    assert Bytes.parse_optional_time(621_355_968_000_000_000) == 0
  end

  property "reads a string and returns the remaining bytes" do
    forall {text, rest} <- {ascii_text(), binary()} do
      assert Bytes.parse_string(<<byte_size(text)::little-32, text::binary, rest::binary>>) ==
               {:ok, text, rest}
    end
  end

  test "rejects a length beyond the bytes or below -1" do
    assert Bytes.parse_string(<<5::little-32, "abc">>) == :error
    assert Bytes.parse_string(<<-2::little-signed-32, "abc">>) == :error
    assert Bytes.parse_string(<<-1::little-signed-32, "abc">>) == {:ok, nil, "abc"}
  end
end
