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

  Several editors of one store, each of another stream, save independently: a new version has what the others saved
  last, also those of other operating-system processes. When another program has saved this very stream, its
  annotations and schema are taken at the next edit (or `refresh/1`), and edits that were not saved are made on them
  again. Where they do not fit, they stay as they are: the next save makes them the newest version, and `shadowed` in
  `status/1` names the other program's, which stays beside it.
  """
  use GenServer
  alias Situ.Annotation.{Journal, Layer, Schema, Versions}
  alias Situ.Dataset.Version
  alias Situ.{Error, Store}

  @type server :: GenServer.server()

  @doc "Starts it. Errors: those of the store, `:no_schema`, `:bad_journal`."
  @spec start_link(keyword()) :: GenServer.on_start() | {:error, Error.t()}
  def start_link(opts) do
    {given, opts} = Keyword.split(opts, [:path, :stream, :schema])

    with {:ok, state} <-
           open(Keyword.fetch!(given, :path), Keyword.fetch!(given, :stream), given[:schema]),
         do: GenServer.start_link(__MODULE__, state, opts)
  end

  defp open(path, stream, schema) do
    path = Path.expand(path)
    journal = Journal.path(path, stream)

    base = if Store.exists?(path), do: Version.newest(path) || path

    with {:ok, mine, others} <- Versions.stored(base, stream),
         {:ok, layer} <- if(mine, do: {:ok, mine}, else: fresh(stream, schema)),
         digest = Journal.digest(mine),
         {:ok, transactions} <- Versions.unsaved(journal, {base, mine}, stream),
         {:ok, layer, undo} <- replay(layer, transactions) do
      {:ok,
       %{
         path: path,
         base: base,
         seen: base,
         shadowed: nil,
         stream: stream,
         digest: digest,
         others: others,
         layer: layer,
         undo: undo,
         redo: [],
         journal: journal,
         recovered: length(transactions),
         unsaved?: transactions != [],
         subscribers: %{}
       }}
    end
  end

  defp fresh(_stream, %Schema{} = schema), do: Layer.new(schema)

  defp fresh(stream, nil) do
    {:error,
     Error.new(:no_schema, "there is no annotation stream #{inspect(stream)} yet",
       fix: "give its schema:"
     )}
  end

  defp replay(layer, transactions) do
    Enum.reduce_while(transactions, {:ok, layer, []}, fn transaction, {:ok, layer, undo} ->
      case Layer.apply(layer, transaction) do
        {:ok, layer} -> {:cont, {:ok, layer, [transaction | undo]}}
        {:error, error} -> {:halt, {:error, Journal.unfit(error)}}
      end
    end)
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
  def init(state), do: {:ok, state}

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
    with {:ok, state} <- current(state),
         {:ok, %Layer{}, transaction} <- edited(fun, state.layer),
         {:ok, state} <- made(state, transaction) do
      {:reply, {:ok, state.layer}, %{state | undo: [transaction | state.undo], redo: []}}
    else
      {:error, error} -> {:reply, {:error, error}, state}
    end
  end

  def handle_call(way, _from, state) when way in [:undo, :redo] do
    with {:ok, state} <- current(state) do
      if way == :undo, do: step(state, :undo, :redo), else: step(state, :redo, :undo)
    else
      error -> {:reply, error, state}
    end
  end

  def handle_call({:put_schema, schema, fun}, from, state) do
    with {:ok, state} <- current(state), {:ok, layer} <- allowed(state.layer, schema, fun) do
      # only what is on the disk is answered for
      case handle_call(:save, from, %{state | layer: layer, undo: [], redo: []}) do
        {:reply, {:ok, _}, _} = saved -> saved
        {:reply, error, _} -> {:reply, error, state}
      end
    else
      error -> {:reply, error, state}
    end
  end

  def handle_call(:save, _from, state) do
    case Versions.write(state) do
      {:ok, state} ->
        _ = File.rm(state.journal)
        tell(state, :saved)
        {:reply, {:ok, state.base}, %{state | unsaved?: false}}

      {:error, error} ->
        {:reply, {:error, error}, state}
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
        {:reply, {:error, nothing(from)}, state}

      [transaction | rest] ->
        change = if from == :undo, do: Layer.inverse(transaction), else: transaction

        case made(state, change) do
          {:ok, state} ->
            state = state |> Map.put(from, rest) |> Map.update!(to, &[transaction | &1])
            {:reply, {:ok, state.layer}, state}

          {:error, error} ->
            {:reply, {:error, error}, state}
        end
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
