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
  import Situ.BinarySize, only: [pinned_size: 1]
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
      for(node <- Keyword.fetch!(parts, :nodes), do: bytes_field(1, encode_node(node))),
      text_field(2, "situ"),
      for(
        {name, tensor} <- Keyword.get(parts, :constants, %{}),
        do: bytes_field(5, encode_constant(name, tensor))
      ),
      for(port <- Keyword.fetch!(parts, :inputs), do: bytes_field(11, encode_port(port))),
      for(port <- Keyword.fetch!(parts, :outputs), do: bytes_field(12, encode_port(port)))
    ]

    IO.iodata_to_binary([
      int_field(1, @ir_version),
      bytes_field(7, graph),
      bytes_field(8, [text_field(1, ""), int_field(2, @opset)])
    ])
  end

  @doc """
  Returns the metadata of a file, a map of strings. It is empty if the bytes are not an ONNX file.

      iex> Situ.Infer.Onnx.parse_metadata(<<0x72, 8, 0x0A, 1, "a", 0x12, 3, "b", 0>>)
      %{}
      iex> Situ.Infer.Onnx.parse_metadata(<<0x72, 7, 0x0A, 1, "a", 0x12, 2, "bc">>)
      %{"a" => "bc"}
  """
  @spec parse_metadata(binary()) :: %{String.t() => String.t()}
  def parse_metadata(bytes) do
    for {14, entry} <- parse_fields(bytes, []), into: %{} do
      entry = Map.new(parse_fields(entry, []))
      {Map.get(entry, 1, ""), Map.get(entry, 2, "")}
    end
  end

  # Returns the fields of a message that are bytes, or none if the message is malformed.
  defp parse_fields(<<>>, fields), do: fields

  defp parse_fields(bytes, fields) do
    with {key, rest} <- parse_varint(bytes, 0, 0),
         {value, rest} <- parse_value(Bitwise.band(key, 7), rest) do
      parse_fields(
        rest,
        if(is_binary(value), do: [{Bitwise.bsr(key, 3), value} | fields], else: fields)
      )
    else
      :error -> []
    end
  end

  defp parse_value(0, bytes), do: parse_varint(bytes, 0, 0)
  defp parse_value(1, <<_::64, rest::binary>>), do: {nil, rest}
  defp parse_value(5, <<_::32, rest::binary>>), do: {nil, rest}

  defp parse_value(2, bytes) do
    with {size, rest} <- parse_varint(bytes, 0, 0) do
      case rest do
        <<value::binary-pinned_size(size), rest::binary>> -> {value, rest}
        _ -> :error
      end
    end
  end

  defp parse_value(_kind, _bytes), do: :error

  defp parse_varint(<<1::1, n::7, rest::binary>>, shift, sum) when shift < 63,
    do: parse_varint(rest, shift + 7, sum + Bitwise.bsl(n, shift))

  defp parse_varint(<<0::1, n::7, rest::binary>>, shift, sum),
    do: {sum + Bitwise.bsl(n, shift), rest}

  defp parse_varint(_, _, _), do: :error

  defp encode_node({operator, inputs, outputs, attributes}) do
    [
      Enum.map(inputs, &text_field(1, &1)),
      Enum.map(outputs, &text_field(2, &1)),
      text_field(4, operator),
      for(
        {name, value} <- attributes,
        do: bytes_field(5, [text_field(1, to_string(name)) | encode_attribute(value)])
      )
    ]
  end

  # Encodes the value's field, and the field for the type of the value.
  defp encode_attribute(value) when is_float(value),
    do: [[field_key(2, 5), <<value::float-little-32>>], int_field(20, 1)]

  defp encode_attribute(value) when is_integer(value), do: [int_field(3, value), int_field(20, 2)]
  defp encode_attribute(value) when is_binary(value), do: [text_field(4, value), int_field(20, 3)]

  defp encode_attribute(values) when is_list(values),
    do: [Enum.map(values, &int_field(8, &1)), int_field(20, 7)]

  defp encode_constant(name, %Tensor{} = tensor),
    do: [encode_header(name, tensor), bytes_field(9, tensor.data)]

  defp encode_constant(name, {:external, file, offset, tensor}) do
    entries = [location: file, offset: offset, length: byte_size(tensor.data)]

    entries =
      for {key, value} <- entries,
          do: bytes_field(13, [text_field(1, to_string(key)), text_field(2, to_string(value))])

    [encode_header(name, tensor), entries, int_field(14, 1)]
  end

  defp encode_header(name, tensor) do
    dims = tensor.shape |> Tuple.to_list() |> Enum.map(&int_field(1, &1))
    [dims, int_field(2, Map.fetch!(@types, tensor.type)), text_field(8, name)]
  end

  defp encode_port({name, type, shape}) do
    dims =
      for {size, i} <- shape |> Tuple.to_list() |> Enum.with_index() do
        bytes_field(1, if(size, do: int_field(1, size), else: text_field(2, "#{name}_#{i}")))
      end

    [
      text_field(1, name),
      bytes_field(
        2,
        bytes_field(1, [int_field(1, Map.fetch!(@types, type)), bytes_field(2, dims)])
      )
    ]
  end

  # In Protocol Buffers a field is its number and wire type, followed by its value.
  defp text_field(field, value), do: bytes_field(field, value)

  defp bytes_field(field, value),
    do: [field_key(field, 2), encode_varint(IO.iodata_length(value)), value]

  defp int_field(field, value), do: [field_key(field, 0), encode_varint(value)]
  defp field_key(field, kind), do: encode_varint(field * 8 + kind)

  defp encode_varint(n) when n < 0, do: encode_varint(n + 0x1_0000_0000_0000_0000)
  defp encode_varint(n) when n < 128, do: <<n>>
  defp encode_varint(n), do: <<1::1, n::7, encode_varint(div(n, 128))::binary>>
end
