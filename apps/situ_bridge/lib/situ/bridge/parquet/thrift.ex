defmodule Situ.Bridge.Parquet.Thrift do
  @moduledoc false
  # Thrift's compact protocol (thrift-compact-protocol.md in https://github.com/apache/thrift), limited to the types
  # that Parquet uses. Pure.
  #
  # Encodes `{:i32 | :i64, n}`, `{:bool, b}`, `{:binary, bytes}`, `{:list, [value]}` and `{:struct, [{id, value}]}`,
  # whose fields are in the order of their ids. Decodes numbers, booleans, binaries, lists, and structs as maps by
  # field id.
  import Situ.Bits, only: [known: 1]
  import Bitwise

  @types %{i32: 5, i64: 6, binary: 8, list: 9, struct: 12}
  @deepest 32

  @doc "Encodes a struct."
  @spec write({:struct, [{pos_integer(), term()}]}) :: iodata()
  def write({:struct, fields}) do
    {parts, _} =
      Enum.map_reduce(fields, 0, fn {id, value}, last ->
        {[field(id - last, value), body(value)], id}
      end)

    [parts, 0]
  end

  defp field(delta, {:bool, value}), do: <<delta::4, if(value, do: 1, else: 2)::4>>
  defp field(delta, {type, _}), do: <<delta::4, @types[type]::4>>

  defp body({:bool, _}), do: []
  defp body({int, n}) when int in [:i32, :i64], do: varint(zigzag(n))
  defp body({:binary, bytes}), do: [varint(byte_size(bytes)), bytes]
  defp body({:struct, _} = struct), do: write(struct)

  defp body({:list, [{type, _} | _] = list}) do
    n = length(list)
    head = if n < 15, do: <<n::4, @types[type]::4>>, else: [<<15::4, @types[type]::4>>, varint(n)]
    [head | Enum.map(list, &body/1)]
  end

  defp body({:list, []}), do: <<0::4, 12::4>>

  defp zigzag(n), do: bxor(n <<< 1, n >>> 63) &&& 0xFFFFFFFFFFFFFFFF

  @doc "Encodes a number with seven bits per byte, the lowest bits first."
  @spec varint(non_neg_integer()) :: iodata()
  def varint(n) when n < 128, do: <<n>>
  def varint(n), do: [<<1::1, n::7>>, varint(n >>> 7)]

  @doc "Decodes the struct at the start of `bytes`; also returns the remaining bytes. Throws `{:not_parquet, why}`."
  @spec read(binary()) :: {map(), binary()}
  def read(bytes), do: members(bytes, 0, %{}, 0)

  defp members(_bytes, _last, _found, depth) when depth > @deepest,
    do: fail("it is nested too deeply")

  defp members(<<0, rest::binary>>, _last, found, _depth), do: {found, rest}

  defp members(<<0::4, type::4, rest::binary>>, _last, found, depth) do
    {id, rest} = int(rest)
    member(id, type, rest, found, depth)
  end

  defp members(<<delta::4, type::4, rest::binary>>, last, found, depth),
    do: member(last + delta, type, rest, found, depth)

  defp members("", _last, _found, _depth), do: fail("it is truncated")

  defp member(id, type, rest, found, depth) do
    {value, rest} = value(type, rest, depth)
    members(rest, id, Map.put(found, id, value), depth)
  end

  defp value(1, rest, _), do: {true, rest}
  defp value(2, rest, _), do: {false, rest}
  defp value(3, <<n::signed, rest::binary>>, _), do: {n, rest}
  defp value(type, rest, _) when type in [4, 5, 6], do: int(rest)
  defp value(7, <<x::little-float-64, rest::binary>>, _), do: {x, rest}
  defp value(7, <<_::64, rest::binary>>, _), do: {nil, rest}

  defp value(8, rest, _) do
    {n, rest} = unsigned(rest)

    case rest do
      <<bytes::binary-known(n), rest::binary>> -> {bytes, rest}
      _ -> fail("it is truncated")
    end
  end

  defp value(type, <<head, rest::binary>>, depth) when type in [9, 10] do
    {n, rest} = if head >>> 4 == 15, do: unsigned(rest), else: {head >>> 4, rest}
    # Every element takes at least one byte.
    if n > byte_size(rest), do: fail("a list of #{n} elements in #{byte_size(rest)} bytes")
    elements(n, head &&& 15, rest, depth, [])
  end

  defp value(12, rest, depth), do: members(rest, 0, %{}, depth + 1)
  defp value(_type, _rest, _depth), do: fail("a value of an unknown type")

  defp elements(0, _type, rest, _depth, found), do: {Enum.reverse(found), rest}

  defp elements(n, type, <<bool, rest::binary>>, depth, found) when type in [1, 2],
    do: elements(n - 1, type, rest, depth, [bool == 1 | found])

  defp elements(n, type, rest, depth, found) do
    {value, rest} = value(type, rest, depth)
    elements(n - 1, type, rest, depth, [value | found])
  end

  defp int(bytes) do
    {n, rest} = unsigned(bytes)
    {bxor(n >>> 1, -(n &&& 1)), rest}
  end

  @doc "Decodes a number encoded by `varint/1`; also returns the remaining bytes."
  def unsigned(bytes), do: unsigned(bytes, 0, 0)
  defp unsigned(<<0::1, n::7, rest::binary>>, shift, sum), do: {sum + (n <<< shift), rest}

  defp unsigned(<<1::1, n::7, rest::binary>>, shift, sum) when shift < 63,
    do: unsigned(rest, shift + 7, sum + (n <<< shift))

  defp unsigned(_, _, _), do: fail("a variable-length number is malformed")

  defp fail(why), do: throw({:not_parquet, why})
end
