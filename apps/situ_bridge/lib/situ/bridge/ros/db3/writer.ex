defmodule Situ.Bridge.Ros.Db3.Writer do
  @moduledoc false
  # Writes a ROS 2 bag in SQLite. The program `sqlite3` runs as long as the bag is being
  # written and receives statements on its standard input; a pipe holds little, so a slow disk slows the writer down.
  # The last statements contain the summary, without which the file is not complete.
  @behaviour Situ.Bridge.Recorder
  @behaviour Situ.Bridge.Raw.Writer
  alias Situ.Bridge.Mcap.{Channel, ExtraFields}
  alias Situ.Bridge.RawChannel
  alias Situ.Bridge.Ros.Db3.{Sqlite, Summary}
  alias Situ.Error

  @tables """
  pragma synchronous = off;
  begin;
  create table schema(schema_version integer primary key, ros_distro text not null);
  create table metadata(id integer primary key, metadata_version integer not null, metadata text not null);
  create table topics(id integer primary key, name text not null, type text not null,
    serialization_format text not null, offered_qos_profiles text not null, type_description_hash text not null);
  create table message_definitions(id integer primary key, topic_type text not null, encoding text not null,
    encoded_message_definition text not null, type_description_hash text not null);
  create table messages(id integer primary key, topic_id integer not null, timestamp integer not null,
    data blob not null);
  create index timestamp_idx on messages(timestamp asc);
  insert into schema(schema_version, ros_distro) values(4, 'situ');
  """

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

  # `topics` maps the number of a topic to its channel and the number of its messages.
  defstruct [
    :path,
    :name,
    :session,
    channels: %{},
    topics: %{},
    count: 0,
    span: nil,
    sql: [],
    bytes: 0
  ]

  @impl true
  def file_options do
    [
      name: [
        type: {:optional, :string},
        default: nil,
        doc: "The name of the file in its summary; default: as written."
      ]
    ]
  end

  @impl true
  def topic_options, do: @topic_options

  @impl true
  def create(path, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, file_options()),
         {:ok, session} <- Sqlite.start_session(path) do
      name = opts[:name] || Path.basename(path)
      add_sql(%__MODULE__{path: path, name: name, session: session}, @tables)
    end
  end

  @impl true
  def write(writer, topic, message, opts) do
    with {:ok, channel, writer} <- ensure_channel(writer, topic, message.data, opts),
         {:ok, bytes} <- Channel.encode(channel, message.data, message.originating_time) do
      {recorded, sent} = ExtraFields.fetch_times(message)
      write_row(writer, channel.id, {recorded, sent, 0, bytes})
    end
  end

  defp ensure_channel(writer, topic, data, opts) do
    case writer.channels do
      %{^topic => channel} ->
        {:ok, channel, writer}

      channels ->
        with {:ok, opts} <- Situ.Options.validate(opts, @topic_options),
             {:ok, channel} <- Channel.new(topic, [encoding: :cdr] ++ opts, data),
             raw = %RawChannel{
               id: nil,
               topic: topic,
               stream: topic,
               encoding: "cdr",
               schema: channel.schema
             },
             {:ok, id, writer} <- add_channel(writer, raw) do
          channel = %{channel | id: id}
          {:ok, channel, %{writer | channels: Map.put(channels, topic, channel)}}
        end
    end
  end

  @impl true
  def refuse_channel(%RawChannel{encoding: "cdr", schema: {_, _, _}}), do: nil

  def refuse_channel(%RawChannel{encoding: encoding}),
    do: "a bag of ROS 2 holds messages in CDR, and these are encoded as #{inspect(encoding)}"

  @impl true
  def add_channel(writer, %RawChannel{schema: {type, language, text}} = channel) do
    id = map_size(writer.topics) + 1
    metadata = Map.new(channel.metadata)
    hash = metadata["topic_type_hash"] || ""
    qos = metadata["offered_qos_profiles"] || ""
    known? = Enum.any?(writer.topics, fn {_, {other, _}} -> elem(other.schema, 0) == type end)

    definition =
      if known? or text == "",
        do: [],
        else: insert("message_definitions", ["null", type, language, text, hash])

    topic = insert("topics", [id, channel.topic, type, channel.encoding, qos, hash])
    writer = %{writer | topics: Map.put(writer.topics, id, {channel, 0})}
    with {:ok, writer} <- add_sql(writer, [definition, topic]), do: {:ok, id, writer}
  end

  defp insert(table, [id | texts]) do
    values = Enum.map(texts, &[", ", quote_text(&1)])
    ["insert into ", table, " values(", to_string(id), values, ");\n"]
  end

  # Text is written as bytes: names and definitions may contain quotes, line feeds and commands of the program.
  defp quote_text(text), do: ["cast(x'", Base.encode16(text), "' as text)"]

  @impl true
  def write_row(writer, id, {log_time, _publish_time, _sequence, bytes})
      when log_time in 0..0x7FFF_FFFF_FFFF_FFFF do
    {channel, count} = Map.fetch!(writer.topics, id)

    sql = [
      "insert into messages(topic_id, timestamp, data) values(",
      [Integer.to_string(id), ", ", Integer.to_string(log_time), ", x'", Base.encode16(bytes)],
      "');\n"
    ]

    add_sql(
      %{
        writer
        | topics: %{writer.topics | id => {channel, count + 1}},
          count: writer.count + 1,
          span: extend_span(writer.span, log_time)
      },
      sql
    )
  end

  def write_row(writer, id, {log_time, _publish_time, _sequence, _bytes}) do
    {channel, _count} = Map.fetch!(writer.topics, id)

    {:error,
     Error.new(
       :not_writable,
       "a message of #{channel.topic} has the time #{Situ.Time.to_iso8601(log_time)}",
       why: "bags of ROS 2 store only times from 1970 to 2262"
     )}
  end

  defp extend_span(nil, time), do: {time, time}
  defp extend_span({first, last}, time), do: {min(first, time), max(last, time)}

  @max_bytes 256 * 1024

  defp add_sql(writer, sql) do
    bytes = writer.bytes + IO.iodata_length(sql)
    writer = %{writer | sql: [writer.sql | sql], bytes: bytes}
    if bytes > @max_bytes, do: flush(writer), else: {:ok, writer}
  end

  @impl true
  def flush(writer) do
    with :ok <- Sqlite.send_statements(writer.session, writer.sql),
         do: {:ok, %{writer | sql: [], bytes: 0}}
  end

  @impl true
  def finish(writer) do
    topics = for {_id, topic} <- Enum.sort(writer.topics), do: topic
    {version, summary} = Summary.build(writer.name, topics, writer.span)

    with {:ok, writer} <-
           add_sql(writer, [
             insert("metadata(metadata_version, metadata)", [version, summary]),
             "commit;\n"
           ]),
         {:ok, writer} <- flush(writer),
         :ok <- Sqlite.end_session(writer.session),
         do: {:ok, nil}
  end
end
