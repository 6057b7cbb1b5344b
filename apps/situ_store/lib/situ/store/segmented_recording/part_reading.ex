defmodule Situ.Store.SegmentedRecording.PartReading do
  @moduledoc false
  # Reads a stream of a segmented recording part by part, and goes from the end of a part to the next.
  alias Situ.Store.{NativeErrors, NativeFormat}
  alias Situ.Store.SegmentedRecording.{Index, Timeline}
  require Logger

  @doc "Returns the table of the recording's index, or an error if the ordinals of this recording are no longer valid."
  @spec open_table(map()) :: {:ok, :ets.table()} | {:error, Situ.Error.t()}
  def open_table(%{key: key, epoch: epoch, first: first}) do
    case Index.lookup(key) do
      {table, ^epoch, _} -> {:ok, table}
      # The index was started again. Ordinals are the same if no segment has been deleted.
      {table, _, ^first} -> {:ok, table}
      {:error, error} -> {:error, error}
      _ -> {:error, Index.expired_error(key)}
    end
  end

  @doc "Returns the ordinal in the index of a stream's ordinal 0."
  @spec origin(map(), Situ.Store.StreamInfo.t()) :: non_neg_integer()
  def origin(%{origin: origin}, %{name: name}), do: Map.get(origin, name, 0)

  @doc "Returns the reader of a part's segment and the stream in it, `:deleted`, or an error."
  @spec open_part(map(), :ets.table(), map(), Timeline.Part.t()) ::
          {:ok, {NativeFormat.t(), Situ.Store.StreamInfo.t()}}
          | :deleted
          | {:error, Situ.Error.t()}
  def open_part(state, table, %{name: name}, part) do
    with {:ok, reader, infos} <- Index.fetch_segment(state.key, table, part.number) do
      case infos do
        %{^name => part_info} -> {:ok, {reader, part_info}}
        _ -> {:error, NativeErrors.no_stream_error(name, Map.keys(infos), reader.path)}
      end
    end
  end

  @doc """
  Calls `read.({reader, info}, ordinal, to)` with the part that contains an ordinal, and with the next parts while it
  returns nothing: `{:ok, result, next, false}`. Returns `{:ok, result, next}`, `{:ended, ordinal}` or another result.
  """
  @spec walk(map(), map(), {non_neg_integer(), Situ.Time.t() | :unbounded}, function()) :: term()
  def walk(state, info, {ordinal, to}, read) do
    origin = origin(state, info)

    with {:ok, table} <- open_table(state) do
      case walk_from(state, {table, info, read}, ordinal + origin, to, :stale) do
        {:ok, result, next} -> {:ok, result, next - origin}
        {:ended, next} -> {:ended, max(next - origin, ordinal)}
        other -> other
      end
    end
  end

  # `:stale`: the table may not contain the latest messages. It is refreshed once, at its end.
  defp walk_from(state, {table, info, _} = request, ordinal, to, age) do
    parts = Index.fetch_parts(table, info.name)

    if parts == {},
      do: walk_on(state, request, ordinal, to, age),
      else:
        walk_part(
          state,
          request,
          {parts, Timeline.find_ordinal(parts, ordinal)},
          {ordinal, to},
          age
        )
  end

  defp walk_part(state, {table, info, read} = request, {parts, index}, {ordinal, to}, age) do
    part = elem(parts, index)
    # Reading from ordinal 0 means to read from the oldest message.
    missed? = index == 0 and ordinal > origin(state, info) and ordinal < part.base
    if missed?, do: warn_of_deletion(state, info, part.base - ordinal)
    local = max(ordinal - part.base, 0)

    with true <- to == :unbounded or part.first <= to,
         {:ok, source} <- open_part(state, table, info, part),
         {:ok, result, next, true} <- read.(source, local, visible_limit(part, to)) do
      {:ok, result, part.base + next}
    else
      false ->
        {:ended, ordinal}

      {:ok, _nothing, _next, false} ->
        walk_next(state, request, {parts, index}, {ordinal, to}, age)

      :deleted ->
        walk_deleted(state, request, part, {ordinal, to})

      {:error, error} ->
        check_deleted(state, request, part, {ordinal, to}, error)

      other ->
        other
    end
  end

  defp visible_limit(%{until: nil}, to), do: to
  defp visible_limit(%{until: until}, :unbounded), do: until - 1
  defp visible_limit(%{until: until}, to), do: min(to, until - 1)

  defp walk_next(state, request, {parts, index}, {_ordinal, to}, age)
       when index + 1 < tuple_size(parts) do
    walk_part(state, request, {parts, index + 1}, {elem(parts, index + 1).base, to}, age)
  end

  # Messages after `to` exist, so there is nothing to wait for.
  defp walk_next(_state, _request, {parts, index}, {ordinal, to}, _age)
       when is_integer(to) and to < :erlang.map_get(:last, elem(parts, index)),
       do: {:ended, ordinal}

  defp walk_next(state, request, _position, {ordinal, to}, age),
    do: walk_on(state, request, ordinal, to, age)

  defp walk_on(_state, _request, ordinal, _to, :fresh), do: {:ended, ordinal}

  defp walk_on(state, request, ordinal, to, :stale) do
    :ok = Index.call(state.key, :refresh)
    walk_from(state, request, ordinal, to, :fresh)
  end

  # Retention has deleted the segment during the reading.
  defp walk_deleted(state, {_, info, _} = request, part, {ordinal, to}) do
    :ok = Index.call(state.key, :refresh)
    next = part.base + part.count
    if ordinal > part.base, do: warn_of_deletion(state, info, next - ordinal)
    walk_from(state, request, max(ordinal, next), to, :fresh)
  end

  defp check_deleted(state, request, part, position, error) do
    case Index.call(state.key, {:check, part.number}) do
      :deleted -> walk_deleted(state, request, part, position)
      :replaced -> walk_from(state, request, elem(position, 0), elem(position, 1), :fresh)
      :ok -> {:error, error}
    end
  end

  defp warn_of_deletion(%{key: {name, _, _}}, info, count) do
    Logger.warning(
      "#{name}: #{count} messages of #{inspect(info.name)} were deleted before they were read, because the " <>
        "recording keeps only its latest segments (`keep:`)"
    )
  end

  @doc "Returns the index's ordinal of the first message at or after a time, or the next ordinal."
  @spec seek(map(), map(), Situ.Time.t()) :: {:ok, non_neg_integer()} | {:error, Situ.Error.t()}
  def seek(state, info, time) do
    with {:ok, table} <- open_table(state),
         {:part, part} <- find_time(state, table, info, time) do
      seek_part(state, table, {info, part}, time)
    else
      :none -> {:ok, Index.call(state.key, {:next_ordinal, info.name})}
      error -> error
    end
  end

  defp seek_part(state, table, {info, part}, time) do
    with {:ok, {reader, part_info}} <- open_part(state, table, info, part),
         {:ok, local} <- NativeFormat.seek(reader, part_info, time) do
      {:ok, part.base + if(part.until, do: min(local, part.count), else: local)}
    else
      :deleted -> {:ok, part.base + part.count}
      error -> error
    end
  end

  # The segments that are being written may have later messages than the table.
  defp find_time(state, table, info, time) do
    with :none <- find_part(Index.fetch_parts(table, info.name), time),
         :ok <- Index.call(state.key, :refresh),
         do: find_part(Index.fetch_parts(table, info.name), time)
  end

  defp find_part(parts, time) do
    index = Timeline.find_time(parts, time)
    if index < tuple_size(parts), do: {:part, elem(parts, index)}, else: :none
  end

  @doc "Returns the last message at or before a time, or `nil`."
  @spec latest_at(map(), map(), Situ.Time.t()) ::
          {:ok, Situ.Message.t() | nil} | {:error, Situ.Error.t()}
  def latest_at(state, info, time) do
    with {:ok, table} <- open_table(state) do
      _ = find_time(state, table, info, time + 1)

      case table |> Index.fetch_parts(info.name) |> Timeline.find_latest(time) do
        nil -> {:ok, nil}
        part -> latest_in_part(state, table, {info, part}, time)
      end
    end
  end

  defp latest_in_part(state, table, {info, part}, time) do
    time = visible_limit(part, time)

    with {:ok, {reader, part_info}} <- open_part(state, table, info, part),
         {:ok, local} <- NativeFormat.seek(reader, part_info, time + 1),
         first = max(local - 1, 0),
         {:ok, messages, _} <- NativeFormat.read(reader, part_info, first, time, 1, exact: true) do
      {:ok, messages |> List.first() |> put_source(info.id)}
    else
      :deleted -> {:ok, nil}
      error -> error
    end
  end

  defp put_source(nil, _id), do: nil
  defp put_source(message, id), do: %{message | source_id: id}

  @doc "Returns the time of the last visible message of a part."
  @spec last_time(map(), :ets.table(), map(), Timeline.Part.t()) :: Situ.Time.t()
  def last_time(_state, _table, _info, %{until: nil, last: last}), do: last

  def last_time(state, table, info, part) do
    with {:ok, {reader, part_info}} <- open_part(state, table, info, part),
         {:ok, [message], _} <-
           NativeFormat.read(reader, part_info, part.count - 1, part.last, 1, exact: true),
         do: message.originating_time,
         else: (_ -> part.last)
  end
end
