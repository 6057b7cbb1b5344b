defmodule Situ.Infer.Onnx do
  @moduledoc """
  Writes small ONNX files: graphs of operators over named tensors. They are used for tests, and for pre- and
  post-processing that is best done by the same library as the network.

      iex> bytes = Situ.Infer.Onnx.encode(
      ...>   inputs: [{"x", :f32, {nil, 2}}],
      ...>   outputs: [{"y", :f32, {nil, 2}}],
      ...>   constants: %{"two" => Situ.Tensor.from_list([2.0], :f32, {1})},
      ...>   nodes: [{"Mul", ["x", "two"], ["y"], []}]
      ...> )
      iex> {:ok, model} = Situ.Infer.Model.from_bytes(bytes, "doubling")
      iex> {:ok, %{"y" => y}} = Situ.Infer.Model.run(model, %{"x" => Situ.Tensor.from_list([1.0, 3.0], :f32, {1, 2})})
      iex> Situ.Tensor.to_list(y)
      [2.0, 6.0]

  A node is `{operator, inputs, outputs, attributes}`; an attribute is an integer, a float, a list of integers or a
  string. `nil` in a shape is a free size. The operators are from opset 13: <https://onnx.ai/onnx/operators/>. The
  graph is not checked here; the engine checks the bytes when it loads them.
  """
  import Situ.Bits, only: [known: 1]
  alias Situ.Tensor

  @ir_version 8
  @opset 13
  @types %{
    f32: 1,
    u8: 2,
    s8: 3,
    u16: 4,
    s16: 5,
    s32: 6,
    s64: 7,
    bool: 9,
    f16: 10,
    bf16: 16,
    text: 8,
    f64: 11,
    u32: 12,
    u64: 13
  }

  @type port_spec :: {String.t(), Tensor.element_type(), tuple()}
  @type attribute :: integer() | float() | [integer()] | String.t()
  @type operation :: {String.t(), [String.t()], [String.t()], keyword(attribute())}

  @type constant :: Tensor.t() | {:external, String.t(), non_neg_integer(), Tensor.t()}

  @doc """
  Returns the bytes of a file with `inputs:`, `outputs:`, `nodes:` and `constants:` (tensors by name).

  The data of a constant `{:external, file, offset, tensor}` is at that offset of `file`, next to the model file; the
  caller must write it.
  """
  @spec encode(keyword()) :: binary()
  def encode(parts) do
    graph = [
      for(node <- Keyword.fetch!(parts, :nodes), do: bytes(1, operation(node))),
      text(2, "situ"),
      for(
        {name, tensor} <- Keyword.get(parts, :constants, %{}),
        do: bytes(5, constant(name, tensor))
      ),
      for(port <- Keyword.fetch!(parts, :inputs), do: bytes(11, port(port))),
      for(port <- Keyword.fetch!(parts, :outputs), do: bytes(12, port(port)))
    ]

    IO.iodata_to_binary([
      int(1, @ir_version),
      bytes(7, graph),
      bytes(8, [text(1, ""), int(2, @opset)])
    ])
  end

  @doc """
  Returns the metadata of a file, a map of strings. It is empty if the bytes are not an ONNX file.

      iex> Situ.Infer.Onnx.metadata(<<0x72, 8, 0x0A, 1, "a", 0x12, 3, "b", 0>>)
      %{}
      iex> Situ.Infer.Onnx.metadata(<<0x72, 7, 0x0A, 1, "a", 0x12, 2, "bc">>)
      %{"a" => "bc"}
  """
  @spec metadata(binary()) :: %{String.t() => String.t()}
  def metadata(bytes) do
    for {14, entry} <- fields(bytes, []), into: %{} do
      entry = Map.new(fields(entry, []))
      {Map.get(entry, 1, ""), Map.get(entry, 2, "")}
    end
  end

  # Returns the fields of a message that are bytes, or none if the message is malformed.
  defp fields(<<>>, found), do: found

  defp fields(bytes, found) do
    with {key, rest} <- unvarint(bytes, 0, 0),
         {value, rest} <- value(Bitwise.band(key, 7), rest) do
      fields(rest, if(is_binary(value), do: [{Bitwise.bsr(key, 3), value} | found], else: found))
    else
      :error -> []
    end
  end

  defp value(0, bytes), do: unvarint(bytes, 0, 0)
  defp value(1, <<_::64, rest::binary>>), do: {nil, rest}
  defp value(5, <<_::32, rest::binary>>), do: {nil, rest}

  defp value(2, bytes) do
    with {size, rest} <- unvarint(bytes, 0, 0) do
      case rest do
        <<value::binary-known(size), rest::binary>> -> {value, rest}
        _ -> :error
      end
    end
  end

  defp value(_kind, _bytes), do: :error

  defp unvarint(<<1::1, n::7, rest::binary>>, shift, sum) when shift < 63,
    do: unvarint(rest, shift + 7, sum + Bitwise.bsl(n, shift))

  defp unvarint(<<0::1, n::7, rest::binary>>, shift, sum),
    do: {sum + Bitwise.bsl(n, shift), rest}

  defp unvarint(_, _, _), do: :error

  defp operation({operator, inputs, outputs, attributes}) do
    [
      Enum.map(inputs, &text(1, &1)),
      Enum.map(outputs, &text(2, &1)),
      text(4, operator),
      for(
        {name, value} <- attributes,
        do: bytes(5, [text(1, to_string(name)) | attribute(value)])
      )
    ]
  end

  # Encodes the value's field, and the field for the type of the value.
  defp attribute(value) when is_float(value),
    do: [[key(2, 5), <<value::float-little-32>>], int(20, 1)]

  defp attribute(value) when is_integer(value), do: [int(3, value), int(20, 2)]
  defp attribute(value) when is_binary(value), do: [text(4, value), int(20, 3)]
  defp attribute(values) when is_list(values), do: [Enum.map(values, &int(8, &1)), int(20, 7)]

  defp constant(name, %Tensor{} = tensor),
    do: [encode_header(name, tensor), bytes(9, tensor.data)]

  defp constant(name, {:external, file, offset, tensor}) do
    entries = [location: file, offset: offset, length: byte_size(tensor.data)]

    entries =
      for {key, value} <- entries,
          do: bytes(13, [text(1, to_string(key)), text(2, to_string(value))])

    [encode_header(name, tensor), entries, int(14, 1)]
  end

  defp encode_header(name, tensor) do
    dims = tensor.shape |> Tuple.to_list() |> Enum.map(&int(1, &1))
    [dims, int(2, Map.fetch!(@types, tensor.type)), text(8, name)]
  end

  defp port({name, type, shape}) do
    dims =
      for {size, i} <- shape |> Tuple.to_list() |> Enum.with_index() do
        bytes(1, if(size, do: int(1, size), else: text(2, "#{name}_#{i}")))
      end

    [text(1, name), bytes(2, bytes(1, [int(1, Map.fetch!(@types, type)), bytes(2, dims)]))]
  end

  # In Protocol Buffers a field is its number and wire type, followed by its value.
  defp text(field, value), do: bytes(field, value)
  defp bytes(field, value), do: [key(field, 2), varint(IO.iodata_length(value)), value]
  defp int(field, value), do: [key(field, 0), varint(value)]
  defp key(field, kind), do: varint(field * 8 + kind)

  defp varint(n) when n < 0, do: varint(n + 0x1_0000_0000_0000_0000)
  defp varint(n) when n < 128, do: <<n>>
  defp varint(n), do: <<1::1, n::7, varint(div(n, 128))::binary>>
end
