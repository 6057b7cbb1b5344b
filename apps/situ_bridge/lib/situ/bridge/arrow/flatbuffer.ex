defmodule Situ.Bridge.Arrow.FlatBuffer do
  @moduledoc false
  # FlatBuffers (https://flatbuffers.dev/internals), limited to the features that Arrow's metadata needs. Pure. Any
  # offset outside the bytes throws `{:not_arrow, why}`.
  #
  # Objects are written before the objects that they refer to, and a table's vtable directly before the table.
  import Bitwise

  @type field ::
          {:u8 | :i16 | :i32 | :i64, integer()}
          | {:bool, boolean()}
          | {:ref, t()}
  @typedoc "A table maps field numbers to fields. All structs of a vector have the same size, in units of 64 bits."
  @type t ::
          {:table, [{non_neg_integer(), field()}]}
          | {:string, String.t()}
          | {:vector, [t()]}
          | {:structs, [binary()]}

  @sizes %{u8: 1, bool: 1, i16: 2, i32: 4, i64: 8, ref: 4}

  @doc "Encodes a table as the root of a buffer."
  @spec encode_table(t()) :: binary()
  def encode_table({:table, _} = root) do
    {bytes, start} = put_object(root, 4)
    IO.iodata_to_binary([<<start::little-32>>, bytes])
  end

  # Returns the bytes from `at` on, and the offset of the object.
  defp put_object({:string, text}, at) do
    start = align_offset(at, 4)
    {[zero_padding(at, start), <<byte_size(text)::little-32>>, text, 0], start}
  end

  defp put_object({:structs, structs}, at) do
    start = align_offset(at + 4, 8) - 4
    {[zero_padding(at, start), <<length(structs)::little-32>>, structs], start}
  end

  defp put_object({:vector, objects}, at) do
    start = align_offset(at, 4)
    count = length(objects)
    positions = for i <- 0..(count - 1)//1, do: start + 4 + 4 * i

    {offsets, children, _end} =
      put_referenced(Enum.zip(positions, objects), start + 4 + 4 * count)

    words = for position <- positions, do: <<offsets[position]::little-32>>
    {[zero_padding(at, start), <<count::little-32>>, words, children], start}
  end

  defp put_object({:table, fields}, at) do
    slots = fields |> Enum.map(&elem(&1, 0)) |> Enum.max(fn -> -1 end)
    vtable = align_offset(at, 2)
    start = align_offset(vtable + 4 + 2 * (slots + 1), 8)

    {layout, stop} =
      Enum.map_reduce(fields, start + 4, fn {slot, {kind, value}}, at ->
        position = align_offset(at, @sizes[kind])
        {{slot, position, kind, value}, position + @sizes[kind]}
      end)

    {offsets, children, _end} =
      put_referenced(for({_slot, position, :ref, object} <- layout, do: {position, object}), stop)

    positions = Map.new(layout, fn {slot, position, _, _} -> {slot, position - start} end)
    slots = for slot <- 0..slots//1, do: <<Map.get(positions, slot, 0)::little-16>>
    size = 4 + IO.iodata_length(slots)

    {inline, _} =
      Enum.map_reduce(layout, start + 4, fn {_, position, kind, value}, at ->
        value = if kind == :ref, do: offsets[position], else: value
        {[zero_padding(at, position), encode_scalar(kind, value)], position + @sizes[kind]}
      end)

    head = [<<size::little-16, stop - start::little-16>>, slots]

    {[
       zero_padding(at, vtable),
       head,
       zero_padding(vtable + size, start),
       <<start - vtable::little-signed-32>>,
       inline,
       children
     ], start}
  end

  # Puts objects one after another from `at` on; returns the offset of each, relative to the field that refers to it.
  defp put_referenced(layout, at) do
    Enum.reduce(layout, {%{}, [], at}, fn {position, object}, {offsets, bytes, at} ->
      {child, start} = put_object(object, at)
      {Map.put(offsets, position, start - position), [bytes, child], at + IO.iodata_length(child)}
    end)
  end

  defp encode_scalar(:bool, value), do: if(value, do: <<1>>, else: <<0>>)
  defp encode_scalar(:u8, value), do: <<value>>
  defp encode_scalar(:i16, value), do: <<value::little-16>>
  defp encode_scalar(kind, value) when kind in [:i32, :ref], do: <<value::little-32>>
  defp encode_scalar(:i64, value), do: <<value::little-64>>

  defp align_offset(at, n), do: at + n - 1 &&& bnot(n - 1)
  defp zero_padding(from, to), do: <<0::size((to - from) * 8)>>

  @doc "Returns the offset of the root table."
  @spec root_offset(binary()) :: non_neg_integer()
  def root_offset(bytes), do: read_unsigned(bytes, 0, 4)

  @doc "Reads the number in `slot` of a table, or returns `default` if the field is absent."
  @spec read_number(binary(), non_neg_integer(), non_neg_integer(), field_kind, integer()) ::
          integer()
        when field_kind: :u8 | :i16 | :i32 | :i64
  def read_number(bytes, table, slot, kind, default) do
    case field_offset(bytes, table, slot) do
      nil -> default
      at -> read_signed(bytes, at, @sizes[kind], kind)
    end
  end

  @doc "Returns the offset of the object that `slot` refers to, or `nil`."
  @spec object_offset(binary(), non_neg_integer(), non_neg_integer()) :: non_neg_integer() | nil
  def object_offset(bytes, table, slot) do
    with at when at != nil <- field_offset(bytes, table, slot),
         do: at + read_unsigned(bytes, at, 4)
  end

  @doc "Reads the string in `slot` of a table, or returns `nil` if the field is absent."
  @spec read_string(binary(), non_neg_integer(), non_neg_integer()) :: String.t() | nil
  def read_string(bytes, table, slot) do
    with at when at != nil <- object_offset(bytes, table, slot) do
      text = slice_bytes(bytes, at + 4, read_unsigned(bytes, at, 4))
      if String.valid?(text), do: text, else: throw_malformed("a name is not valid UTF-8")
    end
  end

  @doc "Returns the offsets of the tables in a vector."
  @spec table_offsets(binary(), non_neg_integer(), non_neg_integer()) :: [non_neg_integer()]
  def table_offsets(bytes, table, slot) do
    {at, count} = vector_bounds(bytes, table, slot, 4)

    for i <- 0..(count - 1)//1 do
      position = at + 4 * i
      position + read_unsigned(bytes, position, 4)
    end
  end

  @doc "Reads the structs of a vector, each `size` bytes long."
  @spec read_structs(binary(), non_neg_integer(), non_neg_integer(), pos_integer()) :: [binary()]
  def read_structs(bytes, table, slot, size) do
    {at, count} = vector_bounds(bytes, table, slot, size)
    for i <- 0..(count - 1)//1, do: slice_bytes(bytes, at + size * i, size)
  end

  # Returns the offset of the first element and the number of elements, which is limited by the number of bytes.
  defp vector_bounds(bytes, table, slot, size) do
    case object_offset(bytes, table, slot) do
      nil ->
        {0, 0}

      at ->
        count = read_unsigned(bytes, at, 4)
        if count * size > byte_size(bytes), do: throw_malformed("a vector extends beyond the end")
        {at + 4, count}
    end
  end

  defp field_offset(bytes, table, slot) do
    vtable = table - read_signed(bytes, table, 4, :i32)
    if vtable < 0, do: throw_malformed("a table has no vtable")
    size = read_unsigned(bytes, vtable, 2)

    if 4 + 2 * slot + 2 <= size do
      case read_unsigned(bytes, vtable + 4 + 2 * slot, 2) do
        0 -> nil
        offset -> table + offset
      end
    end
  end

  defp read_unsigned(bytes, at, size),
    do: bytes |> slice_bytes(at, size) |> :binary.decode_unsigned(:little)

  defp read_signed(bytes, at, size, :u8), do: read_unsigned(bytes, at, size)

  defp read_signed(bytes, at, size, _kind) do
    bits = size * 8
    n = read_unsigned(bytes, at, size)
    if n >= 1 <<< (bits - 1), do: n - (1 <<< bits), else: n
  end

  defp slice_bytes(bytes, at, size) when at >= 0 and at + size <= byte_size(bytes),
    do: binary_part(bytes, at, size)

  defp slice_bytes(_bytes, _at, _size),
    do: throw_malformed("an offset in its metadata is out of range")

  defp throw_malformed(why), do: throw({:not_arrow, why})
end
