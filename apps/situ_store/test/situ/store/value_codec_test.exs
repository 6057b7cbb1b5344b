defmodule Situ.Store.ValueCodecTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Store.ValueCodec
  doctest ValueCodec

  test "does not copy large binaries" do
    data = :binary.copy(<<7>>, 1_000_000)
    image = Situ.Image.new!(width: 1_000, height: 1_000, format: :gray8, data: data)
    {:ok, parts} = ValueCodec.encode(image)
    assert Enum.any?(List.flatten(parts), &:erts_debug.same(&1, data))
    assert ValueCodec.decode(IO.iodata_to_binary(parts)) == {:ok, image}
  end

  test "rejects values that are not plain data, and unknown codecs" do
    assert ValueCodec.encode(self()) == :error
    assert {:error, why} = ValueCodec.decode(<<4, "nope", 1, 2>>)
    assert why =~ "nope"
  end

  property "decodes any bytes without raising" do
    forall bytes <- binary() do
      match?({_, _}, ValueCodec.decode(bytes))
    end
  end
end
