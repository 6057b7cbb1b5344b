defmodule Situ.EditLog.Merging do
  @moduledoc false
  # Saves states of a document that a program has changed while others edited it, too.
  alias Situ.EditLog.{Changes, Description, Document}
  alias Situ.Error

  @doc """
  Applies changes that were made to an earlier state, to the current one. Error: `:conflict` if
  another program has changed the same places differently. Options: see
  `Situ.EditLog.Document.edit/3`.
  """
  @spec merge(Document.t(), [Changes.change()], keyword()) :: Document.result()
  def merge(document, changes, opts \\ []),
    do: Document.edit(document, &merge_content(document, &1, changes), opts)

  @doc "Applies changes to a content; the error `:conflict` names the first change that does not fit."
  @spec merge_content(Document.t(), Document.content(), [Changes.change()]) ::
          {:ok, Document.content()} | {:error, Error.t()}
  def merge_content(document, content, changes) do
    with {:conflict, change} <- Document.apply_changes(%{document | content: content}, changes) do
      {:error,
       Error.new(:conflict, "cannot merge the edit: #{Description.describe_change(change)}",
         why: "another program has changed the same place differently in the meantime",
         fix: "look at the current state, and repeat the edit if it is still wanted",
         meta: %{change: change}
       )}
    end
  end

  @doc """
  Saves a document that was read as `base` and is now `later`, and merges it with the edits of others. Without a base,
  or if the file is missing, `later` replaces the document. Errors: see `merge/3`.
  """
  @spec save(Path.t(), module(), {Document.content() | nil, Document.content()}) ::
          Document.result()
  def save(path, format, {nil, later}), do: Document.put(path, format, later)

  def save(path, format, {base, later}) do
    case Document.open(path, format) do
      {:ok, document} ->
        merge(document, format.diff(base, later, document.path), [])

      {:error, %{code: code}} when code in [:not_found, :bad_document] ->
        Document.put(path, format, later)

      error ->
        error
    end
  end
end
