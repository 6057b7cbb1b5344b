defmodule Situ.Bridge.Psi.Layout do
  @moduledoc false
  # Reads plain values in the memory layout of .NET: primitives, and structs of primitives with alignment gaps.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.Bridge.Psi.Bytes
  alias Situ.Number

  @type t ::
          atom()
          | {:struct | :tuple, pos_integer(), pos_integer(),
             [{String.t(), non_neg_integer(), t()}]}

  # {size, alignment}
  @primitives %{
    bool: {1, 1},
    int8: {1, 1},
    uint8: {1, 1},
    int16: {2, 2},
    uint16: {2, 2},
    char: {2, 2},
    int32: {4, 4},
    uint32: {4, 4},
    int64: {8, 8},
    uint64: {8, 8},
    float32: {4, 4},
    float64: {8, 8},
    datetime: {8, 8},
    timespan: {8, 8},
    decimal: {16, 8},
    guid: {16, 4}
  }

  @names %{
    "System.Boolean" => :bool,
    "System.SByte" => :int8,
    "System.Byte" => :uint8,
    "System.Int16" => :int16,
    "System.UInt16" => :uint16,
    "System.Char" => :char,
    "System.Int32" => :int32,
    "System.UInt32" => :uint32,
    "System.Int64" => :int64,
    "System.UInt64" => :uint64,
    "System.IntPtr" => :int64,
    "System.UIntPtr" => :uint64,
    "System.Single" => :float32,
    "System.Double" => :float64,
    "System.DateTime" => :datetime,
    "System.TimeSpan" => :timespan,
    "System.Decimal" => :decimal,
    "System.Guid" => :guid
  }

  @doc "Returns the layout of a primitive by its .NET name, or nil."
  @spec find_primitive(String.t()) :: atom() | nil
  def find_primitive(name), do: @names[name]

  @doc "Returns whether the type is a primitive in .NET, where times, decimals and Guids are structs."
  @spec clr_primitive?(String.t()) :: boolean()
  def clr_primitive?(name),
    do: find_primitive(name) not in [nil, :datetime, :timespan, :decimal, :guid]

  @doc "Returns the size of a value in bytes, including the alignment gap after it in an array."
  @spec value_size(t()) :: pos_integer()
  def value_size({_struct, size, _align, _fields}), do: size
  def value_size(primitive), do: elem(Map.fetch!(@primitives, primitive), 0)

  defp value_alignment({_struct, _size, align, _fields}), do: align
  defp value_alignment(primitive), do: elem(Map.fetch!(@primitives, primitive), 1)

  @doc """
  Returns the layout of a struct. Its fields are in order, each at a multiple of its alignment.

      iex> Situ.Bridge.Psi.Layout.struct_layout([{"hasValue", :bool}, {"value", :float64}])
      {:struct, 16, 8, [{"hasValue", 0, :bool}, {"value", 8, :float64}]}
  """
  @spec struct_layout([{String.t(), t()}]) :: t()
  def struct_layout(fields) do
    {positioned, size} =
      Enum.map_reduce(fields, 0, fn {name, layout}, at ->
        at = align_offset(at, value_alignment(layout))
        {{name, at, layout}, at + value_size(layout)}
      end)

    alignment = fields |> Enum.map(&value_alignment(elem(&1, 1))) |> Enum.max(fn -> 1 end)
    {:struct, max(align_offset(size, alignment), 1), alignment, positioned}
  end

  @doc """
  Returns the layout of a tuple. The runtime orders its items by size; the decoded tuple has them in their own order.

      iex> Situ.Bridge.Psi.Layout.tuple_layout([{"Item1", :bool}, {"Item2", :float64}])
      {:tuple, 16, 8, [{"Item1", 8, :bool}, {"Item2", 0, :float64}]}
  """
  @spec tuple_layout([{String.t(), t()}]) :: t()
  def tuple_layout(fields) do
    {:struct, size, align, positioned} =
      fields
      |> Enum.sort_by(fn {_, layout} -> -value_size(layout) end)
      |> __MODULE__.struct_layout()

    {:tuple, size, align, for({name, _} <- fields, do: List.keyfind(positioned, name, 0))}
  end

  defp align_offset(at, to), do: div(at + to - 1, to) * to

  @doc """
  Reads the value in `bytes`, whose size must be `value_size/1`. A struct with the single field `value__` is an enum and
  returns an integer.
  """
  @spec read_value(t(), binary()) :: term()
  def read_value({:struct, _, _, [{"value__", 0, layout}]}, bytes), do: read_value(layout, bytes)
  def read_value({:struct, _, _, [{"m_value", 0, layout}]}, bytes), do: read_value(layout, bytes)

  def read_value({:struct, _, _, [{"hasValue", 0, :bool}, {"value", at, layout}]}, bytes) do
    if :binary.first(bytes) == 0,
      do: nil,
      else: read_value(layout, binary_part(bytes, at, value_size(layout)))
  end

  def read_value({:tuple, _, _, fields}, bytes) do
    fields
    |> Enum.map(fn {_, at, layout} ->
      read_value(layout, binary_part(bytes, at, value_size(layout)))
    end)
    |> List.to_tuple()
  end

  def read_value({:struct, _, _, fields}, bytes) do
    Map.new(fields, fn {name, at, layout} ->
      {name, read_value(layout, binary_part(bytes, at, value_size(layout)))}
    end)
  end

  def read_value(:bool, <<b>>), do: b != 0
  def read_value(:int8, <<n::signed-8>>), do: n
  def read_value(:uint8, <<n>>), do: n
  def read_value(:int16, <<n::little-signed-16>>), do: n
  def read_value(:uint16, <<n::little-16>>), do: n
  def read_value(:int32, <<n::little-signed-32>>), do: n
  def read_value(:uint32, <<n::little-32>>), do: n
  def read_value(:int64, <<n::little-signed-64>>), do: n
  def read_value(:uint64, <<n::little-64>>), do: n
  def read_value(kind, bytes) when kind in [:float32, :float64], do: Number.decode_float(bytes)
  def read_value(:datetime, <<n::little-64>>), do: Bytes.parse_time(n)
  def read_value(:timespan, <<n::little-signed-64>>), do: n * 100

  def read_value(:char, <<c::little-16>>) when c in 0xD800..0xDFFF, do: "\uFFFD"
  def read_value(:char, <<c::little-16>>), do: <<c::utf8>>

  def read_value(:guid, <<a::little-32, b::little-16, c::little-16, d::binary-2, e::binary-6>>) do
    [<<a::32>>, <<b::16>>, <<c::16>>, d, e]
    |> Enum.map_join("-", &Base.encode16(&1, case: :lower))
  end

  # The sign and the number of decimals come first, followed by a 96-bit integer.
  def read_value(:decimal, <<_::16, scale, sign, high::little-32, low::little-64>>) do
    digits = Integer.to_string(Bitwise.bsl(high, 64) + low)
    minus = if Bitwise.band(sign, 0x80) != 0, do: "-", else: ""
    minus <> insert_point(digits, scale)
  end

  defp insert_point(digits, 0), do: digits

  defp insert_point(digits, scale) do
    digits = String.pad_leading(digits, scale + 1, "0")
    {integer, fraction} = String.split_at(digits, -scale)
    integer <> "." <> fraction
  end

  @doc "Reads all values in `bytes` and returns them as a list."
  @spec read_all(t(), binary()) :: [term()]
  def read_all(:float64, bytes), do: Number.decode_floats(bytes, 8)
  def read_all(:float32, bytes), do: Number.decode_floats(bytes, 4)
  def read_all(:int32, bytes), do: for(<<n::little-signed-32 <- bytes>>, do: n)
  def read_all(:int16, bytes), do: for(<<n::little-signed-16 <- bytes>>, do: n)
  def read_all(:uint16, bytes), do: for(<<n::little-16 <- bytes>>, do: n)

  def read_all(layout, bytes) do
    size = value_size(layout)
    for <<value::binary-pinned_size(size) <- bytes>>, do: read_value(layout, value)
  end
end
