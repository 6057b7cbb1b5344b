defmodule Situ.Annotation.Editor do
  @moduledoc """
  One annotation stream being edited: undo and redo, several users, and a journal that a crash does not take along.

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

  Options of `start_link/1`: `path:` (the annotation store, `ROOT/NAME`; its newest version is opened), `stream:`,
  `schema:` (for a stream that is not there yet), and those of a GenServer (`name:`).

  Every transaction is appended to `ROOT/NAME.STREAM.journal` and on the disk before `edit/2` answers. `save/1`
  writes a new version of the store (`Situ.Annotation.Recording`) and removes the journal; an editor started after a
  crash finds the journal and carries on (`recovered` in `status/1` counts the transactions). Subscribers get
  `{:situ_annotation, pid, transaction}` after every edit, undo and redo, and `{:situ_annotation, pid, :saved}`.

  One editor at a time has unsaved edits of a stream, on all computers that share the folder: from its first edit to
  its next save it holds a lock (`ROOT/NAME.STREAM.journal.lock`). Others see what was saved last; their edits are
  refused (`:being_edited`) with the name of the program, its process and computer, and since when. The operating
  system releases the lock of a program that dies, so its journal is found as before.

  Several editors of one store, each of another stream, save independently: a new version has what the others saved
  last, also those of other operating-system processes. When another program has saved this very stream, its
  annotations and schema are taken at the next edit (or `refresh/1`), and edits that were not saved are made on them
  again. Where they do not fit, they stay as they are: the next save makes them the newest version, and `shadowed` in
  `status/1` names the other program's, which stays beside it.
  """
  use GenServer
  alias Situ.Annotation.{EditorState, Journal, Layer, Schema, Versions}
  alias Situ.Error
  alias Situ.Store.FileLock

  @type server :: GenServer.server()

  @doc "Starts it. Errors: those of the store, `:no_schema`, `:bad_journal`."
  @spec start_link(keyword()) :: GenServer.on_start() | {:error, Error.t()}
  def start_link(opts) do
    {given, opts} = Keyword.split(opts, [:path, :stream, :schema])
    {path, stream} = {Keyword.fetch!(given, :path), Keyword.fetch!(given, :stream)}

    with {:ok, state} <- EditorState.open(path, stream, given[:schema]) do
      started = GenServer.start_link(__MODULE__, state, opts)
      # The name may be taken.
      if state.lock && not match?({:ok, _}, started), do: FileLock.release(state.lock)
      started
    end
  end

  @doc "The annotations as they are now."
  @spec layer(server()) :: Layer.t()
  def layer(server), do: GenServer.call(server, :layer)

  @doc """
  `undo`, `redo`: how many steps each way; `unsaved?`; `recovered`: transactions found in the journal at the start.
  """
  @spec status(server()) :: map()
  def status(server), do: GenServer.call(server, :status)

  @doc """
  Makes an edit, `layer -> {:ok, layer, transaction} | {:error, error}` (the functions of `Situ.Annotation.Layer`
  and `Situ.Annotation.Edit`): `{:ok, layer}`. Earlier undone edits can no longer be redone.
  """
  @spec edit(server(), (Layer.t() -> Layer.edited())) :: {:ok, Layer.t()} | {:error, Error.t()}
  def edit(server, fun) when is_function(fun, 1), do: GenServer.call(server, {:edit, fun}, 60_000)

  @doc "Takes the last edit back. Error: `:nothing_to_undo`."
  @spec undo(server()) :: {:ok, Layer.t()} | {:error, Error.t()}
  def undo(server), do: GenServer.call(server, :undo, 60_000)

  @doc "Makes the edit again that was undone last. Error: `:nothing_to_redo`."
  @spec redo(server()) :: {:ok, Layer.t()} | {:error, Error.t()}
  def redo(server), do: GenServer.call(server, :redo, 60_000)

  @doc """
  Gives the stream another schema and saves it: `{:ok, folder}`. Every annotation goes through `fun` first, which
  adapts it to new names. Earlier edits can no longer be undone. Error: that of the first annotation that the schema
  does not allow; then nothing has changed.
  """
  @spec put_schema(server(), Schema.t(), (Situ.Annotation.t() -> Situ.Annotation.t())) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def put_schema(server, %Schema{} = schema, fun \\ & &1),
    do: GenServer.call(server, {:put_schema, schema, fun}, 600_000)

  @doc "Writes a new version of the store: `{:ok, folder}`. The edits before it can still be undone."
  @spec save(server()) :: {:ok, Path.t()} | {:error, Error.t()}
  def save(server), do: GenServer.call(server, :save, 600_000)

  @doc "Takes what another program has saved meanwhile; subscribers get `{:situ_annotation, pid, :reloaded}`."
  @spec refresh(server()) :: {:ok, Layer.t()} | {:error, Error.t()}
  def refresh(server), do: GenServer.call(server, :refresh, 60_000)

  @doc "From now on the caller gets a message for each edit, until it ends."
  @spec subscribe(server()) :: :ok
  def subscribe(server), do: GenServer.call(server, :subscribe)

  @doc "Ends the editor; what is not saved stays in the journal."
  @spec stop(server()) :: :ok
  def stop(server), do: GenServer.stop(server)

  @impl true
  def init(state) do
    if state.lock, do: FileLock.own(state.lock)
    {:ok, state}
  end

  @impl true
  def handle_call(:layer, _from, state), do: {:reply, state.layer, state}

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
    case current(state) do
      {:ok, state} -> {:reply, {:ok, state.layer}, state}
      error -> {:reply, error, state}
    end
  end

  def handle_call({:edit, fun}, _from, state) do
    change(state, fn state ->
      with {:ok, %Layer{}, transaction} <- edited(fun, state.layer),
           {:ok, state} <- made(state, transaction),
           do: {:ok, %{state | undo: [transaction | state.undo], redo: []}}
    end)
  end

  def handle_call(:undo, _from, state), do: change(state, &step(&1, :undo, :redo))
  def handle_call(:redo, _from, state), do: change(state, &step(&1, :redo, :undo))

  def handle_call({:put_schema, schema, fun}, _from, state) do
    changed =
      change(state, fn state ->
        # The new schema counts only when it is on the disk.
        with {:ok, layer} <- allowed(state.layer, schema, fun),
             do: save_version(%{state | layer: layer, undo: [], redo: []})
      end)

    with {:reply, {:ok, _}, state} <- changed, do: {:reply, {:ok, state.base}, state}
  end

  def handle_call(:save, _from, state) do
    case save_version(state) do
      {:ok, state} -> {:reply, {:ok, state.base}, EditorState.unlock(state)}
      error -> {:reply, error, state}
    end
  end

  # Edits go into the journal, which is one editor's at a time. It takes what others have saved first, and keeps
  # that when the edit then fails.
  defp change(state, fun) do
    with {:ok, locked} <- EditorState.lock(state) do
      # A killed editor had left edits.
      if locked.layer != state.layer, do: tell(locked, :reloaded)

      case current(locked) do
        {:ok, state} -> state |> fun.() |> answer(state)
        error -> answer(error, locked)
      end
    else
      error -> {:reply, error, state}
    end
  end

  defp answer({:ok, state}, _before), do: {:reply, {:ok, state.layer}, EditorState.unlock(state)}
  defp answer(error, state), do: {:reply, error, EditorState.unlock(state)}

  # Without the lock, the journal belongs to another editor.
  defp save_version(state) do
    with {:ok, state} <- Versions.write(state) do
      if state.lock, do: File.rm(state.journal)
      tell(state, :saved)
      {:ok, %{state | unsaved?: false}}
    end
  end

  defp current(state) do
    with {:ok, now} <- Versions.current(state) do
      if now.base != state.base, do: tell(now, :reloaded)
      {:ok, now}
    end
  end

  defp allowed(layer, schema, fun) do
    Layer.new(schema, layer |> Layer.annotations() |> Enum.map(fun))
  rescue
    exception ->
      {:error,
       Error.new(:edit_failed, "the schema cannot be changed", why: Exception.message(exception))}
  end

  # The border to a function from outside: what others have edited outlives it.
  defp edited(fun, layer) do
    fun.(layer)
  rescue
    exception ->
      {:error, Error.new(:edit_failed, "the edit failed", why: Exception.message(exception))}
  end

  defp step(state, from, to) do
    case Map.fetch!(state, from) do
      [] ->
        {:error, nothing(from)}

      [transaction | rest] ->
        change = if from == :undo, do: Layer.inverse(transaction), else: transaction

        with {:ok, state} <- made(state, change),
             do: {:ok, state |> Map.put(from, rest) |> Map.update!(to, &[transaction | &1])}
    end
  end

  defp nothing(:undo), do: Error.new(:nothing_to_undo, "there is nothing to undo")
  defp nothing(:redo), do: Error.new(:nothing_to_redo, "there is nothing to redo")

  # On the disk first, then in memory, then told.
  defp made(state, transaction) do
    with {:ok, layer} <- Layer.apply(state.layer, transaction),
         :ok <- Journal.append(state.journal, {state.base, state.digest}, transaction) do
      tell(state, transaction)
      {:ok, %{state | layer: layer, unsaved?: true}}
    end
  end

  defp tell(state, what),
    do: for({pid, _} <- state.subscribers, do: send(pid, {:situ_annotation, self(), what}))

  @impl true
  def handle_info({:DOWN, _, :process, pid, _}, state),
    do: {:noreply, %{state | subscribers: Map.delete(state.subscribers, pid)}}

  def handle_info(_, state), do: {:noreply, state}
end
