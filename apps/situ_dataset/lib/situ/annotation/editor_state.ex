defmodule Situ.Annotation.EditorState do
  @moduledoc false
  # Builds the initial state of an editor: the newest version of its store, with the edits of a journal that a crash
  # left there. An editor with unsaved edits holds the journal's lock, which keeps other editors from using the
  # journal.
  alias Situ.Annotation.{Journal, Layer, Schema, StoreVersions}
  alias Situ.Dataset.StoreVersion
  alias Situ.{Error, Store}
  alias Situ.Store.FileLock

  @doc """
  Returns the state of a new editor. If another editor holds the journal, the state has the saved annotations, and edits
  are refused until the other one has saved.
  """
  @spec open_state(Path.t(), String.t(), Schema.t() | nil) :: {:ok, map()} | {:error, Error.t()}
  def open_state(path, stream, schema) do
    path = Path.expand(path)

    state = %{
      path: path,
      stream: stream,
      journal: Journal.journal_path(path, stream),
      subscribers: %{}
    }

    with {:ok, lock} <- lock_existing(state.journal),
         {:ok, state} <- load_locked(Map.put(state, :lock, lock), schema),
         do: {:ok, unlock_journal(state)}
  end

  defp lock_existing(journal) do
    if File.exists?(journal) do
      with {:error, %{code: :being_edited}} <- Journal.acquire_lock(journal), do: {:ok, nil}
    else
      {:ok, nil}
    end
  end

  defp load_locked(state, schema) do
    with {:error, _} = error <- load_state(state, schema) do
      :ok = release_lock(state.lock)
      error
    end
  end

  defp release_lock(nil), do: :ok
  defp release_lock(lock), do: FileLock.release(lock)

  defp load_state(%{path: path, stream: stream} = state, schema) do
    base = if Store.exists?(path), do: StoreVersion.newest_folder(path) || path

    with {:ok, mine, others} <- StoreVersions.load_version(base, stream),
         {:ok, layer} <- if(mine, do: {:ok, mine}, else: new_layer(stream, schema)),
         {:ok, transactions} <- unsaved_transactions(state, {base, mine}),
         {:ok, layer, undo} <- replay_transactions(layer, transactions) do
      {:ok,
       Map.merge(state, %{
         base: base,
         seen: base,
         shadowed: nil,
         digest: Journal.layer_digest(mine),
         others: others,
         layer: layer,
         undo: undo,
         redo: [],
         recovered: length(transactions),
         unsaved?: transactions != []
       })}
    end
  end

  defp new_layer(_stream, %Schema{} = schema), do: Layer.new(schema)

  defp new_layer(stream, nil) do
    {:error,
     Error.new(:no_schema, "annotation stream #{inspect(stream)} does not exist",
       fix: "pass schema: to create it"
     )}
  end

  defp unsaved_transactions(%{lock: nil}, _base), do: {:ok, []}

  defp unsaved_transactions(state, base),
    do: StoreVersions.unsaved_transactions(state.journal, base, state.stream)

  defp replay_transactions(layer, transactions) do
    Enum.reduce_while(transactions, {:ok, layer, []}, fn transaction, {:ok, layer, undo} ->
      case Layer.apply_transaction(layer, transaction) do
        {:ok, layer} -> {:cont, {:ok, layer, [transaction | undo]}}
        {:error, error} -> {:halt, {:error, Journal.mismatch_error(error)}}
      end
    end)
  end

  @doc """
  Acquires the journal's lock and loads the edits that a killed editor left in the journal. Error: `:being_edited`.
  """
  @spec lock_journal(map()) :: {:ok, map()} | {:error, Error.t()}
  def lock_journal(%{lock: nil} = state) do
    with {:ok, lock} <- Journal.acquire_lock(state.journal) do
      state = %{state | lock: lock}

      if File.exists?(state.journal),
        do: load_locked(state, state.layer.schema),
        else: {:ok, state}
    end
  end

  def lock_journal(state), do: {:ok, state}

  @doc "Releases the lock unless there are unsaved edits."
  @spec unlock_journal(map()) :: map()
  def unlock_journal(%{unsaved?: false, lock: lock} = state) when lock != nil do
    :ok = release_lock(lock)
    %{state | lock: nil}
  end

  def unlock_journal(state), do: state
end
