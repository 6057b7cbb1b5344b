defmodule Situ.Annotation.StoreVersions do
  @moduledoc false
  # Reads, adopts and writes the versions of a store that an editor and other programs save. The state is the editor's
  # state: `base` is the version that its edits apply to, and `seen` is the newest version that was examined.
  alias Situ.Annotation.{Journal, Layer, Rebase, Recording}
  alias Situ.Dataset.StoreVersion
  alias Situ.{Error, Store}

  # The number of attempts to write a version while other programs save at the same time.
  @tries 100

  @doc "Returns the stream of a version (or `nil`), and its other streams, which are copied to the next version."
  @spec load_version(Path.t() | nil, String.t()) ::
          {:ok, Layer.t() | nil, %{String.t() => Layer.t()}} | {:error, Error.t()}
  def load_version(nil, _stream), do: {:ok, nil, %{}}

  def load_version(folder, stream) do
    with {:ok, store} <- Store.open(folder),
         {:ok, layers} <- load_layers(store, Store.streams(store)) do
      {mine, others} = Map.pop(layers, stream)
      {:ok, mine, others}
    end
  end

  defp load_layers(store, infos) do
    Enum.reduce_while(infos, {:ok, %{}}, fn info, {:ok, layers} ->
      case Recording.load_layer(store, info) do
        {:ok, layer} -> {:cont, {:ok, Map.put(layers, info.name, layer)}}
        {:error, error} -> {:halt, {:error, error}}
      end
    end)
  end

  @doc """
  Returns the edits of a journal that are not yet in the version `base`, whose layer of the stream is `mine`. Edits
  that fit neither version are kept next to the journal under another name.
  """
  @spec unsaved_transactions(Path.t(), {Path.t() | nil, Layer.t() | nil}, String.t()) ::
          {:ok, [Layer.transaction()]} | {:error, Error.t()}
  def unsaved_transactions(journal, {base, mine}, stream) do
    case Journal.read_transactions(journal, {base, Journal.layer_digest(mine)}) do
      {:older, older, transactions} ->
        older = older && Path.join(Path.dirname(base), older)

        case already_saved?(older, transactions, base, stream) do
          true -> {remove_journal(journal), []}
          false -> rebase_journal(journal, transactions, {base, mine})
          :unknown -> {set_journal_aside(journal), []}
        end

      result ->
        result
    end
  end

  defp remove_journal(journal) do
    _ = File.rm(journal)
    :ok
  end

  defp set_journal_aside(journal) do
    _ = File.rename(journal, journal <> ".kept")
    :ok
  end

  # Returns whether a version after `older` contains the result of the transactions.
  defp already_saved?(older, transactions, base, stream) do
    with {:ok, %Layer{} = layer} <- load_start(older, base, stream),
         {:ok, layer} <- replay_transactions(layer, transactions) do
      digest = Journal.layer_digest(layer)

      Enum.any?(versions_after(older, base), fn version ->
        match?({:ok, mine, _} when mine != nil, load_version(version, stream)) and
          version_digest(version, stream) == digest
      end)
    else
      _ -> :unknown
    end
  end

  # Before the first version there was only the schema.
  defp load_start(nil, base, stream) do
    with {:ok, %Layer{schema: schema}, _} <- load_version(base, stream), do: Layer.new(schema)
  end

  defp load_start(older, _base, stream) do
    with {:ok, mine, _} <- load_version(older, stream), do: {:ok, mine}
  end

  defp version_digest(version, stream) do
    {:ok, mine, _} = load_version(version, stream)
    Journal.layer_digest(mine)
  end

  defp versions_after(older, base) do
    for path <- Store.list(Path.dirname(base)),
        Path.rootname(path) == Path.rootname(base) and path <= base,
        older == nil or path > older,
        do: path
  end

  defp replay_transactions(layer, transactions) do
    Enum.reduce_while(transactions, {:ok, layer}, fn transaction, {:ok, layer} ->
      case Layer.apply_transaction(layer, transaction) do
        {:ok, layer} -> {:cont, {:ok, layer}}
        error -> {:halt, error}
      end
    end)
  end

  defp rebase_journal(journal, transactions, {base, mine}) do
    with {:ok, _, transactions} <- Rebase.rebase_onto(mine, transactions),
         :ok <-
           Journal.replace_transactions(journal, {base, Journal.layer_digest(mine)}, transactions) do
      {:ok, transactions}
    else
      {:error, %Error{code: :not_saved} = error} -> {:error, error}
      {:error, _} -> {set_journal_aside(journal), []}
    end
  end

  @doc "Updates the state with the version that another program has saved; examines each version only once."
  @spec load_newest(map()) :: {:ok, map()} | {:error, Error.t()}
  def load_newest(%{seen: seen, base: base, path: path} = state) do
    newest = StoreVersion.newest_folder(path)
    if newest in [nil, seen, base], do: {:ok, state}, else: adopt_version(state, newest)
  end

  defp adopt_version(state, newest) do
    with {:ok, mine, others} <- load_version(newest, state.stream) do
      theirs = %{base: newest, seen: newest, others: others, digest: Journal.layer_digest(mine)}

      cond do
        mine == nil or theirs.digest == state.digest -> {:ok, %{state | seen: newest}}
        state.unsaved? -> rebase_edits(state, mine, theirs)
        true -> {:ok, Map.merge(state, Map.merge(theirs, %{layer: mine, undo: [], redo: []}))}
      end
    end
  end

  # The journal is replaced before the call returns, so that a crash in between loses no edit.
  defp rebase_edits(state, mine, %{base: newest, digest: digest} = theirs) do
    with {:ok, transactions} <-
           Journal.read_transactions(state.journal, {state.base, state.digest}),
         {:ok, layer, transactions} <- Rebase.rebase_onto(mine, transactions),
         :ok <- Journal.replace_transactions(state.journal, {newest, digest}, transactions) do
      edits = %{layer: layer, undo: Enum.reverse(transactions), redo: []}
      {:ok, Map.merge(state, Map.merge(theirs, edits))}
    else
      {:error, %Error{code: :not_saved} = error} -> {:error, error}
      _ -> {:ok, %{state | seen: newest, shadowed: newest}}
    end
  end

  @doc """
  Writes the state's layer as the next version. Other streams keep their last saved state, no matter which program
  saved it; versions that are saved in the meantime are included.
  """
  @spec write_version(map()) :: {:ok, map()} | {:error, Error.t()}
  def write_version(state, tries \\ @tries) do
    with {:ok, state} <- load_newest(state),
         newest = StoreVersion.newest_folder(state.path),
         {:ok, others} <- load_others(state, newest),
         layers = Map.put(others, state.stream, state.layer),
         {:ok, folder} <- Recording.write_after(layers, state.path, newest) do
      digest = Journal.layer_digest(state.layer)
      {:ok, %{state | base: folder, seen: folder, others: others, digest: digest}}
    else
      {:error, %Error{code: :newer_version}} when tries > 0 -> write_version(state, tries - 1)
      error -> error
    end
  end

  defp load_others(%{base: newest} = state, newest), do: {:ok, state.others}
  defp load_others(%{others: others}, nil), do: {:ok, others}

  defp load_others(state, newest) do
    with {:ok, _mine, others} <- load_version(newest, state.stream), do: {:ok, others}
  end
end
