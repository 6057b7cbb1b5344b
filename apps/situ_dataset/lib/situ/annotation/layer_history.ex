defmodule Situ.Annotation.LayerHistory do
  @moduledoc false
  # Creates layers, and undoes, names and restores their versions. Except for `create_layer/3`, the caller holds the
  # lock of the document and has caught up.
  alias Situ.Annotation.{Layer, LayerDocument, LayerOperation, Schema}
  alias Situ.{EditLog, Error}
  alias Situ.EditLog.{Entry, Versions}

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
        append_current(document, "undo", {LayerOperation.invert(entry.do), entry})

      {[], _} ->
        {:error, Error.new(:nothing_to_undo, "there is nothing to undo")}
    end
  end

  @doc "Redoes the edit that this user undid last. Errors: `:nothing_to_redo`, `:stale_edit`."
  @spec redo(LayerDocument.t()) :: LayerDocument.result()
  def redo(document) do
    case undo_stacks(document) do
      {_, [entry | _]} -> append_current(document, "redo", {entry.do, entry})
      {_, []} -> {:error, Error.new(:nothing_to_redo, "there is nothing to redo")}
    end
  end

  # A schema is replaced as a whole, so a later change by someone else would be lost.
  defp append_current(document, kind, {operation, entry}) do
    case operation["schema"] do
      [expected, _] ->
        if Schema.parse(expected) == {:ok, document.layer.schema},
          do: LayerDocument.append(document, kind, operation, of: entry.n),
          else: {:error, schema_error()}

      _ ->
        LayerDocument.append(document, kind, operation, of: entry.n)
    end
  end

  defp schema_error do
    Error.new(:stale_edit, "the schema was changed by someone else",
      why: "undoing or redoing an earlier change of it would lose theirs",
      fix: "restore a version from the history, or change the schema again"
    )
  end

  @doc "Restores the layer of an earlier version by a new operation."
  @spec restore(LayerDocument.t(), non_neg_integer(), keyword()) :: LayerDocument.result()
  def restore(document, version, opts) do
    with {:ok, layer} <- layer_at(document, version) do
      operation = LayerOperation.diff_layers(document.layer, layer)
      append(document, "restore", operation, [{:of, version} | opts])
    end
  end

  @doc "Names a version."
  @spec name_version(LayerDocument.t(), String.t(), non_neg_integer()) :: LayerDocument.result()
  def name_version(document, name, version),
    do: append(document, "name", %{"annotations" => []}, of: version, note: name)

  @doc """
  Returns the layer after the operation `version`. Version 0 is the layer before the first operation in the log. Error:
  `:bad_log`.
  """
  @spec layer_at(LayerDocument.t(), non_neg_integer()) :: {:ok, Layer.t()} | {:error, Error.t()}
  def layer_at(document, version) do
    with {:ok, log, entries} <- EditLog.read_all(document.document) do
      entries
      |> Enum.drop(version)
      |> Enum.reverse()
      |> Enum.reduce_while({:ok, document.layer}, &revert_entry(&1, &2, log))
    end
  end

  defp revert_entry(entry, {:ok, layer}, log) do
    inverse = %{entry | kind: "edit", do: LayerOperation.invert(entry.do)}

    case LayerOperation.apply_entry(layer, inverse) do
      {:ok, layer} -> {:cont, {:ok, layer}}
      _ -> {:halt, {:error, EditLog.damaged_error(log, 0)}}
    end
  end

  @doc """
  Creates a layer with these annotations in the store `path` and writes the first version. Error: `:layer_exists`, also
  if the layer has edits that were never saved.
  """
  @spec create_layer(Path.t(), String.t(), Layer.t()) :: :ok | {:error, Error.t()}
  def create_layer(path, stream, %Layer{} = layer) do
    path = Path.expand(path)

    EditLog.with_lock(LayerDocument.document_path(path, stream), fn ->
      with {:ok, document} <- LayerDocument.open_locked(path, stream, layer.schema),
           :ok <- check_new(document),
           operation =
             LayerOperation.diff_layers(%{document.layer | schema: layer.schema}, layer),
           {:ok, document} <- append(document, "edit", operation, note: "create the layer"),
           {:ok, _} <- LayerDocument.write_version(document),
           do: :ok
    end)
  end

  defp check_new(%{base: nil, log: %{n: 0}}), do: :ok

  defp check_new(document) do
    {:error,
     Error.new(:layer_exists, "there already is a layer named #{inspect(document.stream)}",
       fix: "choose another name, or open that layer"
     )}
  end
end
