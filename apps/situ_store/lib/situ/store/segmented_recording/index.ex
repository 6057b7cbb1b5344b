defmodule Situ.Store.SegmentedRecording.Index do
  @moduledoc false
  # Knows the segments of one recording and which messages are in which. One process per recording, which starts when
  # the recording is opened and ends when nobody has used it for a while. All readers of the recording share it, so
  # ordinals stay the same when new segments are found and the oldest are deleted.
  #
  # Readers look up the parts of a stream in a table, without a call. They call the process for what may have changed:
  # at the end of the messages that they know, and for counts.
  use GenServer, restart: :temporary
  alias Situ.Error
  alias Situ.Store.{Folder, NativeErrors, NativeFormat, Replacement}
  alias Situ.Store.SegmentedRecording.{Contents, Scan, Waiting}
  require Logger

  @registry Situ.Store.SegmentedRecording.Registry
  @supervisor Situ.Store.SegmentedRecording.Supervisor
  @idle_ms :timer.minutes(10)
  # So many closed segments stay open for reading.
  @most_open 256

  @typedoc "The name of a recording, its folder, and the options for opening its segments."
  @type key :: {name :: String.t(), root :: Path.t(), opts :: keyword()}

  # `names`: the entries of the folder. `folders`: the versions of the recording's name.
  defstruct [
    :key,
    :table,
    :epoch,
    :contents,
    names: nil,
    folders: [],
    owners: %{},
    opened: :queue.new(),
    waiting: nil
  ]

  @doc false
  @spec child_specs() :: [Supervisor.child_spec() | {module(), keyword()}]
  def child_specs do
    [
      {Registry, keys: :unique, name: @registry},
      {DynamicSupervisor, name: @supervisor, strategy: :one_for_one}
    ]
  end

  @doc "Starts the index of a recording or finds the running one, and reads the current segments."
  @spec open(key()) ::
          {:ok, %{epoch: reference(), first: integer(), origin: map()}} | {:error, Error.t()}
  def open(key), do: call(key, {:open, self()})

  @doc "Calls the index, which may have to be started again. Reading thousands of segments takes seconds."
  @spec call(key(), term()) :: term()
  def call(key, request) do
    with {:ok, pid} <- ensure_started(key), do: GenServer.call(pid, request, :infinity)
  catch
    # It ended because nobody had used it, just before the call.
    :exit, {reason, _} when reason in [:noproc, :normal] -> call(key, request)
  end

  defp ensure_started(key) do
    with :ok <- ensure_supervised(),
         [] <- Registry.lookup(@registry, key),
         {:error, {:already_started, pid}} <-
           DynamicSupervisor.start_child(@supervisor, {__MODULE__, key}) do
      {:ok, pid}
    else
      [{pid, _}] ->
        {:ok, pid}

      {:ok, pid} ->
        {:ok, pid}

      {:error, reason} ->
        {:error, start_error(key, reason)}
    end
  end

  defp start_error({name, root, _}, reason) do
    Error.new(:store_failed, "cannot read the segments of #{Path.join(root, name)}",
      why: inspect(reason)
    )
  end

  # A script may read recordings without starting this application.
  defp ensure_supervised do
    with nil <- Process.whereis(@registry),
         {:error, {_app, reason}} <- Application.ensure_all_started(:situ_store),
         do: {:error, reason},
         else: (_ -> :ok)
  end

  @doc "Returns the table, the epoch and the first segment of a running index."
  @spec lookup(key()) :: {:ets.table(), reference(), integer()} | {:error, Error.t()}
  def lookup(key) do
    with :ok <- ensure_supervised(),
         [{_pid, {_, _, _} = found}] <- Registry.lookup(@registry, key) do
      found
    else
      {:error, reason} -> {:error, start_error(key, reason)}
      _not_ready -> with :ok <- call(key, :refresh), do: lookup(key)
    end
  end

  @doc "Returns the parts of a stream, as a tuple in order of time."
  @spec fetch_parts(:ets.table(), String.t()) :: tuple()
  def fetch_parts(table, name) do
    case :ets.lookup(table, {:parts, name}) do
      [{_, parts}] -> parts
      [] -> {}
    end
  end

  @doc "Returns the open reader of a segment with its streams, or `:deleted`."
  @spec fetch_segment(key(), :ets.table(), integer()) ::
          {:ok, NativeFormat.t(), map()} | :deleted | {:error, Error.t()}
  def fetch_segment(key, table, number) do
    case :ets.lookup(table, {:segment, number}) do
      [{_, reader, infos}] -> {:ok, reader, infos}
      [] -> call(key, {:segment, number})
    end
  end

  @doc false
  @spec start_link(key()) :: GenServer.on_start()
  def start_link(key) do
    GenServer.start_link(__MODULE__, key, name: {:via, Registry, {@registry, key, nil}})
  end

  @impl true
  def init(key) do
    table = :ets.new(__MODULE__, [:set, :protected, read_concurrency: true])
    state = %__MODULE__{key: key, table: table, contents: Contents.new()}
    {:ok, %{state | waiting: Waiting.new()}, {:continue, :read_segments}}
  end

  @impl true
  def handle_continue(:read_segments, state), do: {:noreply, read_again(state), @idle_ms}

  defp read_again(%{key: key, table: table} = state) do
    :ets.delete_all_objects(table)
    epoch = make_ref()
    state = refresh(%{state | contents: Contents.new(), opened: :queue.new(), epoch: epoch}, true)
    first = Contents.first_number(state.contents)
    {_, _} = Registry.update_value(@registry, key, fn _ -> {table, epoch, first} end)
    state
  end

  @impl true
  def handle_call({:open, pid}, _from, state) do
    state = reload_replaced(state)
    state = refresh(monitor_owner(state, pid), false)
    first = Contents.first_number(state.contents)
    origin = Contents.first_ordinals(state.contents)
    reply({:ok, %{epoch: state.epoch, first: first, origin: origin}}, state)
  end

  def handle_call(:refresh, _from, state), do: reply(:ok, refresh(state, false))

  # The contents may be large, so the result is computed here.
  def handle_call({:query, fun}, _from, state) do
    state = refresh(state, false)
    reply(fun.(state.contents), state)
  end

  def handle_call({:next_ordinal, name}, _from, state) do
    state = refresh(state, false)
    reply(Contents.next_ordinal(state.contents, name), state)
  end

  def handle_call({:segment, number}, _from, state) do
    case Contents.fetch_segment(state.contents, number) do
      nil -> reply(:deleted, state)
      %{reader: nil} = segment -> open_again(segment, state)
      segment -> reply({:ok, segment.reader, segment.infos}, state)
    end
  end

  def handle_call({:check, number}, _from, state) do
    state = refresh(state, false)

    case Contents.fetch_segment(state.contents, number) do
      nil ->
        reply(:deleted, state)

      segment ->
        if replaced?(segment),
          do: reply(:replaced, reload(state, number)),
          else: reply(:ok, state)
    end
  end

  def handle_call({:notify, known, pid, tag}, _from, state) do
    state = refresh(state, false)
    live = Contents.live_readers(state.contents)
    reply(:ok, %{state | waiting: Waiting.add(state.waiting, {known, pid, tag}, live)})
  end

  defp monitor_owner(%{owners: owners} = state, pid) do
    if is_map_key(owners, pid),
      do: state,
      else: %{state | owners: Map.put(owners, pid, Process.monitor(pid))}
  end

  # A segment may have been repaired, compacted or recorded again since. If nobody reads the recording, everything is
  # read again. Otherwise, ordinals must not change.
  defp reload_replaced(state) do
    replaced = for {number, segment} <- state.contents.segments, replaced?(segment), do: number

    cond do
      replaced == [] -> state
      state.owners == %{} -> read_again(state)
      true -> Enum.reduce(replaced, state, &reload(&2, &1))
    end
  end

  defp replaced?(%{reader: nil} = segment),
    do: Scan.index_stamp(segment.path) not in [segment.stamp, nil]

  defp replaced?(_being_written), do: false

  defp reload(%{key: {_, _, opts}} = state, number) do
    :ets.delete(state.table, {:segment, number})
    {contents, changed} = Scan.reload(state.contents, number, opts)
    put_contents(state, contents, changed)
  end

  defp reply(result, state), do: {:reply, result, state, @idle_ms}

  # A closed segment is opened again, and the segment that has been open longest is closed.
  defp open_again(segment, %{key: {_, _, opts}} = state) do
    case NativeFormat.open(segment.path, opts) do
      {:ok, reader} ->
        :ets.insert(state.table, {{:segment, segment.number}, reader, segment.infos})
        opened = :queue.in(segment.number, state.opened)
        reply({:ok, reader, segment.infos}, close_oldest(%{state | opened: opened}))

      {:error, error} ->
        if File.dir?(segment.path),
          do: reply({:error, error}, state),
          else: reply(:deleted, refresh(state, false))
    end
  end

  defp close_oldest(%{opened: opened} = state) do
    if :queue.len(opened) > @most_open do
      {{:value, number}, opened} = :queue.out(opened)
      :ets.delete(state.table, {:segment, number})
      %{state | opened: opened}
    else
      state
    end
  end

  @impl true
  def handle_info({:situ_store, number, event}, state) do
    waiting = Waiting.handle_event(state.waiting, number, event)
    # A segment that has ended may have a successor.
    state = if elem(event, 0) == :ended, do: refresh(state, false), else: state
    live? = Contents.live_readers(state.contents) != []
    {:noreply, %{state | waiting: Waiting.reply(waiting, live?)}, @idle_ms}
  end

  def handle_info({:DOWN, _ref, :process, pid, _}, state),
    do: {:noreply, %{state | owners: Map.delete(state.owners, pid)}, @idle_ms}

  def handle_info(:timeout, %{owners: owners} = state) do
    if owners == %{} and Waiting.empty?(state.waiting),
      do: {:stop, :normal, state},
      else: {:noreply, state, @idle_ms}
  end

  def handle_info(_other, state), do: {:noreply, state, @idle_ms}

  # Listing the folder is enough if nothing in it has changed and no segment is being written.
  defp refresh(%{key: {_, root, _}} = state, dense?) do
    names = with {:error, _} <- File.ls(root), do: []
    same? = names == state.names and not dense?

    if same? and Contents.unchanging?(state.contents, state.folders),
      do: state,
      else: scan(list_folders(%{state | names: names}, same?), dense?)
  end

  defp list_folders(state, true), do: state

  defp list_folders(%{key: {name, root, _}} = state, false) do
    folders =
      for path <- Folder.list_versions(name, root), do: {Folder.version_number(path), path}

    lost = Replacement.list_interrupted(Path.join(root, name))
    %{state | folders: folders, contents: Contents.note_lost(state.contents, lost)}
  end

  defp scan(%{key: {name, _, opts}, folders: folders} = state, dense?) do
    {contents, changed} = Scan.update(state.contents, folders, opts, dense?)
    if not dense?, do: warn_of_unseen(name, Scan.count_unseen(state.contents, contents, folders))

    # A segment was repaired that could not be read before. Its messages precede others.
    if not dense? and Scan.out_of_order?(state.contents, contents),
      do: read_again(state),
      else: put_contents(state, contents, changed)
  end

  defp warn_of_unseen(_name, 0), do: :ok

  defp warn_of_unseen(name, count) do
    Logger.warning(
      "#{name}: #{count} segments were recorded and deleted since the recording was last read, because it keeps " <>
        "only its latest segments (`keep:`)"
    )
  end

  defp put_contents(%{table: table, contents: before} = state, contents, changed) do
    for stream <- changed,
        do: :ets.insert(table, {{:parts, stream}, Contents.parts_of(contents, stream)})

    # Segments that are being written are always open.
    open =
      for {number, %{reader: reader} = segment} <- contents.segments,
          reader != nil,
          into: %{},
          do: {number, segment}

    for {number, %{reader: reader, infos: infos}} <- open,
        do: :ets.insert(table, {{:segment, number}, reader, infos})

    for {number, segment} <- before.segments,
        not is_map_key(open, number),
        segment.reader != nil or not is_map_key(contents.segments, number),
        do: :ets.delete(table, {:segment, number})

    %{state | contents: contents}
  end

  @doc "Returns the error for a handle whose segments were deleted after the index had ended."
  @spec expired_error(key()) :: Error.t()
  def expired_error({name, root, _}) do
    Error.new(:segments_deleted, "the oldest segments of #{Path.join(root, name)} were deleted",
      why: "the recording was not used for a long time, so the position in it is unknown",
      fix: "open the recording again"
    )
  end

  @doc "Returns the error for a recording whose segments were all deleted."
  @spec no_store_error(key()) :: Error.t()
  def no_store_error({name, root, _}),
    do: NativeErrors.to_error(:no_store, Path.join(root, name))
end
