defmodule Situ.Bridge.Parquet.Chunk do
  @moduledoc false
  # Reads the values of a column in one row group page by page and returns a few rows at a time, so that memory holds
  # only one page and these rows. Throws `{:not_parquet, why}`, and everything that `read` throws.
  alias Situ.Bridge.Columnar.Input
  alias Situ.Bridge.Parquet.{Leaf, Page, Thrift}

  @head_bytes 4_096
  @small_chunk 65_536
  # Levels compress well, so a small file could claim a huge number of values for one row.
  @max_entries 20_000_000
  @enforce_keys [:leaf, :read, :at, :stop, :packing, :remaining, :nested?]
  defstruct @enforce_keys ++ [dictionary: nil, page: nil, row: [], row_size: 0]

  @typedoc """
  The position of the chunk in the file, its compression and its number of values. `nested?` values are returned as
  the entries of a row.
  """
  @type location :: %{
          at: non_neg_integer(),
          size: non_neg_integer(),
          packing: Page.packing(),
          count: non_neg_integer(),
          nested?: boolean()
        }

  @typedoc "`remaining` is the number of values in unread pages, `row` the entries of an incomplete row."
  @type t :: %__MODULE__{}

  @spec start_reading(Leaf.t(), location(), Input.read()) :: t()
  def start_reading(leaf, location, read) do
    %__MODULE__{
      leaf: leaf,
      read: read_chunk(location, read),
      at: location.at,
      stop: location.at + location.size,
      packing: location.packing,
      remaining: location.count,
      nested?: location.nested?
    }
  end

  # A small chunk is read in one call, since each read switches to another thread.
  defp read_chunk(%{at: from, size: size}, read) when size in 1..@small_chunk do
    bytes = read.(from, size)
    &binary_part(bytes, &1 - from, &2)
  end

  defp read_chunk(_position, read), do: read

  @doc "Takes at most `max` rows: one value per row, or all entries of a nested row."
  @spec take_rows(t(), pos_integer()) :: {[term()], t()}
  def take_rows(chunk, max), do: take_rows(chunk, max, [])

  defp take_rows(chunk, 0, groups), do: {concat_reversed(groups), chunk}

  defp take_rows(%{page: nil, remaining: 0} = chunk, _count, groups) do
    case chunk.row do
      [] -> {concat_reversed(groups), chunk}
      row -> {concat_reversed([[Enum.reverse(row)] | groups]), %{chunk | row: [], row_size: 0}}
    end
  end

  defp take_rows(%{page: nil} = chunk, count, groups),
    do: chunk |> read_page() |> take_rows(count, groups)

  defp take_rows(%{page: %{remaining: 0}} = chunk, count, groups),
    do: take_rows(%{chunk | page: nil}, count, groups)

  defp take_rows(%{nested?: false} = chunk, count, groups) do
    {rows, page} = Page.take_values(chunk.page, min(count, chunk.page.remaining))
    take_rows(%{chunk | page: page}, count - length(rows), [rows | groups])
  end

  # `count` entries complete at most `count` rows.
  defp take_rows(chunk, count, groups) do
    {entries, page} = Page.take_entries(chunk.page, min(count, chunk.page.remaining))
    {row, size, rows} = Enum.reduce(entries, {chunk.row, chunk.row_size, []}, &put_entry/2)
    rows = Enum.reverse(rows)
    chunk = %{chunk | page: page, row: row, row_size: size}
    take_rows(chunk, count - length(rows), [rows | groups])
  end

  defp concat_reversed(groups), do: groups |> Enum.reverse() |> Enum.concat()

  # An entry with repetition level 0 begins a new row.
  defp put_entry({0, _, _} = entry, {[], 0, rows}), do: {[entry], 1, rows}
  defp put_entry({0, _, _} = entry, {row, _, rows}), do: {[entry], 1, [Enum.reverse(row) | rows]}

  defp put_entry(_entry, {[], 0, _rows}),
    do: throw_malformed("a column begins in the middle of a row")

  defp put_entry(_entry, {_row, size, _rows}) when size >= @max_entries,
    do: throw_malformed("a row has more than #{@max_entries} values")

  defp put_entry(entry, {row, size, rows}), do: {[entry | row], size + 1, rows}

  defp read_page(%{leaf: leaf} = chunk) do
    {head, at} = read_head(chunk, @head_bytes)
    stored = Page.stored_size(head, chunk.stop - at)
    body = chunk.read.(at, stored)
    chunk = %{chunk | at: at + stored}

    if head[1] == 2 do
      dictionary = Page.decode_dictionary(head, body, leaf, chunk.packing)
      read_page(%{chunk | dictionary: dictionary})
    else
      column = {leaf, chunk.packing, chunk.dictionary}

      case Page.start_decoding(head, body, column, chunk.remaining) do
        nil -> read_page(chunk)
        page -> %{chunk | page: page, remaining: chunk.remaining - page.remaining}
      end
    end
  end

  # Headers are small unless they contain statistics of long strings.
  defp read_head(%{at: at, stop: stop} = chunk, max) do
    bytes = chunk.read.(at, min(max, stop - at))

    try do
      {head, rest} = Thrift.decode_struct(bytes)
      {head, at + byte_size(bytes) - byte_size(rest)}
    catch
      {:not_parquet, _cut_short} when max < stop - at -> read_head(chunk, max * 16)
    end
  end

  defp throw_malformed(why), do: throw({:not_parquet, why})
end
