defmodule Situ.Bridge.Ros.Bag.Index do
  @moduledoc false
  # Reads the contents of a bag: its connections and the position of each message. They come from the index if there is
  # one. Otherwise (the recorder was killed, or the file is cut short), all chunks are scanned.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.Bridge.Ros.Bag.{Chunk, Record}

  # connections: number => %{topic, type, md5, definition, header}
  # positions: number => [{time, chunk position, offset}]
  defstruct connections: %{}, positions: %{}, damage: [], indexed?: true

  @magic "#ROSBAG V2.0\n"
  @max_header 64 * 1024 * 1024

  @spec read(:file.fd(), non_neg_integer()) :: {:ok, %__MODULE__{}} | {:error, term()}
  def read(file, size) do
    case :file.pread(file, 0, byte_size(@magic)) do
      {:ok, @magic} -> {:ok, read_index(file, size) || scan_file(file, size)}
      {:ok, "#ROSBAG V" <> version} -> {:error, {:version, String.trim(version)}}
      {:ok, _} -> {:error, :not_bag}
      :eof -> {:error, :not_bag}
      {:error, reason} -> {:error, {:io, reason}}
    end
  end

  # Reads the header of the record at `at`. Returns its kind, its fields, and the position and size of its data.
  defp read_record(file, at, size) do
    with {:ok, <<h::little-32>>} when h <= @max_header and at + 8 + h <= size <-
           :file.pread(file, at, 4),
         {:ok, <<header::binary-pinned_size(h), d::little-32>>} <-
           :file.pread(file, at + 4, h + 4),
         {:ok, fields} <- Record.parse_fields(header) do
      {:ok, Record.record_kind(fields), fields, at + 8 + h, d}
    else
      _ -> :error
    end
  end

  defp read_index(file, size) do
    with {:ok, :bag, fields, _, _} <- read_record(file, byte_size(@magic), size),
         at when is_integer(at) and at > 0 and at <= size <- Record.get_u64(fields, "index_pos"),
         {:ok, contents, chunks} <- read_index_section(file, at, size, %__MODULE__{}, []),
         true <- length(chunks) == Record.get_u32(fields, "chunk_count"),
         %__MODULE__{} = contents <-
           Enum.reduce_while(chunks, contents, &read_chunk_index(file, size, &1, &2)) do
      contents
    else
      _ -> nil
    end
  end

  # Reads the connections and chunk infos, which continue to the end of the file.
  defp read_index_section(_file, at, size, contents, chunks) when at == size,
    do: {:ok, contents, chunks}

  defp read_index_section(file, at, size, contents, chunks) do
    with {:ok, op, fields, data, n} when data + n <= size <- read_record(file, at, size) do
      case op do
        :connection ->
          read_index_section(
            file,
            data + n,
            size,
            put_connection(contents, fields, read_bytes(file, data, n)),
            chunks
          )

        :chunk_info ->
          read_index_section(file, data + n, size, contents, [
            {Record.get_u64(fields, "chunk_pos"), Record.get_u32(fields, "count")} | chunks
          ])

        _ ->
          read_index_section(file, data + n, size, contents, chunks)
      end
    else
      _ -> :error
    end
  end

  # Reads the index records that follow a chunk; there is one for each connection.
  defp read_chunk_index(file, size, {at, connections}, contents)
       when is_integer(at) and is_integer(connections) do
    with {:ok, :chunk, _, data, n} <- read_record(file, at, size),
         {:ok, contents} <- read_index_records(file, size, data + n, connections, at, contents) do
      {:cont, contents}
    else
      _ -> {:halt, nil}
    end
  end

  defp read_chunk_index(_file, _size, _chunk, _contents), do: {:halt, nil}

  defp read_index_records(_file, _size, _at, 0, _chunk, contents), do: {:ok, contents}

  defp read_index_records(file, size, at, count, chunk, contents) do
    with {:ok, :index, fields, data, n} when data + n <= size <- read_record(file, at, size),
         number when is_integer(number) <- Record.get_u32(fields, "conn") do
      rows =
        for <<time::binary-8, offset::little-32 <- read_bytes(file, data, n)>>,
          do: {Record.parse_time(time), chunk, offset}

      read_index_records(
        file,
        size,
        data + n,
        count - 1,
        chunk,
        put_positions(contents, number, rows)
      )
    else
      _ -> :error
    end
  end

  defp read_bytes(file, at, n) do
    case :file.pread(file, at, n) do
      {:ok, bytes} -> bytes
      _ -> ""
    end
  end

  defp put_positions(contents, number, rows),
    do: %{contents | positions: Map.update(contents.positions, number, [rows], &[rows | &1])}

  defp put_connection(contents, fields, data) do
    with number when is_integer(number) <- Record.get_u32(fields, "conn"),
         {:ok, header_fields} <- Record.parse_fields(data) do
      connection = %{
        topic: fields["topic"] || header_fields["topic"] || "",
        type: header_fields["type"] || "",
        md5: header_fields["md5sum"],
        definition: header_fields["message_definition"] || "",
        header: header_fields |> Map.drop(["type", "message_definition"]) |> Enum.sort(),
        caller: header_fields["callerid"],
        latching: header_fields["latching"] == "1"
      }

      %{contents | connections: Map.put_new(contents.connections, number, connection)}
    else
      _ -> contents
    end
  end

  # Scanning the records of a bag without an index

  defp scan_file(file, size),
    do: scan_records(file, byte_size(@magic), size, %__MODULE__{indexed?: false})

  defp scan_records(_file, at, size, contents) when at >= size, do: contents

  defp scan_records(file, at, size, contents) do
    case read_record(file, at, size) do
      {:ok, :chunk, _fields, data, n} when data + n <= size ->
        scan_records(file, data + n, size, scan_chunk(file, at, size, contents))

      {:ok, :chunk, _fields, _data, _n} ->
        file |> scan_chunk(at, size, contents) |> report_torn_record(at)

      {:ok, :connection, fields, data, n} when data + n <= size ->
        scan_records(
          file,
          data + n,
          size,
          put_connection(contents, fields, read_bytes(file, data, n))
        )

      {:ok, _other, _fields, data, n} when data + n <= size ->
        scan_records(file, data + n, size, contents)

      _ ->
        report_torn_record(contents, at)
    end
  end

  defp report_torn_record(contents, at),
    do: %{
      contents
      | damage: ["the file is cut short in the record at byte #{at}" | contents.damage]
    }

  defp scan_chunk(file, at, size, contents) do
    case Chunk.read(file, at, size) do
      {:ok, records} -> scan_chunk_records(records, 0, at, contents)
      {:error, why} -> %{contents | damage: ["the chunk at byte #{at}: #{why}" | contents.damage]}
    end
  end

  defp scan_chunk_records(records, offset, at, contents) do
    case Record.take_record(records) do
      {:ok, op, fields, data, rest} ->
        scan_chunk_records(
          rest,
          offset + byte_size(records) - byte_size(rest),
          at,
          put_record(op, fields, data, {at, offset}, contents)
        )

      :error ->
        contents
    end
  end

  defp put_record(:message, fields, _data, {at, offset}, contents) do
    case {Record.get_u32(fields, "conn"), Record.parse_time(fields["time"])} do
      {number, time} when is_integer(number) and is_integer(time) ->
        put_positions(contents, number, [{time, at, offset}])

      _ ->
        contents
    end
  end

  defp put_record(:connection, fields, data, _position, contents),
    do: put_connection(contents, fields, data)

  defp put_record(_op, _fields, _data, _position, contents), do: contents
end
