defmodule Situ.EditLog do
  @moduledoc false
  # The log of what people change in a document: a dataset file, a layer of annotations, a layout. `DOCUMENT.edits` has
  # one line for each operation (`Situ.EditLog.Lines`), in the order in which they were acknowledged. Programs that edit
  # a document take its lock, read the operations that others have added, and append theirs. An operation is on disk
  # before it is acknowledged. The log only knows operations as JSON; `Situ.EditLog.Document` and
  # `Situ.Annotation.Editor` give them a meaning.
  # See docs/adr/0174-one-log-of-edits-per-document.md.
  alias Situ.EditLog.{Disk, Entry, Lines, LockCheck}
  alias Situ.Error
  alias Situ.Store.{AtomicFile, FileLock}

  # Edits take milliseconds. After this time the error names the program that holds the lock.
  @wait_ms 30_000
  @page 1_048_576

  @enforce_keys [:path]
  defstruct [:path, :id, :inode, header: %{}, n: 0, offset: 0]

  @typedoc """
  A position in a log: the number of the last entry that was read (`n`) and the offset in bytes of the next one. `id`
  is `nil` before the log exists.
  """
  @type t :: %__MODULE__{
          path: Path.t(),
          id: String.t() | nil,
          inode: integer() | nil,
          header: map(),
          n: non_neg_integer(),
          offset: non_neg_integer()
        }

  @doc "Returns the path of a document's log."
  @spec log_path(Path.t()) :: Path.t()
  def log_path(document), do: document <> ".edits"

  @doc """
  Runs `fun` while no other program can edit the document. Errors: `:in_use`, which names the holder, `:no_locks` if the
  file system has no working locks, and `:not_saved`.
  """
  @spec with_lock(Path.t(), (() -> result), non_neg_integer()) :: result | {:error, Error.t()}
        when result: term()
  def with_lock(document, fun, wait_ms \\ @wait_ms) do
    with :ok <- make_folder(document),
         :ok <- LockCheck.check_folder(Path.dirname(document)),
         {:ok, lock} <- FileLock.acquire(document <> ".lock", wait_ms) do
      try do
        fun.()
      after
        FileLock.release(lock)
      end
    else
      {:held, holder} -> {:error, in_use_error(document, holder)}
      {:error, %Error{code: :no_locks}} = error -> error
      # The lock's file cannot be written.
      {:error, %Error{} = error} -> {:error, %{error | code: :not_saved}}
    end
  end

  defp make_folder(document) do
    with {:error, reason} <- AtomicFile.make_folder(Path.dirname(document)),
         do: {:error, not_saved_error(document, reason)}
  end

  defp in_use_error(document, holder) do
    Error.new(:in_use, "#{document} is being edited",
      why: FileLock.describe_holder(holder),
      fix: "wait for that program or quit it, and edit again",
      meta: %{holder: holder}
    )
  end

  @doc "Opens the log of a document at its beginning. `id` is `nil` if it does not exist."
  @spec open(Path.t()) :: {:ok, t()} | {:error, Error.t()}
  def open(document) do
    log = %__MODULE__{path: log_path(document)}

    case read_from(log.path, 0, @page) do
      {:ok, inode, bytes} -> parse_header(%{log | inode: inode}, bytes)
      :none -> {:ok, log}
      {:error, reason} -> {:error, unreadable_error(log, reason)}
    end
  end

  defp parse_header(log, bytes) do
    case Lines.parse_first(bytes) do
      {:ok, %{"log" => id, "version" => 1, "base_bytes" => base} = header, size} ->
        {:ok, %{log | id: id, header: header, offset: size + base}}

      # A crash while the log was created.
      :incomplete when byte_size(bytes) < @page ->
        {:ok, %{log | inode: nil}}

      _ ->
        {:error, damaged_error(log, 0)}
    end
  end

  @doc "Returns the document from which the log began. Error: `:bad_log`."
  @spec read_base(t()) :: {:ok, map()} | {:error, Error.t()}
  def read_base(%{header: header} = log) do
    with {:ok, _inode, first} <- read_from(log.path, 0, @page),
         {:ok, _header, size} <- Lines.parse_first(first),
         {:ok, _inode, bytes} <- read_from(log.path, size, header["base_bytes"]),
         {:ok, %{"base" => %{} = base}, _} <- Lines.parse_first(bytes) do
      {:ok, base}
    else
      _ -> {:error, damaged_error(log, 0)}
    end
  end

  @doc """
  Moves a log to a position that a saved version of the document contains, and returns `:error` if no entry begins
  there.
  """
  @spec seek(t(), non_neg_integer(), non_neg_integer()) :: {:ok, t()} | :error
  def seek(log, n, offset) do
    with {:ok, device} <- :file.open(log.path, [:read, :raw, :binary]) do
      found = :file.pread(device, max(offset - 1, 0), 64)
      _ = :file.close(device)
      check_position(%{log | n: n, offset: offset}, found)
    else
      _ -> :error
    end
  end

  defp check_position(log, {:ok, <<"\n", rest::binary>>}),
    do: if(rest == "" or Lines.numbered?(rest, log.n + 1), do: {:ok, log}, else: :error)

  defp check_position(_log, _found), do: :error

  @doc """
  Reads the entries after the position; returns `:replaced` if the file is another log. An incomplete last line is
  ignored, because it was never acknowledged. Error: `:bad_log`.
  """
  @spec read_new(t()) :: {:ok, t(), [Entry.t()]} | :replaced | {:error, Error.t()}
  def read_new(%{id: nil} = log),
    do: if(File.exists?(log.path), do: :replaced, else: {:ok, log, []})

  def read_new(log) do
    case Disk.file_stat(log.path) do
      {:ok, {inode, size, _}} when inode == log.inode and size == log.offset -> {:ok, log, []}
      {:ok, {inode, size, _}} when inode == log.inode and size > log.offset -> read_entries(log)
      {:error, reason} when reason != :enoent -> {:error, unreadable_error(log, reason)}
      _ -> :replaced
    end
  end

  defp read_entries(log) do
    with {:ok, _inode, bytes} <- read_from(log.path, log.offset, :all),
         {:ok, entries, size} <- Lines.parse_entries(bytes, log.n + 1) do
      {:ok, %{log | n: log.n + length(entries), offset: log.offset + size}, entries}
    else
      # Another program may have removed a line that it could not write completely.
      {:damaged, _} when log.n > 0 -> :replaced
      {:damaged, at} -> {:error, damaged_error(log, log.offset + at)}
      :none -> :replaced
      {:error, reason} -> {:error, unreadable_error(log, reason)}
    end
  end

  defp read_from(path, offset, size) do
    case :file.open(path, [:read, :raw, :binary]) do
      {:ok, device} ->
        {:ok, {inode, _, _}} = Disk.file_stat(path)
        {:ok, ^offset} = :file.position(device, offset)
        pages = if size == :all, do: read_pages(device, []), else: read_page(device, size)
        _ = :file.close(device)
        with {:ok, bytes} <- pages, do: {:ok, inode, bytes}

      {:error, :enoent} ->
        :none

      error ->
        error
    end
  end

  defp read_page(device, size) do
    with :eof <- :file.read(device, size), do: {:ok, ""}
  end

  defp read_pages(device, pages) do
    case :file.read(device, @page) do
      {:ok, page} -> read_pages(device, [pages, page])
      :eof -> {:ok, IO.iodata_to_binary(pages)}
      error -> error
    end
  end

  @doc """
  Creates the log with a header and the document from which it begins (`nil` if the header describes it). The caller
  holds the lock. Error: `:not_saved`.
  """
  @spec create(t(), map(), map() | nil) :: {:ok, t()} | {:error, Error.t()}
  def create(log, header, base \\ nil) do
    id = 8 |> :crypto.strong_rand_bytes() |> Base.encode16(case: :lower)
    second = if base, do: IO.iodata_to_binary(Lines.encode(%{"base" => base})), else: ""
    own = %{"log" => id, "version" => 1, "base_bytes" => byte_size(second)}
    header = Map.merge(header, own)
    lines = IO.iodata_to_binary([Lines.encode(header), second])

    with :ok <- Disk.replace(log.path, lines),
         {:ok, {inode, _, _}} <- Disk.file_stat(log.path) do
      {:ok, %{log | id: id, header: header, inode: inode, n: 0, offset: byte_size(lines)}}
    else
      {:error, reason} -> {:error, not_saved_error(log.path, reason)}
    end
  end

  @doc """
  Appends an entry and returns when it is on disk. The caller holds the lock and has read all entries. Error:
  `:not_saved`; the log is then unchanged.
  """
  @spec append(t(), Entry.t()) :: {:ok, t(), Entry.t()} | {:error, Error.t()}
  def append(log, entry) do
    entry = %{entry | n: log.n + 1}
    line = IO.iodata_to_binary(Lines.encode(Entry.to_json(entry)))

    case Disk.append(log.path, log.offset, line) do
      :ok -> {:ok, %{log | n: entry.n, offset: log.offset + byte_size(line)}, entry}
      {:error, reason} -> {:error, not_saved_error(log.path, reason)}
    end
  end

  @doc "Returns entries before the position, oldest first: those in the last `bytes` bytes before it."
  @spec read_before(t(), pos_integer()) :: [Entry.t()]
  def read_before(log, bytes) do
    first = max(log.offset - bytes, 0)

    with true <- log.n > 0,
         {:ok, device} <- :file.open(log.path, [:read, :raw, :binary]) do
      found = :file.pread(device, first, log.offset - first)
      _ = :file.close(device)
      parse_before(found)
    else
      _ -> []
    end
  end

  # The first line is the header or was cut.
  defp parse_before({:ok, bytes}) do
    case :binary.split(bytes, "\n") do
      [_, rest] -> Lines.parse_valid(rest)
      [_] -> []
    end
  end

  defp parse_before(_), do: []

  @doc "Returns the position and all entries of a document's log, from the first one."
  @spec read_all(Path.t()) :: {:ok, t(), [Entry.t()]} | {:error, Error.t()}
  def read_all(document) do
    with {:ok, log} <- open(document) do
      case read_new(log) do
        :replaced -> {:ok, log, []}
        result -> result
      end
    end
  end

  defp not_saved_error(path, reason) do
    Error.new(:not_saved, "cannot write the edit to #{path}",
      why: to_string(:file.format_error(reason)),
      fix:
        "free disk space or check the folder; the edit was not applied, earlier edits are saved"
    )
  end

  defp unreadable_error(log, reason) do
    Error.new(:bad_log, "cannot read the log of edits #{log.path}",
      why: to_string(:file.format_error(reason)),
      fix: "check the permissions of the file"
    )
  end

  @doc "Returns the error for a log whose content at `offset` cannot be used."
  @spec damaged_error(t(), non_neg_integer()) :: Error.t()
  def damaged_error(log, offset) do
    Error.new(:bad_log, "the log of edits #{log.path} is damaged",
      why: "the line at byte #{offset} is not an operation that fits the operations before it",
      fix:
        "restore the file from a backup; or move it away to continue with the last saved state of the document, " <>
          "without the edits that are only in the log"
    )
  end
end
