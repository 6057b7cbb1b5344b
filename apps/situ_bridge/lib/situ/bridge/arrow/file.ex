defmodule Situ.Bridge.Arrow.File do
  @moduledoc false
  # Reads an Arrow file: its columns, and the rows of its batches, a few at a time. The streaming format has no
  # footer, so opening it scans its messages once.
  @behaviour Situ.Bridge.Columnar.Reader
  alias Situ.Bridge.Arrow.{Batch, FlatBuffer, Schema, Values}
  alias Situ.Bridge.Columnar.Input

  @format {:not_arrow, "Arrow"}
  @most_metadata 67_108_864
  @most_body 4_294_967_296
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
  def open(path), do: Input.read(path, @format, &table(path, &1))

  defp table(path, {size, read}) do
    {{bytes, at, version}, messages} =
      case read.(0, min(8, size)) do
        "ARROW1" <> _ -> footer(size, read)
        <<0xFFFFFFFF::32, _::binary>> -> messages(size, read)
        _ -> fail("it does not begin like an Arrow file or an Arrow stream")
      end

    {columns, left_out, dictionaries} = Schema.decode(bytes, at, version)

    %__MODULE__{
      path: path,
      columns: columns,
      left_out: left_out,
      times: for(%{time?: true, name: name} <- columns, do: name),
      groups: groups(messages, dictionaries, read)
    }
  end

  defp footer(size, read) do
    if size < 20, do: fail("it is too short")

    n =
      case read.(size - 10, 10) do
        <<n::little-32, "ARROW1">> when n <= @most_metadata and n + 18 <= size -> n
        _ -> fail("it does not end in ARROW1: it was truncated or never finished")
      end

    bytes = read.(size - 10 - n, n)
    root = FlatBuffer.root(bytes)
    schema = FlatBuffer.object(bytes, root, 1) || fail("it has no schema")
    list_blocks = fn kind, slot -> for block <- blocks(bytes, root, slot), do: {kind, block} end
    version = FlatBuffer.number(bytes, root, 0, :i16, 0)
    {{bytes, schema, version}, list_blocks.(@dictionary, 2) ++ list_blocks.(@batch, 3)}
  end

  defp blocks(bytes, root, slot) do
    for <<at::little-signed-64, metadata::little-signed-32, _::32, body::little-signed-64>> <-
          FlatBuffer.structs(bytes, root, slot, 24) do
      {at, metadata, body}
    end
  end

  # A stream ends at its end marker, or at the point where it was truncated.
  defp messages(size, read) do
    found = message({size, read}, 0, [])

    case Enum.find(found, &(elem(&1, 0) == @schema)) do
      {_, bytes, header, _block} ->
        version = FlatBuffer.number(bytes, FlatBuffer.root(bytes), 0, :i16, 0)
        {{bytes, header, version}, for({kind, _, _, block} <- found, do: {kind, block})}

      nil ->
        fail("it has no schema")
    end
  end

  defp message({size, read} = file, at, found) when at + 8 <= size do
    case read.(at, 8) do
      <<0xFFFFFFFF::32, n::little-32>> when n in 1..@most_metadata and at + 8 + n <= size ->
        bytes = read.(at + 8, n)
        root = FlatBuffer.root(bytes)
        kind = FlatBuffer.number(bytes, root, 1, :u8, 0)
        body = FlatBuffer.number(bytes, root, 3, :i64, 0)
        header = FlatBuffer.object(bytes, root, 2) || fail("a message has no header")
        next = at + 8 + n + body

        if body in 0..@most_body and next <= size,
          do: message(file, next, [{kind, bytes, header, {at, n + 8, body}} | found]),
          else: Enum.reverse(found)

      _ ->
        Enum.reverse(found)
    end
  end

  defp message(_file, _at, found), do: Enum.reverse(found)

  # A stream may replace a dictionary for the batches that follow.
  defp groups(messages, dictionaries, read) do
    {groups, _known} =
      Enum.flat_map_reduce(messages, %{}, fn
        {@dictionary, block}, known -> {[], put_dictionary(known, block, dictionaries, read)}
        {@batch, block}, known -> {[{block, known}], known}
        {_other, _block}, known -> {[], known}
      end)

    groups
  end

  # Adds the entries of a dictionary. A delta extends the known entries, otherwise they are replaced.
  defp put_dictionary(known, block, dictionaries, read) do
    {bytes, root} = Batch.metadata(block, @dictionary, read)
    id = FlatBuffer.number(bytes, root, 0, :i64, 0)
    at = FlatBuffer.object(bytes, root, 1) || fail("a dictionary has no entries")

    case dictionaries do
      %{^id => column} ->
        entries = block |> Batch.start({bytes, at}, read) |> Batch.column(column, %{})
        entries = Values.read(entries, 0, entries.rows)
        delta? = FlatBuffer.number(bytes, root, 2, :u8, 0) == 1
        before = if delta?, do: known |> Map.get(id, {}) |> Tuple.to_list(), else: []
        Map.put(known, id, List.to_tuple(before ++ entries))

      _ ->
        known
    end
  end

  @impl true
  def stream_rows(table, group, columns),
    do: Input.stream(table.path, @format, &start(group, columns, &1), &next_rows/1)

  defp start({block, dictionaries}, columns, {_size, read}) do
    batch = Batch.start(block, Batch.metadata(block, @batch, read), read)
    columns = Enum.map(columns, &Batch.column(batch, &1, dictionaries))
    %{columns: columns, rows: batch.rows, from: 0}
  end

  defp next_rows(%{from: from, rows: rows}) when from >= rows, do: :done

  defp next_rows(%{from: from, rows: rows} = state) do
    n = min(@slice, rows - from)
    columns = Enum.map(state.columns, &Values.read(&1, from, n))
    {Enum.zip_with(columns, & &1), %{state | from: from + n}}
  end

  defp fail(why), do: throw({:not_arrow, why})
end
