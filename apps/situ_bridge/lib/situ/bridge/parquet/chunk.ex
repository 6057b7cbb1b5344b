defmodule Situ.Bridge.Parquet.Chunk do
  @moduledoc false
  # Reads the values of a column in one row group page by page, and returns a few rows at a time, so that memory holds
  # one page and these rows. Throws `{:not_parquet, why}`, and whatever `read` throws.
  alias Situ.Bridge.Columnar.Input
  alias Situ.Bridge.Parquet.{Leaf, Page, Thrift}

  @head 4_096
  @small 65_536
  # A small file could name very many values of one row, since levels pack well.
  @most_entries 20_000_000
  @enforce_keys [:leaf, :read, :at, :ends, :packing, :left, :nested?]
  defstruct @enforce_keys ++ [dictionary: nil, page: nil, row: [], row_size: 0]

  @typedoc """
  Where the chunk is in the file, how it is packed, and how many values it has; `nested?` values come as the entries of
  a row.
  """
  @type place :: %{
          at: non_neg_integer(),
          size: non_neg_integer(),
          packing: Page.packing(),
          count: non_neg_integer(),
          nested?: boolean()
        }

  @typedoc "`left` are the values of the pages that are not read yet, `row` the entries of a row that has begun."
  @type t :: %__MODULE__{}

  @spec start(Leaf.t(), place(), Input.read()) :: t()
  def start(leaf, place, read) do
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

  # A small chunk is read at once, since each read switches to another thread.
  defp read_chunk(%{at: from, size: size}, read) when size in 1..@small do
    bytes = read.(from, size)
    &binary_part(bytes, &1 - from, &2)
  end

  defp read_chunk(_place, read), do: read

  @doc "Takes the next `most` rows, or all there are: a value each, or all entries of the row."
  @spec take_rows(t(), pos_integer()) :: {[term()], t()}
  def take_rows(chunk, most), do: take_rows(chunk, most, [])

  defp take_rows(chunk, 0, found), do: {concat(found), chunk}

  defp take_rows(%{page: nil, left: 0} = chunk, _missing, found) do
    case chunk.row do
      [] -> {concat(found), chunk}
      row -> {concat([[Enum.reverse(row)] | found]), %{chunk | row: [], row_size: 0}}
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

  # A number of entries ends at most as many rows.
  defp take_rows(chunk, missing, found) do
    {entries, page} = Page.take_entries(chunk.page, min(missing, chunk.page.left))
    {row, size, rows} = Enum.reduce(entries, {chunk.row, chunk.row_size, []}, &put_entry/2)
    rows = Enum.reverse(rows)
    chunk = %{chunk | page: page, row: row, row_size: size}
    take_rows(chunk, missing - length(rows), [rows | found])
  end

  defp concat(found), do: found |> Enum.reverse() |> Enum.concat()

  # A row begins where nothing is repeated.
  defp put_entry({0, _, _} = entry, {[], 0, rows}), do: {[entry], 1, rows}
  defp put_entry({0, _, _} = entry, {row, _, rows}), do: {[entry], 1, [Enum.reverse(row) | rows]}
  defp put_entry(_entry, {[], 0, _rows}), do: fail("a column that begins within a row")

  defp put_entry(_entry, {_row, size, _rows}) when size >= @most_entries,
    do: fail("a row of more than #{@most_entries} values")

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

      case Page.start(head, body, column, chunk.left) do
        nil -> read_page(chunk)
        page -> %{chunk | page: page, left: chunk.left - page.left}
      end
    end
  end

  # Headers are small, but for statistics of long texts.
  defp read_head(%{at: at, ends: ends} = chunk, most) do
    bytes = chunk.read.(at, min(most, ends - at))

    try do
      {head, rest} = Thrift.read(bytes)
      {head, at + byte_size(bytes) - byte_size(rest)}
    catch
      {:not_parquet, _cut_short} when most < ends - at -> read_head(chunk, most * 16)
    end
  end

  defp fail(why), do: throw({:not_parquet, why})
end
