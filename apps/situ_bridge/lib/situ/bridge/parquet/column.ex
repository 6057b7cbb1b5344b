defmodule Situ.Bridge.Parquet.Column do
  @moduledoc false
  # A column: what it is called, what it holds, and its values as bytes (encoding PLAIN, with levels of definition where
  # values may be missing). Pure.
  import Bitwise
  alias Situ.Bridge.Parquet.Thrift

  @enforce_keys [:name, :kind]
  defstruct [:name, :kind, optional?: true]

  @type kind :: :time | :integer | :float | :boolean | :text | :bytes
  @type t :: %__MODULE__{name: String.t(), kind: kind(), optional?: boolean()}

  # Parquet's physical types.
  @physical %{time: 2, integer: 2, float: 5, boolean: 0, text: 6, bytes: 6}
  @special %{
    nan: <<0, 0, 0, 0, 0, 0, 0xF8, 0x7F>>,
    infinity: <<0, 0, 0, 0, 0, 0, 0xF0, 0x7F>>,
    neg_infinity: <<0, 0, 0, 0, 0, 0, 0xF0, 0xFF>>
  }

  @spec physical(t()) :: non_neg_integer()
  def physical(column), do: @physical[column.kind]

  @doc "The column in the file's schema."
  @spec element(t()) :: {:struct, list()}
  def element(column) do
    logical =
      case column.kind do
        :time ->
          [{10, record([{8, record([{1, {:bool, true}}, {2, record([{3, record([])}])}])}])}]

        :text ->
          [{6, {:i32, 0}}, {10, record([{1, record([])}])}]

        _ ->
          []
      end

    record([
      {1, {:i32, physical(column)}},
      {3, {:i32, if(column.optional?, do: 1, else: 0)}},
      {4, {:binary, column.name}} | logical
    ])
  end

  defp record(fields), do: {:struct, fields}

  @doc """
  A page's body: the levels and the values; `nil` is missing. `{:bytes, bytes, n}` are the bytes of `n` numbers
  (truths: one each), of which none is missing.
  """
  @spec page(t(), [term()] | {:bytes, binary(), pos_integer()}) :: iodata()
  def page(%{optional?: false}, {:bytes, bytes, _n}), do: bytes

  def page(column, {:bytes, bytes, n}) do
    levels = levels([], n, n)

    body =
      if column.kind == :boolean,
        do: eights(for(<<b <- bytes>>, into: <<>>, do: <<b::1>>)),
        else: bytes

    [<<IO.iodata_length(levels)::little-32>>, levels, body]
  end

  def page(%{optional?: false} = column, values), do: plain(column.kind, values)

  def page(column, values) do
    there = Enum.reject(values, &is_nil/1)
    levels = levels(values, length(values), length(there))
    [<<IO.iodata_length(levels)::little-32>>, levels, plain(column.kind, there)]
  end

  # One run where all is there; else a bit each, in eights.
  defp levels(_values, n, n), do: [Thrift.varint(n <<< 1), 1]

  defp levels(values, n, _there) do
    bits = for v <- values, into: <<>>, do: if(v == nil, do: <<0::1>>, else: <<1::1>>)
    [Thrift.varint(div(n + 7, 8) <<< 1 ||| 1), eights(bits)]
  end

  # The first of eight is the lowest.
  defp eights(<<a::1, b::1, c::1, d::1, e::1, f::1, g::1, h::1, rest::bitstring>>),
    do: [<<h::1, g::1, f::1, e::1, d::1, c::1, b::1, a::1>> | eights(rest)]

  defp eights(<<>>), do: []
  defp eights(few), do: eights(<<few::bitstring, 0::size(8 - bit_size(few))>>)

  defp plain(kind, values) when kind in [:time, :integer],
    do: for(n <- values, into: <<>>, do: <<n::little-signed-64>>)

  defp plain(:float, values) do
    for x <- values,
        into: <<>>,
        do: if(is_number(x), do: <<x::little-float-64>>, else: @special[x])
  end

  defp plain(:boolean, values),
    do: eights(for(b <- values, into: <<>>, do: if(b, do: <<1::1>>, else: <<0::1>>)))

  defp plain(_text, values), do: for(text <- values, do: [<<byte_size(text)::little-32>>, text])
end
