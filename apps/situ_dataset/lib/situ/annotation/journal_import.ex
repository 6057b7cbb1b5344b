defmodule Situ.Annotation.JournalImport do
  @moduledoc false
  # Reads the journal in which earlier releases kept the edits since the last save: one line of JSON for each
  # transaction. The first line names the version that they apply to and contains a digest of the stream in it. A last
  # line that a crash truncated was never acknowledged; any other broken line is damage. The edits become operations of
  # the layer's log, and the journal is removed.
  alias Situ.{Annotation, Error}
  alias Situ.Annotation.{Layer, LayerOperation, Rebase, Schema, StoreVersions}
  alias Situ.Store.FileLock

  @typedoc """
  The newest version (the store's folder; `nil` before the first version), the digest of the stream in it (`nil` if it
  is not stored), and the layer.
  """
  @type base :: {Path.t() | nil, String.t() | nil, Layer.t()}

  @doc "Returns the path of the journal of a stream."
  @spec journal_path(Path.t(), String.t()) :: Path.t()
  def journal_path(store, stream),
    do: "#{store}.#{String.replace(stream, ~r/[^\w.-]/u, "_")}.journal"

  @doc """
  Returns the edits of the journal that are not yet in `base`, oldest first. Edits that fit neither version are kept
  next to the journal under another name. Returns no edits while a program of an earlier release holds the journal,
  because that program saves them. Error: `:bad_journal`.
  """
  @spec read(Path.t(), String.t(), base()) :: {:ok, [Layer.transaction()]} | {:error, Error.t()}
  def read(store, stream, base) do
    path = journal_path(store, stream)

    with true <- File.exists?(path), {:ok, lock} <- FileLock.acquire(path <> ".lock") do
      result = read_transactions(path, base, {store, stream})
      :ok = FileLock.release(lock)
      result
    else
      _ -> {:ok, []}
    end
  end

  @doc "Returns the digest of the journal's content."
  @spec journal_id(Path.t(), String.t()) :: String.t()
  def journal_id(store, stream) do
    case File.read(journal_path(store, stream)) do
      {:ok, text} -> :sha256 |> :crypto.hash(text) |> Base.encode16() |> String.slice(0, 16)
      {:error, _} -> ""
    end
  end

  @doc "Removes the journal."
  @spec remove(Path.t(), String.t()) :: :ok
  def remove(store, stream) do
    _ = File.rm(journal_path(store, stream))
    :ok
  end

  defp read_transactions(path, {folder, digest, layer}, {store, stream}) do
    with {:ok, text} <- File.read(path),
         lines = text |> String.split("\n") |> Enum.drop(-1),
         {:ok, head, transactions} <- parse_lines(lines, path) do
      case compare_head(head, folder, digest) do
        :same ->
          {:ok, transactions}

        :newer ->
          {:error,
           mismatch_error(Error.new(:other_version, "the edits were made on another version"))}

        :older ->
          rebase_older(path, {head["base"], transactions}, {layer, store, stream})
      end
    else
      :empty -> {remove_file(path), []}
      {:error, reason} when is_atom(reason) -> {:error, unreadable_error(path, reason)}
      error -> error
    end
  end

  defp remove_file(path) do
    _ = File.rm(path)
    :ok
  end

  defp compare_head(%{"base" => base} = head, folder, digest) do
    current = folder && Path.basename(folder)

    cond do
      base == current -> :same
      base != nil and (current == nil or base > current) -> :newer
      Map.has_key?(head, "stream") and head["stream"] == digest -> :same
      true -> :older
    end
  end

  # The edits apply to an earlier version. Either they were saved and the journal was not removed yet, or another
  # program has saved the stream.
  defp rebase_older(path, {older, transactions}, {layer, store, stream}) do
    case already_saved?(older, transactions, {layer, store, stream}) do
      true -> {remove_file(path), []}
      false -> rebase_onto(path, layer, transactions)
      :unknown -> {set_aside(path), []}
    end
  end

  defp rebase_onto(path, layer, transactions) do
    case Rebase.rebase_onto(layer, transactions) do
      {:ok, _, transactions} -> {:ok, transactions}
      {:error, _} -> {set_aside(path), []}
    end
  end

  defp set_aside(path) do
    _ = File.rename(path, path <> ".kept")
    :ok
  end

  # Returns whether a version after `older` contains the result of the transactions.
  defp already_saved?(older, transactions, {layer, store, stream}) do
    with {:ok, start} <- load_start(older, layer, {store, stream}),
         {:ok, result} <- apply_all(start, transactions) do
      digest = layer_digest(result)

      Enum.any?(StoreVersions.list_folders(store), fn version ->
        (older == nil or Path.basename(version) > older) and
          match?({:ok, _}, StoreVersions.load_layer(version, stream)) and
          version |> StoreVersions.load_layer(stream) |> elem(1) |> layer_digest() == digest
      end)
    else
      _ -> :unknown
    end
  end

  # Before the first version there was only the schema.
  defp load_start(nil, layer, _stream), do: Layer.new(layer.schema)

  defp load_start(older, _layer, {store, stream}),
    do: store |> Path.dirname() |> Path.join(older) |> StoreVersions.load_layer(stream)

  defp apply_all(layer, transactions) do
    Enum.reduce_while(transactions, {:ok, layer}, fn transaction, {:ok, layer} ->
      case Layer.apply_transaction(layer, transaction) do
        {:ok, layer} -> {:cont, {:ok, layer}}
        error -> {:halt, error}
      end
    end)
  end

  @doc "Returns the digest by which journals identify the annotations that they apply to."
  @spec layer_digest(Layer.t()) :: String.t()
  def layer_digest(%Layer{} = layer) do
    stored =
      {Schema.to_json(layer.schema), Enum.map(Layer.annotations(layer), &Annotation.to_json/1)}

    :sha256 |> :crypto.hash(:erlang.term_to_binary(stored, [:deterministic])) |> Base.encode16()
  end

  defp parse_lines([], _path), do: :empty

  defp parse_lines([first | lines], path) do
    with {:ok, %{"base" => base} = head} when is_binary(base) or is_nil(base) <-
           Situ.JSON.decode(first),
         {:ok, transactions} <- parse_transactions(lines, path) do
      {:ok, head, transactions}
    else
      {:error, %Error{}} = error -> error
      _ -> {:error, damaged_error(path, 1)}
    end
  end

  defp parse_transactions(lines, path) do
    lines
    |> Enum.with_index(2)
    |> Error.map_ok(fn {line, n} ->
      with {:ok, list} when is_list(list) <- Situ.JSON.decode(line),
           {:ok, transaction} <- LayerOperation.parse_transaction(%{"annotations" => list}) do
        {:ok, transaction}
      else
        _ -> {:error, damaged_error(path, n)}
      end
    end)
  end

  defp unreadable_error(path, reason) do
    Error.new(:bad_journal, "cannot read the journal of unsaved edits #{path}",
      why: to_string(:file.format_error(reason)),
      fix: "check the permissions of the file"
    )
  end

  defp damaged_error(path, line) do
    Error.new(:bad_journal, "the journal of unsaved edits #{path} is damaged",
      why: "line #{line} is not a transaction",
      fix:
        "move the file away to edit without these edits; the lines before line #{line} are intact"
    )
  end

  @doc "Returns the error for a journal that does not fit its recording."
  @spec mismatch_error(Error.t()) :: Error.t()
  def mismatch_error(error) do
    Error.new(:bad_journal, "the journal of unsaved edits does not fit the recording",
      why: error.what,
      fix:
        "move the journal away, or restore the version of the recording that the edits were made on"
    )
  end
end
