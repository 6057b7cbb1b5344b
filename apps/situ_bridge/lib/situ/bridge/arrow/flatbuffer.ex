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
  @spec encode(t()) :: binary()
  def encode({:table, _} = root) do
    {bytes, start} = put(root, 4)
    IO.iodata_to_binary([<<start::little-32>>, bytes])
  end

  # Returns the bytes from `at` on, and the offset of the object.
  defp put({:string, text}, at) do
    start = aligned(at, 4)
    {[pad(at, start), <<byte_size(text)::little-32>>, text, 0], start}
  end

  defp put({:structs, structs}, at) do
    start = aligned(at + 4, 8) - 4
    {[pad(at, start), <<length(structs)::little-32>>, structs], start}
  end

  defp put({:vector, objects}, at) do
    start = aligned(at, 4)
    count = length(objects)
    places = for i <- 0..(count - 1)//1, do: start + 4 + 4 * i
    {offsets, children, _end} = point(Enum.zip(places, objects), start + 4 + 4 * count)
    words = for place <- places, do: <<offsets[place]::little-32>>
    {[pad(at, start), <<count::little-32>>, words, children], start}
  end

  defp put({:table, fields}, at) do
    slots = fields |> Enum.map(&elem(&1, 0)) |> Enum.max(fn -> -1 end)
    vtable = aligned(at, 2)
    start = aligned(vtable + 4 + 2 * (slots + 1), 8)

    {placed, till} =
      Enum.map_reduce(fields, start + 4, fn {slot, {kind, value}}, at ->
        place = aligned(at, @sizes[kind])
        {{slot, place, kind, value}, place + @sizes[kind]}
      end)

    {offsets, children, _end} =
      point(for({_slot, place, :ref, object} <- placed, do: {place, object}), till)

    places = Map.new(placed, fn {slot, place, _, _} -> {slot, place - start} end)
    slots = for slot <- 0..slots//1, do: <<Map.get(places, slot, 0)::little-16>>
    size = 4 + IO.iodata_length(slots)

    {inline, _} =
      Enum.map_reduce(placed, start + 4, fn {_, place, kind, value}, at ->
        value = if kind == :ref, do: offsets[place], else: value
        {[pad(at, place), scalar(kind, value)], place + @sizes[kind]}
      end)

    head = [<<size::little-16, till - start::little-16>>, slots]

    {[
       pad(at, vtable),
       head,
       pad(vtable + size, start),
       <<start - vtable::little-signed-32>>,
       inline,
       children
     ], start}
  end

  # Puts objects one after another from `at` on; returns the offset of each, relative to the field that refers to it.
  defp point(placed, at) do
    Enum.reduce(placed, {%{}, [], at}, fn {place, object}, {offsets, bytes, at} ->
      {more, start} = put(object, at)
      {Map.put(offsets, place, start - place), [bytes, more], at + IO.iodata_length(more)}
    end)
  end

  defp scalar(:bool, value), do: if(value, do: <<1>>, else: <<0>>)
  defp scalar(:u8, value), do: <<value>>
  defp scalar(:i16, value), do: <<value::little-16>>
  defp scalar(kind, value) when kind in [:i32, :ref], do: <<value::little-32>>
  defp scalar(:i64, value), do: <<value::little-64>>

  defp aligned(at, n), do: at + n - 1 &&& bnot(n - 1)
  defp pad(from, to), do: <<0::size((to - from) * 8)>>

  @doc "Returns the offset of the root table."
  @spec root(binary()) :: non_neg_integer()
  def root(bytes), do: unsigned(bytes, 0, 4)

  @doc "Reads the number in `slot` of a table, or returns `default` if the field is absent."
  @spec number(binary(), non_neg_integer(), non_neg_integer(), field_kind, integer()) :: integer()
        when field_kind: :u8 | :i16 | :i32 | :i64
  def number(bytes, table, slot, kind, default) do
    case place(bytes, table, slot) do
      nil -> default
      at -> signed(bytes, at, @sizes[kind], kind)
    end
  end

  @doc "Returns the offset of the object that `slot` refers to, or `nil`."
  @spec object(binary(), non_neg_integer(), non_neg_integer()) :: non_neg_integer() | nil
  def object(bytes, table, slot) do
    with at when at != nil <- place(bytes, table, slot), do: at + unsigned(bytes, at, 4)
  end

  @doc "Reads the string in `slot` of a table, or returns `nil` if the field is absent."
  @spec string(binary(), non_neg_integer(), non_neg_integer()) :: String.t() | nil
  def string(bytes, table, slot) do
    with at when at != nil <- object(bytes, table, slot) do
      text = part(bytes, at + 4, unsigned(bytes, at, 4))
      if String.valid?(text), do: text, else: fail("a name is not valid UTF-8")
    end
  end

  @doc "Returns the offsets of the tables in a vector."
  @spec tables(binary(), non_neg_integer(), non_neg_integer()) :: [non_neg_integer()]
  def tables(bytes, table, slot) do
    {at, count} = vector(bytes, table, slot, 4)

    for i <- 0..(count - 1)//1 do
      place = at + 4 * i
      place + unsigned(bytes, place, 4)
    end
  end

  @doc "Reads the structs of a vector, each `size` bytes long."
  @spec structs(binary(), non_neg_integer(), non_neg_integer(), pos_integer()) :: [binary()]
  def structs(bytes, table, slot, size) do
    {at, count} = vector(bytes, table, slot, size)
    for i <- 0..(count - 1)//1, do: part(bytes, at + size * i, size)
  end

  # Returns the offset of the first element and the number of elements, which is limited by the number of bytes.
  defp vector(bytes, table, slot, size) do
    case object(bytes, table, slot) do
      nil ->
        {0, 0}

      at ->
        count = unsigned(bytes, at, 4)
        if count * size > byte_size(bytes), do: fail("a vector extends beyond the end")
        {at + 4, count}
    end
  end

  defp place(bytes, table, slot) do
    vtable = table - signed(bytes, table, 4, :i32)
    if vtable < 0, do: fail("a table has no vtable")
    size = unsigned(bytes, vtable, 2)

    if 4 + 2 * slot + 2 <= size do
      case unsigned(bytes, vtable + 4 + 2 * slot, 2) do
        0 -> nil
        offset -> table + offset
      end
    end
  end

  defp unsigned(bytes, at, size), do: bytes |> part(at, size) |> :binary.decode_unsigned(:little)

  defp signed(bytes, at, size, :u8), do: unsigned(bytes, at, size)

  defp signed(bytes, at, size, _kind) do
    bits = size * 8
    n = unsigned(bytes, at, size)
    if n >= 1 <<< (bits - 1), do: n - (1 <<< bits), else: n
  end

  defp part(bytes, at, size) when at >= 0 and at + size <= byte_size(bytes),
    do: binary_part(bytes, at, size)

  defp part(_bytes, _at, _size), do: fail("an offset in its metadata is out of range")
  defp fail(why), do: throw({:not_arrow, why})
end
