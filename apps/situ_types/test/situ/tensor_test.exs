defmodule Situ.TensorTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Tensor
  doctest Situ.Tensor

  property "a tensor comes back from its bytes, and foreign bytes are refused without raising" do
    forall {list, junk} <- {list(integer(-100, 100)), binary()} do
      tensor = Tensor.from_list(list, :s16, {length(list)})
      result = Tensor.decode(junk)

      Tensor.decode(IO.iodata_to_binary(Tensor.encode(tensor))) == {:ok, tensor} and
        match?({tag, _} when tag in [:ok, :error], result)
    end
  end
end
