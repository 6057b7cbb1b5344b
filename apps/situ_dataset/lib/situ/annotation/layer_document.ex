defmodule Situ.Annotation.LayerDocument do
  @moduledoc false
  # A layer of annotations and the log of its edits, `ROOT/NAME.STREAM.edits`. Every edit is an operation in the log.
  # A save writes a version of the store `ROOT/NAME` that contains the operations so far. The layer is the newest
  # version with a mark of the log, and the operations after it. A version without a mark, from a program that does not
  # use the log, becomes an operation. If it contradicts the log, the log is kept, and `shadowed` is this version.
  # See docs/adr/0176-annotation-layers-merge-operations.md.
  alias Situ.Annotation.{
    JournalImport,
    Layer,
    LayerOperation,
    OutsideVersion,
    Schema,
    StoreVersions
  }

  alias Situ.{EditLog, Error}
  alias Situ.EditLog.Entry

  # Earlier edits that can be undone after a restart, in bytes of the log.
  @undo_bytes 262_144
  @most_entries 1_000

  @enforce_keys [:path, :stream, :document]
  defstruct [
    :path,
    :stream,
    :document,
    :log,
    :layer,
    :base,
    :seen,
    :shadowed,
    saved: 0,
    recovered: 0,
    entries: []
  ]

  @typedoc """
  `base` is the newest version of the log, `saved` the number of the last operation that is stored in a version, `seen`
  the newest version that was examined, and `entries` the latest entries, newest first.
  """
  @type t :: %__MODULE__{
          path: Path.t(),
          stream: String.t(),
          document: Path.t(),
          log: EditLog.t() | nil,
          layer: Layer.t() | nil,
          base: Path.t() | nil,
          seen: Path.t() | nil,
          shadowed: Path.t() | nil,
          saved: non_neg_integer(),
          recovered: non_neg_integer(),
          entries: [Entry.t()]
        }
  @type result :: {:ok, t()} | {:error, Error.t()}

  @doc "Returns the path of a stream's document; its log and lock are next to the store."
  @spec document_path(Path.t(), String.t()) :: Path.t()
  def document_path(path, stream), do: "#{path}.#{String.replace(stream, ~r/[^\w.-]/u, "_")}"

  @doc """
  Opens a layer. `schema` is for a stream that does not exist yet. Takes over the edits of earlier releases
  (`Situ.Annotation.JournalImport`) and of other programs. Errors: `:no_schema`, `:bad_log`, `:bad_journal`, and the
  errors of the store.
  """
  @spec open(Path.t(), String.t(), Schema.t() | nil) :: result()
  def open(path, stream, schema) do
    state = new_state(path, stream)

    with {:ok, state, outside} <- load_state(state, schema) do
      if outside != [] or File.exists?(JournalImport.journal_path(state.path, stream)),
        do: EditLog.with_lock(state.document, fn -> open_locked(state, schema) end),
        else: {:ok, state}
    end
  end

  @doc "Opens a layer while the caller holds the lock of its document (`document_path/2`)."
  @spec open_locked(Path.t(), String.t(), Schema.t() | nil) :: result()
  def open_locked(path, stream, schema), do: path |> new_state(stream) |> open_locked(schema)

  defp new_state(path, stream) do
    path = Path.expand(path)
    %__MODULE__{path: path, stream: stream, document: document_path(path, stream)}
  end

  defp open_locked(state, schema) do
    with {:ok, state, outside} <- load_state(state, schema),
         {:ok, state} <- adopt_versions(state, outside),
         {:ok, state} <- import_journal(state),
         do: {:ok, count_recovered(state)}
  end

  defp count_recovered(state) do
    count = Enum.count(state.entries, &(&1.n > state.saved and &1.kind != "outside"))
    %{state | recovered: count}
  end

  # Finds the newest version with a mark of the log, and the versions of other programs after it, oldest first.
  defp load_state(state, schema) do
    with {:ok, log} <- EditLog.open(state.document),
         folders = StoreVersions.list_folders(state.path),
         {:ok, start, outside} <- find_start(folders, state.stream, {log, []}),
         {:ok, state} <- load_start(%{state | log: log, entries: []}, start, schema),
         {:ok, state} <- read_entries(%{state | seen: List.first(folders)}) do
      taken = for %{kind: "outside", of: folder} <- state.entries, do: folder

      outside =
        for {folder, before} <- outside, Path.basename(folder) not in taken, do: {folder, before}

      {:ok, count_recovered(state), outside}
    end
  end

  defp find_start([], _stream, {_log, outside}), do: {:ok, :schema, outside}

  defp find_start([folder | older], stream, {log, outside}) do
    with {:ok, mark} <- StoreVersions.read_mark(folder, stream) do
      cond do
        log.id == nil -> {:ok, {folder, 0, log.offset}, []}
        mark["log"] == log.id -> {:ok, {folder, mark["version"], mark["offset"]}, outside}
        log.header["base"] == Path.basename(folder) -> {:ok, {folder, 0, log.offset}, outside}
        true -> find_start(older, stream, {log, [{folder, List.first(older)} | outside]})
      end
    else
      :none -> find_start(older, stream, {log, outside})
      error -> error
    end
  end

  defp load_start(state, {folder, n, offset}, _schema) do
    with {:ok, layer} <- StoreVersions.load_layer(folder, state.stream) do
      state = %{state | layer: layer, base: folder, saved: n}
      if n == 0, do: {:ok, state}, else: seek_log(state, n, offset)
    end
  end

  defp load_start(%{log: %{header: %{"schema" => schema}}} = state, :schema, _schema) do
    with {:ok, schema} <- Schema.parse(schema), do: start_empty(state, schema)
  end

  defp load_start(%{log: %{id: nil}} = state, :schema, %Schema{} = schema),
    do: start_empty(state, schema)

  defp load_start(%{log: %{id: nil}, stream: stream}, :schema, nil) do
    {:error,
     Error.new(:no_schema, "annotation stream #{inspect(stream)} does not exist",
       fix: "pass schema: to create it"
     )}
  end

  defp load_start(state, :schema, _schema) do
    {:error,
     Error.new(:bad_log, "the edits in #{state.log.path} cannot be applied",
       why: "they begin with the version #{state.log.header["base"]}, which was deleted",
       fix: "restore a later version of the store, or move the log away to give up its edits"
     )}
  end

  # Nothing is stored yet, so even the version without annotations is not saved.
  defp start_empty(state, schema) do
    with {:ok, layer} <- Layer.new(schema), do: {:ok, %{state | layer: layer}}
  end

  defp seek_log(state, n, offset) do
    case EditLog.seek(state.log, n, offset) do
      {:ok, log} ->
        {:ok, %{state | log: log, entries: Enum.reverse(EditLog.read_before(log, @undo_bytes))}}

      :error ->
        {:error, EditLog.damaged_error(state.log, offset)}
    end
  end

  @doc "Applies the operations that other programs have added to the log."
  @spec read_entries(t()) :: result()
  def read_entries(state) do
    case EditLog.read_new(state.log) do
      {:ok, log, entries} -> apply_entries(%{state | log: log}, entries)
      :replaced -> reload(state)
      error -> error
    end
  end

  defp reload(state) do
    with {:ok, fresh, _outside} <-
           load_state(new_state(state.path, state.stream), state.layer && state.layer.schema),
         :ok <- check_present(state, fresh),
         do: {:ok, %{fresh | seen: state.seen, recovered: state.recovered}}
  end

  # A log that has gone must not begin anew in the old folder, where nobody would find the edits.
  defp check_present(%{log: %{id: id}} = state, %{base: nil, log: %{id: nil}}) when id != nil do
    {:error, StoreVersions.moved_error(state.document)}
  end

  defp check_present(_state, _fresh), do: :ok

  defp apply_entries(state, entries) do
    Enum.reduce_while(entries, {:ok, state}, fn entry, {:ok, state} ->
      case LayerOperation.apply_entry(state.layer, entry) do
        {:ok, layer} -> {:cont, {:ok, push_entry(%{state | layer: layer}, entry)}}
        _ -> {:halt, {:error, EditLog.damaged_error(state.log, state.log.offset)}}
      end
    end)
  end

  defp push_entry(state, entry) do
    state = %{state | entries: keep_latest([entry | state.entries])}

    case entry do
      # Without unsaved edits, the state is the content of the other program's version.
      %{kind: "outside", note: nil, n: n} when state.saved == n - 1 ->
        %{state | saved: n}

      %{kind: "outside", note: note, of: of} when note != nil ->
        %{state | shadowed: folder(state, of)}

      _ ->
        state
    end
  end

  defp keep_latest(entries) do
    if rem(length(entries), @most_entries) == 0,
      do: Enum.take(entries, @most_entries),
      else: entries
  end

  defp folder(state, name), do: Path.join(Path.dirname(state.path), name)

  @doc "Reads the operations and the versions of other programs. Takes the lock only if there are new versions."
  @spec refresh(t()) :: result()
  def refresh(state) do
    if new_version?(state),
      do: EditLog.with_lock(state.document, fn -> catch_up(state) end),
      else: read_entries(state)
  end

  defp new_version?(state), do: StoreVersions.newest_folder(state.path) not in [nil, state.seen]

  @doc "Reads the operations and the versions of other programs. The caller holds the lock."
  @spec catch_up(t()) :: result()
  def catch_up(state) do
    with {:ok, state} <- read_entries(state) do
      if new_version?(state), do: examine_versions(state), else: {:ok, state}
    end
  end

  # Without a log, a new version cannot contradict any edits.
  defp examine_versions(%{log: %{id: nil}} = state) do
    with {:ok, fresh, _outside} <- load_state(state, state.layer.schema), do: {:ok, fresh}
  end

  # Another stream of the store may have been saved, or this one by a program with or without the log.
  defp examine_versions(state) do
    folders = StoreVersions.list_folders(state.path)

    with {:ok, start, outside} <- find_start(folders, state.stream, {state.log, []}) do
      taken = for %{kind: "outside", of: folder} <- state.entries, do: folder

      outside =
        for {folder, before} <- outside,
            Path.basename(folder) not in taken,
            state.base == nil or newer?(folder, state.base),
            do: {folder, before}

      adopt_versions(%{put_start(state, start) | seen: List.first(folders)}, outside)
    end
  end

  defp newer?(folder, base),
    do: {byte_size(folder), folder} > {byte_size(base), base}

  defp put_start(state, {folder, n, _offset}) when n >= state.saved and n > 0,
    do: %{state | base: folder, saved: n}

  defp put_start(state, _start), do: state

  defp adopt_versions(state, outside) do
    Enum.reduce_while(outside, {:ok, state}, fn {folder, before}, {:ok, state} ->
      case adopt_version(state, folder, before) do
        {:ok, state} -> {:cont, {:ok, state}}
        error -> {:halt, error}
      end
    end)
  end

  defp adopt_version(state, folder, before) do
    with {:ok, later} <- StoreVersions.load_layer(folder, state.stream),
         {:ok, before} <- load_before(state, before) do
      operation = OutsideVersion.diff_versions(before, later, state.layer)
      name = Path.basename(folder)
      opts = [of: name, program: "a program that wrote #{name}"]

      case append(state, "outside", operation, opts) do
        {:ok, state} ->
          {:ok, %{state | base: state.base || folder}}

        {:error, %{code: :not_saved}} = error ->
          error

        _conflict ->
          append(state, "outside", %{"annotations" => []}, opts ++ [note: "not merged"])
      end
    end
  end

  defp load_before(state, nil), do: Layer.new(state.layer.schema)

  defp load_before(state, folder) do
    case StoreVersions.read_mark(folder, state.stream) do
      {:ok, _} -> StoreVersions.load_layer(folder, state.stream)
      _ -> Layer.new(state.layer.schema)
    end
  end

  defp import_journal(state) do
    newest = StoreVersions.newest_folder(state.path)
    stored = if state.base, do: JournalImport.layer_digest(state.layer)

    case JournalImport.read(state.path, state.stream, {newest, stored, state.layer}) do
      {:ok, []} ->
        {:ok, state}

      {:ok, transactions} ->
        with {:ok, state} <- append_all(state, transactions) do
          :ok = JournalImport.remove(state.path, state.stream)
          {:ok, state}
        end

      error ->
        error
    end
  end

  # A program that was killed during the import has appended some of the transactions already.
  defp append_all(state, transactions) do
    taken = for %{note: "recovered", of: of} <- state.entries, do: of
    journal = JournalImport.journal_id(state.path, state.stream)

    transactions
    |> Enum.with_index(&{"#{journal}/#{&2}", LayerOperation.encode_transaction(&1)})
    |> Enum.reject(fn {id, _} -> id in taken end)
    |> Enum.reduce_while({:ok, state}, fn {id, operation}, {:ok, state} ->
      case append(state, "edit", operation, note: "recovered", of: id) do
        {:ok, state} -> {:cont, {:ok, state}}
        {:error, %{code: :not_saved}} = error -> {:halt, error}
        {:error, error} -> {:halt, {:error, JournalImport.mismatch_error(error)}}
      end
    end)
  end

  @doc """
  Appends an operation to the log and applies it. The caller holds the lock and has caught up. Errors: `:not_saved`, and
  the errors of `Situ.Annotation.Layer.apply_transaction/2`.
  """
  @spec append(t(), String.t(), map(), keyword()) :: result()
  def append(state, kind, operation, opts \\ []) do
    entry = Entry.new(kind, operation, opts)

    with {:ok, layer} <- LayerOperation.apply_entry(state.layer, entry),
         {:ok, log} <- ensure_log(state),
         {:ok, log, entry} <- EditLog.append(log, entry) do
      {:ok, push_entry(%{state | layer: layer, log: log}, entry)}
    else
      :error -> {:error, Error.new(:bad_operation, "the operation is not valid")}
      error -> error
    end
  end

  defp ensure_log(%{log: %{id: nil} = log, base: nil} = state),
    do: EditLog.create(log, %{"base" => nil, "schema" => Schema.to_json(state.layer.schema)})

  defp ensure_log(%{log: %{id: nil} = log, base: base}),
    do: EditLog.create(log, %{"base" => Path.basename(base)})

  defp ensure_log(%{log: log}), do: {:ok, log}

  @doc "Writes a version that contains all operations. The caller holds the lock and has caught up."
  @spec write_version(t()) :: result()
  def write_version(state) do
    if state.base != nil and unsaved?(state) == false and state.shadowed == nil,
      do: {:ok, state},
      else: write_marked(state)
  end

  defp write_marked(state) do
    with {:ok, log} <- ensure_log(state),
         mark = %{"log" => log.id, "version" => log.n, "offset" => log.offset},
         {:ok, folder} <-
           StoreVersions.write_version(state.path, state.stream, {state.layer, mark}) do
      {:ok, %{state | log: log, base: folder, seen: folder, saved: log.n, shadowed: nil}}
    end
  end

  @doc "Returns whether no version contains the layer."
  @spec unsaved?(t()) :: boolean()
  def unsaved?(state), do: state.log.n > state.saved
end
