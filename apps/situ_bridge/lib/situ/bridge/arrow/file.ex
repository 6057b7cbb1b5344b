defmodule Situ.Bridge.Arrow.File do
  @moduledoc false
  # An Arrow file as it is read: its columns and its batches. Also the streaming form, which has no footer: then the
  # messages are gone through once.
  @behaviour Situ.Bridge.Columnar.Reader
  alias Situ.Bridge.Arrow.{FlatBuffer, Schema, Values}
  alias Situ.Error

  @most_metadata 67_108_864
  @most_body 4_294_967_296
  @schema 1
  @dictionary 2
  @batch 3

  @enforce_keys [:path, :columns, :nested, :times, :groups]
  defstruct @enforce_keys ++ [dictionaries: %{}]

  @typedoc "A group is a batch: where it is in the file, and the size of its metadata and of its body."
  @type t :: %__MODULE__{
          path: Path.t(),
          columns: [Schema.column()],
          nested: [String.t()],
          times: [String.t()],
          groups: [block()],
          dictionaries: %{integer() => tuple()}
        }
  @type block ::
          {at :: non_neg_integer(), metadata :: non_neg_integer(), body :: non_neg_integer()}

  # Errors: `:io`, `:not_arrow`.
  @impl true
  def open(path) do
    guarded(path, fn file, size ->
      {schema, dictionaries, batches} =
        case read(file, size, 0, min(8, size)) do
          "ARROW1" <> _ -> footer(file, size)
          <<0xFFFFFFFF::32, _::binary>> -> messages(file, size)
          _ -> fail("it begins neither as a file nor as a stream of Arrow")
        end

      {bytes, at} = schema
      {columns, nested, types} = Schema.decode(bytes, at)

      table = %__MODULE__{
        path: path,
        columns: columns,
        nested: nested,
        times: for(%{time?: true, name: name} <- columns, do: name),
        groups: batches
      }

      {:ok, %{table | dictionaries: dictionaries(file, size, dictionaries, types)}}
    end)
  end

  defp guarded(path, fun) do
    with {:ok, file} <- :file.open(path, [:read, :raw, :binary]) do
      try do
        {:ok, size} = :file.position(file, :eof)
        fun.(file, size)
      catch
        {:not_arrow, why} ->
          {:error, Error.new(:not_arrow, "#{path} cannot be read as Arrow", why: why)}

        {:io, reason} ->
          {:error, io(path, reason)}
      after
        :file.close(file)
      end
    else
      {:error, reason} -> {:error, io(path, reason)}
    end
  end

  defp io(path, reason),
    do: Error.new(:io, "cannot read #{path}", why: to_string(:file.format_error(reason)))

  defp footer(file, size) do
    if size < 20, do: fail("it is too short")

    n =
      case read(file, size, size - 10, 10) do
        <<n::little-32, "ARROW1">> when n <= @most_metadata and n + 18 <= size -> n
        _ -> fail("it does not end in ARROW1: it is cut short, or was never finished")
      end

    bytes = read(file, size, size - 10 - n, n)
    root = FlatBuffer.root(bytes)
    schema = FlatBuffer.object(bytes, root, 1) || fail("it has no schema")
    {{bytes, schema}, blocks(bytes, root, 2), blocks(bytes, root, 3)}
  end

  defp blocks(bytes, root, slot) do
    for <<at::little-signed-64, metadata::little-signed-32, _::32, body::little-signed-64>> <-
          FlatBuffer.structs(bytes, root, slot, 24) do
      {at, metadata, body}
    end
  end

  # Until its end mark, or until it is cut short.
  defp messages(file, size) do
    found = message(file, size, 0, [])

    case for {@schema, bytes, header, _block} <- found, do: {bytes, header} do
      [schema | _] ->
        of = fn kind -> for {^kind, _, _, block} <- found, do: block end
        {schema, of.(@dictionary), of.(@batch)}

      [] ->
        fail("it has no schema")
    end
  end

  defp message(file, size, at, found) when at + 8 <= size do
    case read(file, size, at, 8) do
      <<0xFFFFFFFF::32, n::little-32>> when n in 1..@most_metadata and at + 8 + n <= size ->
        bytes = read(file, size, at + 8, n)
        root = FlatBuffer.root(bytes)
        kind = FlatBuffer.number(bytes, root, 1, :u8, 0)
        body = FlatBuffer.number(bytes, root, 3, :i64, 0)
        header = FlatBuffer.object(bytes, root, 2) || fail("a message without a header")
        behind = at + 8 + n + body

        if body in 0..@most_body and behind <= size,
          do: message(file, size, behind, [{kind, bytes, header, {at, n + 8, body}} | found]),
          else: Enum.reverse(found)

      _ ->
        Enum.reverse(found)
    end
  end

  defp message(_file, _size, _at, found), do: Enum.reverse(found)

  # The entries of each dictionary; one that is a delta goes on.
  defp dictionaries(file, size, blocks, types) do
    Enum.reduce(blocks, %{}, fn block, known ->
      {bytes, root} = metadata(file, size, block, @dictionary)
      id = FlatBuffer.number(bytes, root, 0, :i64, 0)
      batch = FlatBuffer.object(bytes, root, 1) || fail("a dictionary without entries")

      case types do
        %{^id => type} ->
          column = %{
            type: type,
            dictionary: nil,
            node: 0,
            buffer: 0,
            view: 0,
            children: [],
            name: "dictionary #{id}"
          }

          entries = top(file, size, block, {bytes, batch}, column, %{})
          delta? = FlatBuffer.number(bytes, root, 2, :u8, 0) == 1
          before = if delta?, do: known |> Map.get(id, {}) |> Tuple.to_list(), else: []
          Map.put(known, id, List.to_tuple(before ++ entries))

        _ ->
          known
      end
    end)
  end

  @impl true
  def rows(table, block, columns) do
    guarded(table.path, fn file, size ->
      {bytes, batch} = metadata(file, size, block, @batch)
      apart(bytes, batch, block)

      {:ok,
       columns
       |> Enum.map(&top(file, size, block, {bytes, batch}, &1, table.dictionaries))
       |> Enum.zip_with(& &1)}
    end)
  end

  defp metadata(file, size, {at, n, _body}, kind) when n in 8..@most_metadata and at >= 0 do
    # Old files have no ones before the length.
    bytes =
      case read(file, size, at, n) do
        <<0xFFFFFFFF::32, _length::32, bytes::binary>> -> bytes
        <<_length::32, bytes::binary>> -> bytes
      end

    root = FlatBuffer.root(bytes)

    if FlatBuffer.number(bytes, root, 1, :u8, 0) != kind,
      do: fail("a message of another kind than the footer says")

    {bytes, FlatBuffer.object(bytes, root, 2) || fail("a message without a header")}
  end

  defp metadata(_file, _size, _block, _kind), do: fail("a batch that is not there")

  # Buffers that lie over one another would make much of a small file.
  defp apart(bytes, batch, {_at, _metadata, body}) do
    all =
      for <<_::64, length::little-signed-64>> <- FlatBuffer.structs(bytes, batch, 2, 16),
          reduce: 0,
          do: (sum -> sum + length)

    if all > body, do: fail("a batch whose buffers are larger than itself")
  end

  # A column of the table has as many rows as the batch; one within another has as many as that one's lists hold.
  defp top(file, size, block, {bytes, batch}, column, dictionaries) do
    rows = FlatBuffer.number(bytes, batch, 0, :i64, 0)

    case Enum.at(FlatBuffer.structs(bytes, batch, 1, 16), column.node) do
      <<^rows::little-signed-64, _::binary>> ->
        column(file, size, block, {bytes, batch}, column, dictionaries)

      _ ->
        fail("the column #{inspect(column.name)} has another number of rows than its batch")
    end
  end

  defp column(file, size, block, {bytes, batch}, column, dictionaries) do
    type = if column.dictionary, do: column.index, else: column.type

    case Enum.at(FlatBuffer.structs(bytes, batch, 1, 16), column.node) do
      <<rows::little-signed-64, missing::little-signed-64>> when rows >= 0 ->
        buffers = buffers(file, size, block, {bytes, batch}, column, type)
        # Where nothing is missing, the presence means nothing.
        buffers = if missing == 0, do: List.replace_at(buffers, 0, ""), else: buffers

        inner =
          for child <- column.children,
              do: {child.name, column(file, size, block, {bytes, batch}, child, dictionaries)}

        type
        |> with_names(column.children)
        |> Values.read(buffers, rows, inner)
        |> entries(column, dictionaries)

      _ ->
        fail("the column #{inspect(column.name)} is not in its batch")
    end
  end

  defp with_names(:map, [%{children: pair}]), do: {:map, Enum.map(pair, & &1.name)}
  defp with_names(type, _children), do: type

  defp entries(values, %{dictionary: nil}, _dictionaries), do: values

  defp entries(values, %{dictionary: id} = column, dictionaries) do
    entries = Map.get(dictionaries, id, {})

    for i <- values do
      cond do
        i == nil -> nil
        i in 0..(tuple_size(entries) - 1)//1 -> elem(entries, i)
        true -> fail("the column #{inspect(column.name)} has a number beyond its dictionary")
      end
    end
  end

  defp buffers(file, size, {at, n, body}, {bytes, batch}, column, type) do
    codec =
      with compression when compression != nil <- FlatBuffer.object(bytes, batch, 3),
           do: FlatBuffer.number(bytes, compression, 0, :u8, 0)

    # Buffers of texts before this column move its own.
    views =
      for <<count::little-signed-64>> <- FlatBuffer.structs(bytes, batch, 4, 8), do: max(count, 0)

    from = column.buffer + (views |> Enum.take(column.view) |> Enum.sum())
    count = count(type, Enum.at(views, column.view) || 0)

    bytes
    |> FlatBuffer.structs(batch, 2, 16)
    |> Enum.slice(from, count)
    |> Enum.map(fn <<offset::little-signed-64, length::little-signed-64>> ->
      if offset < 0 or length < 0 or offset + length > body,
        do: fail("the column #{inspect(column.name)} has a buffer outside of its batch")

      file |> read(size, at + n + offset, length) |> Values.unpack(codec)
    end)
  end

  defp count(:null, _views), do: 0
  defp count(type, _views) when type == :struct or elem(type, 0) == :lists, do: 1
  defp count({:view, _}, views), do: 2 + views
  defp count({kind, _bits}, _views) when kind in [:text, :bytes], do: 3
  defp count(_type, _views), do: 2

  defp read(_file, _size, _at, 0), do: ""

  defp read(file, size, at, n) do
    if at < 0 or at + n > size, do: fail("it is cut short")

    case :file.pread(file, at, n) do
      {:ok, bytes} when byte_size(bytes) == n -> bytes
      {:error, reason} -> throw({:io, reason})
      _ -> fail("it is cut short")
    end
  end

  defp fail(why), do: throw({:not_arrow, why})
end
