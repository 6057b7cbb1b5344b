defmodule Situ.Annotation.Editor do
  @moduledoc """
  Edits one annotation stream: undo and redo, several users, and a journal that survives a crash.

      iex> path = Path.join(System.tmp_dir!(), "situ-doc-editor/annotation")
      iex> alias Situ.Annotation.{Editor, Layer, Schema}
      iex> {:ok, editor} = Editor.start_link(path: path, stream: "Speech", schema: Schema.text("Speech"))
      iex> {:ok, _} = Editor.edit(editor, &Layer.add(&1, Situ.Annotation.new(0, 10, "P1")))
      iex> {:ok, layer} = Editor.undo(editor)
      iex> {Layer.annotations(layer), Editor.status(editor)}
      {[], %{undo: 0, redo: 1, unsaved?: true, recovered: 0, shadowed: nil}}
      iex> {:ok, _} = Editor.redo(editor)
      iex> {:ok, folder} = Editor.save(editor)
      iex> {Path.basename(folder), Editor.status(editor).unsaved?}
      {"annotation.0000", false}
      iex> :ok = Editor.stop(editor)
      iex> File.rm_rf!(Path.dirname(path)) != []
      true

  Every transaction is appended to `ROOT/NAME.STREAM.journal` and is on disk before `edit/2` returns. `save/1`
  writes a new version of the store (`Situ.Annotation.Recording`) and removes the journal. An editor that starts
  after a crash replays the journal; `recovered` in `status/1` is the number of replayed transactions. Subscribers
  receive `{:situ_annotation, pid, transaction}` after every edit, undo and redo, and `{:situ_annotation, pid,
  :saved}`.

  Only one editor at a time can have unsaved edits of a stream, across all computers that share the folder. From its
  first edit until its next save it holds a lock (`ROOT/NAME.STREAM.journal.lock`). Other editors see the last saved
  version; their edits fail with `:being_edited`, which reports the program, process and computer that hold the lock,
  and since when. The operating system releases the lock of a program that dies, so that
  another editor can recover its journal.

  Editors of different streams in one store save independently: a new version includes the latest saved version of
  every other stream, even if another operating-system process saved it. If another program has saved the same
  stream, the next edit (or `refresh/1`) loads its annotations and schema and reapplies the unsaved edits. If the
  edits cannot be reapplied, they are kept: the next save writes them as the newest version, and `shadowed` in
  `status/1` names the other program's version, which is kept, too.
  """
  # See docs/adr/0091-annotations-are-streams-with-versions.md.
  use GenServer
  alias Situ.Annotation.{EditorState, Journal, Layer, Review, Schema, StoreVersions}
  alias Situ.Error
  alias Situ.Store.FileLock

  @type server :: GenServer.server()

  @doc """
  Starts an editor. Options: `path:` (the annotation store, `ROOT/NAME`; the editor opens its newest version),
  `stream:`, `schema:` (for a stream that does not exist yet), `save_on_leave:` (whether the editor saves when the last
  subscriber that has edited ends, default `false`), and GenServer options such as `name:`. Errors: `:no_schema`,
  `:bad_journal` and the errors of the store.
  """
  @spec start_link(keyword()) :: GenServer.on_start() | {:error, Error.t()}
  def start_link(opts) do
    {own_opts, opts} = Keyword.split(opts, [:path, :stream, :schema, :save_on_leave])
    {path, stream} = {Keyword.fetch!(own_opts, :path), Keyword.fetch!(own_opts, :stream)}

    with {:ok, state} <- EditorState.open_state(path, stream, own_opts[:schema]) do
      state =
        Map.merge(state, %{
          save_on_leave?: own_opts[:save_on_leave] || false,
          writers: [],
          revision: :counters.new(1, [])
        })

      started = GenServer.start_link(__MODULE__, state, opts)
      # Starting fails if the name is taken.
      if state.lock && not match?({:ok, _}, started), do: FileLock.release(state.lock)
      started
    end
  end

  @doc "Returns the current annotations."
  @spec current_layer(server()) :: Layer.t()
  def current_layer(server), do: GenServer.call(server, :layer)

  @doc "Returns a number that changes with every message to subscribers, such as after an edit."
  @spec revision(server()) :: non_neg_integer()
  def revision(server), do: GenServer.call(server, :revision)

  @doc """
  Returns `undo` and `redo` (the number of steps in each direction), `unsaved?`, `recovered` (the number of
  transactions recovered from the journal at the start) and `shadowed`.
  """
  @spec status(server()) :: map()
  def status(server), do: GenServer.call(server, :status)

  @doc """
  Applies an edit and returns `{:ok, layer}`. The edit is a function `layer -> {:ok, layer, transaction} |
  {:error, error}`, from `Situ.Annotation.Layer` or `Situ.Annotation.Edit`, for example. Undone edits can no longer be
  redone.
  """
  @spec edit(server(), (Layer.t() -> Layer.edited())) :: {:ok, Layer.t()} | {:error, Error.t()}
  def edit(server, fun) when is_function(fun, 1), do: GenServer.call(server, {:edit, fun}, 60_000)

  @doc "Undoes the last edit. Error: `:nothing_to_undo`."
  @spec undo(server()) :: {:ok, Layer.t()} | {:error, Error.t()}
  def undo(server), do: GenServer.call(server, :undo, 60_000)

  @doc "Redoes the edit that was undone last. Error: `:nothing_to_redo`."
  @spec redo(server()) :: {:ok, Layer.t()} | {:error, Error.t()}
  def redo(server), do: GenServer.call(server, :redo, 60_000)

  @doc """
  Changes the schema of the stream, saves it and returns `{:ok, folder}`. `fun` first adapts every annotation to the
  new schema. Earlier edits can no longer be undone. If the schema does not allow an annotation, nothing changes and
  the error names the first such annotation.
  """
  @spec put_schema(server(), Schema.t(), (Situ.Annotation.t() -> Situ.Annotation.t())) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def put_schema(server, %Schema{} = schema, fun \\ & &1),
    do: GenServer.call(server, {:put_schema, schema, fun}, 600_000)

  @doc "Writes a new version of the store and returns `{:ok, folder}`. Earlier edits can still be undone."
  @spec save(server()) :: {:ok, Path.t()} | {:error, Error.t()}
  def save(server), do: GenServer.call(server, :save, 600_000)

  @doc "Loads a version that another program has saved; subscribers receive `{:situ_annotation, pid, :reloaded}`."
  @spec refresh(server()) :: {:ok, Layer.t()} | {:error, Error.t()}
  def refresh(server), do: GenServer.call(server, :refresh, 60_000)

  @doc "Subscribes the calling process to a message for each edit."
  @spec subscribe(server()) :: :ok
  def subscribe(server), do: GenServer.call(server, :subscribe)

  @doc "Stops the editor; unsaved edits stay in the journal."
  @spec stop(server()) :: :ok
  def stop(server), do: GenServer.stop(server)

  @impl true
  def init(state) do
    if state.lock, do: FileLock.take_ownership(state.lock)
    {:ok, state}
  end

  @impl true
  def handle_call(:layer, _from, state), do: {:reply, state.layer, state}
  def handle_call(:revision, _from, state), do: {:reply, :counters.get(state.revision, 1), state}

  def handle_call(:status, _from, state) do
    status = %{
      undo: length(state.undo),
      redo: length(state.redo),
      unsaved?: state.unsaved?,
      recovered: state.recovered,
      shadowed: state.shadowed
    }

    {:reply, status, state}
  end

  def handle_call(:subscribe, {pid, _}, state) do
    subscribers = Map.put_new_lazy(state.subscribers, pid, fn -> Process.monitor(pid) end)
    {:reply, :ok, %{state | subscribers: subscribers}}
  end

  def handle_call(:refresh, _from, state) do
    case load_current(state) do
      {:ok, state} -> {:reply, {:ok, state.layer}, state}
      error -> {:reply, error, state}
    end
  end

  def handle_call({:edit, fun}, {pid, _}, state) do
    state
    |> remember_writer(pid)
    |> run_locked_edit(fn state ->
      with {:ok, %Layer{}, transaction} <- run_edit(fun, state.layer),
           {:ok, state} <- apply_transaction(state, transaction),
           do: {:ok, %{state | undo: [transaction | state.undo], redo: []}}
    end)
  end

  def handle_call(:undo, _from, state),
    do: run_locked_edit(state, &step_history(&1, :undo, :redo))

  def handle_call(:redo, _from, state),
    do: run_locked_edit(state, &step_history(&1, :redo, :undo))

  def handle_call({:put_schema, schema, fun}, _from, state) do
    changed =
      run_locked_edit(state, fn state ->
        # The new schema takes effect only after it was written to disk.
        with {:ok, layer} <- convert_layer(state.layer, schema, fun),
             do: save_version(%{state | layer: layer, undo: [], redo: []})
      end)

    with {:reply, {:ok, _}, state} <- changed, do: {:reply, {:ok, state.base}, state}
  end

  def handle_call(:save, _from, state) do
    case save_version(state) do
      {:ok, state} -> {:reply, {:ok, state.base}, EditorState.unlock_journal(state)}
      error -> {:reply, error, state}
    end
  end

  # Only one editor at a time may write to the journal. The editor first loads the versions that other programs have
  # saved, and keeps them even if the edit then fails.
  defp run_locked_edit(state, fun) do
    with {:ok, locked} <- EditorState.lock_journal(state) do
      # The journal contained edits of an editor that was killed.
      if locked.layer != state.layer, do: notify_subscribers(locked, :reloaded)

      case load_current(locked) do
        {:ok, state} -> state |> fun.() |> reply_and_unlock(state)
        error -> reply_and_unlock(error, locked)
      end
    else
      error -> {:reply, error, state}
    end
  end

  defp reply_and_unlock({:ok, state}, _before),
    do: {:reply, {:ok, state.layer}, EditorState.unlock_journal(state)}

  defp reply_and_unlock(error, state), do: {:reply, error, EditorState.unlock_journal(state)}

  # Without the lock, the journal belongs to another editor and must not be removed.
  defp save_version(state) do
    with {:ok, state} <- StoreVersions.write_version(state) do
      if state.lock, do: File.rm(state.journal)
      notify_subscribers(state, :saved)
      {:ok, %{state | unsaved?: false}}
    end
  end

  defp load_current(state) do
    with {:ok, now} <- StoreVersions.load_newest(state) do
      if now.base != state.base, do: notify_subscribers(now, :reloaded)
      {:ok, now}
    end
  end

  defp convert_layer(layer, schema, fun) do
    Layer.new(schema, layer |> Layer.annotations() |> Enum.map(fun), layer.review)
  rescue
    exception ->
      {:error,
       Error.new(:edit_failed, "cannot change the schema", why: Exception.message(exception))}
  end

  # The function comes from the caller: an exception in it must not lose the edits of other users.
  defp run_edit(fun, layer) do
    fun.(layer)
  rescue
    exception ->
      {:error, Error.new(:edit_failed, "the edit failed", why: Exception.message(exception))}
  end

  defp step_history(state, from, to) do
    case Map.fetch!(state, from) do
      [] ->
        {:error, empty_history_error(from)}

      [transaction | rest] ->
        change = if from == :undo, do: Layer.invert_transaction(transaction), else: transaction

        with {:ok, state} <- apply_transaction(state, change),
             state = if(from == :undo, do: forget_added(state, transaction), else: state),
             do: {:ok, state |> Map.put(from, rest) |> Map.update!(to, &[transaction | &1])}
    end
  end

  defp forget_added(state, transaction),
    do: update_in(state.layer.review, &Review.forget_added(&1, transaction))

  defp empty_history_error(:undo), do: Error.new(:nothing_to_undo, "there is nothing to undo")
  defp empty_history_error(:redo), do: Error.new(:nothing_to_redo, "there is nothing to redo")

  # The transaction is written to disk before it takes effect in memory and subscribers are notified.
  defp apply_transaction(state, transaction) do
    with {:ok, layer} <- Layer.apply_transaction(state.layer, transaction),
         :ok <- Journal.append_transaction(state.journal, {state.base, state.digest}, transaction) do
      notify_subscribers(state, transaction)
      {:ok, %{state | layer: layer, unsaved?: true}}
    end
  end

  defp notify_subscribers(state, what) do
    :counters.add(state.revision, 1, 1)
    for {pid, _} <- state.subscribers, do: send(pid, {:situ_annotation, self(), what})
  end

  @impl true
  def handle_info({:DOWN, _, :process, pid, _}, state),
    do:
      {:noreply,
       save_on_leave(%{
         state
         | subscribers: Map.delete(state.subscribers, pid),
           writers: List.delete(state.writers, pid)
       })}

  def handle_info(_, state), do: {:noreply, state}

  # If it cannot save, the edits remain in the journal.
  defp save_on_leave(%{save_on_leave?: true, unsaved?: true, writers: []} = state) do
    case save_version(state) do
      {:ok, state} -> EditorState.unlock_journal(state)
      {:error, _} -> state
    end
  end

  defp save_on_leave(state), do: state

  defp remember_writer(%{subscribers: subscribers, writers: writers} = state, pid) do
    if is_map_key(subscribers, pid) and pid not in writers,
      do: %{state | writers: [pid | writers]},
      else: state
  end
end
