defmodule Situ.Bridge.Protobuf.Reader do
  @moduledoc false
  # Decodes Protobuf bytes to maps with a schema. Pure.
  #
  # Memory is bounded by the size of the input: messages nest at most a hundred deep, and all maps together have at most
  # `@base` members plus `@rate` for each byte, however many fields a schema gives its messages.
  import Situ.Bits, only: [known: 1]
  import Bitwise
  alias Situ.Bridge.Protobuf.Schema
  alias Situ.Bridge.Ros.Number

  @deepest 100
  @base 100_000
  @rate 16
  @times ["google.protobuf.Timestamp", "google.protobuf.Duration"]

  @doc "Decodes `bytes` as the message `name`. The error is a sentence."
  @spec decode(Schema.t(), String.t(), binary()) :: {:ok, map()} | {:error, String.t()}
  def decode(schema, name, bytes) do
    {value, _budget} = message(bytes, name, schema, @base + @rate * byte_size(bytes), 0)
    {:ok, value}
  catch
    {:not_protobuf, why} -> {:error, why}
  end

  defp fail(why), do: throw({:not_protobuf, why})

  defp message(_bytes, name, _schema, _budget, @deepest),
    do: fail("#{name} is nested #{@deepest} deep")

  defp message(bytes, name, schema, budget, depth) do
    type = Map.fetch!(schema.messages, name)
    budget = budget - map_size(type.empty)
    if budget < 0, do: fail("its messages have far more fields than it has bytes")
    found = scan(bytes, type.by_number, [])
    {value, budget} = build(found, type, schema, budget, depth)
    {timed(name, value), budget}
  end

  defp timed(name, %{"seconds" => s, "nanos" => ns}) when name in @times,
    do: (s || 0) * 1_000_000_000 + (ns || 0)

  defp timed(_name, value), do: value

  # Returns `{number, value}` of every known field, the last one first; messages are still bytes.
  defp scan("", _fields, found), do: found

  defp scan(bytes, fields, found) do
    {key, rest} = varint(bytes)
    number = key >>> 3
    if number not in 1..536_870_911, do: fail("a field has the number #{number}")

    case fields do
      %{^number => field} -> field(field, key &&& 7, rest, fields, found)
      _ -> rest |> skip(key &&& 7, number, 0) |> scan(fields, found)
    end
  end

  defp field(field, wire, bytes, fields, found) do
    case {Schema.wire(field.type), wire} do
      {wire, wire} ->
        {value, rest} = value(wire, field.type, bytes)
        scan(rest, fields, [{field.number, value} | found])

      {scalar, 2} when scalar != 2 and field.repeated? ->
        {packed, rest} = sized(bytes)
        scan(rest, fields, [{field.number, {:packed, unpacked(packed, field.type)}} | found])

      _other ->
        bytes |> skip(wire, field.number, 0) |> scan(fields, found)
    end
  end

  defp value(0, type, bytes) do
    {n, rest} = varint(bytes)
    {integer(type, n), rest}
  end

  defp value(2, type, bytes) do
    {taken, rest} = sized(bytes)
    {if(type in [:string, :bytes], do: :binary.copy(taken), else: taken), rest}
  end

  defp value(_fixed, type, bytes) do
    {kind, size} = Schema.fixed(type)

    case bytes do
      <<taken::binary-known(size), rest::binary>> -> {Number.read(kind, taken, :little), rest}
      _ -> fail("it ends within a number")
    end
  end

  defp unpacked(bytes, type) do
    case Schema.fixed(type) do
      nil ->
        varints(bytes, type, [])

      {kind, size} ->
        if rem(byte_size(bytes), size) != 0, do: fail("a packed list ends within a number")
        Number.read_all(kind, bytes, :little)
    end
  end

  defp varints("", _type, found), do: Enum.reverse(found)

  defp varints(bytes, type, found) do
    {n, rest} = varint(bytes)
    varints(rest, type, [integer(type, n) | found])
  end

  defp integer(:bool, n), do: n != 0
  defp integer(:uint32, n), do: n &&& 0xFFFF_FFFF
  defp integer(:uint64, n), do: n
  defp integer(:int64, n), do: signed(n, 64)
  defp integer(:sint64, n), do: unzigzag(n)
  defp integer(:sint32, n), do: unzigzag(n &&& 0xFFFF_FFFF)
  defp integer(_int32_or_enum, n), do: signed(n &&& 0xFFFF_FFFF, 32)

  defp signed(n, size) when n < 1 <<< (size - 1), do: n
  defp signed(n, size), do: n - (1 <<< size)
  defp unzigzag(n), do: bxor(n >>> 1, -(n &&& 1))

  defp varint(<<0::1, n::7, rest::binary>>), do: {n, rest}
  defp varint(<<1::1, a::7, 0::1, b::7, rest::binary>>), do: {b <<< 7 ||| a, rest}
  defp varint(bytes), do: varint(bytes, 0, 0)

  defp varint(_bytes, 70, _sum), do: fail("a number has more than ten bytes")

  defp varint(<<1::1, n::7, rest::binary>>, shift, sum),
    do: varint(rest, shift + 7, sum ||| n <<< shift)

  defp varint(<<0::1, n::7, rest::binary>>, shift, sum),
    do: {(sum ||| n <<< shift) &&& 0xFFFF_FFFF_FFFF_FFFF, rest}

  defp varint("", _shift, _sum), do: fail("it ends within a number")

  defp sized(bytes) do
    {n, rest} = varint(bytes)

    case rest do
      <<taken::binary-known(n), rest::binary>> -> {taken, rest}
      _ -> fail("#{n} bytes are expected, but only #{byte_size(rest)} are left")
    end
  end

  defp skip(bytes, 0, _number, _depth), do: bytes |> varint() |> elem(1)
  defp skip(<<_::binary-8, rest::binary>>, 1, _number, _depth), do: rest
  defp skip(bytes, 2, _number, _depth), do: bytes |> sized() |> elem(1)
  defp skip(<<_::binary-4, rest::binary>>, 5, _number, _depth), do: rest

  # A group ends with an end tag of the same number.
  defp skip(bytes, 3, number, depth) when depth < @deepest do
    {key, rest} = varint(bytes)

    case {key >>> 3, key &&& 7} do
      {^number, 4} -> rest
      {inner, wire} -> rest |> skip(wire, inner, depth + 1) |> skip(3, number, depth)
    end
  end

  defp skip(_bytes, wire, number, _depth),
    do: fail("the field #{number} (wire type #{wire}) is invalid or incomplete")

  # Repeated occurrences of a single field: the last scalar wins, and the parts of a message are merged.
  defp build(found, type, schema, budget, depth) do
    found
    |> Enum.reduce(%{}, fn {number, value}, all ->
      Map.update(all, number, [value], &[value | &1])
    end)
    |> Enum.reduce({type.empty, budget}, fn {number, values}, {map, budget} ->
      field = Map.fetch!(type.by_number, number)
      {value, budget} = member(field, values, schema, budget, depth)
      {Map.put(map, field.name, value), budget}
    end)
    |> then(fn {map, budget} ->
      {if(type.oneofs?, do: one_of(map, found, type), else: map), budget}
    end)
  end

  # Only the member of a oneof that was written last is kept.
  defp one_of(map, [{_, _} | _] = found, type) do
    for %{oneof: oneof} = field <- type.fields, oneof != nil, reduce: map do
      map -> if holds?(field, found, type), do: map, else: %{map | field.name => nil}
    end
  end

  defp one_of(map, [], _type), do: map

  defp holds?(field, found, type) do
    last = Enum.find_value(found, fn {n, _} -> same_oneof(type.by_number[n], field.oneof) end)
    last == nil or last == field.number
  end

  defp same_oneof(%{oneof: oneof, number: number}, oneof), do: number
  defp same_oneof(_field, _oneof), do: nil

  defp member(%{repeated?: true, type: {:message, name}}, values, schema, budget, depth) do
    {messages, budget} =
      Enum.map_reduce(values, budget, &message(&1, name, schema, &2, depth + 1))

    if schema.messages[name].map?,
      do: {Map.new(messages, &{key(&1["key"]), &1["value"]}), budget},
      else: {messages, budget}
  end

  defp member(%{type: {:message, name}}, values, schema, budget, depth),
    do: values |> IO.iodata_to_binary() |> message(name, schema, budget, depth + 1)

  defp member(%{repeated?: true} = field, values, schema, budget, _depth) do
    values =
      Enum.flat_map(values, fn
        {:packed, list} -> Enum.map(list, &named(field, &1, schema))
        value -> [named(field, value, schema)]
      end)

    {values, budget}
  end

  defp member(field, values, schema, budget, _depth),
    do: {named(field, List.last(values), schema), budget}

  defp named(%{type: {:enum, name}}, n, schema), do: Map.get(schema.enums[name].names, n, n)
  defp named(_field, value, _schema), do: value

  # All map keys are strings, as in other formats.
  defp key(key) when is_binary(key), do: key
  defp key(key), do: to_string(key)
end
