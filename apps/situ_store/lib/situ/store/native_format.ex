defmodule Situ.Store.NativeFormat do
  @moduledoc false
  # Implements the behaviours of recordings for Situ's own stores.
  @behaviour Situ.Recording
  @behaviour Situ.Recording.Format

  alias Situ.{Columns, Error}
  alias Situ.Store.CatalogCache
  alias Situ.Store.S3.Mirror
  alias Situ.Store.Summary.Bins

  alias Situ.Store.{
    NativeErrors,
    Folder,
    Native,
    StoredMessages,
    StreamInfo
  }

  defstruct [:ref, :path]
  @type t :: %__MODULE__{}

  @read_bytes 4 * 1024 * 1024

  # The latest time, and the largest possible difference between two times.
  @longest 0x7FFFFFFFFFFFFFFF

  @impl true
  def extensions, do: []

  @impl true
  def open(path, opts) do
    with {:ok, ref} <-
           path
           |> Native.reader_open(opts[:verify] != :small, opts[:max_unpacked] || 64 * 1024 * 1024)
           |> explain_lost_index()
           |> NativeErrors.wrap_error(path) do
      {:ok, %__MODULE__{ref: ref, path: path}}
    end
  end

  # The folder contains data files, so it is a store without its index.
  defp explain_lost_index({:error, :no_store}), do: {:error, :index_lost}
  defp explain_lost_index(result), do: result

  # Loads the entries published since the last refresh, so that counts are current.
  defp refresh_entries(state) do
    with :slow <- Native.reader_refresh(state.ref), do: Native.reader_refresh_all(state.ref)
  end

  @impl true
  def info(%__MODULE__{} = state) do
    case Native.reader_state(state.ref) do
      {:ok, {entries, closed?, live?, created, synced, id}} ->
        shelf = store_info(state)

        %{
          name: shelf.name,
          version: Folder.version_number(state.path),
          created: created,
          closed?: closed?,
          live?: live?,
          volatile?: shelf.volatile?,
          piece: shelf.piece,
          entries: entries,
          synced: synced,
          id: Base.encode16(id, case: :lower),
          damage: Native.reader_damage(state.ref)
        }

      {:error, reason} ->
        raise NativeErrors.to_error(reason, state.path)
    end
  end

  @impl true
  def streams(%__MODULE__{} = state) do
    refresh_entries(state)
    state |> lookup_streams(:all) |> Enum.map(&put_statistics(state, &1))
  end

  @impl true
  def stream(%__MODULE__{} = state, name) do
    refresh_entries(state)

    case lookup_streams(state, name) do
      nil -> missing_stream_error(state, name)
      info -> {:ok, put_statistics(state, info)}
    end
  end

  defp missing_stream_error(state, name) do
    shelf = store_info(state)

    error =
      if shelf.damage,
        do: NativeErrors.to_error(shelf.damage, state.path, name),
        else:
          NativeErrors.no_stream_error(
            name,
            Enum.map(lookup_streams(state, :all), & &1.name),
            state.path
          )

    {:error, error}
  end

  defp put_statistics(state, info) do
    case fetch_statistics(state, info) do
      {:ok, {count, first, last, first_creation, last_creation, size, latency, stored, _}} ->
        %{
          info
          | count: count,
            first: first,
            last: last,
            first_creation: first_creation,
            last_creation: last_creation,
            size: size,
            latency_sum: round(latency),
            stored: stored
        }

      {:error, %Error{} = error} ->
        raise error

      _ ->
        info
    end
  end

  defp fetch_statistics(state, info),
    do: Mirror.with_bytes(state.path, fn -> Native.reader_statistics(state.ref, info.id) end)

  defp store_info(state), do: CatalogCache.store_info(state.ref, state.path)
  defp lookup_streams(state, name), do: CatalogCache.lookup_streams(state.ref, state.path, name)

  @impl true
  def seek(state, info, time) do
    time = clamp_time(time)

    with :slow <- Native.reader_seek_quick(state.ref, info.id, time) do
      Mirror.with_bytes(state.path, fn -> Native.reader_seek(state.ref, info.id, time) end)
    end
    |> NativeErrors.wrap_error(state.path, info.name)
  end

  @impl true
  def read(state, info, ordinal, to, limit, opts) do
    bytes = if opts[:exact], do: 0, else: @read_bytes

    read = fn -> Native.read(state.ref, info.id, ordinal, clamp_time(to), limit, bytes) end

    case Mirror.with_bytes(state.path, read) do
      {:ok, runs, next} ->
        {:ok, StoredMessages.build_messages(runs, info), next}

      {:error, reason} ->
        if opts[:skip_damage] == true and not is_struct(reason, Error),
          do: read_after_damage(state, info, ordinal, to, limit, opts),
          else: {:error, NativeErrors.to_error(reason, state.path, info.name)}
    end
  end

  @impl true
  def columns(state, info, ordinal, to, bytes) do
    read = fn -> Native.reader_columns(state.ref, info.id, ordinal, clamp_time(to), bytes) end

    case Mirror.with_bytes(state.path, read) do
      {:ok, {kind, count, times, creation_times, values, first_id}, next} ->
        columns = %Columns{
          kind: kind,
          count: count,
          times: times,
          creation_times: creation_times,
          values: values,
          sequence_id: first_id
        }

        {:ok, columns, next}

      {:error, reason} ->
        {:error, NativeErrors.to_error(reason, state.path, info.name)}

      others_or_ended ->
        others_or_ended
    end
  end

  defp read_after_damage(state, info, ordinal, to, limit, opts) do
    case Native.reader_skip(state.ref, info.id, ordinal) do
      ^ordinal -> {:ok, [], ordinal}
      next -> read(state, info, next, to, limit, opts)
    end
  end

  @doc false
  @spec clamp_time(Situ.Time.t() | :unbounded) :: Situ.Time.t()
  def clamp_time(:unbounded), do: @longest
  def clamp_time(time), do: time |> max(-@longest) |> min(@longest)

  @impl true
  def summary(state, info, from, to, pixels) do
    {from, to} = {clamp_time(from), clamp_time(to)}
    level = Native.summary_level(from, to, pixels)

    with {:ok, bins} <- read_signal(state, info, from, to, level),
         do: {:ok, Bitwise.bsl(1, level), bins}
  end

  @doc false
  @spec read_signal(
          %__MODULE__{},
          StreamInfo.t(),
          Situ.Time.t(),
          Situ.Time.t(),
          non_neg_integer()
        ) ::
          {:ok, [Situ.Store.Summary.bin()]} | {:error, Error.t()}
  def read_signal(state, info, from, to, level) do
    refresh_entries(state)

    read = fn -> Native.reader_summary(state.ref, info.id, from, to, level) end

    case Mirror.with_bytes(state.path, read) do
      {:ok, bins} when map_size(info.codecs) == 0 ->
        {:ok, bins}

      {:ok, bins} ->
        with {:ok, rest} <- codec_summary(state, info, end_of_bins(bins, from, level), to, level),
             do: {:ok, bins ++ rest}

      {:error, reason} ->
        {:error, NativeErrors.to_error(reason, state.path, info.name)}
    end
  end

  @impl true
  def tracks(state, info, from, to, level, most) do
    {from, to} = {clamp_time(from), clamp_time(to)}

    with {:ok, counts, tracks} <-
           state.path
           |> Mirror.with_bytes(fn ->
             Native.reader_tracks(state.ref, info.id, from, to, level, most)
           end)
           |> NativeErrors.wrap_error(state.path, info.name),
         {:ok, tracks} <- put_signal_track(state, info, tracks, from, to, level),
         do: {:ok, counts, tracks}
  end

  # Where the stored signal is too coarse, the codec computes the signal within messages.
  defp put_signal_track(_state, %{codecs: codecs}, tracks, _from, _to, _level)
       when map_size(codecs) == 0,
       do: {:ok, tracks}

  defp put_signal_track(state, info, tracks, from, to, level) do
    case read_signal(state, info, from, to, level) do
      {:ok, []} -> {:ok, tracks}
      {:ok, bins} -> {:ok, [{nil, {:numbers, bins}} | List.keydelete(tracks, nil, 0)]}
      error -> error
    end
  end

  defp end_of_bins([], from, _level), do: from
  defp end_of_bins(bins, _from, level), do: elem(List.last(bins), 0) + Bitwise.bsl(1, level)

  # The codec computes points that are finer than the stored pyramid or not in it yet. A message may describe the second
  # before its time, because audio is timestamped with its end.
  defp codec_summary(_state, %{last: last}, from, _to, _level) when last == nil or from > last,
    do: {:ok, []}

  defp codec_summary(state, info, from, to, level) do
    with {:ok, ordinal} <- seek(state, info, from),
         {:ok, points} <- collect_points(state, info, max(ordinal - 1, 0), to + 1_000_000_000, []) do
      within = Enum.filter(points, fn {time, _, _, _, _} -> time >= from and time <= to end)
      {:ok, Bins.fold_points(within, level)}
    end
  end

  defp collect_points(state, info, ordinal, to, found) do
    case read(state, info, ordinal, to, 1_000, []) do
      {:ok, [], _} ->
        {:ok, found |> Enum.reverse() |> Enum.concat()}

      {:ok, messages, next} ->
        collect_points(state, info, next, to, [points_in_messages(messages) | found])

      error ->
        error
    end
  end

  defp points_in_messages(messages),
    do: for(%{data: %_{}} = message <- messages, point <- Bins.message_points(message), do: point)

  @impl true
  def notify(state, known, pid, tag) do
    if Native.reader_await(state.ref, known, pid, tag),
      do: :ok,
      else:
        raise(
          Error.new(:no_thread, "cannot wait for the writer of #{state.path}",
            why: "the operating system cannot create another thread",
            fix:
              "raise the thread limit (`ulimit -u`), or open fewer stores that are being written"
          )
        )
  end

  @impl true
  def count(state, info) do
    refresh_entries(state)
    Native.reader_count(state.ref, info.id)
  end

  @impl true
  def gaps(state, %StreamInfo{id: id}, least) do
    read = fn -> Native.reader_gaps(state.ref, id, min(least, @longest)) end
    with {:error, error} <- Mirror.with_bytes(state.path, read), do: raise(error)
  end

  @lanes %{0 => "data", 1 => "large"}

  @impl true
  def missing_files(state) do
    for {lane, number} <- Native.reader_extents(state.ref),
        name = "#{@lanes[lane]}-#{String.pad_leading(to_string(number), 6, "0")}.situ",
        not File.exists?(Path.join(state.path, name)),
        not File.exists?(Path.join(state.path, Path.rootname(name) <> ".mirror")),
        do: name
  end

  @doc false
  @spec verify_chunks(%__MODULE__{}, (non_neg_integer(), non_neg_integer() -> any())) ::
          {:ok, [tuple()], non_neg_integer()} | {:error, Error.t()}
  def verify_chunks(state, progress),
    do: verify_from(state, 0, Native.reader_damage(state.ref), progress)

  defp verify_from(state, from, found, progress) do
    read = fn -> Native.reader_verify(state.ref, from, 256) end

    case Mirror.with_bytes(state.path, read) do
      {:ok, more, total} when from + 256 >= total ->
        progress.(total, total)
        {:ok, found ++ more, total}

      {:ok, more, total} ->
        progress.(from + 256, total)
        verify_from(state, from + 256, found ++ more, progress)

      {:error, reason} ->
        {:error, NativeErrors.to_error(reason, state.path)}
    end
  end
end
