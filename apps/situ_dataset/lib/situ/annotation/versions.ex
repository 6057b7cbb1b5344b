defmodule Situ.Annotation.Versions do
  @moduledoc false
  # Reads, adopts and writes the versions of a store that an editor and other programs save. The state is the editor's
  # state: `base` is the version that its edits apply to, and `seen` is the newest version that was examined.
  alias Situ.Annotation.{Journal, Layer, Rebase, Recording}
  alias Situ.Dataset.Version
  alias Situ.{Error, Store}

  # The number of attempts to write a version while other programs save at the same time.
  @tries 100

  @doc "Returns the stream of a version (or `nil`), and its other streams, which are copied to the next version."
  @spec stored(Path.t() | nil, String.t()) ::
          {:ok, Layer.t() | nil, %{String.t() => Layer.t()}} | {:error, Error.t()}
  def stored(nil, _stream), do: {:ok, nil, %{}}

  def stored(folder, stream) do
    with {:ok, store} <- Store.open(folder),
         {:ok, layers} <- layers(store, Store.streams(store)) do
      {mine, others} = Map.pop(layers, stream)
      {:ok, mine, others}
    end
  end

  defp layers(store, infos) do
    Enum.reduce_while(infos, {:ok, %{}}, fn info, {:ok, layers} ->
      case Recording.load(store, info) do
        {:ok, layer} -> {:cont, {:ok, Map.put(layers, info.name, layer)}}
        {:error, error} -> {:halt, {:error, error}}
      end
    end)
  end

  @doc """
  Returns the edits of a journal that are not yet in the version `base`, whose layer of the stream is `mine`. Edits
  that fit neither version are kept next to the journal under another name.
  """
  @spec unsaved(Path.t(), {Path.t() | nil, Layer.t() | nil}, String.t()) ::
          {:ok, [Layer.transaction()]} | {:error, Error.t()}
  def unsaved(journal, {base, mine}, stream) do
    case Journal.read(journal, {base, Journal.digest(mine)}) do
      {:older, older, transactions} ->
        older = older && Path.join(Path.dirname(base), older)

        case saved?(older, transactions, base, stream) do
          true -> {done(journal), []}
          false -> again(journal, transactions, {base, mine})
          :unknown -> {aside(journal), []}
        end

      result ->
        result
    end
  end

  defp done(journal) do
    _ = File.rm(journal)
    :ok
  end

  defp aside(journal) do
    _ = File.rename(journal, journal <> ".kept")
    :ok
  end

  # Returns whether a version after `older` contains the result of the transactions.
  defp saved?(older, transactions, base, stream) do
    with {:ok, %Layer{} = layer} <- begun(older, base, stream),
         {:ok, layer} <- replayed(layer, transactions) do
      digest = Journal.digest(layer)

      Enum.any?(after_it(older, base), fn version ->
        match?({:ok, mine, _} when mine != nil, stored(version, stream)) and
          digest(version, stream) == digest
      end)
    else
      _ -> :unknown
    end
  end

  # Before the first version there was only the schema.
  defp begun(nil, base, stream) do
    with {:ok, %Layer{schema: schema}, _} <- stored(base, stream), do: Layer.new(schema)
  end

  defp begun(older, _base, stream) do
    with {:ok, mine, _} <- stored(older, stream), do: {:ok, mine}
  end

  defp digest(version, stream) do
    {:ok, mine, _} = stored(version, stream)
    Journal.digest(mine)
  end

  defp after_it(older, base) do
    for path <- Store.list(Path.dirname(base)),
        Path.rootname(path) == Path.rootname(base) and path <= base,
        older == nil or path > older,
        do: path
  end

  defp replayed(layer, transactions) do
    Enum.reduce_while(transactions, {:ok, layer}, fn transaction, {:ok, layer} ->
      case Layer.apply(layer, transaction) do
        {:ok, layer} -> {:cont, {:ok, layer}}
        error -> {:halt, error}
      end
    end)
  end

  defp again(journal, transactions, {base, mine}) do
    with {:ok, _, transactions} <- Rebase.onto(mine, transactions),
         :ok <- Journal.rewrite(journal, {base, Journal.digest(mine)}, transactions) do
      {:ok, transactions}
    else
      {:error, %Error{code: :not_saved} = error} -> {:error, error}
      {:error, _} -> {aside(journal), []}
    end
  end

  @doc "Updates the state with the version that another program has saved; examines each version only once."
  @spec current(map()) :: {:ok, map()} | {:error, Error.t()}
  def current(%{seen: seen, base: base, path: path} = state) do
    newest = Version.newest(path)
    if newest in [nil, seen, base], do: {:ok, state}, else: taken(state, newest)
  end

  defp taken(state, newest) do
    with {:ok, mine, others} <- stored(newest, state.stream) do
      theirs = %{base: newest, seen: newest, others: others, digest: Journal.digest(mine)}

      cond do
        mine == nil or theirs.digest == state.digest -> {:ok, %{state | seen: newest}}
        state.unsaved? -> rebased(state, mine, theirs)
        true -> {:ok, Map.merge(state, Map.merge(theirs, %{layer: mine, undo: [], redo: []}))}
      end
    end
  end

  # The journal is replaced before the call returns, so that a crash in between loses no edit.
  defp rebased(state, mine, %{base: newest, digest: digest} = theirs) do
    with {:ok, transactions} <- Journal.read(state.journal, {state.base, state.digest}),
         {:ok, layer, transactions} <- Rebase.onto(mine, transactions),
         :ok <- Journal.rewrite(state.journal, {newest, digest}, transactions) do
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
  @spec write(map()) :: {:ok, map()} | {:error, Error.t()}
  def write(state, tries \\ @tries) do
    with {:ok, state} <- current(state),
         newest = Version.newest(state.path),
         {:ok, others} <- others(state, newest),
         layers = Map.put(others, state.stream, state.layer),
         {:ok, folder} <- Recording.write_after(layers, state.path, newest) do
      digest = Journal.digest(state.layer)
      {:ok, %{state | base: folder, seen: folder, others: others, digest: digest}}
    else
      {:error, %Error{code: :newer_version}} when tries > 0 -> write(state, tries - 1)
      error -> error
    end
  end

  defp others(%{base: newest} = state, newest), do: {:ok, state.others}
  defp others(%{others: others}, nil), do: {:ok, others}

  defp others(state, newest) do
    with {:ok, _mine, others} <- stored(newest, state.stream), do: {:ok, others}
  end
end
