defmodule Situ.Bridge.Mcap do
  @moduledoc """
  Opens MCAP files (https://mcap.dev) as recordings with `Situ.Store.open("drive.mcap")`. They also work in the
  studio, in `bin/situ store` and for replay in a pipeline. `create/3` and `write/4` write MCAP files while a pipeline
  runs, and `export/3` writes them from a recording.

      {:ok, store} = Situ.Store.open("drive.mcap")
      {:ok, message} = Situ.Store.latest_at(store, "/camera/image_raw", time)

      drive = Situ.Bridge.Mcap.create(p, "drive.mcap")
      Situ.Bridge.Mcap.write(level, drive, "/level")

  Each topic is a stream. Messages are decoded by the channel's schema: ROS 1, ROS 2 (CDR), Protobuf and JSON.
  Messages in other encodings are bytes, and `Situ.Store.info/1` notes that. Standard messages of ROS and of Foxglove
  become Situ's types (the tables in `Situ.Bridge.Ros` and `Situ.Bridge.Foxglove`), and other messages become maps. If
  two messages of a topic have the same time, the second one is moved by a nanosecond.

  Files with an index open immediately, whatever their size. Other files, including truncated files and files whose
  writer was killed, are scanned, and all readable messages are available. Chunks may be compressed with LZ4 or
  Zstandard. For attachments and metadata, see `list_attachments/1`, `read_attachment/2` and `Situ.Store.info/1`.
  """

  alias Situ.Bridge.Mcap.{Codec, Copy, ExtraFields, NativeError, TopicSizes, Writer}
  alias Situ.Bridge.Native
  alias Situ.Bridge.Recorder.{StoreExport, Exporter}
  alias Situ.{Error, Message}
  alias Situ.Store.{StreamInfo, Undecoded}

  @schema [
            times: [
              type: {:in, [:log, :publish, :header]},
              default: :log,
              doc:
                "Originating times: when a message was recorded (`:log`; the index has these times), when it was " <>
                  "sent (`:publish`), or the stamp of its ROS header (`:header`; the log time for messages without " <>
                  "one). `:publish` and `:header` scan all messages of a stream on its first use."
            ]
          ] ++ Codec.reader_options()

  Situ.Options.add_to_moduledoc(__MODULE__, @schema, "`reader_opts:` of `Situ.Store.open/2`")

  @behaviour Situ.Recording
  @behaviour Situ.Recording.Format

  @max_bytes 16 * 1024 * 1024

  defstruct [:path, :ref, :name, :channels, :streams, :times, :messages, :notes, :info]

  @impl true
  def extensions, do: [".mcap"]

  @impl true
  def kinds do
    kind = %Situ.Recording.FileKind{name: :mcap, title: "MCAP", extensions: extensions()}
    [%{kind | open: __MODULE__, export: extensions(), signatures: [{0, <<0x89, "MCAP0\r\n">>}]}]
  end

  @impl true
  def open(path, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, ref} <- NativeError.wrap_result(Native.mcap_open(path), path) do
      # If the index is damaged, the file is opened again and scanned without it.
      with {:error, %{code: :damaged} = error} <- open_reader(path, ref, opts),
           {:ok, ref} <-
             NativeError.wrap_result(Native.mcap_open_without_index(path, "(#{error.why})"), path),
           do: open_reader(path, ref, opts)
    end
  end

  defp open_reader(path, ref, opts) do
    {profile, library, channels, schemas, attachments, metadata, {damage, finished?}} =
      Native.mcap_info(ref)

    schemas = Map.new(schemas, fn {id, name, encoding, data} -> {id, {name, encoding, data}} end)

    state = %__MODULE__{
      path: path,
      ref: ref,
      times: opts[:times],
      messages: opts[:messages],
      name: Path.basename(path, Path.extname(path))
    }

    with {:ok, infos} <- build_channels(state, channels, schemas) do
      info = %{
        profile: profile,
        library: library,
        attachments: attachments,
        metadata: metadata,
        damage: damage,
        finished?: finished?
      }

      {:ok, name_channels(%{state | info: info}, infos)}
    end
  end

  # A stream is a topic. If several channels share a topic (after a restart of the recorder), their names are
  # numbered.
  defp build_channels(state, channels, schemas) do
    Enum.reduce_while(channels, {:ok, []}, fn {id, topic, encoding, schema, metadata, _count},
                                              {:ok, infos} ->
      {codec, type, note} = Codec.new(encoding, schemas[schema], topic)
      times = time_order(state.times, codec)

      case NativeError.wrap_result(Native.mcap_span(state.ref, id, times), state.path) do
        {:ok, span} ->
          channel = %{
            id: id,
            native: id,
            topic: topic,
            codec: Codec.set_message_mode(codec, state.messages),
            times: times,
            type: type,
            note: note,
            span: span,
            metadata: metadata,
            schema: schemas[schema]
          }

          {:cont, {:ok, add_extra_channel(channel, state.messages) ++ infos}}

        {:error, error} ->
          {:halt, {:error, error}}
      end
    end)
  end

  defp add_extra_channel(channel, :apart) do
    if Codec.lossy?(channel.codec, channel.type) do
      id = ExtraFields.stream_number(channel.id)
      extra = %{channel | id: id, codec: Codec.extra_codec(channel.codec), type: :map, note: nil}

      [
        %{extra | topic: ExtraFields.stream_name(channel.topic), metadata: [], schema: nil},
        channel
      ]
    else
      [channel]
    end
  end

  defp add_extra_channel(channel, _messages), do: [channel]

  defp time_order(:header, codec), do: Codec.stamp_encoding(codec) || :log
  defp time_order(times, _codec), do: times

  defp name_channels(state, infos) do
    {channels, _names} =
      infos
      |> Enum.reverse()
      |> Enum.map_reduce(MapSet.new(), fn channel, names ->
        name = unused_name(channel.topic, names, 2)
        {Map.put(channel, :name, name), MapSet.put(names, name)}
      end)

    notes = for %{note: note} = channel <- channels, note != nil, do: "#{channel.name}: #{note}"
    streams = Enum.map(channels, &stream_info(state, &1))
    %{state | channels: Map.new(channels, &{&1.id, &1}), streams: streams, notes: notes}
  end

  defp unused_name(topic, names, n) do
    name = if n == 2, do: topic, else: "#{topic} #{n - 1}"
    if MapSet.member?(names, name), do: unused_name(topic, names, n + 1), else: name
  end

  defp stream_info(state, channel) do
    {first, last, count} = channel.span || {nil, nil, 0}
    schema = if state.messages == :apart, do: channel.schema

    %StreamInfo{
      id: channel.id,
      name: channel.name,
      store_name: state.name,
      store_path: state.path,
      type: channel.type,
      type_name: if(channel.schema, do: elem(channel.schema, 0), else: inspect(channel.type)),
      opened: first,
      closed: if(state.info.finished?, do: last || 0),
      count: count,
      first: first,
      last: last,
      first_creation: first,
      last_creation: last,
      supplemental: ExtraFields.build_metadata(channel.metadata, schema)
    }
  end

  @impl true
  def info(state) do
    %{
      name: state.name,
      created:
        state.streams |> Enum.map(& &1.first) |> Enum.reject(&is_nil/1) |> Enum.min(fn -> nil end),
      closed?: state.info.finished?,
      live?: false,
      damage: state.info.damage,
      notes: state.notes,
      written_by: state.info.library,
      profile: state.info.profile,
      metadata: for({name, pairs} <- state.info.metadata, do: {name, Map.new(pairs)})
    }
  end

  @impl true
  def streams(state), do: state.streams

  @impl true
  def seek(state, info, time) do
    channel = Map.fetch!(state.channels, info.id)

    NativeError.wrap_result(
      Native.mcap_seek(state.ref, channel.native, channel.times, time),
      state.path
    )
  end

  @impl true
  def read(state, info, ordinal, to, limit, opts) do
    channel = Map.fetch!(state.channels, info.id)
    envelopes? = opts[:envelopes] == true
    skip? = opts[:skip_damage] == true
    track = {channel.native, channel.times}
    query = {track, ordinal, to, {limit, @max_bytes}, {envelopes?, skip?}}

    with {:ok, {rows, next}} <-
           NativeError.wrap_result(Native.mcap_read(state.ref, query), state.path),
         do: {:ok, Enum.map(rows, &decode_message(&1, channel, envelopes?)), next}
  end

  defp decode_message({time, log_time, publish, sequence, bytes}, channel, envelopes?) do
    %Message{
      data:
        if(envelopes?,
          do: nil,
          else:
            bytes
            |> decode_data(channel.codec)
            |> Codec.put_times(channel.codec, time, {log_time, publish})
        ),
      originating_time: time,
      creation_time: max(log_time, time),
      sequence_id: sequence,
      source_id: channel.id
    }
  end

  defp decode_data(bytes, codec) do
    case Codec.decode(codec, bytes) do
      {:ok, value} -> value
      {:error, why} -> %Undecoded{codec: "mcap", bytes: bytes, reason: why}
    end
  end

  @impl true
  defdelegate import_options(times), to: Codec

  @doc false
  # Makes `Situ.Bridge.Recorder.StoreExport` read messages as maps with all their fields.
  def as_maps(%__MODULE__{channels: channels} = state),
    do: %{state | channels: Codec.read_maps(channels)}

  @doc "Returns the attachments of an opened file: the name, media type, time (ns) and size of each."
  @spec list_attachments(Situ.Store.t()) :: [
          %{
            name: String.t(),
            media_type: String.t(),
            time: Situ.Time.t(),
            size: non_neg_integer()
          }
        ]
  def list_attachments(%Situ.Recording{state: %__MODULE__{info: info}}) do
    for {name, media_type, time, _offset, size} <- info.attachments,
        do: %{name: name, media_type: media_type, time: time, size: size}
  end

  @doc """
  Returns the chunks of an opened file, in file order: the `offset` and `size` of each record, its `compression`
  (`""`: none), the number of compressed (`packed`) and uncompressed (`unpacked`) bytes of its data, and the times of
  its first and last message.
  """
  @spec list_chunks(Situ.Store.t()) :: [
          %{
            offset: non_neg_integer(),
            size: non_neg_integer(),
            compression: String.t(),
            packed: non_neg_integer(),
            unpacked: non_neg_integer(),
            first: Situ.Time.t(),
            last: Situ.Time.t()
          }
        ]
  def list_chunks(%Situ.Recording{state: %__MODULE__{ref: ref}}) do
    for {offset, size, compression, packed, unpacked, first, last} <- Native.mcap_chunks(ref) do
      %{
        offset: offset,
        size: size,
        compression: compression,
        packed: packed,
        unpacked: unpacked,
        first: first,
        last: last
      }
    end
  end

  @doc """
  Returns the channels of an opened file: the id, the topic, the encoding of the messages, the name of their schema,
  the number of messages, and the writer's metadata.
  """
  @spec list_channels(Situ.Store.t()) :: [
          %{
            id: non_neg_integer(),
            topic: String.t(),
            encoding: String.t(),
            schema: String.t() | nil,
            messages: non_neg_integer(),
            metadata: %{String.t() => String.t()}
          }
        ]
  def list_channels(%Situ.Recording{state: %__MODULE__{} = state}) do
    {_, _, channels, schemas, _, _, _} = Native.mcap_info(state.ref)
    names = Map.new(schemas, fn {id, name, _, _} -> {id, name} end)

    for {id, topic, encoding, schema, metadata, count} <- channels do
      %{
        id: id,
        topic: topic,
        encoding: encoding,
        schema: names[schema],
        messages: count,
        metadata: Map.new(metadata)
      }
    end
  end

  @doc "Returns the schemas of an opened file: the id, the name, the schema language (`encoding`), and the definition."
  @spec list_schemas(Situ.Store.t()) :: [
          %{id: non_neg_integer(), name: String.t(), encoding: String.t(), definition: binary()}
        ]
  def list_schemas(%Situ.Recording{state: %__MODULE__{ref: ref}}) do
    {_, _, _, schemas, _, _, _} = Native.mcap_info(ref)

    for {id, name, encoding, data} <- schemas,
        do: %{id: id, name: name, encoding: encoding, definition: data}
  end

  @doc """
  Sums the uncompressed bytes of each topic's messages and returns `{:ok, %{topic => bytes}}`. It reads the whole file
  and does not count messages outside chunks.
  """
  @spec topic_sizes(Situ.Store.t()) ::
          {:ok, %{String.t() => non_neg_integer()}} | {:error, Error.t()}
  def topic_sizes(%Situ.Recording{state: %__MODULE__{} = state} = store) do
    topics = Map.new(list_channels(store), &{&1.id, &1.topic})
    TopicSizes.sum_sizes(state, 0, topics, Map.new(topics, fn {_, topic} -> {topic, 0} end))
  end

  @doc "Returns the bytes of the first attachment with this name. Error: `:no_attachment`."
  @spec read_attachment(Situ.Store.t(), String.t()) :: {:ok, binary()} | {:error, Error.t()}
  def read_attachment(%Situ.Recording{state: %__MODULE__{} = state}, name) do
    case Enum.find(state.info.attachments, &(elem(&1, 0) == name)) do
      nil ->
        {:error, Error.new(:no_attachment, "#{state.path} has no attachment #{inspect(name)}")}

      {_, _, _, offset, _} ->
        NativeError.wrap_result(Native.mcap_attachment(state.ref, offset), state.path)
    end
  end

  # Writing

  @doc """
  Creates an MCAP file that the pipeline writes; call it during `build`.

  #{Situ.Options.docs(Situ.Bridge.Mcap.Options.file_options())}
  """
  @spec create(Situ.Pipeline.t(), Path.t(), keyword()) :: Exporter.t()
  def create(p, path, opts \\ []), do: Exporter.create(p, Writer, path, opts)

  @doc """
  Writes a stream to a topic; returns the stream.

  #{Situ.Options.docs(Situ.Bridge.Mcap.Options.topic_options())}
  """
  @spec write(Situ.Stream.t(), Exporter.t(), String.t(), keyword()) :: Situ.Stream.t()
  defdelegate write(stream, exporter, topic, opts \\ []), to: Exporter

  @doc """
  Writes a recording to a new MCAP file and returns `{:ok, count}`. Takes the options of `create/3`, and `streams:`,
  the names of the streams to write; `encoding:` as in `write/4`; `from:`, `to:` and `skip_damage:` as in
  `Situ.Store.messages/3`; and `progress:`, a function that receives the number of messages written so far.

  If the recording is an MCAP file and no encoding is given, its messages are copied unchanged (`copy/3`). Messages of
  other recordings are encoded, in order of time.
  """
  @spec export(Situ.Store.t(), Path.t(), keyword()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def export(store, path, opts \\ [])

  def export(%Situ.Recording{module: __MODULE__} = store, path, opts) do
    if Enum.any?([:encoding, :type, :definition, :frame], &Keyword.has_key?(opts, &1)),
      do: StoreExport.export_store(Writer, store, path, opts),
      else: with({:ok, %{messages: count}} <- copy(store, path, opts), do: {:ok, count})
  end

  def export(store, path, opts), do: StoreExport.export_store(Writer, store, path, opts)

  @doc """
  Copies an opened MCAP file into a new file, byte for byte: messages with both their times and sequence numbers,
  schemas, channels with their metadata, attachments, metadata records and the header, including data that Situ cannot
  interpret. `metadata:` replaces records with the same names. `left_out` is a list of sentences about data that could
  not be read (with `skip_damage: true`) or that the new file cannot hold.

  #{Situ.Options.docs(Copy.copy_options())}
  """
  @spec copy(Situ.Store.t(), Path.t(), keyword()) ::
          {:ok, %{messages: non_neg_integer(), left_out: [String.t()]}} | {:error, Error.t()}
  def copy(%Situ.Recording{module: __MODULE__, state: state}, path, opts \\ []),
    do: Copy.copy_file(state, path, opts)
end
