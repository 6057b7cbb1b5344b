defmodule Situ.Bridge.Ros.Wire do
  @moduledoc false
  # Encodes and decodes messages of any ROS type, in ROS 1's serialization (`:ros1`) or ROS 2's CDR (`:cdr`).
  #
  # A message is a map with string keys. Times and durations are in nanoseconds. Lists of bytes are binaries; NaN
  # and infinities are atoms. When a message is encoded, missing fields are zero, empty or false. Decoding never
  # allocates more than the input justifies. CDR is read in both byte orders and written in little-endian order,
  # with the alignment of version 1, which ROS 2 uses.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.Bridge.Ros.{Definition, Number}

  @type encoding :: :ros1 | :cdr

  # `at` is the offset from the position where alignment starts.
  defmodule Cursor do
    @moduledoc false
    defstruct [:bytes, :encoding, at: 0, order: :little]
  end

  @doc "Decodes the message in `bytes`. Returns a sentence with the reason if that fails."
  @spec decode(Definition.t(), binary(), encoding()) :: {:ok, map()} | {:error, String.t()}
  def decode(definition, bytes, encoding) do
    {value, _cursor} =
      read_message(definition.name, definition.types, new_cursor(bytes, encoding))

    {:ok, value}
  catch
    {:not_ros, why} -> {:error, why}
  end

  defp new_cursor(bytes, :ros1), do: %Cursor{bytes: bytes, encoding: :ros1}
  defp new_cursor(<<0, 1, _::16, rest::binary>>, :cdr), do: %Cursor{bytes: rest, encoding: :cdr}

  defp new_cursor(<<0, 0, _::16, rest::binary>>, :cdr),
    do: %Cursor{bytes: rest, encoding: :cdr, order: :big}

  defp new_cursor(<<_, kind, _::binary>>, :cdr),
    do:
      fail_decoding("the CDR encapsulation has the kind #{kind}, but only version 1 can be read")

  defp new_cursor(_, :cdr), do: fail_decoding("the data is too short for CDR")

  defp fail_decoding(why), do: throw({:not_ros, why})

  # In ROS 2, times are messages.
  defp read_message(name, _types, cursor)
       when name in ["builtin_interfaces/Time", "builtin_interfaces/Duration"],
       do: read_stamp(cursor, :int32)

  defp read_message(name, types, cursor) do
    {pairs, cursor} =
      Enum.map_reduce(Map.fetch!(types, name).fields, cursor, fn {field, type}, cursor ->
        {value, cursor} = read_value(type, types, cursor)
        {{field, value}, cursor}
      end)

    {Map.new(pairs), cursor}
  end

  defp read_value({:message, name}, types, cursor), do: read_message(name, types, cursor)
  defp read_value({:array, type, n}, types, cursor), do: read_values(n, type, types, cursor)

  defp read_value({:list, type}, types, cursor) do
    {n, cursor} = read_number(:uint32, cursor)
    read_values(n, type, types, cursor)
  end

  defp read_value(:string, _types, %{encoding: :ros1} = cursor) do
    {n, cursor} = read_number(:uint32, cursor)
    {text, cursor} = take_bytes(n, cursor)
    {:binary.copy(text), cursor}
  end

  # In CDR, the length includes a terminating zero.
  defp read_value(:string, _types, cursor) do
    {n, cursor} = read_number(:uint32, cursor)
    {text, cursor} = take_bytes(n, cursor)
    {text |> String.trim_trailing(<<0>>) |> :binary.copy(), cursor}
  end

  defp read_value(:wstring, _types, cursor) do
    {n, cursor} = read_number(:uint32, cursor)
    {text, cursor} = take_bytes(n * 2, cursor)
    order = {:utf16, cursor.order}

    case :unicode.characters_to_binary(text, order) do
      text when is_binary(text) -> {text, cursor}
      _ -> fail_decoding("a wide string is not valid UTF-16")
    end
  end

  defp read_value(:time, _types, cursor), do: read_stamp(cursor, :uint32)
  defp read_value(:duration, _types, cursor), do: read_stamp(cursor, :int32)
  defp read_value(kind, _types, cursor), do: read_number(kind, cursor)

  defp read_stamp(cursor, seconds) do
    {s, cursor} = read_number(seconds, cursor)

    {ns, cursor} =
      read_number(
        if(cursor.encoding == :ros1 and seconds == :int32, do: :int32, else: :uint32),
        cursor
      )

    {s * 1_000_000_000 + ns, cursor}
  end

  defp read_values(n, type, types, cursor) do
    case Number.number_size(type) do
      nil -> read_each(n, type, types, cursor)
      size -> read_numbers(n, type, size, cursor)
    end
  end

  # CDR writes no alignment padding for an empty list.
  defp read_numbers(0, type, _size, cursor),
    do: {Number.decode_all(type, "", cursor.order), cursor}

  defp read_numbers(n, type, size, cursor) do
    {bytes, cursor} = cursor |> align_cursor(size) |> then(&take_bytes(n * size, &1))
    {Number.decode_all(type, bytes, cursor.order), cursor}
  end

  # Rejects impossible lengths: an element takes at least one byte. Lists of messages without fields are not supported.
  defp read_each(n, _type, _types, cursor) when n > byte_size(cursor.bytes),
    do:
      fail_decoding("a list of #{n} elements does not fit into #{byte_size(cursor.bytes)} bytes")

  defp read_each(n, type, types, cursor),
    do: Enum.map_reduce(1..n//1, cursor, fn _, cursor -> read_value(type, types, cursor) end)

  defp read_number(kind, cursor) do
    size = Number.number_size(kind)
    {bytes, cursor} = cursor |> align_cursor(size) |> then(&take_bytes(size, &1))
    {Number.decode(kind, bytes, cursor.order), cursor}
  end

  defp align_cursor(%{encoding: :ros1} = cursor, _size), do: cursor

  defp align_cursor(cursor, size) do
    case rem(size - rem(cursor.at, size), size) do
      0 -> cursor
      gap -> cursor |> then(&take_bytes(gap, &1)) |> elem(1)
    end
  end

  defp take_bytes(n, cursor) do
    case cursor.bytes do
      <<part::binary-pinned_size(n), rest::binary>> ->
        {part, %{cursor | bytes: rest, at: cursor.at + n}}

      bytes ->
        fail_decoding("the data ends after #{cursor.at + byte_size(bytes)} bytes, within a field")
    end
  end

  @doc """
  Encodes a message. Returns a sentence with the value that does not fit if that fails.

      iex> alias Situ.Bridge.Ros.{Definition, Wire}
      iex> {:ok, definition} = Definition.parse("my/Reading", "string name\\nfloat32[] values\\ntime at")
      iex> {:ok, bytes} = Wire.encode(definition, %{"name" => "a", "values" => [1.5], "at" => 1_000_000_002}, :ros1)
      iex> Wire.decode(definition, bytes, :ros1)
      {:ok, %{"name" => "a", "values" => [1.5], "at" => 1_000_000_002}}
  """
  @spec encode(Definition.t(), map(), encoding()) :: {:ok, binary()} | {:error, String.t()}
  def encode(definition, message, encoding) do
    {parts, _at} = put_message(definition.name, definition.types, message, {[], 0}, encoding)
    head = if encoding == :cdr, do: <<0, 1, 0, 0>>, else: ""
    {:ok, IO.iodata_to_binary([head | Enum.reverse(parts)])}
  catch
    {:not_writable, value} -> {:error, "#{inspect(value, limit: 5)} does not fit its field"}
  end

  defp put_message(name, _types, time, acc, encoding)
       when name in ["builtin_interfaces/Time", "builtin_interfaces/Duration"],
       do: put_stamp(time || 0, :int32, acc, encoding)

  defp put_message(name, types, message, acc, encoding) when is_map(message) or is_nil(message) do
    Enum.reduce(Map.fetch!(types, name).fields, acc, fn {field, type}, acc ->
      put_value(type, types, message && Map.get(message, field), acc, encoding)
    end)
  end

  defp put_message(_name, _types, other, _out, _encoding), do: throw({:not_writable, other})

  defp put_value({:message, name}, types, value, acc, encoding),
    do: put_message(name, types, value, acc, encoding)

  defp put_value({:array, type, n}, types, value, acc, encoding) do
    if value != nil and count_elements(value) != n, do: throw({:not_writable, value})
    put_values(type, types, value || zero_elements(type, n), acc, encoding)
  end

  defp put_value({:list, type}, types, value, acc, encoding) do
    value = value || []

    put_values(
      type,
      types,
      value,
      put_number(:uint32, count_elements(value), acc, encoding),
      encoding
    )
  end

  defp put_value(:string, _types, value, acc, :ros1) do
    text = check_text(value)
    append_bytes(text, put_number(:uint32, byte_size(text), acc, :ros1))
  end

  defp put_value(:string, _types, value, acc, :cdr) do
    text = check_text(value) <> <<0>>
    append_bytes(text, put_number(:uint32, byte_size(text), acc, :cdr))
  end

  defp put_value(:wstring, _types, value, acc, encoding) do
    text = :unicode.characters_to_binary(check_text(value), :utf8, {:utf16, :little})
    append_bytes(text, put_number(:uint32, div(byte_size(text), 2), acc, encoding))
  end

  defp put_value(:time, _types, value, acc, encoding),
    do: put_stamp(value || 0, :uint32, acc, encoding)

  defp put_value(:duration, _types, value, acc, encoding),
    do: put_stamp(value || 0, :int32, acc, encoding)

  defp put_value(kind, _types, nil, acc, encoding),
    do: put_number(kind, if(kind == :bool, do: false, else: 0), acc, encoding)

  defp put_value(kind, _types, value, acc, encoding), do: put_number(kind, value, acc, encoding)

  defp put_stamp(ns, seconds, acc, encoding) when is_integer(ns) do
    acc = put_number(seconds, Integer.floor_div(ns, 1_000_000_000), acc, encoding)
    put_number(:uint32, Integer.mod(ns, 1_000_000_000), acc, encoding)
  end

  defp put_stamp(other, _seconds, _out, _encoding), do: throw({:not_writable, other})

  defp put_values(kind, _types, bytes, acc, _encoding)
       when is_binary(bytes) and kind in [:uint8, :int8],
       do: append_bytes(bytes, acc)

  defp put_values(_type, _types, value, _out, _encoding) when not is_list(value),
    do: throw({:not_writable, value})

  defp put_values(type, types, list, acc, encoding),
    do: Enum.reduce(list, acc, &put_value(type, types, &1, &2, encoding))

  defp count_elements(bytes) when is_binary(bytes), do: byte_size(bytes)
  defp count_elements(list) when is_list(list), do: length(list)
  defp count_elements(other), do: throw({:not_writable, other})

  defp zero_elements(kind, n) when kind in [:uint8, :int8], do: :binary.copy(<<0>>, n)
  defp zero_elements(_type, n), do: List.duplicate(nil, n)

  defp check_text(nil), do: ""
  defp check_text(text) when is_binary(text), do: text
  defp check_text(other), do: throw({:not_writable, other})

  defp put_number(kind, value, {parts, at}, :cdr) do
    size = Number.number_size(kind)
    gap = rem(size - rem(at, size), size)

    append_bytes(
      Number.encode(kind, value),
      {if(gap == 0, do: parts, else: [<<0::size(gap)-unit(8)>> | parts]), at + gap}
    )
  end

  defp put_number(kind, value, acc, :ros1), do: append_bytes(Number.encode(kind, value), acc)

  defp append_bytes(bytes, {parts, at}), do: {[bytes | parts], at + byte_size(bytes)}
end
