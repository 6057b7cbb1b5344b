defmodule Situ.Dataset.History do
  @moduledoc """
  Lists, compares, names and restores the versions of a dataset.

      iex> alias Situ.Dataset
      iex> alias Situ.Dataset.History
      iex> file = Path.join(System.tmp_dir!(), "situ-doc-history/study.json")
      iex> {:ok, dataset} = Dataset.new("Study", file: file, autosave: true)
      iex> {:ok, dataset} = Dataset.add_session(dataset, "p01")
      iex> {:ok, dataset} = Dataset.put_fields(dataset, tags: ["pilot"])
      iex> {:ok, entries} = History.list(dataset)
      iex> for e <- entries, do: {e.version, e.what}
      [{1, "add session p01"}, {2, "add tag pilot"}]
      iex> {:ok, dataset} = History.name_version(dataset, "before cleaning")
      iex> {:ok, dataset} = Dataset.remove_session(dataset, "p01")
      iex> History.diff(dataset, "before cleaning", "now")
      {:ok, ["remove session p01"]}
      iex> {:ok, dataset} = History.restore(dataset, "before cleaning")
      iex> {:ok, dataset} = History.undo(dataset)
      iex> dataset.sessions
      []
      iex> File.rm_rf!(Path.dirname(file)) != []
      true

  A version is the state after the operation of that number. It is written as `12`, `v12`, `now`, or the name that
  `name_version/3` gave it; `0` is the state before the first operation in the log. Restoring and undoing are new
  operations, so nothing is ever removed from the history. The dataset must have a file.
  """
  alias Situ.{Dataset, Error}
  alias Situ.Dataset.DatasetDocument
  alias Situ.EditLog.{Changes, Description, Document, DocumentHistory}

  @typedoc "An operation, see `t:Situ.Annotation.History.entry/0`."
  @type entry :: Situ.Annotation.History.entry()

  @doc "Returns the operations, oldest first. Errors: `:no_file`, `:bad_log`."
  @spec list(Dataset.t()) :: {:ok, [entry()]} | {:error, Error.t()}
  def list(dataset) do
    with {:ok, document} <- fetch_document(dataset),
         {:ok, entries} <- DocumentHistory.list_entries(document),
         do: {:ok, Enum.map(entries, &Description.summarize_entry/1)}
  end

  defp fetch_document(%Dataset{document: %Document{} = document}), do: {:ok, document}

  defp fetch_document(_dataset) do
    {:error,
     Error.new(:no_file, "the dataset has no history",
       why: "it was not read from a dataset file",
       fix: "save it with `save_as/2`"
     )}
  end

  @doc "Returns the dataset of a version as a value without a file. Errors: `:no_file`, `:no_version`."
  @spec fetch_version(Dataset.t(), String.t()) :: Dataset.result()
  def fetch_version(dataset, version) do
    with {:ok, document} <- fetch_document(dataset),
         {:ok, content} <- DocumentHistory.fetch_content(document, version),
         do: {:ok, struct!(%Dataset{unsaved?: true}, content)}
  end

  @doc "Returns the differences between two versions in plain words. Errors: `:no_file`, `:no_version`."
  @spec diff(Dataset.t(), String.t(), String.t()) :: {:ok, [String.t()]} | {:error, Error.t()}
  def diff(dataset, before, later) do
    with {:ok, document} <- fetch_document(dataset),
         {:ok, before} <- DocumentHistory.fetch_content(document, before),
         {:ok, later} <- DocumentHistory.fetch_content(document, later) do
      [before, later] =
        for one <- [before, later], do: DatasetDocument.to_json(one, document.path)

      {:ok, before |> Changes.diff(later) |> Enum.map(&Description.describe_change/1)}
    end
  end

  @doc "Restores a version by a new operation. Errors: `:no_version`, and the errors of `Situ.Dataset.update/3`."
  @spec restore(Dataset.t(), String.t()) :: Dataset.result()
  def restore(dataset, version),
    do: change_dataset(dataset, &DocumentHistory.restore(&1, version, write: true))

  @doc """
  Undoes this user's last edit, also of an earlier program. Errors: `:nothing_to_undo`, `:dataset_changed` if somebody
  has changed the same field since, and the errors of `Situ.Dataset.update/3`.
  """
  @spec undo(Dataset.t()) :: Dataset.result()
  def undo(dataset), do: change_dataset(dataset, &DocumentHistory.undo(&1, write: true))

  @doc "Redoes the edit that this user undid last. Errors: `:nothing_to_redo`, and the errors of `undo/1`."
  @spec redo(Dataset.t()) :: Dataset.result()
  def redo(dataset), do: change_dataset(dataset, &DocumentHistory.redo(&1, write: true))

  @doc "Gives a version (default: the current one) a name. Error: `:no_version`."
  @spec name_version(Dataset.t(), String.t(), String.t()) :: Dataset.result()
  def name_version(dataset, name, version \\ "now"),
    do: change_dataset(dataset, &DocumentHistory.name_version(&1, name, version))

  defp change_dataset(dataset, fun) do
    with {:ok, document} <- fetch_document(dataset),
         do: document |> fun.() |> Dataset.take_document(dataset)
  end
end
