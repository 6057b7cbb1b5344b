defmodule Situ.Annotation.EditorState do
  @moduledoc false
  # The state that an editor starts from: the newest version of its store and, on it, the edits of a journal that a
  # crash left.
  # Whoever has unsaved edits holds the journal's lock; nobody else reads or writes the journal then.
  alias Situ.Annotation.{Journal, Layer, Schema, Versions}
  alias Situ.Dataset.Version
  alias Situ.{Error, Store}
  alias Situ.Store.FileLock

  @doc """
  The state of an editor that begins. A journal that another editor holds is left to it: then the saved annotations are
  shown, and edits are refused until it has saved.
  """
  @spec open(Path.t(), String.t(), Schema.t() | nil) :: {:ok, map()} | {:error, Error.t()}
  def open(path, stream, schema) do
    path = Path.expand(path)
    state = %{path: path, stream: stream, journal: Journal.path(path, stream), subscribers: %{}}

    with {:ok, lock} <- lock_leftover(state.journal),
         do: state |> Map.put(:lock, lock) |> load(schema) |> settle(lock)
  end

  defp lock_leftover(journal) do
    if File.exists?(journal) do
      with {:error, %{code: :being_edited}} <- Journal.lock(journal), do: {:ok, nil}
    else
      {:ok, nil}
    end
  end

  defp load(%{path: path, stream: stream} = state, schema) do
    base = if Store.exists?(path), do: Version.newest(path) || path

    with {:ok, mine, others} <- Versions.stored(base, stream),
         {:ok, layer} <- if(mine, do: {:ok, mine}, else: new_layer(stream, schema)),
         {:ok, transactions} <- unsaved(state, {base, mine}),
         {:ok, layer, undo} <- replay(layer, transactions) do
      {:ok,
       Map.merge(state, %{
         base: base,
         seen: base,
         shadowed: nil,
         digest: Journal.digest(mine),
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
     Error.new(:no_schema, "there is no annotation stream #{inspect(stream)} yet",
       fix: "give its schema:"
     )}
  end

  defp unsaved(%{lock: nil}, _base), do: {:ok, []}
  defp unsaved(state, base), do: Versions.unsaved(state.journal, base, state.stream)

  defp replay(layer, transactions) do
    Enum.reduce_while(transactions, {:ok, layer, []}, fn transaction, {:ok, layer, undo} ->
      case Layer.apply(layer, transaction) do
        {:ok, layer} -> {:cont, {:ok, layer, [transaction | undo]}}
        {:error, error} -> {:halt, {:error, Journal.unfit(error)}}
      end
    end)
  end

  defp settle({:ok, state}, _lock), do: {:ok, unlock(state)}

  defp settle(error, nil), do: error

  defp settle(error, lock) do
    FileLock.release(lock)
    error
  end

  @doc """
  The state with the journal's lock. Edits that an editor left there when it was killed are taken over first. Error:
  `:being_edited`.
  """
  @spec lock(map()) :: {:ok, map()} | {:error, Error.t()}
  def lock(%{lock: nil} = state) do
    with {:ok, lock} <- Journal.lock(state.journal) do
      state = %{state | lock: lock}

      if File.exists?(state.journal),
        do: state |> load(state.layer.schema) |> keep(lock),
        else: {:ok, state}
    end
  end

  def lock(state), do: {:ok, state}

  defp keep({:ok, state}, _lock), do: {:ok, state}
  defp keep(error, lock), do: settle(error, lock)

  @doc "The state without the lock, when nothing is unsaved."
  @spec unlock(map()) :: map()
  def unlock(%{unsaved?: false, lock: lock} = state) when lock != nil do
    :ok = FileLock.release(lock)
    %{state | lock: nil}
  end

  def unlock(state), do: state
end
