defmodule Situ.Bridge.Arrow.Batch do
  @moduledoc false
  # A batch of an Arrow file: its columns, for `Situ.Bridge.Arrow.Values` to read rows of. Throws `{:not_arrow, why}`,
  # and whatever `read` throws.
  alias Situ.Bridge.Arrow.{Buffer, FlatBuffer, Schema, Values}
  alias Situ.Bridge.Columnar.Input

  @most_metadata 67_108_864
  @small 65_536
  @enforce_keys [:read, :body_size, :rows, :nodes, :buffers, :views, :codec]
  defstruct @enforce_keys

  @typedoc "Where a message is in the file, and the size of its metadata and of its body."
  @type block ::
          {at :: non_neg_integer(), metadata :: non_neg_integer(), body :: non_neg_integer()}
  @type t :: %__MODULE__{}
  @type dictionaries :: %{integer() => tuple()}

  @doc "Reads the metadata of a message of this kind, and returns them with the place of its header."
  @spec metadata(block(), kind :: 1..3, Input.read()) :: {binary(), non_neg_integer()}
  def metadata({at, n, _body}, kind, read) when n in 8..@most_metadata and at >= 0 do
    # Old files have no ones before the length.
    bytes =
      case read.(at, n) do
        <<0xFFFFFFFF::32, _length::32, bytes::binary>> -> bytes
        <<_length::32, bytes::binary>> -> bytes
      end

    root = FlatBuffer.root(bytes)

    if FlatBuffer.number(bytes, root, 1, :u8, 0) != kind,
      do: fail("a message of another kind than the footer says")

    {bytes, FlatBuffer.object(bytes, root, 2) || fail("a message without a header")}
  end

  def metadata(_block, _kind, _read), do: fail("a batch that is not there")

  @doc "Starts to read the batch of a message, whose metadata have it at `batch`."
  @spec start(block(), {binary(), non_neg_integer()}, Input.read()) :: t()
  def start({at, metadata, size}, {bytes, batch}, read) do
    buffers =
      for <<at::little-signed-64, length::little-signed-64>> <-
            FlatBuffer.structs(bytes, batch, 2, 16),
          do: {at, length}

    # Buffers that overlap could make very many values of a small file.
    if buffers |> Enum.map(&elem(&1, 1)) |> Enum.sum() > size,
      do: fail("a batch whose buffers are larger than itself")

    compression = FlatBuffer.object(bytes, batch, 3)

    %__MODULE__{
      read: read_body(at + metadata, size, read),
      body_size: size,
      rows: FlatBuffer.number(bytes, batch, 0, :i64, 0),
      nodes: bytes |> FlatBuffer.structs(batch, 1, 16) |> List.to_tuple(),
      buffers: buffers,
      views:
        for(<<n::little-signed-64>> <- FlatBuffer.structs(bytes, batch, 4, 8), do: max(n, 0)),
      codec: compression && FlatBuffer.number(bytes, compression, 0, :u8, 0)
    }
  end

  # A small body is read at once, since each read switches to another thread.
  defp read_body(at, size, read) when size in 0..@small do
    body = read.(at, size)
    &binary_part(body, &1, &2)
  end

  defp read_body(at, _size, read), do: &read.(at + &1, &2)

  @doc """
  Finds a column of the table, which has as many rows as the batch. Columns within it have as many as its lists hold.
  """
  @spec column(t(), Schema.column(), dictionaries()) :: Values.column()
  def column(batch, column, dictionaries) do
    found = find_column(batch, column, dictionaries)

    if found.rows != batch.rows,
      do: fail("the column #{inspect(column.name)} has another number of rows than its batch")

    found
  end

  defp find_column(batch, column, dictionaries) do
    type = if column.dictionary, do: column.index, else: column.type

    case node(batch.nodes, column.node) do
      <<rows::little-signed-64, missing::little-signed-64>> when rows >= 0 ->
        {presence, buffers} = batch |> buffers(column, type) |> split_presence(type)

        %{
          type: type,
          rows: rows,
          # Where nothing is missing, the presence means nothing.
          presence: if(missing != 0 and presence != nil and elem(presence, 0) > 0, do: presence),
          buffers: buffers,
          children: for(c <- column.children, do: {c.name, find_column(batch, c, dictionaries)}),
          entries: column.dictionary && Map.get(dictionaries, column.dictionary, {})
        }

      _ ->
        fail("the column #{inspect(column.name)} is not in its batch")
    end
  end

  defp node(nodes, at) when at < tuple_size(nodes), do: elem(nodes, at)
  defp node(_nodes, _at), do: nil

  defp split_presence([], :null), do: {nil, []}
  defp split_presence([presence | buffers], _type), do: {presence, buffers}
  defp split_presence([], _type), do: fail("a column without its buffers")

  defp buffers(batch, column, type) do
    # The string views before this column have further buffers, which move its own.
    from = column.buffer + (batch.views |> Enum.take(column.view) |> Enum.sum())
    count = count(type, Enum.at(batch.views, column.view) || 0)

    for {at, length} <- Enum.slice(batch.buffers, from, count) do
      if at < 0 or length < 0 or at + length > batch.body_size,
        do: fail("the column #{inspect(column.name)} has a buffer outside of its batch")

      Buffer.unpack({length, &batch.read.(at + &1, &2)}, batch.codec)
    end
  end

  defp count(:null, _views), do: 0
  defp count(type, _views) when type == :struct or elem(type, 0) == :lists, do: 1
  defp count({:view, _}, views), do: 2 + views
  defp count({kind, _bits}, _views) when kind in [:text, :bytes], do: 3
  defp count(_type, _views), do: 2

  defp fail(why), do: throw({:not_arrow, why})
end
