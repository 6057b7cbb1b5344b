defmodule Situ.BinarySizeTest do
  use ExUnit.Case, async: true
  doctest Situ.BinarySize

  import Situ.BinarySize, only: [pinned_size: 1]

  test "known/1 accepts expressions of several variables, and units" do
    {n, m} = {1, 2}
    assert <<a::binary-pinned_size(n + m), b::little-pinned_size(m)-unit(8)>> = <<1, 2, 3, 4, 5>>
    assert {a, b} == {<<1, 2, 3>>, 0x0504}
    assert for(<<part::binary-pinned_size(m) <- "abcd">>, do: part) == ["ab", "cd"]
    refute match?(<<_::binary-pinned_size(m)>>, "abc")
  end
end
