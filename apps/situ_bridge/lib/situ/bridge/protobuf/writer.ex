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
    {:ok, IO.iodata_to_binary(put_message(map, name, schema))}
  catch
    {:not_writable, value} -> {:error, "#{inspect(value, limit: 5)} does not fit its field"}
    {:not_protobuf, why} -> {:error, why}
  end

  defp put_message(time, name, schema) when is_integer(time) and name in @times do
    seconds = Integer.floor_div(time, 1_000_000_000)
    put_message(%{"seconds" => seconds, "nanos" => time - seconds * 1_000_000_000}, name, schema)
  end

  defp put_message(%{} = map, name, schema) do
    %{fields: fields, empty: empty} = Map.fetch!(schema.messages, name)

    case Enum.find(Map.keys(map), &(not is_map_key(empty, &1))) do
      nil -> for field <- fields, do: put(field, Map.get(map, field.name), schema)
      key -> throw({:not_protobuf, "#{name} has no field #{inspect(key, limit: 5)}"})
    end
  end

  defp put_message(other, _name, _schema), do: throw({:not_writable, other})

  defp put(_field, nil, _schema), do: []

  defp put(%{repeated?: true, type: {:message, name}} = field, map, schema)
       when is_map(map) and not is_struct(map) do
    if not schema.messages[name].map?, do: throw({:not_writable, map})

    for {key, value} <- Enum.sort(map),
        do: put_sized(field, put_message(entry(key, value, name, schema), name, schema))
  end

  defp put(%{repeated?: true, packed?: true}, [], _schema), do: []

  defp put(%{repeated?: true, packed?: true} = field, list, schema) when is_list(list),
    do: put_sized(field, Enum.map(list, &put_value(field.type, &1, schema)))

  defp put(%{repeated?: true} = field, list, schema) when is_list(list),
    do: for(value <- list, do: put_one(field, value, schema))

  defp put(%{repeated?: true}, other, _schema), do: throw({:not_writable, other})

  defp put(%{presence?: false, type: type} = field, value, schema) when is_atom(type) do
    # Minus zero differs from the default, so it is encoded.
    if value === Schema.zero(type) and not negative_zero?(value),
      do: [],
      else: put_one(field, value, schema)
  end

  defp put(field, value, schema), do: put_one(field, value, schema)

  defp negative_zero?(value) when is_float(value),
    do: <<value::float-64>> == <<0x8000_0000_0000_0000::64>>

  defp negative_zero?(_), do: false

  # Map keys that are numbers or booleans in the schema are strings in Elixir.
  defp entry(key, value, name, schema) do
    [%{type: type} | _] = schema.messages[name].fields
    %{"key" => keyed(type, key), "value" => value}
  end

  defp keyed(:string, key), do: key
  defp keyed(:bool, key) when key in ["true", "false"], do: key == "true"

  defp keyed(_type, key) when is_binary(key) do
    case Integer.parse(key) do
      {n, ""} -> n
      _ -> throw({:not_writable, key})
    end
  end

  defp keyed(_type, key), do: key

  defp put_one(field, value, schema) do
    case Schema.wire(field.type) do
      2 -> put_sized(field, put_value(field.type, value, schema))
      wire -> [put_varint(field.number <<< 3 ||| wire), put_value(field.type, value, schema)]
    end
  end

  defp put_sized(field, bytes),
    do: [
      put_varint(field.number <<< 3 ||| 2),
      bytes |> IO.iodata_length() |> put_varint(),
      bytes
    ]

  defp put_value({:message, name}, value, schema), do: put_message(value, name, schema)
  defp put_value({:enum, _}, n, _schema) when n in -0x8000_0000..0x7FFF_FFFF, do: put_signed(n)

  defp put_value({:enum, name}, value, schema) do
    case schema.enums[name].numbers do
      %{^value => n} -> put_signed(n)
      _ -> throw({:not_writable, value})
    end
  end

  defp put_value(:string, text, _schema) when is_binary(text) do
    if String.valid?(text), do: text, else: throw({:not_writable, text})
  end

  defp put_value(:bytes, bytes, _schema) when is_binary(bytes), do: bytes
  defp put_value(:bool, b, _schema) when is_boolean(b), do: if(b, do: <<1>>, else: <<0>>)

  defp put_value(type, n, _schema)
       when type in [:int32, :sint32] and n in -0x8000_0000..0x7FFF_FFFF,
       do: if(type == :int32, do: put_signed(n), else: put_varint(zigzag(n)))

  defp put_value(type, n, _schema)
       when type in [:int64, :sint64] and n in -0x8000_0000_0000_0000..0x7FFF_FFFF_FFFF_FFFF,
       do: if(type == :int64, do: put_signed(n), else: put_varint(zigzag(n)))

  defp put_value(:uint32, n, _schema) when n in 0..0xFFFF_FFFF, do: put_varint(n)
  defp put_value(:uint64, n, _schema) when n in 0..0xFFFF_FFFF_FFFF_FFFF, do: put_varint(n)

  defp put_value(type, value, _schema) do
    case Schema.fixed(type) do
      {kind, _size} -> Number.write(kind, value)
      nil -> throw({:not_writable, value})
    end
  end

  defp put_signed(n) when n < 0, do: put_varint(n + (1 <<< 64))
  defp put_signed(n), do: put_varint(n)
  defp zigzag(n) when n < 0, do: -2 * n - 1
  defp zigzag(n), do: 2 * n

  @doc "Encodes a number as a varint."
  @spec put_varint(non_neg_integer()) :: binary()
  def put_varint(n) when n < 128, do: <<n>>
  def put_varint(n), do: <<1::1, n::7, put_varint(n >>> 7)::binary>>
end
