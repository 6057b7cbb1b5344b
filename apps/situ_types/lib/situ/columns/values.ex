defmodule Situ.Columns.Values do
  @moduledoc false
  # The values of columns as bytes: eight bytes each (little-endian), or one byte for a boolean.
  alias Situ.Columns

  @least -0x8000000000000000
  @most 0x7FFFFFFFFFFFFFFF

  @doc "Returns the kind of a value, or the value if it is of none."
  @spec value_kind(term()) :: {:ok, Columns.kind()} | {:error, term()}
  def value_kind(value) when is_integer(value), do: {:ok, :integer}
  def value_kind(value) when is_float(value), do: {:ok, :float}
  def value_kind(value) when is_boolean(value), do: {:ok, :boolean}
  def value_kind(value), do: {:error, value}

  @doc "Packs values of one kind, or returns the first value that is not of this kind."
  @spec pack_values(Columns.kind(), [term()]) :: {:ok, binary()} | {:error, term()}
  def pack_values(:integer, values), do: pack_integers(values, <<>>)
  def pack_values(:float, values), do: pack_floats(values, <<>>)
  def pack_values(:boolean, values), do: pack_booleans(values, <<>>)

  defp pack_integers([n | rest], bytes) when is_integer(n) and n >= @least and n <= @most,
    do: pack_integers(rest, <<bytes::binary, n::little-signed-64>>)

  defp pack_integers(rest, bytes), do: finish_packing(rest, bytes)

  defp pack_floats([x | rest], bytes) when is_float(x),
    do: pack_floats(rest, <<bytes::binary, x::little-float-64>>)

  defp pack_floats(rest, bytes), do: finish_packing(rest, bytes)

  defp pack_booleans([b | rest], bytes) when is_boolean(b),
    do: pack_booleans(rest, <<bytes::binary, if(b, do: 1, else: 0)>>)

  defp pack_booleans(rest, bytes), do: finish_packing(rest, bytes)

  defp finish_packing([], bytes), do: {:ok, bytes}
  defp finish_packing([value | _rest], _bytes), do: {:error, value}

  @doc "Returns how many bytes a value takes."
  @spec value_width(Columns.kind()) :: 1 | 8
  def value_width(:boolean), do: 1
  def value_width(_kind), do: 8

  @doc "Returns whether all floats are finite, and all booleans 0 or 1."
  @spec valid_values?(Columns.kind(), binary()) :: boolean()
  def valid_values?(:float, bytes), do: all_finite?(bytes)
  def valid_values?(:boolean, bytes), do: for(<<b <- bytes>>, b > 1, do: b) == []
  def valid_values?(:integer, _bytes), do: true

  # The exponent of a float that is not finite is all ones.
  defp all_finite?(<<_::48, end_bits::little-16, rest::binary>>),
    do: Bitwise.band(end_bits, 0x7FF0) != 0x7FF0 and all_finite?(rest)

  defp all_finite?(<<>>), do: true

  @doc "Returns the values as a list. All of them must be valid."
  @spec unpack_values(Columns.kind(), binary()) :: [Columns.value()]
  def unpack_values(:integer, bytes), do: for(<<n::little-signed-64 <- bytes>>, do: n)
  def unpack_values(:float, bytes), do: for(<<x::little-float-64 <- bytes>>, do: x)
  def unpack_values(:boolean, bytes), do: for(<<b <- bytes>>, do: b == 1)
end
