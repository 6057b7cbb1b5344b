defmodule Situ.Bridge.Ros.Bag do
  @moduledoc """
  Opens ROS 1 bags (version 2.0) as recordings with `Situ.Store.open("drive.bag")`. They also work in the studio, in
  `bin/situ store` and for replay. `create/3` and `write/4` write a bag while a pipeline runs, and `export/3` writes
  one from a recording.

      {:ok, store} = Situ.Store.open("drive.bag", reader_opts: [times: :header])
      drive = Situ.Bridge.Ros.Bag.create(p, "drive.bag")
      Situ.Bridge.Ros.Bag.write(images, drive, "/camera/image_raw")

  Each topic is a stream. Messages are decoded with the definition in the bag, and standard types become Situ's types
  (the table in `Situ.Bridge.Ros`). Messages of a topic with the same time are placed one nanosecond apart. Bags
  without an index (`.bag.active`, because the recorder was killed) are scanned. Chunks may be uncompressed or LZ4;
  bzip2 chunks are skipped and reported under `:damage`. Written chunks are uncompressed unless `compression: :lz4` is
  given.

  Depth images that the RealSense SDK recorded (`/device_0/sensor_0/Depth_0/image/data`) become `Situ.DepthImage`, with
  the unit given in the bag. The camera's `Situ.CameraIntrinsics` are in `.../Depth_0/info/camera_info`.
  """

  alias Situ.Bridge.Mcap.{Codec, ExtraFields}
  alias Situ.Bridge.Recorder.{StoreExport, Exporter}
  alias Situ.Bridge.Ros.Bag.{Index, MessageReader, RealSense, Record, Writer}
  alias Situ.Bridge.Ros.{MessageIndex, TopicTrack}
  alias Situ.{Error, Message}
  alias Situ.Store.{StreamInfo, Undecoded}

  @schema Codec.time_options() ++ Codec.reader_options()

  Situ.Options.add_to_moduledoc(__MODULE__, @schema, "`reader_opts:` of `Situ.Store.open/2`")

  @behaviour Situ.Recording
  @behaviour Situ.Recording.Format

  defstruct [:path, :size, :name, :contents, :tracks, :streams, :notes]

  @impl true
  def extensions, do: [".bag", ".active"]

  @impl true
  def kinds,
    do: [
      %Situ.Recording.FileKind{
        name: :bag,
        title: "ROS 1 bag",
        extensions: extensions(),
        signatures: [{0, "#ROSBAG V"}],
        open: __MODULE__,
        export: [".bag"]
      }
    ]

  @impl true
  def open(path, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, size} <- MessageReader.file_size(path),
         {:ok, contents} <- MessageReader.with_file(path, &Index.read(&1, size)) do
      state = %__MODULE__{
        path: path,
        size: size,
        name: Path.basename(path, Path.extname(path)),
        contents: contents
      }

      with {:ok, tracks} <- build_tracks(state, opts),
           do: {:ok, put_streams(%{state | tracks: tracks})}
    end
  end

  # Connections with the same topic and type form one stream.
  defp build_tracks(state, opts) do
    times = opts[:times]

    groups =
      state.contents.connections
      |> Enum.sort()
      |> Enum.group_by(fn {_, c} -> {c.topic, c.type} end)

    groups
    |> Enum.sort_by(fn {_, [{number, _} | _]} -> number end)
    |> Enum.reduce_while({:ok, []}, fn {{topic, type}, connections}, {:ok, tracks} ->
      {_, %{definition: definition}} = hd(connections)
      {codec, situ, note} = Codec.new("ros1", {type, "ros1msg", definition}, topic)

      positions =
        for {number, _} <- connections,
            rows <- Map.get(state.contents.positions, number, []),
            row <- rows,
            do: row

      recorded = positions |> Enum.map(&elem(&1, 0)) |> Enum.min_max(fn -> {nil, nil} end)
      stamps? = times == :header and Codec.stamp_encoding(codec) != nil
      positions = if stamps?, do: put_stamps(state, positions), else: positions

      track = %{
        id: elem(hd(connections), 0),
        topic: topic,
        type: type,
        situ: situ,
        codec: Codec.set_message_mode(codec, opts[:messages]),
        note: note,
        count: length(positions),
        positions: MessageIndex.pack(positions),
        recorded: recorded,
        stamps?: stamps?,
        schema: if(opts[:messages] == :apart, do: {type, "ros1msg", definition})
      }

      {:cont, {:ok, Enum.reverse(TopicTrack.add_extra(track, opts[:messages]), tracks)}}
    end)
    |> then(fn {:ok, tracks} ->
      {:ok, tracks |> Enum.reverse() |> RealSense.put_depth_units(&read_first(state, &1))}
    end)
  end

  defp read_first(state, track) do
    with %{count: count} when count > 0 <- track,
         {:ok, [{_, {_, bytes}}]} <-
           MessageReader.read_messages(state.path, state.size, [
             MessageIndex.row_at(track.positions, 0)
           ]),
         {:ok, data} <- Codec.decode(track.codec, bytes),
         do: data,
         else: (_ -> nil)
  end

  defp put_stamps(state, positions) do
    case MessageReader.read_messages(
           state.path,
           state.size,
           Enum.sort_by(positions, fn {_, chunk, offset} -> {chunk, offset} end)
         ) do
      {:ok, messages} ->
        for {{time, chunk, offset}, {_, bytes}} <- messages,
            do: {parse_stamp(bytes) || time, chunk, offset}

      {:error, _} ->
        positions
    end
  end

  defp parse_stamp(<<_seq::32, 0::64, _::binary>>), do: nil
  defp parse_stamp(<<_seq::32, stamp::binary-8, _::binary>>), do: Record.parse_time(stamp)
  defp parse_stamp(_), do: nil

  defp put_streams(state) do
    {streams, _names} =
      Enum.map_reduce(state.tracks, MapSet.new(), &describe_stream(state, &1, &2))

    notes = for %{note: note} = track <- state.tracks, note != nil, do: "#{track.topic}: #{note}"
    %{state | streams: streams, notes: notes, tracks: Map.new(state.tracks, &{&1.id, &1})}
  end

  defp describe_stream(state, track, names) do
    name =
      if MapSet.member?(names, track.topic),
        do: "#{track.topic} (#{track.type})",
        else: track.topic

    {first, last} =
      if track.count > 0,
        do:
          {elem(MessageIndex.row_at(track.positions, 0), 0),
           elem(MessageIndex.row_at(track.positions, track.count - 1), 0)},
        else: {nil, nil}

    {first_recorded, last_recorded} = track.recorded

    info = %StreamInfo{
      id: track.id,
      name: name,
      store_name: state.name,
      store_path: state.path,
      type: track.situ,
      type_name: track.type,
      opened: first,
      closed: if(state.contents.indexed?, do: last || 0),
      count: track.count,
      first: first,
      last: last,
      first_creation: first_recorded,
      last_creation: last_recorded,
      supplemental: ExtraFields.build_metadata([], track.schema)
    }

    {info, MapSet.put(names, name)}
  end

  @impl true
  defdelegate import_options(times), to: Codec

  @doc false
  # Makes `Situ.Bridge.Recorder.StoreExport` read all the fields of a message, as maps.
  def as_maps(%__MODULE__{tracks: tracks} = state),
    do: %{state | tracks: Codec.read_maps(tracks)}

  @impl true
  def info(state) do
    %{
      name: state.name,
      created:
        state.streams |> Enum.map(& &1.first) |> Enum.reject(&is_nil/1) |> Enum.min(fn -> nil end),
      closed?: state.contents.indexed?,
      live?: false,
      damage: Enum.reverse(state.contents.damage),
      notes: state.notes
    }
  end

  @impl true
  def streams(state), do: state.streams

  @impl true
  def seek(state, info, time) do
    track = Map.fetch!(state.tracks, info.id)
    {:ok, MessageIndex.seek(track.positions, time)}
  end

  @impl true
  def read(state, info, ordinal, to, limit, opts) do
    track = Map.fetch!(state.tracks, info.id)

    positions = MessageIndex.slice(track.positions, ordinal, to, limit)

    cond do
      positions == [] ->
        {:ok, [], ordinal}

      opts[:envelopes] && not track.stamps? ->
        {:ok, build_envelopes(track, positions, ordinal), ordinal + length(positions)}

      true ->
        decode_messages(state, track, positions, ordinal, opts[:envelopes] == true)
    end
  end

  # Builds envelopes without reading the messages, so both times are the recording time.
  defp build_envelopes(track, positions, ordinal) do
    for {{time, _, _}, at} <- Enum.with_index(positions, ordinal),
        do: build_message(track, {time, time}, at, nil)
  end

  defp decode_messages(state, track, positions, ordinal, envelopes?) do
    with {:ok, messages} <- MessageReader.read_messages(state.path, state.size, positions) do
      messages =
        for {{{time, _, _}, {recorded, bytes}}, at} <- Enum.with_index(messages, ordinal) do
          recorded = if track.stamps? and recorded != nil, do: recorded, else: time

          data =
            if not envelopes? do
              bytes
              |> decode_data(track.codec)
              |> RealSense.convert_depth(track.unit)
              |> Codec.put_times(track.codec, time, {recorded, recorded})
            end

          build_message(track, {time, recorded}, at, data)
        end

      {:ok, messages, ordinal + length(messages)}
    end
  end

  defp build_message(track, {time, recorded}, ordinal, data),
    do: %Message{
      data: data,
      originating_time: time,
      creation_time: max(recorded, time),
      sequence_id: ordinal + 1,
      source_id: track.id
    }

  defp decode_data(bytes, codec) do
    case Codec.decode(codec, bytes) do
      {:ok, value} -> value
      {:error, why} -> %Undecoded{codec: "ros1", bytes: bytes, reason: why}
    end
  end

  # Writing

  @doc """
  Creates a bag that the pipeline writes. Call it while the pipeline is built.

  #{Situ.Options.docs(Writer.file_options())}
  """
  @spec create(Situ.Pipeline.t(), Path.t(), keyword()) :: Exporter.t()
  def create(p, path, opts \\ []), do: Exporter.create(p, Writer, path, opts)

  @doc """
  Writes a stream to a topic; returns the stream.

  #{Situ.Options.docs(Writer.topic_options())}
  """
  @spec write(Situ.Stream.t(), Exporter.t(), String.t(), keyword()) :: Situ.Stream.t()
  defdelegate write(stream, exporter, topic, opts \\ []), to: Exporter

  @doc """
  Writes a recording to a new bag, with the messages in order of time. Returns `{:ok, count}`. Accepts the options of
  `create/3`, the options `from:`, `to:` and `skip_damage:` of `Situ.Store.messages/3`, `streams:` (the names of the
  streams to write) and `progress:` (a function that gets the number of messages written so far).
  """
  @spec export(Situ.Store.t(), Path.t(), keyword()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def export(store, path, opts \\ []), do: StoreExport.export_store(Writer, store, path, opts)
end
