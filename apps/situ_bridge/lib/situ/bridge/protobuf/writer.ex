defmodule Situ.Bridge.Protobuf.Writer do
  @moduledoc false
  # Encodes maps to Protobuf bytes with a schema. Pure.
  import Bitwise
  alias Situ.Bridge.Protobuf.Schema
  alias Situ.Bridge.Ros.Number

  @times ["google.protobuf.Timestamp", "google.protobuf.Duration"]

  @doc "Encodes a map as the message `name`. The error is a sentence."
  @spec encode(Schema.t(), String.t(), term()) :: {:ok, binary()} | {:error, String.t()}
  def encode(schema, name, map) do
    {:ok, IO.iodata_to_binary(encode_message(map, name, schema))}
  catch
    {:not_writable, value} -> {:error, "#{inspect(value, limit: 5)} does not fit its field"}
    {:not_protobuf, why} -> {:error, why}
  end

  defp encode_message(time, name, schema) when is_integer(time) and name in @times do
    seconds = Integer.floor_div(time, 1_000_000_000)

    encode_message(
      %{"seconds" => seconds, "nanos" => time - seconds * 1_000_000_000},
      name,
      schema
    )
  end

  defp encode_message(%{} = map, name, schema) do
    %{fields: fields, empty: empty} = Map.fetch!(schema.messages, name)

    case Enum.find(Map.keys(map), &(not is_map_key(empty, &1))) do
      nil -> for field <- fields, do: encode_field(field, Map.get(map, field.name), schema)
      key -> throw({:not_protobuf, "#{name} has no field #{inspect(key, limit: 5)}"})
    end
  end

  defp encode_message(other, _name, _schema), do: throw({:not_writable, other})

  defp encode_field(_field, nil, _schema), do: []

  defp encode_field(%{repeated?: true, type: {:message, name}} = field, map, schema)
       when is_map(map) and not is_struct(map) do
    if not schema.messages[name].map?, do: throw({:not_writable, map})

    for {key, value} <- Enum.sort(map),
        do:
          encode_sized(field, encode_message(build_entry(key, value, name, schema), name, schema))
  end

  defp encode_field(%{repeated?: true, packed?: true}, [], _schema), do: []

  defp encode_field(%{repeated?: true, packed?: true} = field, list, schema) when is_list(list),
    do: encode_sized(field, Enum.map(list, &encode_value(field.type, &1, schema)))

  defp encode_field(%{repeated?: true} = field, list, schema) when is_list(list),
    do: for(value <- list, do: encode_single(field, value, schema))

  defp encode_field(%{repeated?: true}, other, _schema), do: throw({:not_writable, other})

  defp encode_field(%{presence?: false, type: type} = field, value, schema) when is_atom(type) do
    # Minus zero differs from the default, so it is encoded.
    if value === Schema.zero_value(type) and not negative_zero?(value),
      do: [],
      else: encode_single(field, value, schema)
  end

  defp encode_field(field, value, schema), do: encode_single(field, value, schema)

  defp negative_zero?(value) when is_float(value),
    do: <<value::float-64>> == <<0x8000_0000_0000_0000::64>>

  defp negative_zero?(_), do: false

  # Map keys that are numbers or booleans in the schema are strings in Elixir.
  defp build_entry(key, value, name, schema) do
    [%{type: type} | _] = schema.messages[name].fields
    %{"key" => parse_key(type, key), "value" => value}
  end

  defp parse_key(:string, key), do: key
  defp parse_key(:bool, key) when key in ["true", "false"], do: key == "true"

  defp parse_key(_type, key) when is_binary(key) do
    case Integer.parse(key) do
      {n, ""} -> n
      _ -> throw({:not_writable, key})
    end
  end

  defp parse_key(_type, key), do: key

  defp encode_single(field, value, schema) do
    case Schema.wire_type(field.type) do
      2 ->
        encode_sized(field, encode_value(field.type, value, schema))

      wire ->
        [encode_varint(field.number <<< 3 ||| wire), encode_value(field.type, value, schema)]
    end
  end

  defp encode_sized(field, bytes),
    do: [
      encode_varint(field.number <<< 3 ||| 2),
      bytes |> IO.iodata_length() |> encode_varint(),
      bytes
    ]

  defp encode_value({:message, name}, value, schema), do: encode_message(value, name, schema)

  defp encode_value({:enum, _}, n, _schema) when n in -0x8000_0000..0x7FFF_FFFF,
    do: encode_signed(n)

  defp encode_value({:enum, name}, value, schema) do
    case schema.enums[name].numbers do
      %{^value => n} -> encode_signed(n)
      _ -> throw({:not_writable, value})
    end
  end

  defp encode_value(:string, text, _schema) when is_binary(text) do
    if String.valid?(text), do: text, else: throw({:not_writable, text})
  end

  defp encode_value(:bytes, bytes, _schema) when is_binary(bytes), do: bytes
  defp encode_value(:bool, b, _schema) when is_boolean(b), do: if(b, do: <<1>>, else: <<0>>)

  defp encode_value(type, n, _schema)
       when type in [:int32, :sint32] and n in -0x8000_0000..0x7FFF_FFFF,
       do: if(type == :int32, do: encode_signed(n), else: encode_varint(encode_zigzag(n)))

  defp encode_value(type, n, _schema)
       when type in [:int64, :sint64] and n in -0x8000_0000_0000_0000..0x7FFF_FFFF_FFFF_FFFF,
       do: if(type == :int64, do: encode_signed(n), else: encode_varint(encode_zigzag(n)))

  defp encode_value(:uint32, n, _schema) when n in 0..0xFFFF_FFFF, do: encode_varint(n)
  defp encode_value(:uint64, n, _schema) when n in 0..0xFFFF_FFFF_FFFF_FFFF, do: encode_varint(n)

  defp encode_value(type, value, _schema) do
    case Schema.fixed_kind(type) do
      {kind, _size} -> Number.encode(kind, value)
      nil -> throw({:not_writable, value})
    end
  end

  defp encode_signed(n) when n < 0, do: encode_varint(n + (1 <<< 64))
  defp encode_signed(n), do: encode_varint(n)
  defp encode_zigzag(n) when n < 0, do: -2 * n - 1
  defp encode_zigzag(n), do: 2 * n

  @doc "Encodes a number as a varint."
  @spec encode_varint(non_neg_integer()) :: binary()
  def encode_varint(n) when n < 128, do: <<n>>
  def encode_varint(n), do: <<1::1, n::7, encode_varint(n >>> 7)::binary>>
end
