defmodule Situ.Annotation.Journal do
  @moduledoc false
  # The transactions since the last save, a line of JSON each, behind a line that names the version they are made on,
  # and a digest of the stream in it: versions that only changed other streams of the store do no harm. A line that a
  # crash cut short was never answered for, and is taken off; a broken line before others is damage.
  alias Situ.{Annotation, Error}
  alias Situ.Annotation.{Layer, Schema}
  alias Situ.Store.{AtomicFile, FileLock}

  @typedoc "A version (the store's folder, `nil` before the first), and the digest of the stream in it."
  @type base :: {Path.t() | nil, String.t() | nil}

  @spec path(Path.t(), String.t()) :: Path.t()
  def path(store, stream), do: "#{store}.#{String.replace(stream, ~r/[^\w.-]/u, "_")}.journal"

  @doc """
  Locks the journal for the calling process: `{:ok, lock}`. Error: `:being_edited`, which names the holder. An editor
  with unsaved edits holds the lock, so a crash has left a journal that is not locked.
  """
  @spec lock(Path.t()) :: {:ok, FileLock.t()} | {:error, Error.t()}
  def lock(path) do
    with :ok <- make_folder(path),
         {:held, holder} <- FileLock.acquire(path <> ".lock") do
      {:error,
       Error.new(:being_edited, "another editor has unsaved edits of these annotations",
         why: FileLock.describe(holder),
         fix: "save there first, or end that program; then edit again",
         meta: %{holder: holder}
       )}
    end
  end

  defp make_folder(path) do
    with {:error, reason} <- AtomicFile.make_folder(Path.dirname(path)),
         do: {:error, failed(path, reason)}
  end

  @doc "Of the annotations as they are stored, to know them again; `nil` for a stream that is not stored yet."
  @spec digest(Layer.t() | nil) :: String.t() | nil
  def digest(nil), do: nil

  def digest(%Layer{} = layer) do
    stored = {Schema.to_json(layer.schema), Enum.map(Layer.annotations(layer), &json/1)}
    :sha256 |> :crypto.hash(:erlang.term_to_binary(stored, [:deterministic])) |> Base.encode16()
  end

  @doc "Appends a transaction that was made on `base`."
  @spec append(Path.t(), base(), Layer.transaction()) :: :ok | {:error, Error.t()}
  def append(path, base, transaction) do
    line = [Situ.JSON.encode(Enum.map(transaction, &change/1)), "\n"]

    new? = not File.exists?(path)
    line = if new?, do: [Situ.JSON.encode(head(base)), "\n", line], else: line

    with :ok <- AtomicFile.make_folder(Path.dirname(path)),
         {:ok, device} <- :file.open(path, [:append, :raw, :binary]),
         :ok <- written(device, line) do
      # Otherwise a power cut could lose the name of a file whose content is on the disk.
      if new?, do: AtomicFile.sync_folder(Path.dirname(path)), else: :ok
    else
      {:error, reason} -> {:error, failed(path, reason)}
    end
  end

  @doc "Puts the transactions, oldest first, in the place of the journal: on another base, whole or not at all."
  @spec rewrite(Path.t(), base(), [Layer.transaction()]) :: :ok | {:error, Error.t()}
  def rewrite(path, base, transactions) do
    lines = for t <- transactions, do: [Situ.JSON.encode(Enum.map(t, &change/1)), "\n"]

    with {:error, reason} <- AtomicFile.write(path, [Situ.JSON.encode(head(base)), "\n", lines]),
         do: {:error, failed(path, reason)}
  end

  # A line that could not be written whole is taken off again: it would be damage in front of the next.
  defp written(device, line) do
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

  defp head({folder, digest}), do: %{base: version(folder), stream: digest}

  defp version(nil), do: nil
  defp version(folder), do: Path.basename(folder)

  defp change({id, before, later}), do: [id, json(before), json(later)]
  defp json(nil), do: nil
  defp json(annotation), do: Annotation.to_json(annotation)

  defp failed(path, reason) do
    Error.new(:not_saved, "the edit cannot be kept in #{path}",
      why: to_string(:file.format_error(reason)),
      fix: "make room or check the folder; the edit was not made"
    )
  end

  @doc """
  The transactions, oldest first; none where there is no journal. `:older` where they were made on another version than
  `base`, in which the stream was another: either they were saved, and only the journal not yet removed, or another
  program has saved meanwhile.
  """
  @spec read(Path.t(), base()) ::
          {:ok, [Layer.transaction()]}
          | {:older, name :: String.t() | nil, [Layer.transaction()]}
          | {:error, Error.t()}
  def read(path, base) do
    case File.read(path) do
      {:ok, text} ->
        text |> whole(path) |> String.split("\n") |> Enum.drop(-1) |> parse(path, head(base))

      {:error, :enoent} ->
        {:ok, []}

      {:error, reason} ->
        {:error, failed(path, reason)}
    end
  end

  defp whole(text, path) do
    case :binary.matches(text, "\n") do
      [] ->
        _ = File.rm(path)
        ""

      feeds ->
        {last, 1} = List.last(feeds)
        if last + 1 < byte_size(text), do: cut(path, last + 1)
        binary_part(text, 0, last + 1)
    end
  end

  defp cut(path, size) do
    {:ok, device} = :file.open(path, [:read, :write, :raw])
    {:ok, ^size} = :file.position(device, size)
    :ok = :file.truncate(device)
    :ok = :file.close(device)
  end

  defp parse([], _path, _base), do: {:ok, []}

  defp parse([first | lines], path, %{base: base, stream: digest}) do
    case Situ.JSON.decode(first) do
      {:ok, %{"base" => ^base}} ->
        transactions(lines, path)

      {:ok, %{"base" => older, "stream" => ^digest}} when older == nil or older < base ->
        transactions(lines, path)

      {:ok, %{"base" => older}} when older == nil or older < base ->
        with {:ok, transactions} <- transactions(lines, path), do: {:older, older, transactions}

      {:ok, %{"base" => _}} ->
        {:error, unfit(Error.new(:other_version, "it was made on another version"))}

      _ ->
        {:error, damaged(path, 1)}
    end
  end

  defp transactions(lines, path) do
    lines
    |> Enum.with_index(2)
    |> Enum.reduce_while({:ok, []}, fn {line, n}, {:ok, done} ->
      case transaction(line) do
        {:ok, transaction} -> {:cont, {:ok, [transaction | done]}}
        :error -> {:halt, {:error, damaged(path, n)}}
      end
    end)
    |> case do
      {:ok, transactions} -> {:ok, Enum.reverse(transactions)}
      error -> error
    end
  end

  defp transaction(line) do
    with {:ok, list} when is_list(list) <- Situ.JSON.decode(line) do
      changes = Enum.map(list, &read_change/1)
      if :error in changes, do: :error, else: {:ok, changes}
    else
      _ -> :error
    end
  end

  defp read_change([id, before, later]) when is_integer(id) do
    with {:ok, before} <- annotation(before),
         {:ok, later} <- annotation(later),
         do: {id, before, later}
  end

  defp read_change(_), do: :error

  defp annotation(nil), do: {:ok, nil}

  defp annotation(json) do
    case Annotation.from_json(json) do
      {:ok, annotation} -> {:ok, annotation}
      {:error, _} -> :error
    end
  end

  defp damaged(path, line) do
    Error.new(:bad_journal, "the journal of unsaved edits #{path} is damaged",
      why: "line #{line} is no transaction",
      fix: "move the file away to edit without them; the lines before #{line} are sound"
    )
  end

  @doc "The error of a journal that does not belong to the recording beside it."
  @spec unfit(Error.t()) :: Error.t()
  def unfit(error) do
    Error.new(:bad_journal, "the journal of unsaved edits does not fit the recording",
      why: error.what,
      fix: "move the journal away, or put back the version of the recording it was made on"
    )
  end
end
