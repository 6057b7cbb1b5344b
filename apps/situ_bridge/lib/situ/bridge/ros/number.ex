defmodule Situ.Bridge.Ros.Number do
  @moduledoc false
  # Decodes and encodes numbers of fixed size in either byte order. Float values that Elixir does not have are `:nan`,
  # `:infinity` and `:neg_infinity`.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.Number

  @sizes %{
    bool: 1,
    int8: 1,
    uint8: 1,
    int16: 2,
    uint16: 2,
    int32: 4,
    uint32: 4,
    float32: 4,
    int64: 8,
    uint64: 8,
    float64: 8
  }

  @type kind :: atom()
  @type order :: :little | :big

  @doc "Returns the size of a number in bytes, or nil for other types."
  @spec number_size(term()) :: 1 | 2 | 4 | 8 | nil
  def number_size(kind), do: Map.get(@sizes, kind)

  @doc "Decodes the number in `bytes`, whose size must be `number_size/1`."
  @spec decode(kind(), binary(), order()) :: term()
  def decode(kind, bytes, :big), do: decode(kind, reverse_bytes(bytes), :little)
  def decode(:bool, <<b>>, _), do: b != 0
  def decode(:int8, <<n::signed-8>>, _), do: n
  def decode(:uint8, <<n>>, _), do: n
  def decode(:int16, <<n::little-signed-16>>, _), do: n
  def decode(:uint16, <<n::little-16>>, _), do: n
  def decode(:int32, <<n::little-signed-32>>, _), do: n
  def decode(:uint32, <<n::little-32>>, _), do: n
  def decode(:int64, <<n::little-signed-64>>, _), do: n
  def decode(:uint64, <<n::little-64>>, _), do: n
  def decode(kind, bytes, _) when kind in [:float32, :float64], do: Number.decode_float(bytes)

  defp reverse_bytes(bytes),
    do: bytes |> :binary.bin_to_list() |> Enum.reverse() |> :binary.list_to_bin()

  @doc "Decodes all numbers in `bytes`. Lists of 8-bit integers are returned as a binary."
  @spec decode_all(kind(), binary(), order()) :: [term()] | binary()
  def decode_all(kind, bytes, _) when kind in [:uint8, :int8], do: :binary.copy(bytes)

  def decode_all(kind, bytes, :little) when kind in [:float32, :float64],
    do: Number.decode_floats(bytes, number_size(kind))

  def decode_all(:int32, bytes, :little), do: for(<<n::little-signed-32 <- bytes>>, do: n)
  def decode_all(:uint16, bytes, :little), do: for(<<n::little-16 <- bytes>>, do: n)

  def decode_all(kind, bytes, order) do
    size = number_size(kind)
    for <<one::binary-pinned_size(size) <- bytes>>, do: decode(kind, one, order)
  end

  @doc "Encodes a number in little-endian order. Throws `{:not_writable, value}` if the value is out of range."
  @spec encode(kind(), term()) :: binary()
  def encode(:bool, b) when is_boolean(b), do: <<if(b, do: 1, else: 0)>>

  def encode(kind, b) when is_boolean(b) and kind in [:uint8, :int8],
    do: encode(kind, if(b, do: 1, else: 0))

  def encode(:bool, n) when n in [0, 1], do: <<n>>
  def encode(:int8, n) when n in -0x80..0xFF, do: <<n::8>>
  def encode(:uint8, n) when n in 0..0xFF, do: <<n>>
  def encode(:int16, n) when n in -0x8000..0x7FFF, do: <<n::little-16>>
  def encode(:uint16, n) when n in 0..0xFFFF, do: <<n::little-16>>
  def encode(:int32, n) when n in -0x8000_0000..0x7FFF_FFFF, do: <<n::little-32>>
  def encode(:uint32, n) when n in 0..0xFFFF_FFFF, do: <<n::little-32>>

  def encode(:int64, n) when n in -0x8000_0000_0000_0000..0x7FFF_FFFF_FFFF_FFFF,
    do: <<n::little-64>>

  def encode(:uint64, n) when n in 0..0xFFFF_FFFF_FFFF_FFFF, do: <<n::little-64>>

  def encode(:float32, x) when is_number(x) and abs(x) <= 3.4028234663852886e38,
    do: <<x::little-float-32>>

  def encode(:float32, x) when is_number(x),
    do: encode(:float32, if(x > 0, do: :infinity, else: :neg_infinity))

  def encode(:float64, x) when is_number(x), do: <<x::little-float-64>>
  def encode(:float32, :nan), do: <<0x7FC00000::little-32>>
  def encode(:float32, :infinity), do: <<0x7F800000::little-32>>
  def encode(:float32, :neg_infinity), do: <<0xFF800000::little-32>>
  def encode(:float64, :nan), do: <<0x7FF8000000000000::little-64>>
  def encode(:float64, :infinity), do: <<0x7FF0000000000000::little-64>>
  def encode(:float64, :neg_infinity), do: <<0xFFF0000000000000::little-64>>
  def encode(_kind, value), do: throw({:not_writable, value})
end
