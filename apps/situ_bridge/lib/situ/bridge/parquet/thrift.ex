defmodule Situ.Bridge.Parquet.Thrift do
  @moduledoc false
  # Thrift's compact protocol (thrift-compact-protocol.md in https://github.com/apache/thrift), limited to the types
  # that Parquet uses. Pure.
  #
  # Encodes `{:i32 | :i64, n}`, `{:bool, b}`, `{:binary, bytes}`, `{:list, [value]}` and `{:struct, [{id, value}]}`,
  # whose fields are in the order of their ids. Decodes numbers, booleans, binaries, lists, and structs as maps by
  # field id.
  import Situ.BinarySize, only: [pinned_size: 1]
  import Bitwise

  @types %{i32: 5, i64: 6, binary: 8, list: 9, struct: 12}
  @max_depth 32

  @doc "Encodes a struct."
  @spec encode_struct({:struct, [{pos_integer(), term()}]}) :: iodata()
  def encode_struct({:struct, fields}) do
    {parts, _} =
      Enum.map_reduce(fields, 0, fn {id, value}, last ->
        {[field_header(id - last, value), encode_value(value)], id}
      end)

    [parts, 0]
  end

  defp field_header(delta, {:bool, value}), do: <<delta::4, if(value, do: 1, else: 2)::4>>
  defp field_header(delta, {type, _}), do: <<delta::4, @types[type]::4>>

  defp encode_value({:bool, _}), do: []
  defp encode_value({int, n}) when int in [:i32, :i64], do: encode_varint(encode_zigzag(n))
  defp encode_value({:binary, bytes}), do: [encode_varint(byte_size(bytes)), bytes]
  defp encode_value({:struct, _} = struct), do: encode_struct(struct)

  defp encode_value({:list, [{type, _} | _] = list}) do
    n = length(list)

    head =
      if n < 15,
        do: <<n::4, @types[type]::4>>,
        else: [<<15::4, @types[type]::4>>, encode_varint(n)]

    [head | Enum.map(list, &encode_value/1)]
  end

  defp encode_value({:list, []}), do: <<0::4, 12::4>>

  defp encode_zigzag(n), do: bxor(n <<< 1, n >>> 63) &&& 0xFFFFFFFFFFFFFFFF

  @doc "Encodes a number with seven bits per byte, the lowest bits first."
  @spec encode_varint(non_neg_integer()) :: iodata()
  def encode_varint(n) when n < 128, do: <<n>>
  def encode_varint(n), do: [<<1::1, n::7>>, encode_varint(n >>> 7)]

  @doc "Decodes the struct at the start of `bytes`; also returns the remaining bytes. Throws `{:not_parquet, why}`."
  @spec decode_struct(binary()) :: {map(), binary()}
  def decode_struct(bytes), do: decode_fields(bytes, 0, %{}, 0)

  defp decode_fields(_bytes, _last, _acc, depth) when depth > @max_depth,
    do: throw_malformed("it is nested too deeply")

  defp decode_fields(<<0, rest::binary>>, _last, acc, _depth), do: {acc, rest}

  defp decode_fields(<<0::4, type::4, rest::binary>>, _last, acc, depth) do
    {id, rest} = decode_zigzag(rest)
    decode_field(id, type, rest, acc, depth)
  end

  defp decode_fields(<<delta::4, type::4, rest::binary>>, last, acc, depth),
    do: decode_field(last + delta, type, rest, acc, depth)

  defp decode_fields("", _last, _acc, _depth), do: throw_malformed("it is truncated")

  defp decode_field(id, type, rest, acc, depth) do
    {value, rest} = decode_value(type, rest, depth)
    decode_fields(rest, id, Map.put(acc, id, value), depth)
  end

  defp decode_value(1, rest, _), do: {true, rest}
  defp decode_value(2, rest, _), do: {false, rest}
  defp decode_value(3, <<n::signed, rest::binary>>, _), do: {n, rest}
  defp decode_value(type, rest, _) when type in [4, 5, 6], do: decode_zigzag(rest)
  defp decode_value(7, <<x::little-float-64, rest::binary>>, _), do: {x, rest}
  defp decode_value(7, <<_::64, rest::binary>>, _), do: {nil, rest}

  defp decode_value(8, rest, _) do
    {n, rest} = decode_varint(rest)

    case rest do
      <<bytes::binary-pinned_size(n), rest::binary>> -> {bytes, rest}
      _ -> throw_malformed("it is truncated")
    end
  end

  defp decode_value(type, <<head, rest::binary>>, depth) when type in [9, 10] do
    {n, rest} = if head >>> 4 == 15, do: decode_varint(rest), else: {head >>> 4, rest}
    # Every element takes at least one byte.
    if n > byte_size(rest),
      do: throw_malformed("a list of #{n} elements in #{byte_size(rest)} bytes")

    decode_elements(n, head &&& 15, rest, depth, [])
  end

  defp decode_value(12, rest, depth), do: decode_fields(rest, 0, %{}, depth + 1)
  defp decode_value(_type, _rest, _depth), do: throw_malformed("a value of an unknown type")

  defp decode_elements(0, _type, rest, _depth, acc), do: {Enum.reverse(acc), rest}

  defp decode_elements(n, type, <<bool, rest::binary>>, depth, acc) when type in [1, 2],
    do: decode_elements(n - 1, type, rest, depth, [bool == 1 | acc])

  defp decode_elements(n, type, rest, depth, acc) do
    {value, rest} = decode_value(type, rest, depth)
    decode_elements(n - 1, type, rest, depth, [value | acc])
  end

  defp decode_zigzag(bytes) do
    {n, rest} = decode_varint(bytes)
    {bxor(n >>> 1, -(n &&& 1)), rest}
  end

  @doc "Decodes a number encoded by `encode_varint/1`; also returns the remaining bytes."
  def decode_varint(bytes), do: decode_varint(bytes, 0, 0)
  defp decode_varint(<<0::1, n::7, rest::binary>>, shift, sum), do: {sum + (n <<< shift), rest}

  defp decode_varint(<<1::1, n::7, rest::binary>>, shift, sum) when shift < 63,
    do: decode_varint(rest, shift + 7, sum + (n <<< shift))

  defp decode_varint(_, _, _), do: throw_malformed("a variable-length number is malformed")

  defp throw_malformed(why), do: throw({:not_parquet, why})
end
