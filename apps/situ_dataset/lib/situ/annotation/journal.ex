defmodule Situ.Annotation.Journal do
  @moduledoc false
  # Stores the transactions since the last save, one line of JSON each. The first line names the version that they
  # apply to and contains a digest of the stream in it, so that versions that only changed other streams of the store
  # do not matter. A last line that a crash truncated was never acknowledged and is removed; any other broken line is
  # damage.
  alias Situ.{Annotation, Error}
  alias Situ.Annotation.{Layer, Schema}
  alias Situ.Store.{AtomicFile, FileLock}

  @typedoc "A version (the store's folder; `nil` before the first version) and the digest of the stream in it."
  @type base :: {Path.t() | nil, String.t() | nil}

  @spec journal_path(Path.t(), String.t()) :: Path.t()
  def journal_path(store, stream),
    do: "#{store}.#{String.replace(stream, ~r/[^\w.-]/u, "_")}.journal"

  @doc """
  Locks the journal for the calling process and returns `{:ok, lock}`. Error: `:being_edited`, which names the holder.
  An editor with unsaved edits holds the lock, so an unlocked journal is the result of a crash.
  """
  @spec acquire_lock(Path.t()) :: {:ok, FileLock.t()} | {:error, Error.t()}
  def acquire_lock(path) do
    with :ok <- make_folder(path),
         {:held, holder} <- FileLock.acquire(path <> ".lock") do
      {:error,
       Error.new(:being_edited, "another editor has unsaved edits of these annotations",
         why: FileLock.describe_holder(holder),
         fix: "save in the other editor or quit that program, then edit again",
         meta: %{holder: holder}
       )}
    end
  end

  defp make_folder(path) do
    with {:error, reason} <- AtomicFile.make_folder(Path.dirname(path)),
         do: {:error, not_saved_error(path, reason)}
  end

  @doc "Returns a digest that identifies the stored annotations; `nil` for a stream that is not stored yet."
  @spec layer_digest(Layer.t() | nil) :: String.t() | nil
  def layer_digest(nil), do: nil

  def layer_digest(%Layer{} = layer) do
    stored =
      {Schema.to_json(layer.schema), Enum.map(Layer.annotations(layer), &annotation_json/1)}

    :sha256 |> :crypto.hash(:erlang.term_to_binary(stored, [:deterministic])) |> Base.encode16()
  end

  @doc "Appends a transaction that applies to `base`."
  @spec append_transaction(Path.t(), base(), Layer.transaction()) :: :ok | {:error, Error.t()}
  def append_transaction(path, base, transaction) do
    line = [Situ.JSON.encode(Enum.map(transaction, &encode_change/1)), "\n"]

    new? = not File.exists?(path)
    line = if new?, do: [Situ.JSON.encode(encode_head(base)), "\n", line], else: line

    with :ok <- AtomicFile.make_folder(Path.dirname(path)),
         {:ok, device} <- :file.open(path, [:append, :raw, :binary]),
         :ok <- write_line(device, line) do
      # Without this, a power cut could lose the file's name although its content is on disk.
      if new?, do: AtomicFile.sync_folder(Path.dirname(path)), else: :ok
    else
      {:error, reason} -> {:error, not_saved_error(path, reason)}
    end
  end

  @doc "Atomically replaces the journal with these transactions (oldest first), which apply to another base."
  @spec replace_transactions(Path.t(), base(), [Layer.transaction()]) :: :ok | {:error, Error.t()}
  def replace_transactions(path, base, transactions) do
    lines = for t <- transactions, do: [Situ.JSON.encode(Enum.map(t, &encode_change/1)), "\n"]

    with {:error, reason} <-
           AtomicFile.write(path, [Situ.JSON.encode(encode_head(base)), "\n", lines]),
         do: {:error, not_saved_error(path, reason)}
  end

  # A line that was written only in part is removed, because it would damage the next one.
  defp write_line(device, line) do
    {:ok, before} = :file.position(device, :eof)

    with :ok <- :file.write(device, line), :ok <- :file.datasync(device) do
      :ok
    else
      {:error, reason} ->
        _ = :file.position(device, before)
        _ = :file.truncate(device)
        {:error, reason}
    end
  after
    :file.close(device)
  end

  defp encode_head({folder, digest}), do: %{base: version_name(folder), stream: digest}

  defp version_name(nil), do: nil
  defp version_name(folder), do: Path.basename(folder)

  defp encode_change({id, before, later}),
    do: [id, annotation_json(before), annotation_json(later)]

  defp annotation_json(nil), do: nil
  defp annotation_json(annotation), do: Annotation.to_json(annotation)

  defp not_saved_error(path, reason) do
    Error.new(:not_saved, "cannot write the edit to #{path}",
      why: to_string(:file.format_error(reason)),
      fix: "free disk space or check the folder; the edit was not applied"
    )
  end

  @doc """
  Returns the transactions, oldest first; an empty list without a journal. Returns `:older` if they apply to a version
  other than `base` in which the stream is different. Then either the transactions were saved and the journal was not
  removed yet, or another program has saved the stream.
  """
  @spec read_transactions(Path.t(), base()) ::
          {:ok, [Layer.transaction()]}
          | {:older, name :: String.t() | nil, [Layer.transaction()]}
          | {:error, Error.t()}
  def read_transactions(path, base) do
    case File.read(path) do
      {:ok, text} ->
        text
        |> drop_partial_line(path)
        |> String.split("\n")
        |> Enum.drop(-1)
        |> parse_journal(path, encode_head(base))

      {:error, :enoent} ->
        {:ok, []}

      {:error, reason} ->
        {:error, not_saved_error(path, reason)}
    end
  end

  defp drop_partial_line(text, path) do
    case :binary.matches(text, "\n") do
      [] ->
        _ = File.rm(path)
        ""

      feeds ->
        {last, 1} = List.last(feeds)
        if last + 1 < byte_size(text), do: truncate_file(path, last + 1)
        binary_part(text, 0, last + 1)
    end
  end

  defp truncate_file(path, size) do
    {:ok, device} = :file.open(path, [:read, :write, :raw])
    {:ok, ^size} = :file.position(device, size)
    :ok = :file.truncate(device)
    :ok = :file.close(device)
  end

  defp parse_journal([], _path, _base), do: {:ok, []}

  defp parse_journal([first | lines], path, %{base: base, stream: digest}) do
    case Situ.JSON.decode(first) do
      {:ok, %{"base" => ^base}} ->
        parse_transactions(lines, path)

      {:ok, %{"base" => older, "stream" => ^digest}} when older == nil or older < base ->
        parse_transactions(lines, path)

      {:ok, %{"base" => older}} when older == nil or older < base ->
        with {:ok, transactions} <- parse_transactions(lines, path),
             do: {:older, older, transactions}

      {:ok, %{"base" => _}} ->
        {:error,
         mismatch_error(Error.new(:other_version, "the edits were made on another version"))}

      _ ->
        {:error, damaged_error(path, 1)}
    end
  end

  defp parse_transactions(lines, path) do
    lines
    |> Enum.with_index(2)
    |> Enum.reduce_while({:ok, []}, fn {line, n}, {:ok, done} ->
      case parse_transaction(line) do
        {:ok, transaction} -> {:cont, {:ok, [transaction | done]}}
        :error -> {:halt, {:error, damaged_error(path, n)}}
      end
    end)
    |> case do
      {:ok, transactions} -> {:ok, Enum.reverse(transactions)}
      error -> error
    end
  end

  defp parse_transaction(line) do
    with {:ok, list} when is_list(list) <- Situ.JSON.decode(line) do
      changes = Enum.map(list, &read_change/1)
      if :error in changes, do: :error, else: {:ok, changes}
    else
      _ -> :error
    end
  end

  defp read_change([id, before, later]) when is_integer(id) do
    with {:ok, before} <- parse_annotation(before),
         {:ok, later} <- parse_annotation(later),
         do: {id, before, later}
  end

  defp read_change(_), do: :error

  defp parse_annotation(nil), do: {:ok, nil}

  defp parse_annotation(json) do
    case Annotation.from_json(json) do
      {:ok, annotation} -> {:ok, annotation}
      {:error, _} -> :error
    end
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
