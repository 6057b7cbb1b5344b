defmodule Situ.TensorTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Tensor
  doctest Situ.Tensor

  property "a tensor round-trips, and foreign bytes are refused without raising" do
    forall {list, junk} <- {list(integer(-100, 100)), binary()} do
      tensor = Tensor.from_list(list, :s16, {length(list)})
      result = Tensor.decode(junk)

      Tensor.decode(IO.iodata_to_binary(Tensor.encode(tensor))) == {:ok, tensor} and
        match?({tag, _} when tag in [:ok, :error], result)
    end
  end

  test "converts f16 and bf16 values, their limits and values that are not numbers" do
    values = [0.0, 1.0, -2.5, 65_504.0, 0.000061035]

    for type <- [:f16, :bf16] do
      tensor = Tensor.from_list(values, type, {5})
      assert byte_size(tensor.data) == 10
      close = if type == :f16, do: 1.0e-3, else: 4.0e-3

      for {a, b} <- Enum.zip(Tensor.to_list(tensor), values),
          do: assert(abs(a - b) <= close * abs(b))

      assert Tensor.decode(IO.iodata_to_binary(Tensor.encode(tensor))) == {:ok, tensor}
    end

    assert Tensor.to_list(
             Tensor.new(<<0x7C00::16-native, 0xFC00::16-native, 0x7E00::16-native>>, :f16, {3})
           ) ==
             [:infinity, :neg_infinity, :nan]

    assert Tensor.to_list(Tensor.new(<<0x7F80::16-native, 0xFFC0::16-native>>, :bf16, {2})) == [
             :infinity,
             :nan
           ]

    # 1 + 2^-8 is halfway between two values and is rounded to even.
    assert Tensor.to_list(Tensor.from_list([1.00390625], :bf16, {1})) == [1.0]
  end

  test "a tensor may be empty" do
    none = Tensor.zeros(:f32, {0, 3})
    assert Tensor.to_list(none) == []
    assert Tensor.concat([none, Tensor.zeros(:f32, {2, 3})]).shape == {2, 3}
    assert Tensor.decode(IO.iodata_to_binary(Tensor.encode(none))) == {:ok, none}
    assert_raise ArgumentError, ~r/without elements/, fn -> Tensor.to_nx(none) end
  end
end
