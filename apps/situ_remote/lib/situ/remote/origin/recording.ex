defmodule Situ.Remote.Origin.Recording do
  @moduledoc false
  # Serves a finished or growing recording. `{:series, root, name}` continues from each version (`name.0000`,
  # `name.0001` ...) to the next, so nothing is skipped when the recording program restarts or splits its recording into
  # segments. `{:live, root, name}` is the same for live streams, whose segments form one recording; these begin in the
  # oldest segment kept. `{:store, store}` is a single open recording; the origin ends with it.
  @behaviour Situ.Remote.Origin
  alias Situ.Error
  alias Situ.Remote.Link.Batch
  alias Situ.Remote.Origin.Versions
  alias Situ.Store.{NativeFormat, Query, StreamInfo, TypeName}

  @messages 512
  # This time is earlier than any other, but far from the limits of 64-bit integers.
  @before_all -0x4000000000000000

  defstruct [:series, :store, pieces?: false, version: 0, known: 0, awaiting: :no, catalog: -1]

  @doc "Returns an originating time that is earlier than all others."
  @spec before_all() :: Situ.Time.t()
  def before_all, do: @before_all

  @impl true
  def open({:store, %Situ.Recording{} = store}), do: {:ok, %__MODULE__{store: store}}

  def open({:live, root, name}) do
    with {:ok, state} <- open({:series, root, name}), do: {:ok, %{state | pieces?: true}}
  end

  def open({:series, root, name}) do
    state = %__MODULE__{series: {root, name}}

    case Versions.newest_version(root, name) do
      {version, path} ->
        with {:ok, store} <- Query.open(path), do: {:ok, set_version(state, version, store)}

      nil ->
        {:ok, state}
    end
  end

  @impl true
  def version({:store, _store}, _version), do: :error

  def version({:live, root, name}, version), do: version({:series, root, name}, version)

  def version({:series, root, name}, version) do
    with path when path != nil <- Versions.version_path(root, name, version),
         {:ok, store} <- Query.open(path),
         do: {:ok, {:store, store}},
         else: (_ -> :error)
  end

  defp set_version(state, version, store),
    do: %{state | version: version, store: store, known: 0, awaiting: :no, catalog: -1}

  @impl true
  def streams(%{store: nil} = state), do: {:same, state}

  def streams(state) do
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

  @impl true
  def store(%{store: nil, series: {_, name}}, _version),
    do:
      {:error,
       Error.new(:no_store, "the recording #{name} does not exist yet", fix: "try again later")}

  def store(%{series: nil, store: store}, _version), do: {:ok, store}
  def store(%{version: version, store: store}, version), do: {:ok, store}
  def store(%{store: store}, nil), do: {:ok, store}

  def store(%{series: {root, name}}, version) when is_integer(version) do
    case Versions.version_path(root, name, version) do
      nil -> {:error, Error.new(:no_store, "version #{version} of #{name} no longer exists")}
      path -> Query.open(path)
    end
  end

  def store(_state, version),
    do: {:error, Error.new(:bad_request, "invalid version: #{inspect(version, limit: 5)}")}

  # Stream 0 has a record for each new stream and for each end of a stream.
  defp count_records(%{module: NativeFormat} = store),
    do: Query.count(store, %StreamInfo{id: 0, name: ""})

  defp count_records(_foreign), do: 0

  @impl true
  def cursor(%{store: nil}, _name, _from), do: :unknown

  def cursor(%{pieces?: true} = state, name, :start),
    do: cursor(state, name, {:at, @before_all + 1})

  def cursor(state, name, from) when from in [:now, :start] do
    case Query.stream_info(state.store, name) do
      {:ok, info} when from == :start -> {:ok, build_cursor(state, info, 0), @before_all}
      {:ok, info} -> {:ok, build_cursor(state, info, info.count), last_time(state, name)}
      {:error, _} -> :unknown
    end
  end

  def cursor(state, name, {:after, time}), do: cursor(state, name, {:at, time + 1})

  def cursor(%{series: nil} = state, name, {:at, time}) do
    with {:ok, info} <- Query.stream_info(state.store, name),
         {:ok, ordinal} <- Query.seek_ordinal(state.store, info, time) do
      {:ok, build_cursor(state, info, ordinal), time - 1}
    else
      {:error, _} -> :unknown
    end
  end

  def cursor(%{series: {root, name}} = state, stream, {:at, time}) do
    case Versions.find_containing(root, name, stream, time) do
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
    case Versions.with_messages(root, name, stream) do
      nil -> @before_all
      {_version, _store, info} -> info.last
    end
  end

  defp last_or_before_all({:ok, %{last: last}}) when last != nil, do: last
  defp last_or_before_all(_), do: @before_all

  @impl true
  def read(state, cursor) do
    case Query.read_batch(cursor.store, cursor.info, cursor.ordinal, :unbounded, @messages,
           skip_damage: true
         ) do
      {:ok, [], ordinal} ->
        read_next_version(state, %{cursor | ordinal: ordinal})

      {:ok, messages, ordinal} ->
        last = List.last(messages).originating_time
        {:parts, Batch.encode(messages), 0, %{cursor | ordinal: ordinal, last: last}}

      {:error, %Error{} = error} ->
        raise error
    end
  end

  # The cursor is at the end of its version: a later version continues the stream, it has ended, or more will arrive.
  defp read_next_version(%{series: nil} = state, cursor),
    do: check_end(state, cursor, current_info(cursor))

  defp read_next_version(%{series: {root, name}} = state, cursor) do
    case state.version > cursor.version && Versions.find_next(root, name, cursor) do
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
    whole? = cursor.ordinal >= info.count

    cond do
      not newest? or not whole? -> {:idle, cursor}
      info.closed != nil -> {:ended, max(info.closed, cursor.last || info.last || info.closed)}
      state.series == nil and not Query.live?(cursor.store) -> {:ended, info.last || 0}
      true -> {:idle, cursor}
    end
  end

  @impl true
  def skip(_state, cursor, %{max_queue: n}, _now) when is_integer(n) do
    advance_cursor(cursor, Query.count(cursor.store, cursor.info) - n)
  end

  def skip(_state, cursor, %{max_latency: d}, now) when is_integer(d) do
    {:ok, ordinal} = Query.seek_ordinal(cursor.store, cursor.info, now - d)
    advance_cursor(cursor, ordinal)
  end

  def skip(_state, cursor, _lossless, _now), do: {0, cursor}

  defp advance_cursor(%{ordinal: ordinal} = cursor, to) when to > ordinal,
    do: {to - ordinal, %{cursor | ordinal: to}}

  defp advance_cursor(cursor, _to), do: {0, cursor}

  # The tag contains the version, so that a late notice about an older version is ignored. A version that has ended is
  # complete, and no notice about it is awaited.
  @impl true
  def await(%{awaiting: :no, store: store} = state) when store != nil do
    Query.notify(store, state.known, state.version)
    %{state | awaiting: :news}
  end

  def await(state), do: state

  @impl true
  def news(%{version: version} = state, {:situ_store, version, {:published, n}}),
    do: {:ok, %{state | known: n, awaiting: :no}}

  def news(%{version: version} = state, {:situ_store, version, {:ended, n}}),
    do: {:ok, %{state | known: n, awaiting: :over}}

  def news(_state, _other), do: :other

  # Only the folder shows that the recording program has started a new version.
  @impl true
  def look(%{series: nil} = state), do: {state.awaiting == :no, state}

  def look(%{series: {root, name}} = state) do
    case Versions.newest_version(root, name) do
      {version, path} when state.store == nil or version > state.version ->
        case Query.open(path) do
          {:ok, store} -> {true, set_version(state, version, store)}
          {:error, _unfinished} -> {false, state}
        end

      _ ->
        {state.store != nil and state.awaiting == :no, state}
    end
  end
end
