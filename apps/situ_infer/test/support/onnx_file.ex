defmodule Situ.Infer.Test.OnnxFile do
  @moduledoc false
  # Writes a tiny ONNX file: y = x + x over f32 with a free first dimension. Protobuf by hand: (field << 3 | kind),
  # length, bytes.

  @spec doubling(pos_integer()) :: binary()
  def doubling(width) do
    node = text(1, "x") <> text(1, "x") <> text(2, "y") <> text(4, "Add")

    graph =
      bytes(1, node) <> text(2, "g") <> bytes(11, port("x", width)) <> bytes(12, port("y", width))

    int(1, 8) <> bytes(7, graph) <> bytes(8, text(1, "") <> int(2, 13))
  end

  defp port(name, width) do
    shape = bytes(1, text(2, "n")) <> bytes(1, int(1, width))
    text(1, name) <> bytes(2, bytes(1, int(1, 1) <> bytes(2, shape)))
  end

  defp text(field, value), do: bytes(field, value)
  defp bytes(field, value), do: varint(field * 8 + 2) <> varint(byte_size(value)) <> value
  defp int(field, value), do: varint(field * 8) <> varint(value)

  defp varint(n) when n < 128, do: <<n>>
  defp varint(n), do: <<rem(n, 128) + 128>> <> varint(div(n, 128))
end
