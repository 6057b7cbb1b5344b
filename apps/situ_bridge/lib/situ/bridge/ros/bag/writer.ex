defmodule Situ.Bridge.Ros.Bag.Writer do
  @moduledoc false
  @behaviour Situ.Bridge.Recorder
  @behaviour Situ.Bridge.Raw.Writer
  # Writes a bag: chunks of records, each followed by its index, and the connections and chunk infos at the end. The
  # first record of the file contains the position of the connections.
  alias Situ.Bridge.Mcap.{Channel, ExtraFields}
  alias Situ.Bridge.{Native, RawChannel}
  alias Situ.Bridge.Ros.Bag.Record
  alias Situ.Bridge.Ros.Definition
  alias Situ.Error

  @magic "#ROSBAG V2.0\n"
  # The first record is padded to this size, so that it can be overwritten at the end.
  @header_bytes 4_096

  @file_options [
    chunk: [type: :pos_integer, default: 786_432, doc: "Size of a chunk in bytes."],
    compression: [type: {:in, [:none, :lz4]}, default: :none, doc: "Compression of the chunks."]
  ]
  @topic_options [
    type: [
      type: {:optional, :string},
      default: nil,
      doc: "The ROS type. Default: the standard type that fits the first message."
    ],
    definition: [
      type: {:optional, :string},
      default: nil,
      doc: "The definition (`.msg`), unless the type is a standard ROS type."
    ],
    frame: [type: :string, default: "", doc: "The frame of reference in message headers."]
  ]

  defstruct [
    :path,
    :file,
    :chunk,
    :compression,
    at: 0,
    channels: %{},
    pending: [],
    size: 0,
    index: %{},
    infos: [],
    count: 0,
    span: nil
  ]

  @impl true
  def file_options, do: @file_options
  @impl true
  def topic_options, do: @topic_options

  @impl true
  def create(path, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @file_options),
         {:ok, file} <- open_file(path),
         writer = %__MODULE__{
           path: path,
           file: file,
           chunk: opts[:chunk],
           compression: opts[:compression]
         },
         {:ok, writer} <- append_bytes(writer, [@magic, first_record(0, 0, 0)]),
         do: {:ok, writer}
  end

  defp open_file(path) do
    with {:error, reason} <- :file.open(path, [:write, :raw, :binary]),
         do: {:error, file_error(path, reason)}
  end

  defp file_error(path, :enospc),
    do:
      Error.new(:disk_full, "no space left on the disk of #{path}",
        fix: "free some space, or write to another disk"
      )

  defp file_error(path, reason),
    do: Error.new(:io, "cannot write #{path}", why: to_string(:file.format_error(reason)))

  defp first_record(index, connections, chunks) do
    fields = [
      {"index_pos", <<index::little-64>>},
      {"conn_count", <<connections::little-32>>},
      {"chunk_count", <<chunks::little-32>>}
    ]

    header = IO.iodata_length(Record.encode_fields([{"op", <<3>>} | fields]))
    Record.encode_record(:bag, fields, :binary.copy(" ", @header_bytes - 8 - header))
  end

  defp append_bytes(writer, bytes) do
    case :file.write(writer.file, bytes) do
      :ok -> {:ok, %{writer | at: writer.at + IO.iodata_length(bytes)}}
      {:error, reason} -> {:error, file_error(writer.path, reason)}
    end
  end

  @impl true
  def write(writer, topic, message, opts) do
    with {:ok, writer, channel} <- ensure_channel(writer, topic, message.data, opts),
         {:ok, bytes} <- Channel.encode(channel, message.data, message.originating_time),
         {recorded, _sent} = ExtraFields.fetch_times(message),
         {:ok, time} <- check_time(topic, recorded),
         do: append_message(writer, channel.id, time, bytes)
  end

  defp append_message(writer, id, time, bytes) do
    record =
      Record.encode_record(
        :message,
        [{"conn", <<id::little-32>>}, {"time", Record.encode_time(time)}],
        bytes
      )

    index = Map.update(writer.index, id, [{time, writer.size}], &[{time, writer.size} | &1])

    writer = %{
      writer
      | index: index,
        span: extend_span(writer.span, time),
        count: writer.count + 1
    }

    add_pending(writer, record)
  end

  defp check_time(_topic, time) when time in 0..4_294_967_295_999_999_999, do: {:ok, time}

  defp check_time(topic, time),
    do:
      {:error,
       Error.new(
         :not_writable,
         "a message of #{topic} has the time #{Situ.Time.to_iso8601(time)}",
         why: "bags store only times from 1970 to 2106"
       )}

  defp extend_span(nil, time), do: {time, time}
  defp extend_span({first, last}, time), do: {min(first, time), max(last, time)}

  defp add_pending(writer, record) do
    writer = %{
      writer
      | pending: [record | writer.pending],
        size: writer.size + IO.iodata_length(record)
    }

    if writer.size >= writer.chunk, do: end_chunk(writer), else: {:ok, writer}
  end

  defp ensure_channel(writer, topic, data, opts) do
    case writer.channels do
      %{^topic => channel} ->
        {:ok, writer, channel}

      channels ->
        with {:ok, opts} <- Situ.Options.validate(opts, @topic_options),
             {:ok, channel} <- Channel.new(topic, [encoding: :ros1] ++ opts, data) do
          channel = %{channel | id: map_size(channels)}

          with {:ok, writer} <- add_connection(writer, topic, channel), do: {:ok, writer, channel}
        end
    end
  end

  defp add_connection(writer, key, channel) do
    writer = %{writer | channels: Map.put(writer.channels, key, channel)}
    add_pending(writer, connection_record(channel))
  end

  defp connection_record(%{schema: {type, _, text}} = channel) do
    Record.encode_record(
      :connection,
      [{"conn", <<channel.id::little-32>>}, {"topic", channel.topic}],
      Record.encode_fields(
        [{"topic", channel.topic}, {"type", type}] ++
          connection_fields(channel) ++ [{"message_definition", text}]
      )
    )
  end

  defp connection_fields(%Channel{definition: definition}),
    do: [{"md5sum", Definition.md5(definition)}]

  defp connection_fields(%RawChannel{metadata: metadata, schema: {type, _, text}}) do
    fields = List.keydelete(metadata, "topic", 0)

    if List.keymember?(fields, "md5sum", 0),
      do: fields,
      else: [{"md5sum", definition_md5(type, text)} | fields]
  end

  # "*" matches any definition.
  defp definition_md5(type, text) do
    case Definition.parse(type, text, :ros1) do
      {:ok, definition} -> Definition.md5(definition)
      {:error, _why} -> "*"
    end
  end

  @impl true
  def refuse_channel(%RawChannel{encoding: "ros1", schema: {_, "ros1msg", _}}), do: nil

  def refuse_channel(%RawChannel{encoding: encoding}),
    do: "a bag of ROS 1 holds messages of ROS 1, and these are encoded as #{inspect(encoding)}"

  @impl true
  def add_channel(writer, %RawChannel{} = channel) do
    id = map_size(writer.channels)

    with {:ok, writer} <- add_connection(writer, {:raw, id}, %{channel | id: id}),
         do: {:ok, id, writer}
  end

  @impl true
  def write_row(writer, id, {log_time, _publish_time, _sequence, bytes}) do
    with {:ok, time} <- check_time(writer.channels[{:raw, id}].topic, log_time),
         do: append_message(writer, id, time, bytes)
  end

  defp end_chunk(%{pending: []} = writer), do: {:ok, writer}

  defp end_chunk(writer) do
    position = writer.at

    fields = [
      {"compression", Atom.to_string(writer.compression)},
      {"size", <<writer.size::little-32>>}
    ]

    chunk =
      Record.encode_record(
        :chunk,
        fields,
        pack_records(writer.compression, Enum.reverse(writer.pending))
      )

    indexes =
      for {id, entries} <- Enum.sort(writer.index) do
        rows =
          for {time, offset} <- Enum.reverse(entries),
              do: [Record.encode_time(time), <<offset::little-32>>]

        Record.encode_record(
          :index,
          [
            {"ver", <<1::little-32>>},
            {"conn", <<id::little-32>>},
            {"count", <<length(entries)::little-32>>}
          ],
          rows
        )
      end

    with {:ok, writer} <- append_bytes(writer, [chunk, indexes]) do
      counts = for {id, entries} <- Enum.sort(writer.index), do: {id, length(entries)}
      info = {position, writer.span || {0, 0}, counts}
      {:ok, %{writer | pending: [], size: 0, index: %{}, span: nil, infos: [info | writer.infos]}}
    end
  end

  defp pack_records(:none, records), do: records

  defp pack_records(:lz4, records) do
    {:ok, bytes} = records |> IO.iodata_to_binary() |> Native.pack_lz4()
    bytes
  end

  # A chunk begins with its size, so only complete chunks can be written. Pending records stay in memory.
  @impl true
  def flush(writer), do: {:ok, writer}

  @impl true
  def finish(writer) do
    with {:ok, %{at: index} = writer} <- end_chunk(writer),
         {:ok, writer} <-
           append_bytes(writer, [
             connection_records(writer),
             Enum.map(Enum.reverse(writer.infos), &chunk_info_record/1)
           ]),
         head = first_record(index, map_size(writer.channels), length(writer.infos)),
         :ok <- check_written(:file.pwrite(writer.file, byte_size(@magic), head), writer),
         :ok <- check_written(:file.datasync(writer.file), writer),
         :ok <- check_written(:file.close(writer.file), writer),
         do: {:ok, nil}
  end

  defp check_written(:ok, _writer), do: :ok
  defp check_written({:error, reason}, writer), do: {:error, file_error(writer.path, reason)}

  defp connection_records(writer),
    do: writer.channels |> Map.values() |> Enum.sort_by(& &1.id) |> Enum.map(&connection_record/1)

  defp chunk_info_record({position, {first, last}, counts}) do
    fields = [
      {"ver", <<1::little-32>>},
      {"chunk_pos", <<position::little-64>>},
      {"start_time", Record.encode_time(first)},
      {"end_time", Record.encode_time(last)},
      {"count", <<length(counts)::little-32>>}
    ]

    Record.encode_record(
      :chunk_info,
      fields,
      for({id, n} <- counts, do: <<id::little-32, n::little-32>>)
    )
  end
end
