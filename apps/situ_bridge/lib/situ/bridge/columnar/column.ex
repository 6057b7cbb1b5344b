defmodule Situ.Bridge.Columnar.Column do
  @moduledoc false
  # A column of a table to be written: its name, and the kind of its values. Also packs values, and unpacks bits, as
  # Parquet and Arrow do.

  @enforce_keys [:name, :kind]
  defstruct [:name, :kind, optional?: true]

  @type kind :: :time | :integer | :float | :boolean | :text | :bytes
  @typedoc "A struct lists its members in the order of their values."
  @type nested_kind :: kind() | {:list, nested_kind()} | {:struct, [{String.t(), nested_kind()}]}
  @type t :: %__MODULE__{name: String.t(), kind: nested_kind(), optional?: boolean()}
  @typedoc """
  `nil` is a missing value. `{:bytes, bytes, n}` holds `n` packed numbers (or booleans, one byte each), none missing.
  """
  @type values :: [term()] | {:bytes, binary(), pos_integer()}

  @special_floats %{
    nan: <<0, 0, 0, 0, 0, 0, 0xF8, 0x7F>>,
    infinity: <<0, 0, 0, 0, 0, 0, 0xF0, 0x7F>>,
    neg_infinity: <<0, 0, 0, 0, 0, 0, 0xF0, 0xFF>>
  }

  @doc "Packs numbers into 8 bytes each, and booleans into one bit each, starting with the lowest bit of a byte."
  @spec pack_values(kind(), [term()]) :: iodata()
  def pack_values(kind, values) when kind in [:time, :integer],
    do: for(n <- values, into: <<>>, do: <<n::little-signed-64>>)

  def pack_values(:float, values) do
    for x <- values,
        into: <<>>,
        do: if(is_number(x), do: <<x::little-float-64>>, else: @special_floats[x])
  end

  def pack_values(:boolean, values),
    do: pack_bits(for(b <- values, into: <<>>, do: if(b, do: <<1::1>>, else: <<0::1>>)))

  @doc "Packs values that are already bytes; see `t:values/0`."
  @spec pack_bytes(kind(), binary()) :: iodata()
  def pack_bytes(:boolean, bytes), do: pack_bits(for(<<b <- bytes>>, into: <<>>, do: <<b::1>>))
  def pack_bytes(_number, bytes), do: bytes

  @doc "Returns one bit for each value: 1 if it is present."
  @spec presence_bits([term()]) :: iodata()
  def presence_bits(values),
    do: pack_bits(for(v <- values, into: <<>>, do: if(v == nil, do: <<0::1>>, else: <<1::1>>)))

  @doc "Packs bits into bytes, starting with the lowest bit, and pads them with zeros."
  @spec pack_bits(bitstring()) :: iodata()
  def pack_bits(<<a::1, b::1, c::1, d::1, e::1, f::1, g::1, h::1, rest::bitstring>>),
    do: [<<h::1, g::1, f::1, e::1, d::1, c::1, b::1, a::1>> | pack_bits(rest)]

  def pack_bits(<<>>), do: []

  def pack_bits(last_bits),
    do: pack_bits(<<last_bits::bitstring, 0::size(8 - bit_size(last_bits))>>)

  @doc "Unpacks bits as booleans, starting with the lowest bit of a byte."
  @spec unpack_bits(binary()) :: [boolean()]
  def unpack_bits(bytes) do
    for <<a::1, b::1, c::1, d::1, e::1, f::1, g::1, h::1 <- bytes>>,
        bit <- [h, g, f, e, d, c, b, a],
        do: bit == 1
  end
end
