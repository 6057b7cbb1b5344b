defmodule Situ.Annotation.LayerHistory do
  @moduledoc false
  # Undo, redo, named and restored versions of a layer. The caller holds the lock of the document and has caught up.
  alias Situ.Annotation.{LayerDocument, LayerOperation}
  alias Situ.EditLog.{Entry, Versions}
  alias Situ.Error

  @doc "Appends an operation unless it changes nothing."
  @spec append(LayerDocument.t(), String.t(), map(), keyword()) :: LayerDocument.result()
  def append(document, kind, operation, opts) do
    if LayerOperation.empty?(operation) and kind != "name",
      do: {:ok, document},
      else: LayerDocument.append(document, kind, operation, opts)
  end

  @doc "Returns the latest edits that this user can undo and redo, newest first."
  @spec undo_stacks(LayerDocument.t()) :: {[Entry.t()], [Entry.t()]}
  def undo_stacks(document),
    do: document.entries |> Enum.reverse() |> Versions.undo_stacks(Entry.new("edit", %{}))

  @doc "Undoes this user's last edit. Errors: `:nothing_to_undo`, `:stale_edit`."
  @spec undo(LayerDocument.t()) :: LayerDocument.result()
  def undo(document) do
    case undo_stacks(document) do
      {[entry | _], _} ->
        LayerDocument.append(document, "undo", LayerOperation.invert(entry.do), of: entry.n)

      {[], _} ->
        {:error, Error.new(:nothing_to_undo, "there is nothing to undo")}
    end
  end

  @doc "Redoes the edit that this user undid last. Errors: `:nothing_to_redo`, `:stale_edit`."
  @spec redo(LayerDocument.t()) :: LayerDocument.result()
  def redo(document) do
    case undo_stacks(document) do
      {_, [entry | _]} -> LayerDocument.append(document, "redo", entry.do, of: entry.n)
      {_, []} -> {:error, Error.new(:nothing_to_redo, "there is nothing to redo")}
    end
  end

  @doc "Restores the layer of an earlier version by a new operation."
  @spec restore(LayerDocument.t(), non_neg_integer(), keyword()) :: LayerDocument.result()
  def restore(document, version, opts) do
    with {:ok, layer} <- LayerDocument.layer_at(document, version) do
      operation = LayerOperation.diff_layers(document.layer, layer)
      append(document, "restore", operation, [{:of, version} | opts])
    end
  end

  @doc "Names a version."
  @spec name_version(LayerDocument.t(), String.t(), non_neg_integer()) :: LayerDocument.result()
  def name_version(document, name, version),
    do: append(document, "name", %{"annotations" => []}, of: version, note: name)
end
