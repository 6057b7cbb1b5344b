defmodule Situ.EditLog.DocumentHistory do
  @moduledoc false
  # Undo, redo, named and restored versions of a JSON document.
  alias Situ.{EditLog, Error}
  alias Situ.EditLog.{Changes, Document, Entry, Merging, Replay, Versions}

  @doc "Returns the number of a version. Error: `:no_version`."
  @spec find_version(Document.t(), String.t()) :: {:ok, non_neg_integer()} | {:error, Error.t()}
  def find_version(document, version) do
    with {:ok, entries} <- list_entries(document), do: Versions.find_version(entries, version)
  end

  @doc "Returns the entries of the log, oldest first."
  @spec list_entries(Document.t()) :: {:ok, [Entry.t()]} | {:error, Error.t()}
  def list_entries(document) do
    with {:ok, _log, entries} <- EditLog.read_all(document.path), do: {:ok, entries}
  end

  @doc "Returns the content of a version. Error: `:no_version`."
  @spec fetch_content(Document.t(), String.t()) :: {:ok, Document.content()} | {:error, Error.t()}
  def fetch_content(document, version) do
    with {:ok, n} <- find_version(document, version), do: Document.content_at(document, n)
  end

  @doc "Restores a version by a new operation."
  @spec restore(Document.t(), String.t(), keyword()) :: Document.result()
  def restore(document, version, opts) do
    edit = fn _content ->
      with {:ok, n} <- find_version(document, version),
           {:ok, content} <- Document.content_at(document, n),
           do: {:ok, content, of: n}
    end

    Document.edit(document, edit, [{:kind, "restore"} | opts])
  end

  @doc "Undoes this user's last edit. Errors: `:nothing_to_undo`, `:conflict`."
  @spec undo(Document.t(), keyword()) :: Document.result()
  def undo(document, opts) do
    repeat(document, "undo", opts, fn {undo, _} -> {undo, &Changes.invert/1} end)
  end

  @doc "Redoes the edit that this user undid last. Errors: `:nothing_to_redo`, `:conflict`."
  @spec redo(Document.t(), keyword()) :: Document.result()
  def redo(document, opts), do: repeat(document, "redo", opts, fn {_, redo} -> {redo, & &1} end)

  defp repeat(document, kind, opts, choose) do
    edit = fn content ->
      with {:ok, entries} <- list_entries(document) do
        entries
        |> Versions.undo_stacks(Entry.new("edit", %{}))
        |> choose.()
        |> repeat_entry(document, content, kind)
      end
    end

    Document.edit(document, edit, [{:kind, kind} | opts])
  end

  defp repeat_entry({[], _}, _document, _content, "undo"),
    do: {:error, Error.new(:nothing_to_undo, "you have no edit to undo")}

  defp repeat_entry({[], _}, _document, _content, "redo"),
    do: {:error, Error.new(:nothing_to_redo, "you have no edit to redo")}

  defp repeat_entry({[entry | _], convert}, document, content, _kind) do
    changes = [entry] |> Replay.list_changes() |> convert.()

    with {:ok, content} <- Merging.merge_content(document, content, changes),
         do: {:ok, content, of: entry.n}
  end

  @doc "Names a version."
  @spec name_version(Document.t(), String.t(), String.t()) :: Document.result()
  def name_version(document, name, version) do
    edit = fn content ->
      with {:ok, n} <- find_version(document, version), do: {:ok, content, of: n, note: name}
    end

    Document.edit(document, edit, kind: "name")
  end
end
