defmodule Situ.Studio.Recordings.Store do
  @moduledoc false
  # Opens a store's folder or an external file for pages, closed or still being written.
  #
  # A table caches the list of streams briefly, because a page requests it whenever it draws. Thus
  # a live page reads the store's catalog once per redraw and not once per panel.
  @behaviour Situ.Recording

  alias Situ.{Error, Recording, Store}
  alias Situ.Recording.Formats
  alias Situ.Store.{NativeErrors, Query, SegmentedRecording, Summary}

  @enforce_keys [:recording, :cache]
  defstruct [:recording, :cache]

  @type t :: %__MODULE__{recording: Recording.t(), cache: :ets.table()}

  @fresh_live_ms 30
  @fresh_ms 500
  # On another machine, missing files are a separate request.
  @fresh_missing_ms 10_000

  @doc """
  Opens a recording, with options of its reader. The table is deleted when the calling process ends.
  """
  @spec open(Path.t(), keyword()) :: {:ok, Recording.t()} | {:error, Error.t()}
  def open(path, reader_opts \\ []) do
    with {:ok, recording} <- Store.open(path, reader_opts: reader_opts) do
      cache = :ets.new(__MODULE__, [:set, :public, read_concurrency: true])
      :ets.insert(cache, {:stamp, file_stamp(recording), Store.live?(recording)})
      for info <- Store.streams(recording), do: load_type_modules(info.type)
      state = %__MODULE__{recording: recording, cache: cache}
      {:ok, %Recording{path: recording.path, module: __MODULE__, state: state}}
    end
  end

  # Field names are atoms that exist only after their struct's module was loaded, and a reader creates no atoms.
  defp load_type_modules(type) when is_atom(type), do: Situ.KnownModules.ensure_loaded?(type)

  defp load_type_modules(type) when is_tuple(type),
    do: type |> Tuple.to_list() |> Enum.each(&load_type_modules/1)

  defp load_type_modules(types) when is_list(types), do: Enum.each(types, &load_type_modules/1)
  defp load_type_modules(_), do: :ok

  @impl true
  def info(state), do: state |> fetch_row({:look, :info}) |> Error.unwrap!()

  @impl true
  def streams(state), do: state |> fetch_row({:look, :streams}) |> Error.unwrap!()

  @impl true
  def stream(%{recording: recording} = state, name) do
    with {:ok, nil} <- fetch_row(state, {:stream, name}) do
      names = for info <- streams(state), do: info.name
      {:error, NativeErrors.no_stream_error(name, names, recording.path)}
    end
  rescue
    error in Error -> {:error, error}
  end

  @impl true
  def seek(state, info, time), do: Query.seek_ordinal(state.recording, info, time)

  @impl true
  def read(state, info, ordinal, to, limit, opts),
    do: Query.read_batch(state.recording, info, ordinal, to, limit, opts)

  @impl true
  def summary(state, info, from, to, pixels),
    do: Summary.read_numbers(state.recording, info, from, to, pixels)

  @impl true
  def tracks(state, info, from, to, level, most),
    do: Summary.read_tracks(state.recording, info, from, to, level, most)

  # Returns a row of the cached catalog, which is read again if it is old.
  defp fetch_row(%__MODULE__{cache: cache} = state, key) do
    now = System.monotonic_time(:millisecond)

    with :ok <- ensure_fresh(:ets.lookup(cache, :look), state, now) do
      case :ets.lookup(cache, key) do
        [{_, value}] -> {:ok, value}
        [] -> {:ok, nil}
      end
    end
  rescue
    ArgumentError -> gone_error(state)
  end

  defp ensure_fresh([{:look, until}], _state, now) when until > now, do: :ok

  defp ensure_fresh(_, %__MODULE__{recording: recording, cache: cache} = state, now) do
    info = Store.info(recording)

    with :ok <- check_unchanged(state, info.live?) do
      streams = for info <- Store.streams(recording), do: put_extra(state, info)
      for info <- streams, do: :ets.insert(cache, {{:stream, info.name}, info})
      info = %{info | damage: list_missing(state, now) ++ describe_damage(info.damage)}
      rows = [{{:look, :info}, info}, {{:look, :streams}, streams}]
      fresh = if info.live?, do: @fresh_live_ms, else: @fresh_ms
      :ets.insert(cache, rows ++ [{:look, now + fresh}])
      :ok
    end
  rescue
    error in Error -> {:error, error}
  end

  defp put_extra(%{recording: %{path: path}, cache: cache}, info) do
    local = if Formats.for_address(path) == nil, do: path
    %{info | extra: %{shapes: {cache, info.name}, path: local}}
  end

  defp describe_damage([_ | _] = damage), do: ["#{length(damage)} parts are damaged"]
  defp describe_damage(_none), do: []

  defp list_missing(%{recording: recording, cache: cache}, now) do
    case :ets.lookup(cache, :missing) do
      [{:missing, until, missing}] when until > now ->
        missing

      _ ->
        missing =
          for file <- Store.missing_files(recording),
              do: "#{Path.basename(file)} is missing, so its messages cannot be read"

        :ets.insert(cache, {:missing, now + @fresh_missing_ms, missing})
        missing
    end
  end

  # If the file was deleted and replaced, the open one would keep showing outdated data.
  defp check_unchanged(%__MODULE__{cache: cache} = state, live?) do
    case {file_stamp(state.recording), :ets.lookup(cache, :stamp)} do
      {nil, _} ->
        gone_error(state)

      {{inode, _, _}, [{:stamp, {other, _, _}, _}]} when inode != other ->
        replaced_error(state)

      {stamp, [{:stamp, before, false}]} when stamp != before and not live? ->
        replaced_error(state)

      {stamp, _} ->
        :ets.insert(cache, {:stamp, stamp, live?})
        :ok
    end
  end

  # Returns the stamp of a store's index, or of the file itself. Only the inode is compared while a recording is being
  # written. A recording on another machine remains the version that was opened.
  # The reader of a recording in segments notices replaced segments itself.
  defp file_stamp(%{module: SegmentedRecording}), do: {:segments, 0, 0}

  defp file_stamp(%{path: path}),
    do: if(Formats.for_address(path), do: {:elsewhere, 0, 0}, else: on_disk(path))

  defp on_disk(path) do
    index = Path.join(path, "index.situ")

    case File.stat(if(File.exists?(index), do: index, else: path), time: :posix) do
      {:ok, stat} -> {stat.inode, stat.size, stat.mtime}
      {:error, _} -> nil
    end
  end

  defp replaced_error(%{recording: %{path: path}}),
    do:
      {:error,
       Error.new(:replaced, "the recording #{Path.basename(path)} was replaced by another")}

  defp gone_error(%{recording: %{path: path}}),
    do: {:error, Error.new(:gone, "the recording #{Path.basename(path)} no longer exists")}
end
