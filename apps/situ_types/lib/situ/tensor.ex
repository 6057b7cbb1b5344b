defmodule Situ.Tensor do
  @moduledoc """
  A tensor: a binary of numbers with its element type and shape.

  Elements are in row-major order (the last dimension varies fastest) and native byte order. ONNX Runtime and Nx use
  the same layout, so no copy is needed. `shape` is a tuple of dimensions; `{}` is a scalar.

      iex> t = Situ.Tensor.from_list([1.0, 2.0, 3.0, 4.0], :f32, {2, 2})
      iex> Situ.Tensor.to_list(t)
      [1.0, 2.0, 3.0, 4.0]
      iex> Situ.Tensor.reshape(t, {4}).shape
      {4}

  If the host application has the `nx` package, `to_nx/1` and `from_nx/1` convert tensors without copying.
  """
  @behaviour Situ.Codec

  # Nx is only available if the host application depends on it.
  @compile {:no_warn_undefined, [Nx]}

  # The index of a type is written to files, so new types must be appended.
  @types [:f32, :f64, :s8, :s16, :s32, :s64, :u8, :u16, :u32, :u64, :bool, :f16, :bf16]
  @sizes %{f32: 4, f64: 8, s8: 1, s16: 2, s32: 4, s64: 8, u8: 1, u16: 2, u32: 4, u64: 8, bool: 1}
         |> Map.merge(%{f16: 2, bf16: 2})

  @enforce_keys [:type, :shape, :data]
  defstruct [:type, :shape, :data]

  @type element_type ::
          :f32 | :f64 | :s8 | :s16 | :s32 | :s64 | :u8 | :u16 | :u32 | :u64 | :bool | :f16 | :bf16
  @type t :: %__MODULE__{type: element_type(), shape: tuple(), data: binary()}

  @doc """
  Builds a tensor from `data`; raises `ArgumentError` if the size of `data` does not match `shape` and `type`.

      iex> Situ.Tensor.new(<<0::64>>, :f32, {3})
      ** (ArgumentError) 8 bytes do not match a tensor of {3} f32, which takes 12
  """
  @spec new(binary(), element_type(), tuple()) :: t()
  def new(data, type, shape) when is_binary(data) and type in @types and is_tuple(shape) do
    wanted = element_count(shape) * Map.fetch!(@sizes, type)

    if byte_size(data) != wanted do
      raise ArgumentError,
            "#{byte_size(data)} bytes do not match a tensor of #{inspect(shape)} #{type}, which takes #{wanted}"
    end

    %__MODULE__{type: type, shape: shape, data: data}
  end

  @doc "Builds a tensor of zeros."
  @spec zeros(element_type(), tuple()) :: t()
  def zeros(type, shape) do
    new(:binary.copy(<<0>>, element_count(shape) * Map.fetch!(@sizes, type)), type, shape)
  end

  @doc """
  Builds a tensor from numbers (or booleans, for `:bool`) in row-major order.

      iex> Situ.Tensor.from_list([16_000], :s64, {}).data
      <<16_000::64-native>>
  """
  @spec from_list([number() | boolean()], element_type(), tuple()) :: t()
  def from_list(list, type, shape) when is_list(list) do
    new(IO.iodata_to_binary(Enum.map(list, &encode_element(&1, type))), type, shape)
  end

  @doc """
  Returns the elements in row-major order.

      iex> [true, false] |> Situ.Tensor.from_list(:bool, {2}) |> Situ.Tensor.to_list()
      [true, false]
  """
  @spec to_list(t()) :: [number() | boolean()]
  def to_list(%__MODULE__{type: type, data: data}), do: decode_elements(data, type)

  @doc "Returns a tensor with the same elements and another shape, which must have the same number of elements."
  @spec reshape(t(), tuple()) :: t()
  def reshape(%__MODULE__{} = t, shape), do: new(t.data, t.type, shape)

  @doc """
  Returns the number of elements in a tensor of this shape.

      iex> Situ.Tensor.element_count({2, 3, 4})
      24
  """
  @spec element_count(tuple()) :: non_neg_integer()
  def element_count(shape), do: shape |> Tuple.to_list() |> Enum.product()

  @doc """
  Concatenates tensors of the same type along the first dimension; the other dimensions must be equal.

      iex> a = Situ.Tensor.from_list([1, 2], :s8, {1, 2})
      iex> Situ.Tensor.concat([a, a]).shape
      {2, 2}
  """
  @spec concat([t(), ...]) :: t()
  def concat([first | _] = tensors) do
    rest = Tuple.delete_at(first.shape, 0)

    unless Enum.all?(tensors, &(&1.type == first.type and Tuple.delete_at(&1.shape, 0) == rest)) do
      raise ArgumentError,
            "tensors must have the same type and inner shape to be concatenated: " <>
              Enum.map_join(tensors, ", ", &"#{&1.type} #{inspect(&1.shape)}")
    end

    rows = tensors |> Enum.map(&elem(&1.shape, 0)) |> Enum.sum()
    data = IO.iodata_to_binary(Enum.map(tensors, & &1.data))
    new(data, first.type, Tuple.insert_at(rest, 0, rows))
  end

  @doc """
  Splits the tensor along the first dimension into tensors of `sizes` rows each. The parts share memory with the
  tensor.

      iex> Situ.Tensor.from_list([1, 2, 3], :s8, {3}) |> Situ.Tensor.split_rows([2, 1]) |> Enum.map(& &1.shape)
      [{2}, {1}]
  """
  @spec split_rows(t(), [pos_integer()]) :: [t()]
  def split_rows(%__MODULE__{} = t, sizes) do
    rows = elem(t.shape, 0)

    unless Enum.sum(sizes) == rows do
      raise ArgumentError, "the sizes #{inspect(sizes)} do not add up to #{rows} rows"
    end

    bytes = div(byte_size(t.data), max(rows, 1))
    inner = Tuple.delete_at(t.shape, 0)

    {parts, _} =
      Enum.map_reduce(sizes, 0, fn n, at ->
        part = binary_part(t.data, at * bytes, n * bytes)
        {new(part, t.type, Tuple.insert_at(inner, 0, n)), at + n}
      end)

    parts
  end

  @doc """
  Converts to an `Nx.Tensor` without copying. Raises `ArgumentError` if the `nx` package is missing or if the tensor
  has no elements, which Nx does not support.
  """
  @spec to_nx(t()) :: struct()
  def to_nx(%__MODULE__{data: <<>>} = t),
    do: raise(ArgumentError, "Nx has no tensors without elements: #{inspect(t.shape)}")

  def to_nx(%__MODULE__{} = t) do
    nx = require_nx!()
    nx.from_binary(t.data, nx_type(t.type)) |> nx.reshape(t.shape)
  end

  @doc "Converts an `Nx.Tensor` to a tensor."
  @spec from_nx(struct()) :: t()
  def from_nx(tensor) do
    nx = require_nx!()
    {kind, bits} = nx.type(tensor)
    new(nx.to_binary(tensor), element_type!(kind, bits), nx.shape(tensor))
  end

  # Nx has no boolean type and represents booleans as bytes.
  defp nx_type(:bool), do: :u8
  defp nx_type(type), do: type

  defp element_type!(kind, bits) do
    Enum.find(@types, &(Atom.to_string(&1) == "#{kind}#{bits}")) ||
      raise ArgumentError, "unsupported element type #{kind}#{bits}; types: #{inspect(@types)}"
  end

  defp require_nx! do
    if Code.ensure_loaded?(Nx) do
      Nx
    else
      raise ArgumentError, "the conversion needs the nx package in your application"
    end
  end

  @impl Situ.Codec
  def codec_name, do: "situ.tensor"

  @impl Situ.Codec
  def encode(%__MODULE__{} = t) do
    dims = for d <- Tuple.to_list(t.shape), into: <<>>, do: <<d::32-little>>
    type = Enum.find_index(@types, &(&1 == t.type))
    [<<type, tuple_size(t.shape)>>, dims, t.data]
  end

  @impl Situ.Codec
  def decode(<<type, rank, dims::binary-size(rank)-unit(32), data::binary>>)
      when type < length(@types) do
    shape = List.to_tuple(for <<d::32-little <- dims>>, do: d)
    type = Enum.at(@types, type)

    if byte_size(data) == element_count(shape) * Map.fetch!(@sizes, type),
      do: {:ok, %__MODULE__{type: type, shape: shape, data: data}},
      else: {:error, :bad_tensor}
  end

  def decode(_), do: {:error, :bad_tensor}

  defp encode_element(true, :bool), do: <<1>>
  defp encode_element(false, :bool), do: <<0>>
  defp encode_element(x, :f16), do: <<x::float-native-16>>

  # A bfloat16 is the upper half of a 32-bit float, rounded to nearest, ties to even.
  defp encode_element(x, :bf16) do
    <<bits::32>> = <<x::float-32>>
    even = Bitwise.band(Bitwise.bsr(bits, 16), 1)
    <<Bitwise.bsr(bits + 0x7FFF + even, 16)::native-16>>
  end

  defp encode_element(x, :f32), do: <<x::float-native-32>>
  defp encode_element(x, :f64), do: <<x::float-native-64>>
  defp encode_element(x, :s8), do: <<x::signed-8>>
  defp encode_element(x, :u8), do: <<x::8>>
  defp encode_element(x, type) when type in [:s16, :u16], do: <<x::native-16>>
  defp encode_element(x, type) when type in [:s32, :u32], do: <<x::native-32>>
  defp encode_element(x, type) when type in [:s64, :u64], do: <<x::native-64>>

  # Erlang floats cannot hold NaN or infinities, so they are decoded as atoms.
  defp decode_elements(data, :f32), do: for(<<bits::binary-4 <- data>>, do: decode_f32(bits))
  defp decode_elements(data, :f64), do: for(<<bits::binary-8 <- data>>, do: decode_f64(bits))
  defp decode_elements(data, :f16), do: for(<<bits::binary-2 <- data>>, do: decode_f16(bits))

  defp decode_elements(data, :bf16) do
    for <<bits::native-16 <- data>>, do: decode_f32(<<Bitwise.bsl(bits, 16)::native-32>>)
  end

  defp decode_elements(data, :s8), do: for(<<x::signed-8 <- data>>, do: x)
  defp decode_elements(data, :u8), do: for(<<x::8 <- data>>, do: x)
  defp decode_elements(data, :s16), do: for(<<x::signed-native-16 <- data>>, do: x)
  defp decode_elements(data, :u16), do: for(<<x::native-16 <- data>>, do: x)
  defp decode_elements(data, :s32), do: for(<<x::signed-native-32 <- data>>, do: x)
  defp decode_elements(data, :u32), do: for(<<x::native-32 <- data>>, do: x)
  defp decode_elements(data, :s64), do: for(<<x::signed-native-64 <- data>>, do: x)
  defp decode_elements(data, :u64), do: for(<<x::native-64 <- data>>, do: x)
  defp decode_elements(data, :bool), do: for(<<x::8 <- data>>, do: x != 0)

  defp decode_f16(<<x::float-native-16>>), do: x
  defp decode_f16(<<bits::native-16>>), do: Situ.Number.decode_float(<<bits::little-16>>)

  defp decode_f32(<<x::float-native-32>>), do: x
  defp decode_f32(<<bits::native-32>>), do: Situ.Number.decode_float(<<bits::little-32>>)

  defp decode_f64(<<x::float-native-64>>), do: x
  defp decode_f64(<<bits::native-64>>), do: Situ.Number.decode_float(<<bits::little-64>>)

  defimpl Inspect do
    def inspect(%{data: data} = tensor, _opts) when is_binary(data),
      do: "#Situ.Tensor<#{tensor.type} #{Kernel.inspect(tensor.shape)}, #{byte_size(data)} B>"

    def inspect(_tensor, _opts), do: "#Situ.Tensor<invalid>"
  end
end
