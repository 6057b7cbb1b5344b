defmodule Situ.Bridge.Ros.Db3 do
  @moduledoc """
  Opens ROS 2 bags in SQLite (`.db3`) as recordings with `Situ.Store.open("drive/drive_0.db3")`. They also work in the
  studio, in `bin/situ store` and for replay.

      {:ok, store} = Situ.Store.open("drive/drive_0.db3", reader_opts: [times: :header])
      {:ok, messages} = Situ.Store.read(store, "/imu")

  Each topic is a stream. Messages (CDR) are decoded with the definitions in the file, which ROS 2 has written since
  Iron, or with ROS's standard definitions. Standard types become Situ's types (the table in `Situ.Bridge.Ros`). Each
  file of a split bag is a separate recording. The program `sqlite3` (the Debian package of the same name) reads the
  file in a separate process. An opened file is never modified. `export/3` writes a new file.
  """

  alias Situ.Bridge.Mcap.{Codec, ExtraFields}
  alias Situ.Bridge.Recorder.StoreExport
  alias Situ.Bridge.Ros.Db3.{Sqlite, Summary, Topics, Writer}
  alias Situ.Bridge.Ros.{Definition, MessageIndex, TopicTrack}
  alias Situ.Message
  alias Situ.Store.{StreamInfo, Undecoded}

  @schema Codec.time_options() ++ Codec.reader_options()

  Situ.Options.add_to_moduledoc(__MODULE__, @schema, "`reader_opts:` of `Situ.Store.open/2`")

  @behaviour Situ.Recording
  @behaviour Situ.Recording.Format

  # Stands in for a message that another program deleted after the file was opened.
  @deleted_message %Undecoded{
    codec: "cdr",
    bytes: "",
    reason: "the message was deleted from the file"
  }

  # Maximum size of the messages in one batch, in bytes.
  @max_batch 16 * 1024 * 1024

  defstruct [:path, :name, :tracks, :streams, :notes]

  @impl true
  def extensions, do: [".db3"]

  @impl true
  def kinds,
    do: [
      %Situ.Recording.FileKind{
        name: :db3,
        title: "ROS 2 bag (SQLite)",
        extensions: extensions(),
        open: __MODULE__,
        export: [".db3"],
        program: "sqlite3"
      }
    ]

  @impl true
  def open(path, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, topics} <- Topics.read_topics(path),
         {:ok, definitions} <- Topics.read_definitions(path),
         {:ok, rows} <-
           Sqlite.query(path, "select topic_id, timestamp, id, length(data) from messages") do
      positions =
        rows |> Enum.flat_map(&parse_position/1) |> Enum.group_by(&elem(&1, 0), &elem(&1, 1))

      tracks =
        for topic <- topics, do: build_track(topic, definitions, positions, opts[:messages])

      with {:ok, tracks} <- put_stamps(tracks, path, opts[:times]),
           do:
             {:ok,
              build_state(path, Enum.flat_map(tracks, &TopicTrack.add_extra(&1, opts[:messages])))}
    end
  end

  defp build_state(path, tracks) do
    name = Path.basename(path, ".db3")

    %__MODULE__{
      path: path,
      name: name,
      tracks: Map.new(tracks, &{&1.id, &1}),
      streams: Enum.map(tracks, &describe_stream(&1, name, path)),
      notes: for(%{note: note} = track <- tracks, note != nil, do: "#{track.topic}: #{note}")
    }
  end

  # Parses the topic and position of a message. SQLite allows text in numeric columns; such rows are skipped.
  defp parse_position(row) do
    for [topic, time, id, size] <- Topics.parse_numbers(row),
        id >= 0,
        size >= 0,
        do: {topic, {time, id, size}}
  end

  defp build_track(topic, definitions, positions, messages) do
    name = Definition.strip_kind(topic.type)
    schema = find_schema(topic.type, definitions)
    {codec, situ, note} = Codec.new(topic.format, schema, topic.name)
    rows = Map.get(positions, topic.id, [])

    %{
      id: topic.id,
      topic: topic.name,
      type: name,
      codec: Codec.set_message_mode(codec, messages),
      situ: situ,
      note: note,
      recorded: rows |> Enum.map(&elem(&1, 0)) |> Enum.min_max(fn -> {nil, nil} end),
      places: MessageIndex.pack(rows),
      stamps?: false,
      schema: if(messages == :apart, do: schema)
    }
  end

  defp find_schema(type, definitions) do
    with %{^type => {"ros2msg", text}} when text != "" <- definitions do
      {type, "ros2msg", text}
    else
      _ ->
        with text when text != nil <- Topics.standard_definition(type),
             do: {type, "ros2msg", text}
    end
  end

  # Takes originating times from the headers of messages that begin with one.
  defp put_stamps(tracks, path, :header) do
    case for(%{id: id, codec: codec} <- tracks, Codec.stamp_encoding(codec), do: id) do
      [] ->
        {:ok, tracks}

      ids ->
        sql =
          "select topic_id, timestamp, id, length(data), hex(substr(data, 1, 12)) from messages " <>
            "where topic_id in (#{Enum.join(ids, ",")})"

        with {:ok, rows} <- Sqlite.query(path, sql) do
          stamped =
            rows
            |> Enum.flat_map(&parse_stamped_position/1)
            |> Enum.group_by(&elem(&1, 0), &elem(&1, 1))

          {:ok, for(track <- tracks, do: put_positions(track, stamped[track.id]))}
        end
    end
  end

  defp put_stamps(tracks, _path, :log), do: {:ok, tracks}

  defp parse_stamped_position([topic, time, id, size, start]) do
    for {topic, {recorded, id, size}} <- parse_position([topic, time, id, size]),
        {:ok, bytes} <- [Base.decode16(start)],
        do: {topic, {read_stamp(bytes) || recorded, id, size}}
  end

  defp parse_stamped_position(_row), do: []

  # CDR begins with a byte of padding, the byte order and two bytes of options. Seconds and nanoseconds follow. A zero
  # stamp means that the time is missing.
  defp read_stamp(<<_, _, _::16, 0::64>>), do: nil
  defp read_stamp(<<_, 1, _::16, s::little-signed-32, ns::little-32>>), do: join_stamp(s, ns)
  defp read_stamp(<<_, 0, _::16, s::signed-32, ns::32>>), do: join_stamp(s, ns)
  defp read_stamp(_other), do: nil

  defp join_stamp(seconds, ns), do: seconds * 1_000_000_000 + ns

  defp put_positions(track, nil), do: track
  defp put_positions(track, rows), do: %{track | places: MessageIndex.pack(rows), stamps?: true}

  defp describe_stream(track, name, path) do
    count = MessageIndex.count_rows(track.places)

    {first, last} =
      if count > 0, do: {time_at(track, 0), time_at(track, count - 1)}, else: {nil, nil}

    {first_recorded, last_recorded} = track.recorded

    %StreamInfo{
      id: track.id,
      name: track.topic,
      store_name: name,
      store_path: path,
      type: track.situ,
      type_name: track.type,
      opened: first,
      closed: last || 0,
      count: count,
      first: first,
      last: last,
      first_creation: first_recorded,
      last_creation: last_recorded,
      supplemental: ExtraFields.build_metadata([], track.schema)
    }
  end

  defp time_at(track, n), do: track.places |> MessageIndex.row_at(n) |> elem(0)

  @impl true
  defdelegate import_options(times), to: Codec

  @doc false
  # Makes `Situ.Bridge.Recorder.StoreExport` read all the fields of a message, as maps.
  def as_maps(%__MODULE__{tracks: tracks} = state),
    do: %{state | tracks: Codec.read_maps(tracks)}

  @impl true
  def info(state) do
    created =
      state.streams |> Enum.map(& &1.first) |> Enum.reject(&is_nil/1) |> Enum.min(fn -> nil end)

    %{
      name: state.name,
      created: created,
      closed?: true,
      live?: false,
      damage: [],
      notes: state.notes
    }
  end

  @impl true
  def streams(state), do: state.streams

  @impl true
  def seek(state, info, time),
    do: {:ok, MessageIndex.seek(Map.fetch!(state.tracks, info.id).places, time)}

  @impl true
  def read(state, info, ordinal, to, limit, opts) do
    track = Map.fetch!(state.tracks, info.id)
    rows = track.places |> MessageIndex.slice(ordinal, to, limit) |> take_batch(0)

    cond do
      rows == [] ->
        {:ok, [], ordinal}

      opts[:envelopes] && not track.stamps? ->
        data_by_id = for {time, id, _size} <- rows, into: %{}, do: {id, {time, nil}}
        {:ok, build_messages(rows, ordinal, track, data_by_id), ordinal + length(rows)}

      true ->
        with {:ok, data_by_id} <- fetch_messages(state, track, rows, opts[:envelopes] == true),
             do: {:ok, build_messages(rows, ordinal, track, data_by_id), ordinal + length(rows)}
    end
  end

  defp take_batch([row | rows], bytes) when bytes < @max_batch,
    do: [row | take_batch(rows, bytes + elem(row, 2))]

  defp take_batch(_rows, _bytes), do: []

  # Fetches the recording times and the data of messages, by message id.
  defp fetch_messages(state, track, rows, envelopes?) do
    ids = Enum.map_join(rows, ",", &elem(&1, 1))
    column = if envelopes?, do: "''", else: "hex(data)"
    sql = "select id, timestamp, #{column} from messages where id in (#{ids})"

    with {:ok, data_by_id} <- Sqlite.query(state.path, sql) do
      {:ok,
       for(
         [id, recorded, hex] <- data_by_id,
         [id, recorded] <- Topics.parse_numbers([id, recorded]),
         {:ok, bytes} <- [Base.decode16(hex)],
         into: %{},
         do: {id, {recorded, if(not envelopes?, do: decode_data(bytes, track.codec))}}
       )}
    end
  end

  defp build_messages(rows, ordinal, track, data_by_id) do
    for {{time, id, _}, n} <- Enum.with_index(rows, ordinal) do
      {recorded, data} = Map.get(data_by_id, id, {time, @deleted_message})
      recorded = if track.stamps?, do: recorded, else: time

      %Message{
        data: Codec.put_times(data, track.codec, time, {recorded, recorded}),
        originating_time: time,
        creation_time: max(recorded, time),
        sequence_id: n + 1,
        source_id: track.id
      }
    end
  end

  defp decode_data(bytes, codec) do
    case Codec.decode(codec, bytes) do
      {:ok, value} -> value
      {:error, why} -> %Undecoded{codec: "cdr", bytes: bytes, reason: why}
    end
  end

  @doc """
  Writes a recording to a new bag of ROS 2, with the messages in order of time. Returns `{:ok, count}`. Accepts the
  options `from:`, `to:` and `skip_damage:` of `Situ.Store.messages/3`, `streams:` (the names of the streams to write)
  and `progress:` (a function that gets the number of messages written so far). Values are encoded as standard
  messages of ROS 2 (the table in `Situ.Bridge.Ros`).

  If the file is the only one of its folder, `metadata.yaml` is written next to it, so that ROS 2 can play the folder.
  `Situ.Bridge.RawMessages.copy/3` writes bags without encoding messages again.
  """
  @spec export(Situ.Store.t(), Path.t(), keyword()) ::
          {:ok, non_neg_integer()} | {:error, Situ.Error.t()}
  def export(store, path, opts \\ []) do
    with {:ok, count} <- StoreExport.export_store(Writer, store, path, opts),
         :ok <- Summary.write_beside(path),
         do: {:ok, count}
  end

  @doc false
  # For the command line, which gives files their names when they are complete.
  defdelegate write_beside(path), to: Summary
end
