defmodule Situ.Bridge.Arrow.Batch do
  @moduledoc false
  # A batch of an Arrow file: its columns, from which `Situ.Bridge.Arrow.Values` reads rows. Throws
  # `{:not_arrow, why}`, and everything that `read` throws.
  alias Situ.Bridge.Arrow.{Buffer, FlatBuffer, Schema, Values}
  alias Situ.Bridge.Columnar.Input

  @max_metadata 67_108_864
  @small_body 65_536
  @enforce_keys [:read, :body_size, :rows, :nodes, :buffers, :views, :codec]
  defstruct @enforce_keys

  @typedoc "The offset of a message in the file, and the sizes of its metadata and of its body."
  @type block ::
          {at :: non_neg_integer(), metadata :: non_neg_integer(), body :: non_neg_integer()}
  @type t :: %__MODULE__{}
  @type dictionaries :: %{integer() => tuple()}

  @doc "Reads the metadata of a message of this kind; returns its bytes and the offset of its header."
  @spec read_metadata(block(), kind :: 1..3, Input.read()) :: {binary(), non_neg_integer()}
  def read_metadata({at, n, _body}, kind, read) when n in 8..@max_metadata and at >= 0 do
    # Files written before Arrow 0.15 have no 0xFFFFFFFF before the length.
    bytes =
      case read.(at, n) do
        <<0xFFFFFFFF::32, _length::32, bytes::binary>> -> bytes
        <<_length::32, bytes::binary>> -> bytes
      end

    root = FlatBuffer.root_offset(bytes)

    if FlatBuffer.read_number(bytes, root, 1, :u8, 0) != kind,
      do: throw_malformed("a message is of a different kind than the footer says")

    {bytes,
     FlatBuffer.object_offset(bytes, root, 2) || throw_malformed("a message has no header")}
  end

  def read_metadata(_block, _kind, _read),
    do: throw_malformed("the position of a batch is invalid")

  @doc "Starts reading the batch of a message; `batch` is the offset of its table in the metadata."
  @spec start_reading(block(), {binary(), non_neg_integer()}, Input.read()) :: t()
  def start_reading({at, metadata, size}, {bytes, batch}, read) do
    buffers =
      for <<at::little-signed-64, length::little-signed-64>> <-
            FlatBuffer.read_structs(bytes, batch, 2, 16),
          do: {at, length}

    # Overlapping buffers could expand a small file into a huge number of values.
    if buffers |> Enum.map(&elem(&1, 1)) |> Enum.sum() > size,
      do: throw_malformed("the buffers of a batch are larger than its body")

    compression = FlatBuffer.object_offset(bytes, batch, 3)

    %__MODULE__{
      read: read_body(at + metadata, size, read),
      body_size: size,
      rows: FlatBuffer.read_number(bytes, batch, 0, :i64, 0),
      nodes: bytes |> FlatBuffer.read_structs(batch, 1, 16) |> List.to_tuple(),
      buffers: buffers,
      views:
        for(<<n::little-signed-64>> <- FlatBuffer.read_structs(bytes, batch, 4, 8), do: max(n, 0)),
      codec: compression && FlatBuffer.read_number(bytes, compression, 0, :u8, 0)
    }
  end

  # A small body is read in one call, since each read switches to another thread.
  defp read_body(at, size, read) when size in 0..@small_body do
    body = read.(at, size)
    &binary_part(body, &1, &2)
  end

  defp read_body(at, _size, read), do: &read.(at + &1, &2)

  @doc """
  Returns the buffers of a top-level column, which has as many rows as the batch. Nested columns have as many rows as
  their lists have elements.
  """
  @spec resolve_column(t(), Schema.column(), dictionaries()) :: Values.column()
  def resolve_column(batch, column, dictionaries) do
    data = find_column(batch, column, dictionaries)

    if data.rows != batch.rows,
      do:
        throw_malformed(
          "the column #{inspect(column.name)} does not have as many rows as its batch"
        )

    data
  end

  defp find_column(batch, column, dictionaries) do
    type = if column.dictionary, do: column.index, else: column.type

    case column_node(batch.nodes, column.node) do
      <<rows::little-signed-64, missing::little-signed-64>> when rows >= 0 ->
        {presence, buffers} = batch |> column_buffers(column, type) |> split_presence(type)

        %{
          type: type,
          rows: rows,
          # If no value is missing, the validity bitmap may be absent or empty.
          presence: if(missing != 0 and presence != nil and elem(presence, 0) > 0, do: presence),
          buffers: buffers,
          children: for(c <- column.children, do: {c.name, find_column(batch, c, dictionaries)}),
          entries: column.dictionary && Map.get(dictionaries, column.dictionary, {})
        }

      _ ->
        throw_malformed("the column #{inspect(column.name)} is not in its batch")
    end
  end

  defp column_node(nodes, at) when at < tuple_size(nodes), do: elem(nodes, at)
  defp column_node(_nodes, _at), do: nil

  defp split_presence([], :null), do: {nil, []}
  defp split_presence([presence | buffers], _type), do: {presence, buffers}
  defp split_presence([], _type), do: throw_malformed("the buffers of a column are missing")

  defp column_buffers(batch, column, type) do
    # Preceding string-view columns have a variable number of buffers, which shifts this column's buffers.
    from = column.buffer + (batch.views |> Enum.take(column.view) |> Enum.sum())
    count = buffer_count(type, Enum.at(batch.views, column.view) || 0)

    for {at, length} <- Enum.slice(batch.buffers, from, count) do
      if at < 0 or length < 0 or at + length > batch.body_size,
        do: throw_malformed("a buffer of the column #{inspect(column.name)} is outside its batch")

      Buffer.unpack_buffer({length, &batch.read.(at + &1, &2)}, batch.codec)
    end
  end

  defp buffer_count(:null, _views), do: 0
  defp buffer_count(type, _views) when type == :struct or elem(type, 0) == :lists, do: 1
  defp buffer_count({:view, _}, views), do: 2 + views
  defp buffer_count({kind, _bits}, _views) when kind in [:text, :bytes], do: 3
  defp buffer_count(_type, _views), do: 2

  defp throw_malformed(why), do: throw({:not_arrow, why})
end
