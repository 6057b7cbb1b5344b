defmodule Situ.Store.SegmentedRecording do
  @moduledoc false
  # Reads the segments of a recording (`hall.0000`, `hall.0001` ...) as one recording, `hall`. Implements the behaviour
  # of recordings over the readers of the segments, and opens only the segments that a request needs.
  # `Situ.Store.SegmentedRecording.Index` knows which messages are in which segment.
  #
  # Ordinals count from the first message that existed when the recording was opened. They do not change while the
  # recorder adds segments and deletes the oldest.
  # See docs/adr/0168-segments-of-a-name-are-one-recording.md.
  @behaviour Situ.Recording
  alias Situ.Recording
  alias Situ.Store.{NativeErrors, NativeFormat, StreamInfo}
  alias Situ.Store.SegmentedRecording.{Contents, Index, PartReading, Summaries}

  @enforce_keys [:key, :epoch, :first]
  defstruct [:key, :epoch, :first, origin: %{}]
  @type t :: %__MODULE__{}

  @doc "Opens the recording at `path`, ROOT/NAME."
  @spec open(Path.t(), keyword()) :: {:ok, t()} | {:error, Situ.Error.t()}
  def open(path, opts) do
    key = {Path.basename(path), Path.dirname(path), opts}

    with {:ok, %{epoch: epoch, first: first, origin: origin}} <- Index.open(key) do
      if first < 0,
        do: {:error, Index.no_store_error(key)},
        else: {:ok, %__MODULE__{key: key, epoch: epoch, first: first, origin: origin}}
    end
  end

  @doc "Returns the path of the recording, ROOT/NAME."
  @spec path(t()) :: Path.t()
  def path(%{key: {name, root, _}}), do: Path.join(root, name)

  @doc "Returns the current segments, oldest first: path, name, times, counts and state."
  @spec list_segments(Recording.t()) :: [map()]
  def list_segments(%Recording{state: state}) do
    query(state, fn contents ->
      contents |> Contents.list_segments() |> Enum.map(&describe_segment/1)
    end)
  end

  defp describe_segment(segment) do
    infos = Map.values(segment.infos)
    times = for %{first: first, last: last} when first != nil <- infos, do: {first, last}

    %{
      path: segment.path,
      number: segment.number,
      run: segment.run,
      created: segment.info.created,
      live?: segment.info.live?,
      closed?: segment.info.closed?,
      count: infos |> Enum.map(& &1.count) |> Enum.sum(),
      first: times |> Enum.map(&elem(&1, 0)) |> Enum.min(fn -> nil end),
      last: times |> Enum.map(&elem(&1, 1)) |> Enum.max(fn -> nil end)
    }
  end

  # Runs a function of the contents in the process that owns them.
  defp query(state, fun), do: Index.call(state.key, {:query, fun})

  @impl true
  def info(state) do
    case query(state, &build_info(&1, state.key)) do
      nil -> raise Index.no_store_error(state.key)
      info -> info
    end
  end

  defp build_info(%{segments: none}, _key) when none == %{}, do: nil

  defp build_info(contents, {name, _root, _opts}) do
    segments = Contents.list_segments(contents)
    infos = Enum.map(segments, & &1.info)
    newest = List.last(infos)

    %{
      name: name,
      version: nil,
      created: hd(infos).created,
      closed?: Enum.all?(infos, & &1.closed?),
      live?: Enum.any?(infos, & &1.live?),
      volatile?: newest.volatile?,
      piece: nil,
      segments: length(segments),
      deleted: contents.deleted,
      entries: infos |> Enum.map(& &1.entries) |> Enum.sum(),
      synced: newest.synced,
      id: newest.id,
      notes: notes(contents),
      damage: Enum.flat_map(segments, &segment_damage/1) ++ Map.values(contents.unreadable)
    }
  end

  defp segment_damage(segment) do
    name = Path.basename(segment.path)
    for {file, offset, why} <- segment.info.damage, do: {Path.join(name, file), offset, why}
  end

  defp notes(contents) do
    case Contents.count_hidden(contents) do
      0 ->
        []

      n ->
        [
          "#{n} messages of earlier runs are later than messages of a later run, and are not shown: " <>
            "the clock was set back, or the same time was recorded again. Open the segments to read them"
        ]
    end
  end

  @impl true
  def streams(state) do
    path = path(state)
    query(state, &Contents.list_streams(&1, path))
  end

  @impl true
  def stream(state, name) do
    path = path(state)

    case query(state, &(Contents.build_stream(&1, name, path) || Map.keys(&1.ids))) do
      %StreamInfo{} = info -> {:ok, info}
      names -> {:error, NativeErrors.no_stream_error(name, names, path)}
    end
  end

  @impl true
  def count(state, info),
    do: Index.call(state.key, {:next_ordinal, info.name}) - PartReading.origin(state, info)

  @impl true
  def seek(state, info, time) do
    with {:ok, ordinal} <- PartReading.seek(state, info, time),
         do: {:ok, max(ordinal - PartReading.origin(state, info), 0)}
  end

  @impl true
  def latest_at(state, info, time), do: PartReading.latest_at(state, info, time)

  @impl true
  def read(state, info, ordinal, to, limit, opts) do
    PartReading.walk(state, info, {ordinal, to}, fn {reader, part_info}, local, to ->
      with {:ok, messages, next} <- NativeFormat.read(reader, part_info, local, to, limit, opts),
           do: {:ok, messages, next, messages != []}
    end)
    |> case do
      {:ok, messages, next} -> {:ok, put_source(messages, info.id), next}
      {:ended, next} -> {:ok, [], next}
      other -> other
    end
  end

  # The number of a stream differs between segments if its streams were not added in the same order.
  defp put_source([%{source_id: id} | _] = messages, id), do: messages
  defp put_source(messages, id), do: for(message <- messages, do: %{message | source_id: id})

  @impl true
  def columns(state, info, ordinal, to, bytes) do
    PartReading.walk(state, info, {ordinal, to}, fn {reader, part_info}, local, to ->
      case NativeFormat.columns(reader, part_info, local, to, bytes) do
        {:ok, columns, next} -> {:ok, columns, next, true}
        :ended -> {:ok, nil, local, false}
        other -> other
      end
    end)
    |> case do
      {:ended, _} -> :ended
      other -> other
    end
  end

  @impl true
  def summary(state, info, from, to, pixels),
    do: Summaries.read_numbers(state, info, from, to, pixels)

  @impl true
  def tracks(state, info, from, to, level, most),
    do: Summaries.read_tracks(state, info, {from, to}, level, most)

  @impl true
  def gaps(state, info, least) do
    :ok = Index.call(state.key, :refresh)

    with {:ok, table} <- PartReading.open_table(state) do
      parts = table |> Index.fetch_parts(info.name) |> Tuple.to_list()

      between =
        for [a, b] <- Enum.chunk_every(parts, 2, 1, :discard),
            from = PartReading.last_time(state, table, info, a),
            b.first - from >= least,
            do: {from, b.first}

      within =
        for part <- parts,
            {:ok, {reader, part_info}} <- [PartReading.open_part(state, table, info, part)],
            {from, to} <- NativeFormat.gaps(reader, part_info, least),
            part.until == nil or to < part.until,
            do: {from, to}

      Enum.sort(between ++ within)
    else
      _ -> []
    end
  end

  @impl true
  def missing_files(state),
    do:
      query(state, fn contents ->
        contents |> Contents.list_segments() |> Enum.flat_map(& &1.missing)
      end)

  @impl true
  def notify(state, known, pid, tag), do: Index.call(state.key, {:notify, known, pid, tag})

  @doc """
  Returns a stream's parts in order of time: the segment's `number`, the stream's `info` in it, the ordinal of its first
  message (`base`), the number of messages (`count`), and the time from which on messages are hidden (`until`, or
  `nil`).
  """
  @spec list_parts(t(), StreamInfo.t()) :: [map()]
  def list_parts(state, %{name: name} = info) do
    parts =
      query(state, fn contents ->
        for part <- Tuple.to_list(Contents.parts_of(contents, name)),
            do: {part, contents.segments[part.number].infos[name]}
      end)

    origin = PartReading.origin(state, info)

    for {part, info} <- parts do
      part
      |> Map.take([:number, :count, :until])
      |> Map.merge(%{base: part.base - origin, info: info})
    end
  end

  @doc "Opens the segment of a part, which may have been deleted."
  @spec open_part(t(), map()) :: {:ok, Recording.t()} | :deleted | {:error, Situ.Error.t()}
  def open_part(state, part) do
    with {:ok, table} <- PartReading.open_table(state),
         {:ok, reader, _infos} <- Index.fetch_segment(state.key, table, part.number),
         do: {:ok, %Recording{path: reader.path, module: NativeFormat, state: reader}}
  end
end
