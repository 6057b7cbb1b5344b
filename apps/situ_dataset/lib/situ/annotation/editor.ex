defmodule Situ.Annotation.Editor do
  @moduledoc """
  Edits one annotation stream: undo and redo, several users and programs, and a log that survives a crash.

      iex> path = Path.join(System.tmp_dir!(), "situ-doc-editor/annotation")
      iex> alias Situ.Annotation.{Editor, Layer, Schema}
      iex> {:ok, editor} = Editor.start_link(path: path, stream: "Speech", schema: Schema.text("Speech"))
      iex> {:ok, _} = Editor.edit(editor, &Layer.add(&1, Situ.Annotation.new(0, 10, "P1")))
      iex> {:ok, layer} = Editor.undo(editor)
      iex> {Layer.annotations(layer), Editor.status(editor)}
      {[], %{undo: 0, redo: 1, unsaved?: true, recovered: 0, version: 2, shadowed: nil}}
      iex> {:ok, _} = Editor.redo(editor)
      iex> {:ok, folder} = Editor.save(editor)
      iex> {Path.basename(folder), Editor.status(editor).unsaved?}
      {"annotation.0000", false}
      iex> :ok = Editor.stop(editor)
      iex> File.rm_rf!(Path.dirname(path)) != []
      true

  Every edit is an operation in the log `ROOT/NAME.STREAM.edits`, and is on disk before `edit/3` returns. `save/1`
  writes a new version of the store (`Situ.Annotation.Recording`) for programs that read annotations. An editor that
  starts reads the newest version and the operations after it; `recovered` in `status/1` is the number of these
  operations.
  Subscribers receive `{:situ_annotation, pid, transaction}` after every edit, undo and redo, `{:situ_annotation, pid,
  :reloaded}` after edits of other programs, and `{:situ_annotation, pid, :saved}`.

  Several programs may edit a stream at the same time, also on different computers that share the folder. An edit takes
  a lock, reads the operations of the others, and applies to the result, so edits of different annotations, and of
  different fields of one annotation, are merged. With `version:`, an edit is refused if another program has changed
  the same fields since that version.

  Undo and redo apply to the edits of this user with any program on this computer, also after a restart. Every version
  can be listed, compared and restored (`Situ.Annotation.History`).

  If another program writes a version of the store without the log, such as an import, its changes become an operation.
  If they contradict the log, the log is kept: the next save writes it as the newest version, and `shadowed` in
  `status/1` names the other program's version, which is kept, too.
  """
  # See docs/adr/0091-annotations-are-streams-with-versions.md.
  use GenServer
  alias Situ.Annotation.{EditMerge, Layer, LayerDocument, LayerHistory, LayerOperation, Schema}
  alias Situ.EditLog
  alias Situ.EditLog.Entry
  alias Situ.Error

  @type server :: GenServer.server()

  @doc """
  Starts an editor. Options: `path:` (the annotation store, `ROOT/NAME`; the editor opens its newest version),
  `stream:`, `schema:` (for a stream that does not exist yet), `save_on_leave:` (whether the editor saves when the last
  subscriber that has edited ends, default `false`), and GenServer options such as `name:`. Errors: `:no_schema`,
  `:bad_log`, `:bad_journal` (of an earlier release), and the errors of the store.
  """
  @spec start_link(keyword()) :: GenServer.on_start() | {:error, Error.t()}
  def start_link(opts) do
    {own_opts, opts} = Keyword.split(opts, [:path, :stream, :schema, :save_on_leave])
    {path, stream} = {Keyword.fetch!(own_opts, :path), Keyword.fetch!(own_opts, :stream)}

    with {:ok, document} <- LayerDocument.open(path, stream, own_opts[:schema]) do
      state = %{
        document: document,
        save_on_leave?: own_opts[:save_on_leave] || false,
        subscribers: %{},
        writers: [],
        revision: :counters.new(1, [])
      }

      GenServer.start_link(__MODULE__, state, opts)
    end
  end

  @doc "Returns the current annotations."
  @spec current_layer(server()) :: Layer.t()
  def current_layer(server), do: GenServer.call(server, :layer)

  @doc "Returns a number that changes with every message to subscribers, such as after an edit."
  @spec revision(server()) :: non_neg_integer()
  def revision(server), do: GenServer.call(server, :revision)

  @doc """
  Returns `undo` and `redo` (the number of steps in each direction), `unsaved?`, `recovered` (the number of operations
  at the start that were not in a version), `version` (the number of the last operation) and `shadowed`.
  """
  @spec status(server()) :: map()
  def status(server), do: GenServer.call(server, :status)

  @doc """
  Applies an edit and returns `{:ok, layer}`. The edit is a function `layer -> {:ok, layer, transaction} |
  {:error, error}`, from `Situ.Annotation.Layer` or `Situ.Annotation.Edit`, for example. Undone edits can no longer be
  redone. Options: `by:`, the name of the person in the history, `version:`, the version that the person has seen, and
  `reply: :version` to return `{:ok, version}`: a large layer takes long to copy to the calling process.
  Errors: the errors of the function, `:stale_edit` if another person has changed the same fields since that version,
  `:not_saved`, `:in_use`, and `:no_locks`.
  """
  @spec edit(server(), (Layer.t() -> Layer.edited()), keyword()) ::
          {:ok, Layer.t() | pos_integer()} | {:error, Error.t()}
  def edit(server, fun, opts \\ []) when is_function(fun, 1),
    do: GenServer.call(server, {:edit, fun, opts}, 60_000)

  @doc """
  Undoes this user's last edit. Errors: `:nothing_to_undo`, and `:stale_edit` if someone has changed the same annotation
  since.
  """
  @spec undo(server()) :: {:ok, Layer.t()} | {:error, Error.t()}
  def undo(server), do: GenServer.call(server, :undo, 60_000)

  @doc "Redoes the edit that was undone last. Error: `:nothing_to_redo`."
  @spec redo(server()) :: {:ok, Layer.t()} | {:error, Error.t()}
  def redo(server), do: GenServer.call(server, :redo, 60_000)

  @doc """
  Changes the schema of the stream, saves it and returns `{:ok, folder}`. `fun` first adapts every annotation to the
  new schema. The change can be undone. If the schema does not allow an annotation, nothing changes and
  the error names the first such annotation.
  """
  @spec put_schema(server(), Schema.t(), (Situ.Annotation.t() -> Situ.Annotation.t())) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def put_schema(server, %Schema{} = schema, fun \\ & &1),
    do: GenServer.call(server, {:put_schema, schema, fun}, 600_000)

  @doc """
  Changes the schema, such as its tiers (`Situ.Annotation.TierEdit`), with all annotations as one operation that can be
  undone, saves it, and returns `{:ok, layer}`. The edit is a function `layer -> {:ok, layer} | {:error, error}`, which
  gets the layer with the edits of all other programs. Option: `by:`, as for `edit/3`. Errors: the errors of the
  function and of `edit/3`.
  """
  @spec edit_schema(server(), (Layer.t() -> {:ok, Layer.t()} | {:error, Error.t()}), keyword()) ::
          {:ok, Layer.t()} | {:error, Error.t()}
  def edit_schema(server, fun, opts \\ []) when is_function(fun, 1),
    do: GenServer.call(server, {:edit_schema, fun, opts}, 600_000)

  @doc """
  Restores the layer of an earlier version, as a new operation that can be undone. `version` is a number.
  """
  @spec restore(server(), non_neg_integer(), keyword()) :: {:ok, Layer.t()} | {:error, Error.t()}
  def restore(server, version, opts \\ []),
    do: GenServer.call(server, {:restore, version, opts}, 60_000)

  @doc "Writes a new version of the store and returns `{:ok, folder}`. Earlier edits can still be undone."
  @spec save(server()) :: {:ok, Path.t()} | {:error, Error.t()}
  def save(server), do: GenServer.call(server, :save, 600_000)

  @doc "Reads the edits of other programs; subscribers receive `{:situ_annotation, pid, :reloaded}`."
  @spec refresh(server()) :: {:ok, Layer.t()} | {:error, Error.t()}
  def refresh(server), do: GenServer.call(server, :refresh, 60_000)

  @doc "Subscribes the calling process to a message for each edit."
  @spec subscribe(server()) :: :ok
  def subscribe(server), do: GenServer.call(server, :subscribe)

  @doc "Stops the editor; edits that are not in a version stay in the log."
  @spec stop(server()) :: :ok
  def stop(server), do: GenServer.stop(server)

  @impl true
  def init(state), do: {:ok, state}

  @impl true
  def handle_call(:layer, _from, state), do: {:reply, state.document.layer, state}
  def handle_call(:revision, _from, state), do: {:reply, :counters.get(state.revision, 1), state}

  def handle_call(:status, _from, %{document: document} = state) do
    {undo, redo} = LayerHistory.undo_stacks(document)

    status = %{
      undo: length(undo),
      redo: length(redo),
      unsaved?: LayerDocument.unsaved?(document),
      recovered: document.recovered,
      version: document.log.n,
      shadowed: document.shadowed
    }

    {:reply, status, state}
  end

  def handle_call(:subscribe, {pid, _}, state) do
    subscribers = Map.put_new_lazy(state.subscribers, pid, fn -> Process.monitor(pid) end)
    {:reply, :ok, %{state | subscribers: subscribers}}
  end

  def handle_call(:refresh, _from, state) do
    case LayerDocument.refresh(state.document) do
      {:ok, document} -> {:reply, {:ok, document.layer}, put_document(state, document)}
      error -> {:reply, error, state}
    end
  end

  def handle_call({:edit, fun, opts}, {pid, _}, state) do
    state
    |> remember_writer(pid)
    |> run_locked(opts[:reply], fn document ->
      with {:ok, %Layer{}, transaction} <- run_edit(fun, document.layer),
           :ok <- EditMerge.check_version(document.entries, transaction, opts),
           do:
             LayerHistory.append(
               document,
               "edit",
               LayerOperation.encode_transaction(transaction),
               opts
             )
    end)
  end

  def handle_call(:undo, _from, state), do: run_locked(state, &LayerHistory.undo/1)
  def handle_call(:redo, _from, state), do: run_locked(state, &LayerHistory.redo/1)

  def handle_call({:restore, version, opts}, _from, state),
    do: run_locked(state, &LayerHistory.restore(&1, version, opts))

  def handle_call({:put_schema, schema, fun}, _from, state) do
    state
    |> run_locked(&change_layer(&1, fn layer -> convert_layer(layer, schema, fun) end, []))
    |> reply_folder(state)
  end

  def handle_call({:edit_schema, fun, opts}, _from, state) do
    changed = run_locked(state, &change_layer(&1, fn layer -> run_edit(fun, layer) end, opts))

    with {:reply, {:ok, _folder}, later} <- reply_folder(changed, state),
         do: {:reply, {:ok, later.document.layer}, later}
  end

  def handle_call(:save, _from, state),
    do: state |> run_locked(&LayerDocument.write_version/1) |> reply_folder(state)

  defp reply_folder({:reply, {:ok, _}, state}, before) do
    if state.document.base != before.document.base, do: notify_subscribers(state, :saved)
    {:reply, {:ok, state.document.base}, state}
  end

  defp reply_folder(reply, _before), do: reply

  # The editor first reads the edits of other programs, and keeps them even if its own edit then fails.
  defp run_locked(state, reply \\ nil, fun) do
    EditLog.with_lock(state.document.document, fn ->
      with {:ok, document} <- LayerDocument.catch_up(state.document) do
        state = put_document(state, document)

        case fun.(document) do
          {:ok, later} -> {:reply, {:ok, choose_reply(later, reply)}, put_edit(state, later)}
          error -> {:reply, error, state}
        end
      end
    end)
    |> case do
      {:reply, _, _} = reply -> reply
      error -> {:reply, error, state}
    end
  end

  defp choose_reply(document, :version), do: document.log.n
  defp choose_reply(document, nil), do: document.layer

  defp put_document(%{document: before} = state, document) do
    state = %{state | document: document}

    if document.log != before.log or document.base != before.base,
      do: notify_subscribers(state, :reloaded)

    state
  end

  defp put_edit(%{document: %{entries: before}} = state, document) do
    state = %{state | document: document}

    with [%Entry{} = entry | _] when document.entries != before <- document.entries,
         {:ok, transaction} <- LayerOperation.parse_transaction(entry.do),
         do: notify_subscribers(state, transaction)

    state
  end

  # The caller holds the lock. Other programs read the schema from the store, so a version is written.
  defp change_layer(document, fun, opts) do
    with {:ok, %Layer{} = layer} <- fun.(document.layer),
         operation = LayerOperation.diff_layers(document.layer, layer),
         {:ok, document} <- LayerHistory.append(document, "edit", operation, opts),
         do: LayerDocument.write_version(document)
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

  # If it cannot save, the edits remain in the log.
  defp save_on_leave(%{save_on_leave?: true, writers: []} = state) do
    if LayerDocument.unsaved?(state.document) do
      {:reply, _, state} =
        state |> run_locked(&LayerDocument.write_version/1) |> reply_folder(state)

      state
    else
      state
    end
  end

  defp save_on_leave(state), do: state

  defp remember_writer(%{subscribers: subscribers, writers: writers} = state, pid) do
    if is_map_key(subscribers, pid) and pid not in writers,
      do: %{state | writers: [pid | writers]},
      else: state
  end
end
