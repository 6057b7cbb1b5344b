defmodule Situ.Link.Server.RecordingReader do
  @moduledoc false
  # Serves a finished or growing recording. `{:series, root, name}` continues from each version (`name.0000`,
  # `name.0001` ...) to the next, so nothing is skipped when the recording program restarts or splits its recording into
  # segments. `{:live, root, name}` is the same for live streams, whose segments form one recording; these begin in the
  # oldest segment kept. `{:store, store}` is a single open recording; its streams end with it. Each client has a
  # separate reader, with a cursor for every stream that it requested, so no client waits for another.
  alias Situ.Error
  alias Situ.Link.Wire.Batch
  alias Situ.Link.Server.RecordingVersions
  alias Situ.Store.{NativeFormat, Query, SegmentedRecording, StreamInfo, TypeName}

  @batch 512
  @before_all Batch.before_all()

  # `whole`: all segments of a recording that is split, for requests.
  defstruct [
    :series,
    :store,
    :whole,
    live?: false,
    version: 0,
    count: 0,
    notice: :no,
    catalog: -1
  ]

  @type t :: %__MODULE__{}
  @type cursor :: map()

  @typedoc "A served recording, as described above."
  @type spec ::
          {:series | :live, Path.t(), name :: String.t()} | {:store, Situ.Recording.t()}

  @typedoc """
  The start of a subscription: messages from now on, the beginning (of the newest version of a recording), the first
  message at or after a time, or the first message after a time.
  """
  @type from :: :now | :start | {:at, Situ.Time.t()} | {:after, Situ.Time.t()}

  @typedoc "A catalogue entry for a stream: its name, and its `Situ.Type` as text."
  @type entry :: %{name: String.t(), type: String.t()}

  @doc "Opens a recording, which may not exist yet."
  @spec open(spec()) :: {:ok, t()} | {:error, Error.t()}
  def open({:store, %Situ.Recording{} = store}), do: {:ok, %__MODULE__{store: store}}

  def open({:live, root, name}) do
    with {:ok, state} <- open_series(root, name), do: {:ok, %{state | live?: true}}
  end

  def open({:series, root, name}) do
    with {:ok, state} <- open_series(root, name), do: {:ok, open_whole(state)}
  end

  # Ordinals of the recording's index are the same for all clients and connections.
  defp open_whole(%{whole: nil, live?: false, series: {root, name}} = state) do
    case Query.open(Path.join(root, name)) do
      {:ok, %{module: SegmentedRecording} = whole} ->
        %{state | whole: %{whole | state: %{whole.state | origin: %{}}}}

      _ ->
        state
    end
  end

  defp open_whole(state), do: state

  defp open_series(root, name) do
    state = %__MODULE__{series: {root, name}}

    case RecordingVersions.newest_version(root, name) do
      {version, path} ->
        with {:ok, store} <- Query.open(path), do: {:ok, set_version(state, version, store)}

      nil ->
        {:ok, state}
    end
  end

  @doc "Returns the specification of one version of a recording."
  @spec select_version(spec(), non_neg_integer()) :: {:ok, spec()} | :error
  def select_version({:store, _store}, _version), do: :error

  def select_version({:live, root, name}, version),
    do: select_version({:series, root, name}, version)

  def select_version({:series, root, name}, version) do
    with path when path != nil <- RecordingVersions.version_path(root, name, version),
         {:ok, store} <- Query.open(path),
         do: {:ok, {:store, store}},
         else: (_ -> :error)
  end

  defp set_version(state, version, store),
    do: %{state | version: version, store: store, count: 0, notice: :no, catalog: -1}

  @doc "Returns the current streams, or `:same` if they have not changed since the last call."
  @spec list_streams(t()) :: {[entry()] | :same, t()}
  def list_streams(%{store: nil} = state), do: {:same, state}

  def list_streams(state) do
    case count_records(state.store) do
      n when n == state.catalog and n != nil ->
        {:same, state}

      n ->
        entries = for info <- Query.streams(state.store), do: catalog_entry(info)
        {entries, %{state | catalog: n}}
    end
  end

  defp catalog_entry(%{module: nil} = info),
    do: %{name: info.name, type: TypeName.format_type(info.type)}

  defp catalog_entry(info), do: %{name: info.name, type: info.type_name}

  @doc "Returns the recording, for requests. `version` selects a version; `nil` selects the newest."
  @spec fetch_store(t(), version :: term()) :: {:ok, Situ.Recording.t()} | {:error, Error.t()}
  def fetch_store(%{store: nil, series: {_, name}}, _version),
    do:
      {:error,
       Error.new(:no_store, "the recording #{name} does not exist yet", fix: "try again later")}

  def fetch_store(%{series: nil, store: store}, _version), do: {:ok, store}
  def fetch_store(%{whole: %{} = whole}, nil), do: {:ok, whole}
  def fetch_store(%{version: version, store: store}, version), do: {:ok, store}
  def fetch_store(%{store: store}, nil), do: {:ok, store}

  def fetch_store(%{series: {root, name}}, version) when is_integer(version) do
    case RecordingVersions.version_path(root, name, version) do
      nil -> {:error, Error.new(:no_store, "version #{version} of #{name} no longer exists")}
      path -> Query.open(path)
    end
  end

  def fetch_store(_state, version),
    do: {:error, Error.new(:bad_request, "invalid version: #{inspect(version, limit: 5)}")}

  # Stream 0 has a record for each new stream and for each end of a stream.
  defp count_records(%{module: NativeFormat} = store),
    do: Query.count(store, %StreamInfo{id: 0, name: ""})

  defp count_records(%{module: SegmentedRecording} = store), do: length(Query.streams(store))
  defp count_records(_foreign), do: 0

  @doc "Returns a position in a stream, and the originating time of the last message before it."
  @spec open_cursor(t(), String.t(), from()) :: {:ok, cursor(), Situ.Time.t()} | :unknown
  def open_cursor(%{store: nil}, _name, _from), do: :unknown

  def open_cursor(%{live?: true} = state, name, :start),
    do: open_cursor(state, name, {:at, @before_all + 1})

  def open_cursor(state, name, from) when from in [:now, :start] do
    case Query.stream_info(state.store, name) do
      {:ok, info} when from == :start ->
        {:ok, build_cursor(state, info, 0), @before_all}

      {:ok, info} ->
        next = Query.count(state.store, info)
        {:ok, build_cursor(state, info, next), last_time(state, name)}

      {:error, _} ->
        :unknown
    end
  end

  def open_cursor(state, name, {:after, time}), do: open_cursor(state, name, {:at, time + 1})

  def open_cursor(%{series: nil} = state, name, {:at, time}) do
    with {:ok, info} <- Query.stream_info(state.store, name),
         {:ok, ordinal} <- Query.seek_ordinal(state.store, info, time) do
      {:ok, build_cursor(state, info, ordinal), time - 1}
    else
      {:error, _} -> :unknown
    end
  end

  def open_cursor(%{series: {root, name}} = state, stream, {:at, time}) do
    case RecordingVersions.find_containing(root, name, stream, time) do
      {version, store, info} ->
        {:ok, ordinal} = Query.seek_ordinal(store, info, time)
        {:ok, build_cursor(%{state | version: version, store: store}, info, ordinal), time - 1}

      nil ->
        :unknown
    end
  end

  defp build_cursor(state, info, ordinal),
    do: %{version: state.version, store: state.store, info: info, ordinal: ordinal, last: nil}

  # Uses the newest version in which the stream has messages.
  defp last_time(%{series: nil} = state, name),
    do: last_or_before_all(Query.stream_info(state.store, name))

  defp last_time(%{series: {root, name}}, stream) do
    case RecordingVersions.with_messages(root, name, stream) do
      nil -> @before_all
      {_version, _store, info} -> info.last
    end
  end

  defp last_or_before_all({:ok, %{last: last}}) when last != nil, do: last
  defp last_or_before_all(_), do: @before_all

  @doc "Reads the next parts of batches, nothing for now, or the end."
  @spec read(t(), cursor()) ::
          {:parts, [Batch.part()], cursor()} | {:idle, cursor()} | {:ended, Situ.Time.t()}
  def read(state, cursor) do
    case Query.read_batch(cursor.store, cursor.info, cursor.ordinal, :unbounded, @batch,
           skip_damage: true
         ) do
      {:ok, [], ordinal} ->
        read_next_version(state, %{cursor | ordinal: ordinal})

      {:ok, messages, ordinal} ->
        last = List.last(messages).originating_time
        {:parts, Batch.encode(messages), %{cursor | ordinal: ordinal, last: last}}

      {:error, %Error{} = error} ->
        raise error
    end
  end

  # The cursor is at the end of its version: a later version continues the stream, it has ended, or more will arrive.
  defp read_next_version(%{series: nil} = state, cursor),
    do: check_end(state, cursor, current_info(cursor))

  defp read_next_version(%{series: {root, name}} = state, cursor) do
    case state.version > cursor.version && RecordingVersions.find_next(root, name, cursor) do
      {version, store, info} ->
        {:ok, ordinal} =
          if cursor.last, do: Query.seek_ordinal(store, info, cursor.last + 1), else: {:ok, 0}

        read(state, %{cursor | version: version, store: store, info: info, ordinal: ordinal})

      _ ->
        check_end(state, cursor, current_info(cursor))
    end
  end

  defp current_info(%{store: store, info: info}) do
    case Query.stream_info(store, info.name) do
      {:ok, info} -> info
      {:error, _} -> info
    end
  end

  # If a killed writer left a recording open, a later version may continue it.
  defp check_end(state, cursor, info) do
    newest? = cursor.version == state.version
    at_end? = cursor.ordinal >= Query.count(cursor.store, info)

    cond do
      not newest? or not at_end? -> {:idle, cursor}
      info.closed != nil -> {:ended, max(info.closed, cursor.last || info.last || info.closed)}
      state.series == nil and not Query.live?(cursor.store) -> {:ended, info.last || 0}
      true -> {:idle, cursor}
    end
  end

  @doc "Moves the cursor to the messages that a lossy policy keeps. Returns how many messages it skips."
  @spec skip_messages(cursor(), Situ.Delivery.t(), now :: Situ.Time.t()) ::
          {non_neg_integer(), cursor()}
  def skip_messages(cursor, %{max_queue: n}, _now) when is_integer(n) do
    advance_cursor(cursor, Query.count(cursor.store, cursor.info) - n)
  end

  def skip_messages(cursor, %{max_latency: d}, now) when is_integer(d) do
    {:ok, ordinal} = Query.seek_ordinal(cursor.store, cursor.info, now - d)
    advance_cursor(cursor, ordinal)
  end

  def skip_messages(cursor, _lossless, _now), do: {0, cursor}

  defp advance_cursor(%{ordinal: ordinal} = cursor, to) when to > ordinal,
    do: {to - ordinal, %{cursor | ordinal: to}}

  defp advance_cursor(cursor, _to), do: {0, cursor}

  # The tag contains the version, so that a late notice about an older version is ignored. A version that has ended is
  # complete, and no notice about it is awaited.
  @doc "Requests a message to this process when more data may be available; `handle_notice/2` recognizes it."
  @spec request_notice(t()) :: t()
  def request_notice(%{notice: :no, store: store} = state) when store != nil do
    Query.notify(store, state.count, state.version)
    %{state | notice: :requested}
  end

  def request_notice(state), do: state

  @doc "Processes a requested message. Returns `:other` for any other message."
  @spec handle_notice(t(), term()) :: {:ok, t()} | :other
  def handle_notice(%{version: version} = state, {:situ_store, version, {:published, n}}),
    do: {:ok, %{state | count: n, notice: :no}}

  def handle_notice(%{version: version} = state, {:situ_store, version, {:ended, n}}),
    do: {:ok, %{state | count: n, notice: :ended}}

  def handle_notice(_state, _other), do: :other

  # Only the folder shows that the recording program has started a new version.
  @doc "Called periodically. Returns whether data may be available that no message has announced."
  @spec check_versions(t()) :: {boolean(), t()}
  def check_versions(%{series: nil} = state), do: {state.notice == :no, state}

  def check_versions(%{series: {root, name}} = state) do
    case RecordingVersions.newest_version(root, name) do
      {version, path} when state.store == nil or version > state.version ->
        case Query.open(path) do
          {:ok, store} -> {true, state |> set_version(version, store) |> open_whole()}
          {:error, _unfinished} -> {false, state}
        end

      _ ->
        {state.store != nil and state.notice == :no, state}
    end
  end
end
