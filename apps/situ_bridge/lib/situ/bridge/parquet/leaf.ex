defmodule Situ.Bridge.Parquet.Leaf do
  @moduledoc false
  # A column of plain values: their representation in Parquet, and their meaning. Pure.

  # The factors to nanoseconds for the legacy converted types, and for the units of the logical types.
  @legacy_kinds %{
    6 => {:times, 86_400_000_000_000},
    7 => {:times, 1_000_000},
    8 => {:times, 1_000},
    9 => {:times, 1_000_000},
    10 => {:times, 1_000}
  }
  @units %{1 => {:times, 1_000_000}, 2 => {:times, 1_000}, 3 => nil}
  @unsigned %{11 => 8, 12 => 16, 13 => 32, 14 => 64}
  @max_digits 76

  @enforce_keys [:at, :name, :type]
  defstruct [:at, :name, :type, :meaning, length: 0, definition: 0, repetition: 0, time?: false]

  @typedoc "`at` is the leaf's index in its row group; `definition` and `repetition` are the maximum levels."
  @type t :: %__MODULE__{
          at: non_neg_integer(),
          name: String.t(),
          type: 0..7,
          length: non_neg_integer(),
          definition: non_neg_integer(),
          repetition: non_neg_integer(),
          meaning: atom() | {atom(), term()},
          time?: boolean()
        }

  @doc "Builds the leaf of a schema element with its levels."
  @spec new(map(), non_neg_integer(), non_neg_integer(), non_neg_integer()) :: t()
  def new(element, at, definition, repetition) do
    time? = match?(%{8 => _}, element[10]) or element[6] in [9, 10] or element[1] == 3

    %__MODULE__{
      at: at,
      name: element[4],
      type: element[1],
      length: if(is_integer(element[2]), do: element[2], else: 0),
      definition: definition,
      repetition: repetition,
      meaning:
        if(element[1] in [6, 7], do: bytes_meaning(element), else: number_meaning(element)),
      time?: time?
    }
  end

  defp bytes_meaning(%{6 => 5, 7 => scale}) when scale in 0..@max_digits, do: {:decimal, scale}

  defp bytes_meaning(%{10 => %{5 => decimal}}) when is_map(decimal),
    do: decimal_scale(:decimal, decimal)

  defp bytes_meaning(%{10 => %{14 => _}, 2 => 16}), do: :uuid
  defp bytes_meaning(%{10 => %{15 => _}, 2 => 2}), do: :half
  defp bytes_meaning(_), do: nil

  # Timestamps and times of day.
  defp number_meaning(%{10 => %{8 => %{2 => unit}}}) when map_size(unit) == 1, do: time_unit(unit)
  defp number_meaning(%{10 => %{7 => %{2 => unit}}}) when map_size(unit) == 1, do: time_unit(unit)
  defp number_meaning(%{6 => 5, 7 => scale}) when scale in 0..38, do: {:scale, scale}

  defp number_meaning(%{6 => kind}) when is_map_key(@unsigned, kind),
    do: {:unsigned, @unsigned[kind]}

  defp number_meaning(%{6 => kind}) when is_map_key(@legacy_kinds, kind), do: @legacy_kinds[kind]

  defp number_meaning(%{10 => %{5 => decimal}}) when is_map(decimal),
    do: decimal_scale(:scale, decimal)

  # Some writers no longer set the legacy converted types.
  defp number_meaning(%{10 => %{6 => date}}) when is_map(date), do: @legacy_kinds[6]

  defp number_meaning(%{10 => %{10 => %{1 => bits, 2 => false}}}) when bits in [8, 16, 32, 64],
    do: {:unsigned, bits}

  defp number_meaning(_), do: nil

  defp time_unit(unit), do: @units[unit |> Map.keys() |> hd()]

  defp decimal_scale(kind, decimal) do
    scale = decimal[1] || 0
    if scale in 0..@max_digits, do: {kind, scale}
  end

  @doc """
  Converts the bytes of a value according to their meaning.

      iex> alias Situ.Bridge.Parquet.Leaf
      iex> {Leaf.convert_bytes(<<255, 6>>, {:decimal, 2}), Leaf.convert_bytes(<<0, 0x3E>>, :half)}
      {-2.5, 1.5}
      iex> Leaf.convert_bytes("x", nil)
      "x"
  """
  @spec convert_bytes(binary(), atom() | {atom(), term()}) :: term()
  def convert_bytes(bytes, {:decimal, scale}) when byte_size(bytes) in 1..32 do
    size = bit_size(bytes)
    <<n::signed-size(size)>> = bytes
    n / Integer.pow(10, scale)
  end

  def convert_bytes(<<a::binary-4, b::binary-2, c::binary-2, d::binary-2, e::binary-6>>, :uuid),
    do: Enum.map_join([a, b, c, d, e], "-", &Base.encode16(&1, case: :lower))

  def convert_bytes(<<half::binary-2>>, :half), do: Situ.Number.decode_float(half)
  def convert_bytes(bytes, _), do: bytes
end
