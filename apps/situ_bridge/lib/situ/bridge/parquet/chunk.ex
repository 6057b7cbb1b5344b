defmodule Situ.Bridge.Parquet.Chunk do
  @moduledoc false
  # Reads the values of a column in one row group page by page and returns a few rows at a time, so that memory holds
  # only one page and these rows. Throws `{:not_parquet, why}`, and everything that `read` throws.
  alias Situ.Bridge.Columnar.Input
  alias Situ.Bridge.Parquet.{Leaf, Page, Thrift}

  @head 4_096
  @small 65_536
  # Levels compress well, so a small file could claim a huge number of values for one row.
  @most_entries 20_000_000
  @enforce_keys [:leaf, :read, :at, :ends, :packing, :left, :nested?]
  defstruct @enforce_keys ++ [dictionary: nil, page: nil, row: [], row_size: 0]

  @typedoc """
  The position of the chunk in the file, its compression and its number of values. `nested?` values are returned as
  the entries of a row.
  """
  @type place :: %{
          at: non_neg_integer(),
          size: non_neg_integer(),
          packing: Page.packing(),
          count: non_neg_integer(),
          nested?: boolean()
        }

  @typedoc "`left` is the number of values in unread pages, `row` the entries of an incomplete row."
  @type t :: %__MODULE__{}

  @spec start_reading(Leaf.t(), place(), Input.read()) :: t()
  def start_reading(leaf, place, read) do
    %__MODULE__{
      leaf: leaf,
      read: read_chunk(place, read),
      at: place.at,
      ends: place.at + place.size,
      packing: place.packing,
      left: place.count,
      nested?: place.nested?
    }
  end

  # A small chunk is read in one call, since each read switches to another thread.
  defp read_chunk(%{at: from, size: size}, read) when size in 1..@small do
    bytes = read.(from, size)
    &binary_part(bytes, &1 - from, &2)
  end

  defp read_chunk(_place, read), do: read

  @doc "Takes at most `most` rows: one value per row, or all entries of a nested row."
  @spec take_rows(t(), pos_integer()) :: {[term()], t()}
  def take_rows(chunk, most), do: take_rows(chunk, most, [])

  defp take_rows(chunk, 0, found), do: {concat_reversed(found), chunk}

  defp take_rows(%{page: nil, left: 0} = chunk, _missing, found) do
    case chunk.row do
      [] -> {concat_reversed(found), chunk}
      row -> {concat_reversed([[Enum.reverse(row)] | found]), %{chunk | row: [], row_size: 0}}
    end
  end

  defp take_rows(%{page: nil} = chunk, missing, found),
    do: chunk |> read_page() |> take_rows(missing, found)

  defp take_rows(%{page: %{left: 0}} = chunk, missing, found),
    do: take_rows(%{chunk | page: nil}, missing, found)

  defp take_rows(%{nested?: false} = chunk, missing, found) do
    {rows, page} = Page.take_values(chunk.page, min(missing, chunk.page.left))
    take_rows(%{chunk | page: page}, missing - length(rows), [rows | found])
  end

  # `n` entries complete at most `n` rows.
  defp take_rows(chunk, missing, found) do
    {entries, page} = Page.take_entries(chunk.page, min(missing, chunk.page.left))
    {row, size, rows} = Enum.reduce(entries, {chunk.row, chunk.row_size, []}, &put_entry/2)
    rows = Enum.reverse(rows)
    chunk = %{chunk | page: page, row: row, row_size: size}
    take_rows(chunk, missing - length(rows), [rows | found])
  end

  defp concat_reversed(found), do: found |> Enum.reverse() |> Enum.concat()

  # An entry with repetition level 0 begins a new row.
  defp put_entry({0, _, _} = entry, {[], 0, rows}), do: {[entry], 1, rows}
  defp put_entry({0, _, _} = entry, {row, _, rows}), do: {[entry], 1, [Enum.reverse(row) | rows]}

  defp put_entry(_entry, {[], 0, _rows}),
    do: throw_malformed("a column begins in the middle of a row")

  defp put_entry(_entry, {_row, size, _rows}) when size >= @most_entries,
    do: throw_malformed("a row has more than #{@most_entries} values")

  defp put_entry(entry, {row, size, rows}), do: {[entry | row], size + 1, rows}

  defp read_page(%{leaf: leaf} = chunk) do
    {head, at} = read_head(chunk, @head)
    stored = Page.stored_size(head, chunk.ends - at)
    body = chunk.read.(at, stored)
    chunk = %{chunk | at: at + stored}

    if head[1] == 2 do
      dictionary = Page.decode_dictionary(head, body, leaf, chunk.packing)
      read_page(%{chunk | dictionary: dictionary})
    else
      column = {leaf, chunk.packing, chunk.dictionary}

      case Page.start_decoding(head, body, column, chunk.left) do
        nil -> read_page(chunk)
        page -> %{chunk | page: page, left: chunk.left - page.left}
      end
    end
  end

  # Headers are small unless they contain statistics of long strings.
  defp read_head(%{at: at, ends: ends} = chunk, most) do
    bytes = chunk.read.(at, min(most, ends - at))

    try do
      {head, rest} = Thrift.decode_struct(bytes)
      {head, at + byte_size(bytes) - byte_size(rest)}
    catch
      {:not_parquet, _cut_short} when most < ends - at -> read_head(chunk, most * 16)
    end
  end

  defp throw_malformed(why), do: throw({:not_parquet, why})
end
