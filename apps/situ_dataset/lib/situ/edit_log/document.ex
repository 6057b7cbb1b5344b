defmodule Situ.EditLog.Document do
  @moduledoc false
  # A JSON file that people can read, and the log of its edits. An edit appends an operation to the log and is then
  # acknowledged. The file is written after every edit while it is small; a large file is written when the operations
  # since then take an eighth of its size, so an edit costs no more than its own size on average.
  #
  # The file names the version that it contains (`"edits": {"log", "version", "offset", "digest"}`). If its digest does
  # not fit, somebody has edited the file itself. The difference from that version then becomes an operation, too.
  # See docs/adr/0175-documents-are-files-with-a-log.md.
  alias Situ.{EditLog, Error}
  alias Situ.EditLog.{Changes, DocumentFile, Entry, Mark, Replay}

  @small 65_536

  @typedoc "The state of a document: a struct, or any term that the format understands."
  @type content :: term()

  @doc "Parses the text of a file. `mark` are the fields of `edits`. The error is the reason in words."
  @callback parse(text :: binary(), Path.t()) ::
              {:ok, content(), mark :: map() | nil} | {:error, String.t()}
  @doc "Encodes the text of a file, with the text of the member `edits`."
  @callback encode(content(), Path.t(), mark :: String.t() | nil) :: binary()
  @doc "Converts the content to JSON, which contains all of it."
  @callback to_json(content(), Path.t()) :: map()
  @doc "Converts JSON that `to_json/2` returned."
  @callback from_json(map(), Path.t()) :: {:ok, content()} | :error
  @doc "Returns the changes between two contents."
  @callback diff(content(), content(), Path.t()) :: [Changes.change()]
  @doc "Applies a change."
  @callback apply_change(content(), Changes.change(), Path.t()) :: {:ok, content()} | :conflict

  @enforce_keys [:path, :format]
  defstruct [
    :path,
    :format,
    :content,
    :log,
    :stat,
    :checked,
    :digest,
    size: 0,
    written: 0,
    file: 0
  ]

  @typedoc """
  `stat` and `digest` describe the file, `checked` is the time in s when its digest was last compared, `size` is its
  size, `written` is the offset in the log up to which the file contains it, and `file` is the version of the file.
  """
  @type t :: %__MODULE__{
          path: Path.t(),
          format: module(),
          content: content(),
          log: EditLog.t() | nil,
          stat: tuple() | nil,
          checked: integer() | nil,
          digest: String.t() | nil,
          size: non_neg_integer(),
          written: non_neg_integer(),
          file: non_neg_integer()
        }
  @type result :: {:ok, t()} | {:error, Error.t()}
  @type edited :: {:ok, content()} | {:ok, content(), keyword()} | {:error, Error.t()}

  @doc "Returns the number of the last operation that the document contains."
  @spec version(t()) :: non_neg_integer()
  def version(document), do: document.log.n

  @doc """
  Opens a document. Errors: `:not_found`, `:bad_document` with the reason in words, `:bad_log`.
  """
  @spec open(Path.t(), module()) :: result()
  def open(path, format) do
    open_known(%__MODULE__{path: Path.expand(path), format: format})
  end

  # `file` is the version that the file is known to have contained.
  defp open_known(%{path: path, format: format, file: file}) do
    with {:ok, document, mark} <-
           read_document(%__MODULE__{path: path, format: format, file: file}),
         {:ok, log} <- EditLog.open(path),
         do: join_log(%{document | log: log}, mark)
  end

  defp read_document(document) do
    with {:ok, file, mark} <- DocumentFile.read(document.path, document.format),
         do: {:ok, struct!(document, file), mark}
  end

  # A file without a log (of an earlier release) gets its log with the first edit.
  defp join_log(%{log: %{id: nil}} = document, _mark), do: {:ok, document}

  defp join_log(document, mark) do
    with :edited <- replay_log(document, mark), do: join_edited(document, mark)
  end

  # Applies the operations after the version that the file contains. Returns `:edited` if the file was edited or put
  # back.
  defp replay_log(%{log: %{id: id} = log} = document, %{"log" => id, "intact" => true} = mark) do
    with {:ok, log} <- EditLog.seek(log, mark["version"], mark["offset"]),
         {:ok, log, entries} <- EditLog.read_new(log),
         false <- put_back?(document, mark, entries),
         {:ok, document} <- apply_entries(document, {log, entries}) do
      {:ok, %{document | written: mark["offset"], file: mark["version"]}}
    else
      true -> :edited
      {:error, error} -> {:error, error}
      _ -> {:error, EditLog.damaged_error(log, mark["offset"])}
    end
  end

  # The program that created the log was killed before it wrote the file.
  defp replay_log(%{log: %{header: %{"digest" => digest}} = log, digest: digest} = document, nil),
    do: replay_log(document, Mark.first(log))

  defp replay_log(_document, _mark), do: :edited

  # Somebody has replaced the file by an older one.
  defp put_back?(%{file: nil}, _mark, _entries), do: false

  defp put_back?(%{file: file}, %{"version" => version}, entries),
    do: file > version or Enum.any?(entries, &((&1.file || 0) > version))

  defp join_edited(document, mark) do
    case EditLog.with_lock(document.path, fn -> reopen_locked(document) end) do
      {:ok, document} ->
        {:ok, document}

      {:error, %{code: code}} = error when code in [:bad_log, :bad_document, :not_found] ->
        error

      # The folder cannot be written. The edits of the file are shown all the same.
      {:error, _} ->
        merge_unlocked(document, mark)
    end
  end

  # Other programs may write the file in the meantime, so an intact file was not necessarily put back.
  defp merge_unlocked(document, mark) do
    with :edited <- replay_log(%{document | file: nil}, mark),
         {:ok, document, _changes} <- merge_file(document, mark),
         do: {:ok, document}
  end

  defp apply_entries(document, {log, entries}) do
    case apply_changes(document, Replay.list_changes(entries)) do
      {:ok, content} -> {:ok, %{document | content: content, log: log}}
      {:conflict, _} -> {:error, EditLog.damaged_error(log, log.offset)}
    end
  end

  @doc "Applies changes to the content of a document, all or none; returns the first conflicting change."
  @spec apply_changes(t(), [Changes.change()]) :: {:ok, content()} | {:conflict, Changes.change()}
  def apply_changes(document, changes) do
    Enum.reduce_while(changes, {:ok, document.content}, fn change, {:ok, content} ->
      case document.format.apply_change(content, change, document.path) do
        {:ok, content} -> {:cont, {:ok, content}}
        :conflict -> {:halt, {:conflict, change}}
      end
    end)
  end

  # Takes over an edit of the file itself, while the document is locked.
  # An older file that was put back replaces the content.
  defp adopt_file(document, mark) do
    mark = if mark["intact"], do: nil, else: mark

    with {:ok, merged, changes} <- merge_file(document, mark),
         origin = [program: "an editor of the file", of: document.digest],
         {:ok, merged} <- append_changes(merged, {"outside", changes}, origin),
         do: write_file(merged)
  end

  defp merge_file(%{path: path, format: format} = document, mark) do
    file = {format.to_json(document.content, path), mark, document.digest}

    with {:ok, log, now, merged} <- Replay.merge_file(path, file),
         {:ok, before} <- from_json(document, now),
         {:ok, later} <- from_json(document, merged) do
      merged = %{document | log: log, content: later, written: log.offset}
      {:ok, merged, format.diff(before, later, path)}
    end
  end

  defp from_json(document, json) do
    with :error <- document.format.from_json(json, document.path),
         do: {:error, EditLog.damaged_error(document.log, 0)}
  end

  @doc "Reads the edits that other programs have made since, from the log or in the file itself."
  @spec refresh(t()) :: result()
  def refresh(document) do
    case DocumentFile.check(document) do
      {:unchanged, document} -> read_log(document, &open_known/1)
      :changed -> open_known(document)
    end
  end

  defp read_log(document, reopen) do
    case EditLog.read_new(document.log) do
      {:ok, log, []} -> {:ok, %{document | log: log}}
      {:ok, log, entries} -> apply_entries(document, {log, entries})
      :replaced -> reopen.(%{document | file: 0})
      error -> error
    end
  end

  @doc """
  Changes the current content with a function `content -> {:ok, content} | {:ok, content, opts} | {:error, error}`.
  Other programs wait in the meantime. Options: the options of `Situ.EditLog.Entry.new/3`, `kind:` (default `edit`), and
  `write: true` to write a large file, too. Errors: the errors of `fun`, `:in_use`, `:no_locks`, `:not_saved`.
  """
  @spec edit(t(), (content() -> edited()), keyword()) :: result()
  def edit(document, fun, opts \\ []) do
    EditLog.with_lock(document.path, fn ->
      with :ok <- check_type(document.path),
           {:ok, document} <- refresh_locked(document),
           {:ok, later, opts} <- run_edit(fun, document.content, opts),
           changes = document.format.diff(document.content, later, document.path),
           {:ok, document} <- append_changes(document, {opts[:kind] || "edit", changes}, opts),
           do: document |> Map.put(:content, later) |> write_if_due(opts[:write])
    end)
  end

  defp run_edit(fun, content, opts) do
    case fun.(content) do
      {:ok, later} -> {:ok, later, opts}
      {:ok, later, more} -> {:ok, later, Keyword.merge(opts, more)}
      error -> error
    end
  end

  defp check_type(path) do
    case File.stat(path) do
      {:ok, %{type: type}} when type != :regular ->
        {:error,
         Error.new(:not_saved, "cannot write #{path}", why: "it is a #{type}", fix: "move it away")}

      _ ->
        :ok
    end
  end

  # The lock is held already, so an edited file is merged here.
  defp refresh_locked(document) do
    case DocumentFile.check(document) do
      {:unchanged, document} -> read_log(document, &reopen_locked/1)
      :changed -> reopen_locked(document)
    end
  end

  defp reopen_locked(%{path: path, format: format} = document) do
    with {:ok, log} <- EditLog.open(path) do
      case read_document(%__MODULE__{path: path, format: format, log: log, file: document.file}) do
        {:ok, fresh, mark} -> join_locked(fresh, mark)
        {:error, %{code: :not_found}} -> replay_missing(%{document | log: log, written: 0})
        error -> error
      end
    end
  end

  # The file was deleted while a program edits it. The next edit writes it again.
  defp replay_missing(%{log: %{id: nil}} = document), do: {:ok, document}

  defp replay_missing(document) do
    with {:ok, log, entries} <- EditLog.read_all(document.path),
         {:ok, json} <- Replay.apply_entries(log, entries),
         {:ok, content} <- from_json(document, json),
         do: {:ok, %{document | log: log, content: content}}
  end

  defp join_locked(%{log: %{id: nil}} = document, _mark), do: {:ok, document}

  defp join_locked(document, mark) do
    with :edited <- replay_log(document, mark), do: adopt_file(document, mark)
  end

  defp append_changes(document, {kind, []}, _opts) when kind != "name", do: {:ok, document}

  defp append_changes(document, {kind, changes}, opts) do
    with {:ok, log} <- ensure_log(document),
         {:ok, log, _entry} <-
           EditLog.append(
             log,
             Entry.new(kind, %{"changes" => changes}, [{:file, document.file} | opts])
           ),
         do: {:ok, %{document | log: log}}
  end

  defp ensure_log(%{log: %{id: nil}} = document) do
    base = document.format.to_json(document.content, document.path)
    EditLog.create(document.log, %{"digest" => document.digest}, base)
  end

  defp ensure_log(%{log: log}), do: {:ok, log}

  defp write_if_due(%{log: log, size: size} = document, write?) do
    tail = log.offset - document.written

    cond do
      not File.exists?(document.path) -> write_file(document)
      tail == 0 -> {:ok, document}
      # A file that does not name its version yet must do so before a person edits it.
      document.written == 0 -> write_checked(document)
      write? == true or size <= @small or tail * 8 >= size -> write_checked(document)
      true -> {:ok, document}
    end
  end

  # The log contains the edit, so it is acknowledged even if the file cannot be written. The next edit tries again.
  defp write_checked(document) do
    if DocumentFile.same_text?(document), do: write_file(document), else: {:ok, document}
  end

  defp write_file(%{path: path, log: log} = document) do
    mark = if log.id, do: {log.id, log.n, log.offset}
    text = Mark.put_digest(document.format.encode(document.content, path, Mark.encode(mark)))

    case DocumentFile.write(path, text) do
      {:ok, file} ->
        written = %{document | written: log.offset, file: log.n}
        {:ok, struct!(written, file)}

      error ->
        if log.id, do: {:ok, document}, else: error
    end
  end

  @doc """
  Writes a document that was not read from `path`. If the file exists, this is an edit of it, so its content stays in
  the history.
  """
  @spec put(Path.t(), module(), content()) :: result()
  def put(path, format, content) do
    path = Path.expand(path)

    EditLog.with_lock(path, fn ->
      with :ok <- check_type(path), {:ok, log} <- EditLog.open(path) do
        new = %__MODULE__{path: path, format: format, content: content, log: log}

        case read_document(new) do
          {:ok, found, mark} -> replace_content(found, mark, content)
          {:error, _} -> put_missing(new)
        end
      end
    end)
  end

  defp replace_content(found, mark, content) do
    with {:ok, current} <- join_locked(found, mark),
         changes = found.format.diff(current.content, content, found.path),
         {:ok, current} <- append_changes(current, {"edit", changes}, note: "replaced the file"),
         do: write_file(%{current | content: content})
  end

  # The file is missing or is not a document.
  defp put_missing(%{log: %{id: nil}} = new), do: write_file(new)

  defp put_missing(new) do
    with {:ok, current} <- replay_missing(new),
         changes = new.format.diff(current.content, new.content, new.path),
         {:ok, current} <- append_changes(current, {"edit", changes}, note: "replaced the file"),
         do: write_file(%{current | content: new.content})
  end

  @doc "Returns whether the file does not contain all operations of the log."
  @spec write_due?(t()) :: boolean()
  def write_due?(document), do: document.log.id != nil and document.log.offset > document.written

  @doc "Writes the file if it does not contain all operations of the log."
  @spec write(t()) :: result()
  def write(document), do: edit(document, &{:ok, &1}, write: true)

  @doc "Returns the content of an earlier version. Version 0 is the content before the first operation."
  @spec content_at(t(), non_neg_integer()) :: {:ok, content()} | {:error, Error.t()}
  def content_at(%{log: %{id: nil}} = document, _version), do: {:ok, document.content}

  def content_at(document, version) do
    with {:ok, log, entries} <- EditLog.read_all(document.path),
         {:ok, json} <- Replay.apply_entries(log, Enum.take(entries, version)),
         do: from_json(document, json)
  end
end
