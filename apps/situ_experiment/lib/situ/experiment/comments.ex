defmodule Situ.Experiment.Comments do
  @moduledoc false
  # The comments on the sets of a run: who, when, and the text. The file `comments.json` in the
  # experiment's folder has a log of edits, as every other document that people change.
  # See docs/adr/0180-the-studio-shows-the-files-of-experiments.md.
  alias Situ.EditLog.{Document, JsonFormat}
  alias Situ.Error
  alias Situ.Experiment.ResultsFile
  alias Situ.Store.FileLock

  @longest 10_000

  @type comment :: %{set: pos_integer(), by: String.t(), at: String.t(), text: String.t()}

  @doc "Returns the comments on a run, oldest first."
  @spec list_comments(Path.t(), String.t()) :: [comment()]
  def list_comments(folder, run) do
    case ResultsFile.read_json(file_path(folder)) do
      {:ok, %{"comments" => %{} = comments}} ->
        for(
          {_id, %{"run" => ^run, "set" => set, "by" => by, "at" => at, "text" => text}} <-
            comments,
          do: %{set: set, by: by, at: at, text: text}
        )
        |> Enum.sort_by(& &1.at)

      _ ->
        []
    end
  end

  @doc "Returns the path of the file in the experiment's folder."
  @spec file_path(Path.t()) :: Path.t()
  def file_path(folder), do: Path.join(folder, "comments.json")

  @doc """
  Adds a comment on a set. Without a name, `by` is the user of the computer. Errors: `:bad_comment`, and the errors of
  writing the file.
  """
  @spec add_comment(
          Path.t(),
          {run :: String.t(), set :: pos_integer()},
          String.t(),
          String.t() | nil
        ) ::
          :ok | {:error, Error.t()}
  def add_comment(folder, {run, set}, text, by \\ nil) do
    author = FileLock.describe_self()
    by = if by in [nil, ""], do: author.user, else: by
    text = String.trim(text)
    now = Situ.Time.to_iso8601(Situ.Time.now())
    comment = %{"run" => run, "set" => set, "by" => by, "at" => now, "text" => text}

    with :ok <- check_text(text),
         {:ok, document} <- open_document(file_path(folder)),
         {:ok, _} <- Document.edit(document, &put_comment(&1, comment), by: by),
         do: :ok
  end

  defp check_text(text) do
    if text != "" and String.valid?(text) and byte_size(text) <= @longest do
      :ok
    else
      {:error,
       Error.new(:bad_comment, "a comment needs a text of at most #{@longest} bytes",
         fix: "write what you found out about this set"
       )}
    end
  end

  defp open_document(path) do
    case Document.open(path, JsonFormat) do
      {:error, %{code: :not_found}} -> Document.put(path, JsonFormat, %{"comments" => %{}})
      result -> result
    end
  end

  # Every comment has its own key, so comments of two programs never conflict.
  defp put_comment(content, comment) do
    id = 6 |> :crypto.strong_rand_bytes() |> Base.encode16(case: :lower)
    {:ok, Map.update(content, "comments", %{id => comment}, &Map.put(&1, id, comment))}
  end
end
