defmodule Situ.Bridge.Arrow.File do
  @moduledoc false
  # Reads an Arrow file: its columns, and the rows of its batches, a few at a time. The streaming format has no
  # footer, so its messages are scanned once when a file is opened.
  # See docs/adr/0101-parquet-and-arrow-are-plain-elixir.md and docs/adr/0201-arrow-stays-in-plain-elixir.md.
  @behaviour Situ.Bridge.Columnar.Reader
  alias Situ.Bridge.Arrow.{Batch, FlatBuffer, Schema, Values}
  alias Situ.Bridge.Columnar.Input

  @format {:not_arrow, "Arrow"}
  @max_metadata 67_108_864
  @max_body 4_294_967_296
  @slice 1_024
  @schema 1
  @dictionary 2
  @batch 3

  @enforce_keys [:path, :columns, :left_out, :times, :groups]
  defstruct @enforce_keys

  @typedoc "A group is a batch and the dictionaries that apply to it."
  @type t :: %__MODULE__{
          path: Path.t(),
          columns: [Schema.column()],
          left_out: [{String.t(), String.t()}],
          times: [String.t()],
          groups: [{Batch.block(), Batch.dictionaries()}]
        }

  # Errors: `:io`, `:not_arrow`.
  @impl true
  def open(path), do: Input.with_file(path, @format, &read_table(path, &1))

  defp read_table(path, {size, read}) do
    {{bytes, at, version}, messages} =
      case read.(0, min(8, size)) do
        "ARROW1" <> _ -> read_footer(size, read)
        <<0xFFFFFFFF::32, _::binary>> -> read_messages(size, read)
        _ -> throw_malformed("it does not begin like an Arrow file or an Arrow stream")
      end

    {columns, left_out, dictionaries} = Schema.decode_columns(bytes, at, version)

    %__MODULE__{
      path: path,
      columns: columns,
      left_out: left_out,
      times: for(%{time?: true, name: name} <- columns, do: name),
      groups: group_batches(messages, dictionaries, read)
    }
  end

  defp read_footer(size, read) do
    if size < 20, do: throw_malformed("it is too short")

    n =
      case read.(size - 10, 10) do
        <<n::little-32, "ARROW1">> when n <= @max_metadata and n + 18 <= size -> n
        _ -> throw_malformed("it does not end in ARROW1: it was truncated or never finished")
      end

    bytes = read.(size - 10 - n, n)
    root = FlatBuffer.root_offset(bytes)
    schema = FlatBuffer.object_offset(bytes, root, 1) || throw_malformed("it has no schema")

    list_blocks = fn kind, slot ->
      for block <- list_blocks(bytes, root, slot), do: {kind, block}
    end

    version = FlatBuffer.read_number(bytes, root, 0, :i16, 0)
    {{bytes, schema, version}, list_blocks.(@dictionary, 2) ++ list_blocks.(@batch, 3)}
  end

  defp list_blocks(bytes, root, slot) do
    for <<at::little-signed-64, metadata::little-signed-32, _::32, body::little-signed-64>> <-
          FlatBuffer.read_structs(bytes, root, slot, 24) do
      {at, metadata, body}
    end
  end

  # A stream ends at its end marker, or at the point where it was truncated.
  defp read_messages(size, read) do
    messages = collect_messages({size, read}, 0, [])

    case Enum.find(messages, &(elem(&1, 0) == @schema)) do
      {_, bytes, header, _block} ->
        version = FlatBuffer.read_number(bytes, FlatBuffer.root_offset(bytes), 0, :i16, 0)
        {{bytes, header, version}, for({kind, _, _, block} <- messages, do: {kind, block})}

      nil ->
        throw_malformed("it has no schema")
    end
  end

  defp collect_messages({size, read} = file, at, acc) when at + 8 <= size do
    case read.(at, 8) do
      <<0xFFFFFFFF::32, n::little-32>> when n in 1..@max_metadata and at + 8 + n <= size ->
        bytes = read.(at + 8, n)
        root = FlatBuffer.root_offset(bytes)
        kind = FlatBuffer.read_number(bytes, root, 1, :u8, 0)
        body = FlatBuffer.read_number(bytes, root, 3, :i64, 0)

        header =
          FlatBuffer.object_offset(bytes, root, 2) || throw_malformed("a message has no header")

        next = at + 8 + n + body

        if body in 0..@max_body and next <= size,
          do: collect_messages(file, next, [{kind, bytes, header, {at, n + 8, body}} | acc]),
          else: Enum.reverse(acc)

      _ ->
        Enum.reverse(acc)
    end
  end

  defp collect_messages(_file, _at, acc), do: Enum.reverse(acc)

  # A stream may replace a dictionary for the batches that follow.
  defp group_batches(messages, dictionaries, read) do
    {groups, _entries} =
      Enum.flat_map_reduce(messages, %{}, fn
        {@dictionary, block}, entries_by_id ->
          {[], put_dictionary(entries_by_id, block, dictionaries, read)}

        {@batch, block}, entries_by_id ->
          {[{block, entries_by_id}], entries_by_id}

        {_other, _block}, entries_by_id ->
          {[], entries_by_id}
      end)

    groups
  end

  # Adds the entries of a dictionary. A delta extends the known entries; any other message replaces them.
  defp put_dictionary(entries_by_id, block, dictionaries, read) do
    {bytes, root} = Batch.read_metadata(block, @dictionary, read)
    id = FlatBuffer.read_number(bytes, root, 0, :i64, 0)

    at =
      FlatBuffer.object_offset(bytes, root, 1) || throw_malformed("a dictionary has no entries")

    case dictionaries do
      %{^id => column} ->
        entries =
          block |> Batch.start_reading({bytes, at}, read) |> Batch.resolve_column(column, %{})

        entries = Values.read_rows(entries, 0, entries.rows)
        delta? = FlatBuffer.read_number(bytes, root, 2, :u8, 0) == 1
        previous = if delta?, do: entries_by_id |> Map.get(id, {}) |> Tuple.to_list(), else: []
        Map.put(entries_by_id, id, List.to_tuple(previous ++ entries))

      _ ->
        entries_by_id
    end
  end

  @impl true
  def select_groups(table, _time, _range), do: table.groups

  @impl true
  def stream_rows(table, groups, columns) do
    Stream.flat_map(groups, fn group ->
      Input.stream_rows(table.path, @format, &start_rows(group, columns, &1), &next_rows/1)
    end)
  end

  defp start_rows({block, dictionaries}, columns, {_size, read}) do
    batch = Batch.start_reading(block, Batch.read_metadata(block, @batch, read), read)
    columns = Enum.map(columns, &Batch.resolve_column(batch, &1, dictionaries))
    %{columns: columns, rows: batch.rows, from: 0}
  end

  defp next_rows(%{from: from, rows: rows}) when from >= rows, do: :done

  defp next_rows(%{from: from, rows: rows} = state) do
    n = min(@slice, rows - from)
    columns = Enum.map(state.columns, &Values.read_rows(&1, from, n))
    {Enum.zip_with(columns, & &1), %{state | from: from + n}}
  end

  defp throw_malformed(why), do: throw({:not_arrow, why})
end
