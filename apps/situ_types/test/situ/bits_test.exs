defmodule Situ.BitsTest do
  use ExUnit.Case, async: true
  doctest Situ.Bits

  import Situ.Bits, only: [known: 1]

  test "a size of several variables, and in units" do
    {n, m} = {1, 2}
    assert <<a::binary-known(n + m), b::little-known(m)-unit(8)>> = <<1, 2, 3, 4, 5>>
    assert {a, b} == {<<1, 2, 3>>, 0x0504}
    assert for(<<part::binary-known(m) <- "abcd">>, do: part) == ["ab", "cd"]
    refute match?(<<_::binary-known(m)>>, "abc")
  end
end
