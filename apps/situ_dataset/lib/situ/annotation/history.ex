defmodule Situ.Annotation.History do
  @moduledoc """
  Lists, compares, names and restores the versions of a layer of annotations.

      iex> alias Situ.Annotation.{Editor, History, Layer, Schema}
      iex> path = Path.join(System.tmp_dir!(), "situ-doc-annotation-history/annotation")
      iex> {:ok, editor} = Editor.start_link(path: path, stream: "Words", schema: Schema.text("Words"))
      iex> {:ok, _} = Editor.edit(editor, &Layer.add(&1, Situ.Annotation.new(0, 10, "P1")), by: "Ada")
      iex> {:ok, _} = Editor.edit(editor, &Layer.remove(&1, 1), by: "Ben")
      iex> {:ok, entries} = History.list({path, "Words"})
      iex> for e <- entries, do: {e.version, e.by, e.what}
      [{1, "Ada", "add annotation on P1 at 00:00:00.000"}, {2, "Ben", "delete annotation on P1 at 00:00:00.000"}]
      iex> History.diff({path, "Words"}, "1", "now")
      {:ok, ["delete annotation on P1 at 00:00:00.000"]}
      iex> {:ok, layer} = History.restore({path, "Words"}, "v1")
      iex> length(Layer.annotations(layer))
      1
      iex> File.rm_rf!(Path.dirname(path)) != []
      true

  A layer is `{store, stream}`, where `store` is the path of the store without a version, as for
  `Situ.Annotation.Editor`. A version is the state after the operation of that number. It is written as `12`, `v12`,
  `now`, or the name that `name_version/3` gave it; `0` is the state before the first operation in the log. While an
  editor of the layer runs in this program, use its functions, so that subscribers are notified at once.
  """
  alias Situ.Annotation.{Layer, LayerDocument, LayerHistory, LayerOperation}
  alias Situ.{EditLog, Error}
  alias Situ.EditLog.{Description, Versions}

  @type layer :: {Path.t(), String.t()}

  @typedoc """
  An operation: the version that it results in, its time (ISO 8601), the person, the user and the program, and the
  operation in plain words.
  """
  @type entry :: %{
          version: pos_integer(),
          kind: String.t(),
          at: String.t() | nil,
          by: String.t() | nil,
          program: String.t() | nil,
          host: String.t() | nil,
          what: String.t()
        }

  @doc "Returns the operations, oldest first. Errors: `:no_schema` if the layer does not exist, `:bad_log`."
  @spec list(layer()) :: {:ok, [entry()]} | {:error, Error.t()}
  def list({path, stream}) do
    with {:ok, document} <- LayerDocument.open(path, stream, nil),
         {:ok, _log, entries} <- EditLog.read_all(document.document),
         do:
           {:ok,
            Enum.map(
              entries,
              &Description.summarize_entry(&1, fn e -> LayerOperation.describe_entry(e) end)
            )}
  end

  @doc "Returns the layer of a version. Error: `:no_version`."
  @spec fetch_layer(layer(), String.t()) :: {:ok, Layer.t()} | {:error, Error.t()}
  def fetch_layer({path, stream}, version) do
    with {:ok, document} <- LayerDocument.open(path, stream, nil),
         {:ok, n} <- find_version(document, version),
         do: LayerHistory.layer_at(document, n)
  end

  defp find_version(document, version) do
    with {:ok, _log, entries} <- EditLog.read_all(document.document),
         do: Versions.find_version(entries, version)
  end

  @doc "Returns the differences between two versions in plain words. Error: `:no_version`."
  @spec diff(layer(), String.t(), String.t()) :: {:ok, [String.t()]} | {:error, Error.t()}
  def diff(layer, before, later) do
    with {:ok, before} <- fetch_layer(layer, before), {:ok, later} <- fetch_layer(layer, later) do
      operation = LayerOperation.diff_layers(before, later)
      {:ok, LayerOperation.describe_entry(EditLog.Entry.new("edit", operation))}
    end
  end

  @doc """
  Restores a version by a new operation, saves it, and returns the layer. Errors: `:no_version`, and the errors of
  `Situ.Annotation.Editor.edit/3` and `Situ.Annotation.Editor.save/1`.
  """
  @spec restore(layer(), String.t()) :: {:ok, Layer.t()} | {:error, Error.t()}
  def restore(layer, version) do
    change_layer(layer, fn document ->
      with {:ok, n} <- find_version(document, version), do: LayerHistory.restore(document, n, [])
    end)
  end

  @doc "Undoes this user's last edit, saves, and returns the layer. Errors: `:nothing_to_undo`, `:stale_edit`."
  @spec undo(layer()) :: {:ok, Layer.t()} | {:error, Error.t()}
  def undo(layer), do: change_layer(layer, &LayerHistory.undo/1)

  @doc "Redoes the edit that this user undid last. Errors: `:nothing_to_redo`, `:stale_edit`."
  @spec redo(layer()) :: {:ok, Layer.t()} | {:error, Error.t()}
  def redo(layer), do: change_layer(layer, &LayerHistory.redo/1)

  @doc "Gives a version (default: the current one) a name. Error: `:no_version`."
  @spec name_version(layer(), String.t(), String.t()) :: :ok | {:error, Error.t()}
  def name_version(layer, name, version \\ "now") do
    named =
      change_layer(layer, fn document ->
        with {:ok, n} <- find_version(document, version),
             do: LayerHistory.name_version(document, name, n)
      end)

    with {:ok, _} <- named, do: :ok
  end

  defp change_layer({path, stream}, fun) do
    with {:ok, document} <- LayerDocument.open(path, stream, nil) do
      EditLog.with_lock(document.document, fn ->
        with {:ok, document} <- LayerDocument.catch_up(document),
             {:ok, document} <- fun.(document),
             {:ok, document} <- LayerDocument.write_version(document),
             do: {:ok, document.layer}
      end)
    end
  end
end
