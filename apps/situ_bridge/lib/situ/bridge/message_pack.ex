defmodule Situ.Bridge.MessagePack do
  @moduledoc false
  # Encodes and decodes all of MessagePack (https://github.com/msgpack/msgpack/blob/master/spec.md).
  #
  # A valid UTF-8 string is encoded as a `str`, any other binary as a `bin`, and atoms (except `nil`, `true`,
  # `false`) as strings; `:nan`, `:infinity` and `:neg_infinity` are floats. Integers range from -2^63 to 2^64-1.
  # Extensions are `{:ext, type, bytes}`, and the timestamp extension is `{:timestamp, ns}`, in nanoseconds since
  # 1970. The entries of a map may be ordered: `{[{key, value}]}`. Decoding is bounded by the size of the input and
  # 512 levels of nesting, and creates no atoms.
  import Situ.BinarySize, only: [pinned_size: 1]

  @max_depth 512

  @doc """
  Encodes a term. Throws `{:not_writable, term}` for terms that MessagePack cannot represent.

      iex> alias Situ.Bridge.MessagePack
      iex> bytes = MessagePack.encode(%{"x" => [1, -2.5, nil, true]}) |> IO.iodata_to_binary()
      iex> MessagePack.decode(bytes)
      {:ok, %{"x" => [1, -2.5, nil, true]}, ""}
  """
  @spec encode(term()) :: iodata()
  def encode(nil), do: <<0xC0>>
  def encode(false), do: <<0xC2>>
  def encode(true), do: <<0xC3>>
  def encode(:nan), do: <<0xCB, 0x7FF8::16, 0::48>>
  def encode(:infinity), do: <<0xCB, 0x7FF0::16, 0::48>>
  def encode(:neg_infinity), do: <<0xCB, 0xFFF0::16, 0::48>>
  def encode(atom) when is_atom(atom), do: atom |> Atom.to_string() |> encode()
  def encode(x) when is_float(x), do: <<0xCB, x::float>>
  def encode(n) when is_integer(n), do: encode_integer(n)

  def encode(bytes) when is_binary(bytes),
    do: if(String.valid?(bytes), do: encode_string(bytes), else: encode_binary(bytes))

  def encode({pairs}) when is_list(pairs), do: encode_map(pairs)
  def encode({:timestamp, ns}) when is_integer(ns), do: encode_timestamp(ns)

  def encode({:ext, type, bytes}) when type in -128..127 and is_binary(bytes),
    do: [extension_header(byte_size(bytes)), <<type::signed-8>>, bytes]

  def encode(list) when is_list(list), do: [list_header(length(list)) | Enum.map(list, &encode/1)]
  def encode(map) when is_map(map) and not is_struct(map), do: map |> Enum.sort() |> encode_map()
  def encode(other), do: throw({:not_writable, other})

  defp encode_integer(n) when n in 0..127, do: <<n>>
  defp encode_integer(n) when n in -32..-1, do: <<n::signed-8>>
  defp encode_integer(n) when n in 0..0xFF, do: <<0xCC, n>>
  defp encode_integer(n) when n in 0..0xFFFF, do: <<0xCD, n::16>>
  defp encode_integer(n) when n in 0..0xFFFF_FFFF, do: <<0xCE, n::32>>
  defp encode_integer(n) when n in 0..0xFFFF_FFFF_FFFF_FFFF, do: <<0xCF, n::64>>
  defp encode_integer(n) when n in -0x80..-1, do: <<0xD0, n::signed-8>>
  defp encode_integer(n) when n in -0x8000..-1, do: <<0xD1, n::signed-16>>
  defp encode_integer(n) when n in -0x8000_0000..-1, do: <<0xD2, n::signed-32>>
  defp encode_integer(n) when n in -0x8000_0000_0000_0000..-1, do: <<0xD3, n::signed-64>>
  defp encode_integer(n), do: throw({:not_writable, n})

  defp encode_string(bytes) do
    head =
      case byte_size(bytes) do
        n when n < 32 -> <<0b101::3, n::5>>
        n when n <= 0xFF -> <<0xD9, n>>
        n when n <= 0xFFFF -> <<0xDA, n::16>>
        n -> <<0xDB, n::32>>
      end

    [head, bytes]
  end

  defp encode_binary(bytes) do
    head =
      case byte_size(bytes) do
        n when n <= 0xFF -> <<0xC4, n>>
        n when n <= 0xFFFF -> <<0xC5, n::16>>
        n -> <<0xC6, n::32>>
      end

    [head, bytes]
  end

  defp list_header(n) when n < 16, do: <<0b1001::4, n::4>>
  defp list_header(n) when n <= 0xFFFF, do: <<0xDC, n::16>>
  defp list_header(n), do: <<0xDD, n::32>>

  defp encode_map(pairs) do
    head =
      case length(pairs) do
        n when n < 16 -> <<0b1000::4, n::4>>
        n when n <= 0xFFFF -> <<0xDE, n::16>>
        n -> <<0xDF, n::32>>
      end

    [head | Enum.map(pairs, &encode_pair/1)]
  end

  defp encode_pair({key, value}), do: [encode(key), encode(value)]
  defp encode_pair(other), do: throw({:not_writable, other})

  defp extension_header(n) when n in [1, 2, 4, 8, 16], do: <<0xD4 + trunc(:math.log2(n))>>
  defp extension_header(n) when n <= 0xFF, do: <<0xC7, n>>
  defp extension_header(n) when n <= 0xFFFF, do: <<0xC8, n::16>>
  defp extension_header(n), do: <<0xC9, n::32>>

  # The shortest of the three forms, as the specification asks.
  defp encode_timestamp(ns) do
    seconds = Integer.floor_div(ns, 1_000_000_000)
    fraction = Integer.mod(ns, 1_000_000_000)

    case {seconds, fraction} do
      {seconds, 0} when seconds in 0..0xFFFF_FFFF ->
        <<0xD6, -1::signed-8, seconds::32>>

      {seconds, _} when seconds in 0..0x3_FFFF_FFFF ->
        <<0xD7, -1::signed-8, fraction::30, seconds::34>>

      _ ->
        <<0xC7, 12, -1::signed-8, fraction::32, seconds::signed-64>>
    end
  end

  @doc "Decodes the first value; also returns the remaining bytes. Option: `objects: :maps | :pairs`."
  @spec decode(binary(), keyword()) :: {:ok, term(), binary()} | {:error, String.t()}
  def decode(bytes, opts \\ []) do
    {value, rest} = decode_value(bytes, 0, opts[:objects] == :pairs)
    {:ok, value, rest}
  catch
    {:not_message_pack, why} -> {:error, why}
  end

  defp decode_value(_bytes, depth, _pairs?) when depth > @max_depth,
    do: throw_malformed("it is nested more than #{@max_depth} levels deep")

  defp decode_value(<<0::1, n::7, rest::binary>>, _, _), do: {n, rest}
  defp decode_value(<<0b1000::4, n::4, rest::binary>>, d, p), do: decode_map(n, rest, d, p)
  defp decode_value(<<0b1001::4, n::4, rest::binary>>, d, p), do: decode_list(n, rest, d, p)
  defp decode_value(<<0b101::3, n::5, rest::binary>>, _, _), do: take_bytes(n, rest)
  defp decode_value(<<0xC0, rest::binary>>, _, _), do: {nil, rest}
  defp decode_value(<<0xC2, rest::binary>>, _, _), do: {false, rest}
  defp decode_value(<<0xC3, rest::binary>>, _, _), do: {true, rest}
  defp decode_value(<<0xC4, n, rest::binary>>, _, _), do: take_bytes(n, rest)
  defp decode_value(<<0xC5, n::16, rest::binary>>, _, _), do: take_bytes(n, rest)
  defp decode_value(<<0xC6, n::32, rest::binary>>, _, _), do: take_bytes(n, rest)

  defp decode_value(<<0xC7, n, type::signed-8, rest::binary>>, _, _),
    do: decode_extension(n, type, rest)

  defp decode_value(<<0xC8, n::16, type::signed-8, rest::binary>>, _, _),
    do: decode_extension(n, type, rest)

  defp decode_value(<<0xC9, n::32, type::signed-8, rest::binary>>, _, _),
    do: decode_extension(n, type, rest)

  defp decode_value(<<0xCA, bits::32, rest::binary>>, _, _),
    do: {Situ.Number.decode_float(<<bits::little-32>>), rest}

  defp decode_value(<<0xCB, bits::64, rest::binary>>, _, _),
    do: {Situ.Number.decode_float(<<bits::little-64>>), rest}

  defp decode_value(<<0xCC, n, rest::binary>>, _, _), do: {n, rest}
  defp decode_value(<<0xCD, n::16, rest::binary>>, _, _), do: {n, rest}
  defp decode_value(<<0xCE, n::32, rest::binary>>, _, _), do: {n, rest}
  defp decode_value(<<0xCF, n::64, rest::binary>>, _, _), do: {n, rest}
  defp decode_value(<<0xD0, n::signed-8, rest::binary>>, _, _), do: {n, rest}
  defp decode_value(<<0xD1, n::signed-16, rest::binary>>, _, _), do: {n, rest}
  defp decode_value(<<0xD2, n::signed-32, rest::binary>>, _, _), do: {n, rest}
  defp decode_value(<<0xD3, n::signed-64, rest::binary>>, _, _), do: {n, rest}

  defp decode_value(<<kind, type::signed-8, rest::binary>>, _, _) when kind in 0xD4..0xD8,
    do: decode_extension(Bitwise.bsl(1, kind - 0xD4), type, rest)

  defp decode_value(<<0xD9, n, rest::binary>>, _, _), do: take_bytes(n, rest)
  defp decode_value(<<0xDA, n::16, rest::binary>>, _, _), do: take_bytes(n, rest)
  defp decode_value(<<0xDB, n::32, rest::binary>>, _, _), do: take_bytes(n, rest)
  defp decode_value(<<0xDC, n::16, rest::binary>>, d, p), do: decode_list(n, rest, d, p)
  defp decode_value(<<0xDD, n::32, rest::binary>>, d, p), do: decode_list(n, rest, d, p)
  defp decode_value(<<0xDE, n::16, rest::binary>>, d, p), do: decode_map(n, rest, d, p)
  defp decode_value(<<0xDF, n::32, rest::binary>>, d, p), do: decode_map(n, rest, d, p)
  defp decode_value(<<0b111::3, n::5, rest::binary>>, _, _), do: {n - 32, rest}

  defp decode_value(<<0xC1, _::binary>>, _, _),
    do: throw_malformed("the byte 0xC1 is not used in MessagePack")

  defp decode_value(_short, _, _), do: throw_malformed("it ends within a value")

  defp take_bytes(n, bytes) do
    case bytes do
      <<part::binary-pinned_size(n), rest::binary>> -> {:binary.copy(part), rest}
      _ -> throw_malformed("it ends within a value of #{n} bytes")
    end
  end

  # Each element takes at least one byte, so a larger count is invalid.
  defp decode_list(n, bytes, _depth, _pairs?) when n > byte_size(bytes),
    do: throw_malformed("a list of #{n} elements in #{byte_size(bytes)} bytes")

  defp decode_list(n, bytes, depth, pairs?),
    do: Enum.map_reduce(1..n//1, bytes, fn _, rest -> decode_value(rest, depth + 1, pairs?) end)

  defp decode_map(n, bytes, _depth, _pairs?) when 2 * n > byte_size(bytes),
    do: throw_malformed("a map of #{n} entries in #{byte_size(bytes)} bytes")

  defp decode_map(n, bytes, depth, pairs?) do
    {pairs, rest} =
      Enum.map_reduce(1..n//1, bytes, fn _, rest ->
        {key, rest} = decode_value(rest, depth + 1, pairs?)
        {value, rest} = decode_value(rest, depth + 1, pairs?)
        {{key, value}, rest}
      end)

    {if(pairs?, do: {pairs}, else: Map.new(pairs)), rest}
  end

  defp decode_extension(n, type, bytes) do
    {data, rest} = take_bytes(n, bytes)
    {build_extension(type, data), rest}
  end

  defp build_extension(-1, <<seconds::32>>), do: {:timestamp, seconds * 1_000_000_000}

  defp build_extension(-1, <<ns::30, seconds::34>>),
    do: {:timestamp, seconds * 1_000_000_000 + ns}

  defp build_extension(-1, <<ns::32, seconds::signed-64>>),
    do: {:timestamp, seconds * 1_000_000_000 + ns}

  defp build_extension(type, data), do: {:ext, type, data}

  defp throw_malformed(why), do: throw({:not_message_pack, why})
end
