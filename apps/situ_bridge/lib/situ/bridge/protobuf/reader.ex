defmodule Situ.Bridge.Protobuf.Reader do
  @moduledoc false
  # Decodes Protobuf bytes to maps with a schema. Pure.
  #
  # Memory is bounded by the size of the input: messages nest at most a hundred deep, and all maps together have at most
  # `@base` members plus `@rate` for each byte, however many fields a schema gives its messages.
  import Situ.BinarySize, only: [pinned_size: 1]
  import Bitwise
  alias Situ.Bridge.Protobuf.Schema
  alias Situ.Bridge.Ros.Number

  @max_depth 100
  @base_members 100_000
  @members_per_byte 16
  @times ["google.protobuf.Timestamp", "google.protobuf.Duration"]

  @doc "Decodes `bytes` as the message `name`. The error is a sentence."
  @spec decode(Schema.t(), String.t(), binary()) :: {:ok, map()} | {:error, String.t()}
  def decode(schema, name, bytes) do
    {value, _budget} =
      decode_message(bytes, name, schema, @base_members + @members_per_byte * byte_size(bytes), 0)

    {:ok, value}
  catch
    {:not_protobuf, why} -> {:error, why}
  end

  defp fail_decoding(why), do: throw({:not_protobuf, why})

  defp decode_message(_bytes, name, _schema, _budget, @max_depth),
    do: fail_decoding("#{name} is nested #{@max_depth} deep")

  defp decode_message(bytes, name, schema, budget, depth) do
    type = Map.fetch!(schema.messages, name)
    budget = budget - map_size(type.empty)
    if budget < 0, do: fail_decoding("its messages have far more fields than it has bytes")
    entries = scan_fields(bytes, type.by_number, [])
    {value, budget} = build_message(entries, type, schema, budget, depth)
    {convert_time(name, value), budget}
  end

  defp convert_time(name, %{"seconds" => s, "nanos" => ns}) when name in @times,
    do: (s || 0) * 1_000_000_000 + (ns || 0)

  defp convert_time(_name, value), do: value

  # Returns `{number, value}` of every known field, the last one first; messages are still bytes.
  defp scan_fields("", _fields, entries), do: entries

  defp scan_fields(bytes, fields, entries) do
    {key, rest} = read_varint(bytes)
    number = key >>> 3
    if number not in 1..536_870_911, do: fail_decoding("a field has the number #{number}")

    case fields do
      %{^number => field} -> scan_field(field, key &&& 7, rest, fields, entries)
      _ -> rest |> skip_field(key &&& 7, number, 0) |> scan_fields(fields, entries)
    end
  end

  defp scan_field(field, wire, bytes, fields, entries) do
    case {Schema.wire_type(field.type), wire} do
      {wire, wire} ->
        {value, rest} = read_value(wire, field.type, bytes)
        scan_fields(rest, fields, [{field.number, value} | entries])

      {scalar, 2} when scalar != 2 and field.repeated? ->
        {packed, rest} = read_sized(bytes)

        scan_fields(rest, fields, [
          {field.number, {:packed, unpack_numbers(packed, field.type)}} | entries
        ])

      _other ->
        bytes |> skip_field(wire, field.number, 0) |> scan_fields(fields, entries)
    end
  end

  defp read_value(0, type, bytes) do
    {n, rest} = read_varint(bytes)
    {convert_integer(type, n), rest}
  end

  defp read_value(2, type, bytes) do
    {part, rest} = read_sized(bytes)
    {if(type in [:string, :bytes], do: :binary.copy(part), else: part), rest}
  end

  defp read_value(_fixed, type, bytes) do
    {kind, size} = Schema.fixed_kind(type)

    case bytes do
      <<part::binary-pinned_size(size), rest::binary>> ->
        {Number.decode(kind, part, :little), rest}

      _ ->
        fail_decoding("it ends within a number")
    end
  end

  defp unpack_numbers(bytes, type) do
    case Schema.fixed_kind(type) do
      nil ->
        read_varints(bytes, type, [])

      {kind, size} ->
        if rem(byte_size(bytes), size) != 0,
          do: fail_decoding("a packed list ends within a number")

        Number.decode_all(kind, bytes, :little)
    end
  end

  defp read_varints("", _type, entries), do: Enum.reverse(entries)

  defp read_varints(bytes, type, entries) do
    {n, rest} = read_varint(bytes)
    read_varints(rest, type, [convert_integer(type, n) | entries])
  end

  defp convert_integer(:bool, n), do: n != 0
  defp convert_integer(:uint32, n), do: n &&& 0xFFFF_FFFF
  defp convert_integer(:uint64, n), do: n
  defp convert_integer(:int64, n), do: to_signed(n, 64)
  defp convert_integer(:sint64, n), do: decode_zigzag(n)
  defp convert_integer(:sint32, n), do: decode_zigzag(n &&& 0xFFFF_FFFF)
  defp convert_integer(_int32_or_enum, n), do: to_signed(n &&& 0xFFFF_FFFF, 32)

  defp to_signed(n, size) when n < 1 <<< (size - 1), do: n
  defp to_signed(n, size), do: n - (1 <<< size)
  defp decode_zigzag(n), do: bxor(n >>> 1, -(n &&& 1))

  defp read_varint(<<0::1, n::7, rest::binary>>), do: {n, rest}
  defp read_varint(<<1::1, a::7, 0::1, b::7, rest::binary>>), do: {b <<< 7 ||| a, rest}
  defp read_varint(bytes), do: read_varint(bytes, 0, 0)

  defp read_varint(_bytes, 70, _sum), do: fail_decoding("a number has more than ten bytes")

  defp read_varint(<<1::1, n::7, rest::binary>>, shift, sum),
    do: read_varint(rest, shift + 7, sum ||| n <<< shift)

  defp read_varint(<<0::1, n::7, rest::binary>>, shift, sum),
    do: {(sum ||| n <<< shift) &&& 0xFFFF_FFFF_FFFF_FFFF, rest}

  defp read_varint("", _shift, _sum), do: fail_decoding("it ends within a number")

  defp read_sized(bytes) do
    {n, rest} = read_varint(bytes)

    case rest do
      <<part::binary-pinned_size(n), rest::binary>> -> {part, rest}
      _ -> fail_decoding("#{n} bytes are expected, but only #{byte_size(rest)} are left")
    end
  end

  defp skip_field(bytes, 0, _number, _depth), do: bytes |> read_varint() |> elem(1)
  defp skip_field(<<_::binary-8, rest::binary>>, 1, _number, _depth), do: rest
  defp skip_field(bytes, 2, _number, _depth), do: bytes |> read_sized() |> elem(1)
  defp skip_field(<<_::binary-4, rest::binary>>, 5, _number, _depth), do: rest

  # A group ends with an end tag of the same number.
  defp skip_field(bytes, 3, number, depth) when depth < @max_depth do
    {key, rest} = read_varint(bytes)

    case {key >>> 3, key &&& 7} do
      {^number, 4} -> rest
      {inner, wire} -> rest |> skip_field(wire, inner, depth + 1) |> skip_field(3, number, depth)
    end
  end

  defp skip_field(_bytes, wire, number, _depth),
    do: fail_decoding("the field #{number} (wire type #{wire}) is invalid or incomplete")

  # Repeated occurrences of a single field: the last scalar wins, and the parts of a message are merged.
  defp build_message(entries, type, schema, budget, depth) do
    entries
    |> Enum.reduce(%{}, fn {number, value}, grouped ->
      Map.update(grouped, number, [value], &[value | &1])
    end)
    |> Enum.reduce({type.empty, budget}, fn {number, values}, {map, budget} ->
      field = Map.fetch!(type.by_number, number)
      {value, budget} = build_member(field, values, schema, budget, depth)
      {Map.put(map, field.name, value), budget}
    end)
    |> then(fn {map, budget} ->
      {if(type.oneofs?, do: clear_other_members(map, entries, type), else: map), budget}
    end)
  end

  # Only the member of a oneof that was written last is kept.
  defp clear_other_members(map, [{_, _} | _] = entries, type) do
    for %{oneof: oneof} = field <- type.fields, oneof != nil, reduce: map do
      map -> if current_member?(field, entries, type), do: map, else: %{map | field.name => nil}
    end
  end

  defp clear_other_members(map, [], _type), do: map

  defp current_member?(field, entries, type) do
    last =
      Enum.find_value(entries, fn {n, _} -> number_in_oneof(type.by_number[n], field.oneof) end)

    last == nil or last == field.number
  end

  defp number_in_oneof(%{oneof: oneof, number: number}, oneof), do: number
  defp number_in_oneof(_field, _oneof), do: nil

  defp build_member(%{repeated?: true, type: {:message, name}}, values, schema, budget, depth) do
    {messages, budget} =
      Enum.map_reduce(values, budget, &decode_message(&1, name, schema, &2, depth + 1))

    if schema.messages[name].map?,
      do: {Map.new(messages, &{map_key(&1["key"]), &1["value"]}), budget},
      else: {messages, budget}
  end

  defp build_member(%{type: {:message, name}}, values, schema, budget, depth),
    do: values |> IO.iodata_to_binary() |> decode_message(name, schema, budget, depth + 1)

  defp build_member(%{repeated?: true} = field, values, schema, budget, _depth),
    do: {values |> join_packed() |> enum_names(field, schema), budget}

  defp build_member(field, values, schema, budget, _depth),
    do: {enum_name(field, List.last(values), schema), budget}

  defp join_packed([{:packed, list}]), do: list

  defp join_packed(values) do
    Enum.flat_map(values, fn
      {:packed, list} -> list
      value -> [value]
    end)
  end

  defp enum_names(values, %{type: {:enum, _}} = field, schema),
    do: Enum.map(values, &enum_name(field, &1, schema))

  defp enum_names(values, _field, _schema), do: values

  defp enum_name(%{type: {:enum, name}}, n, schema), do: Map.get(schema.enums[name].names, n, n)
  defp enum_name(_field, value, _schema), do: value

  # All map keys are strings, as in other formats.
  defp map_key(key) when is_binary(key), do: key
  defp map_key(key), do: to_string(key)
end
