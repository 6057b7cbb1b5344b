defmodule Situ.Dataset do
  @moduledoc """
  Represents the dataset of a study: sessions with their recordings (partitions), metadata and tags.

      iex> folder = Path.join(System.tmp_dir!(), "situ-doc-dataset")
      iex> {:ok, dataset} = Situ.Dataset.new("Study", file: Path.join(folder, "study.json"), autosave: true)
      iex> {:ok, dataset} = Situ.Dataset.add_session(dataset, "p01", tags: ["pilot"])
      iex> {:ok, dataset} = Situ.Dataset.add_partition(dataset, "p01", "Room", Path.join(folder, "p01/room.0000"))
      iex> dataset.unsaved?
      false
      iex> {:ok, again} = Situ.Dataset.open(dataset.file)
      iex> [{"p01", "Room", error}] = Situ.Dataset.troubles(again)
      iex> {Enum.map(again.sessions, & &1.name), error.code}
      {["p01"], :no_store}
      iex> File.rm_rf!(folder) != []
      true

  `open/1` accepts a dataset file, a `.pds` file of \\psi, a folder of recordings, or one recording. A dataset is a
  plain value and edits return `{:ok, dataset}`. With `autosave: true` every edit is on disk before it returns;
  otherwise `unsaved?` is true. Several programs may edit the file: `save/1` merges their edits with those of the
  dataset, and `update/2` edits the current content of the file. An edit is an operation in the log `FILE.edits`, so
  every earlier version can be listed, compared and restored (`Situ.Dataset.History`). `Situ.Dataset.Server` is a
  process that shares a dataset between several users and notifies them of changes.

  | to | see |
  |---|---|
  | read the streams of a session | `Situ.Dataset.OpenSession` |
  | replay a session in a pipeline | `Situ.Dataset.Importer` |
  | get spans, sizes, counts | `summary/1`, `Situ.Dataset.Session.summary/1`, `Situ.Dataset.Partition.summary/1` |
  | find missing or damaged recordings | `troubles/1` |
  | run a pipeline over every session | `derive/3` |

  ## The dataset file

  A dataset file is JSON that people may edit:

      {"version": 1, "name": "Study", "tags": [], "metadata": {},
       "sessions": [
         {"name": "p01", "tags": ["pilot"], "metadata": {"participant": "P01"},
          "partitions": [{"name": "Room", "store": "room", "path": "p01/room.0000"}]}]}

  Paths are relative to the file and use forward slashes, so the file and its recordings can be moved together. Saving
  keeps unknown fields of the file. `priv/schema/dataset.schema.json` of this app describes all fields. Situ adds the
  field `edits`, which relates the file to its log. If a person has changed the file, the next program that opens it
  adds the change to the log. Files of more than 64 KB may lack the last edits of their log until `write_file/1`.
  """
  # A dataset is a value and a JSON file, not a process or a database, because people edit it and
  # move it together with the recordings. Partitions are names and relative paths, and a recording
  # is opened only when it is read. A dataset with missing recordings therefore opens, and one of
  # a thousand sessions opens in about 0.1 s. Unknown fields of the file are kept.
  alias Situ.Dataset.{
    Checksum,
    DatasetDocument,
    Derivation,
    Discovery,
    FileFormat,
    NameRules,
    Partition,
    Session,
    Summary
  }

  alias Situ.EditLog.{Document, Merging}
  alias Situ.{Error, Options}

  @options [
    file: [type: {:optional, :string}, doc: "The file to save to."],
    autosave: [type: :boolean, default: false, doc: "Save after every edit; requires `file:`."],
    metadata: [type: :map, default: %{}, doc: "Any JSON object."],
    tags: [type: {:list, :string}, default: [], doc: "Words for searching."]
  ]

  @fields [:name, :metadata, :tags, :sessions, :extra]

  defstruct name: "Untitled Dataset",
            file: nil,
            autosave?: false,
            unsaved?: false,
            sessions: [],
            metadata: %{},
            tags: [],
            extra: %{},
            document: nil

  @type t :: %__MODULE__{
          name: String.t(),
          file: Path.t() | nil,
          autosave?: boolean(),
          unsaved?: boolean(),
          sessions: [Session.t()],
          metadata: map(),
          tags: [String.t()],
          extra: map(),
          document: term()
        }
  @type result :: {:ok, t()} | {:error, Error.t()}

  # The following functions create, open and save datasets.

  @doc """
  Creates an empty dataset; with `file:` and `autosave: true` it is saved immediately.

  #{Options.docs(@options)}
  """
  @spec new(String.t(), keyword()) :: result()
  def new(name \\ "Untitled Dataset", opts \\ []) do
    with {:ok, opts} <- Options.validate(opts, @options),
         {:ok, dataset} <- put_file(%__MODULE__{name: name}, opts[:file], opts[:autosave]) do
      commit_edit(%{dataset | metadata: opts[:metadata], tags: opts[:tags]})
    end
  end

  defp put_file(_dataset, nil, true) do
    {:error, Error.new(:no_file, "cannot autosave a dataset without a file", fix: "pass file:")}
  end

  defp put_file(dataset, file, autosave?),
    do: {:ok, %{dataset | file: file && Path.expand(file), autosave?: autosave?}}

  @doc """
  Opens a dataset file, a `.pds` file, a folder of recordings (each subfolder is a session) or one recording (as a
  dataset with one session).

  Option: `autosave:` (default `false`). A dataset from a `.pds` file has no `file`, so the original is not
  overwritten; save it under another name.
  """
  @spec open(Path.t(), keyword()) :: result()
  def open(path, opts \\ []) do
    path = Situ.Recording.Formats.expand_path(path)

    cond do
      Situ.Store.exists?(path) ->
        build_dataset(Discovery.from_recording(path))

      File.dir?(path) ->
        build_dataset(Discovery.from_folder(path))

      FileFormat.dataset_file?(path) ->
        load(path, opts)

      File.regular?(path) and Situ.Recording.Formats.for_file(path) != nil ->
        build_dataset(Discovery.from_recording(path))

      true ->
        load(path, opts)
    end
  end

  defp build_dataset({:ok, name, sessions}),
    do: {:ok, %__MODULE__{name: name, sessions: sessions, unsaved?: true}}

  defp build_dataset({:error, error}), do: {:error, error}

  @doc "Opens a dataset file and does not accept other paths. Takes the options of `open/2`."
  @spec load(Path.t(), keyword()) :: result()
  def load(path, opts \\ []) do
    path = Path.expand(path)

    with {:ok, document} <- open_document(path) do
      dataset = struct!(__MODULE__, document.content)

      if Path.extname(path) == ".pds",
        do: {:ok, dataset},
        else: put_file(%{dataset | document: document}, path, opts[:autosave] || false)
    end
  end

  defp open_document(path) do
    with {:error, %{code: :bad_document} = error} <- Document.open(path, DatasetDocument) do
      {:error,
       Error.new(:bad_dataset, "#{path} is not a dataset file",
         why: error.why,
         fix: "see `Situ.Dataset` for the format, or create a dataset with `situ dataset create`"
       )}
    end
  end

  @doc """
  Saves the edits of the dataset to its file. Edits that other programs have saved in the meantime are kept, and the
  returned dataset contains them. Errors: `:no_file`, `:not_saved`, `:dataset_in_use`, `:no_locks` if the file system
  cannot lock files, and `:dataset_changed` if another program has changed the same field differently.
  """
  @spec save(t()) :: result()
  def save(%__MODULE__{file: nil}) do
    {:error,
     Error.new(:no_file, "the dataset does not have a file",
       fix: "save it with `save_as/2` (or -o)"
     )}
  end

  def save(%__MODULE__{document: nil, file: file} = dataset),
    do:
      file |> Document.put(DatasetDocument, Map.take(dataset, @fields)) |> take_document(dataset)

  def save(%__MODULE__{document: document} = dataset),
    do: document |> Merging.merge(list_changes(dataset), []) |> take_document(dataset)

  @doc """
  Writes the dataset to another file, which becomes its file. An existing dataset file gets the content of this dataset,
  and its history remains. Paths in the dataset are stored relative to the new file.
  """
  @spec save_as(t(), Path.t()) :: result()
  def save_as(%__MODULE__{} = dataset, path),
    do: save(%{dataset | file: Path.expand(path), document: nil})

  @doc """
  Reads the dataset from its file, changes it with a function `dataset -> {:ok, dataset} | {:error, error}`, and saves
  it. Use this for files that other programs also edit. Other programs wait while `fun` is running, so it must be
  quick and must not save the dataset itself. For a dataset without a file, `update/2` only applies `fun`.

      Situ.Dataset.update(dataset, &Situ.Dataset.put_fields(&1, tags: ["pilot" | &1.tags]))

  Errors: the errors of `fun` and of `save/1`. Options: `by:`, the person in the history (default: the user of this
  program), and `write:`, whether to also write a large file (default `false`).
  """
  @spec update(t(), (t() -> result()), keyword()) :: result()
  def update(dataset, fun, opts \\ [])
  def update(%__MODULE__{file: nil} = dataset, fun, _opts), do: fun.(dataset)

  def update(%__MODULE__{document: nil} = dataset, fun, opts) do
    with {:ok, saved} <- save(dataset), do: update(saved, fun, opts)
  end

  def update(%__MODULE__{document: document} = dataset, fun, opts) do
    changes = list_changes(dataset)

    edit = fn content ->
      with {:ok, content} <- Merging.merge_content(document, content, changes),
           {:ok, changed} <- fun.(struct!(%{dataset | autosave?: false}, content)),
           do: {:ok, Map.take(changed, @fields)}
    end

    document |> Document.edit(edit, opts) |> take_document(dataset)
  end

  @doc "Reads the edits that other programs have saved. Errors: those of `load/2`, and `:dataset_changed`."
  @spec refresh(t()) :: result()
  def refresh(%__MODULE__{document: nil} = dataset), do: {:ok, dataset}

  def refresh(%__MODULE__{document: document} = dataset) do
    with {:ok, document} <- Document.refresh(document) do
      case Merging.merge_content(document, document.content, list_changes(dataset)) do
        {:ok, content} -> {:ok, struct!(%{dataset | document: document}, content)}
        error -> take_document(error, dataset)
      end
    end
  end

  @doc "Writes the file if it lacks edits of its log, which is only possible for files of more than 64 KB."
  @spec write_file(t()) :: result()
  def write_file(%__MODULE__{} = dataset), do: update(dataset, &{:ok, &1}, write: true)

  # Returns the edits of this value that are not saved.
  defp list_changes(%{document: document} = dataset),
    do: DatasetDocument.diff(document.content, Map.take(dataset, @fields), document.path)

  @doc false
  # Returns the dataset with the content of its document, or the error of a dataset.
  @spec take_document(Document.result(), t()) :: result()
  def take_document({:ok, document}, dataset),
    do: {:ok, struct!(%{dataset | unsaved?: false, document: document}, document.content)}

  def take_document({:error, %{code: :in_use} = error}, _dataset),
    do: {:error, %{error | code: :dataset_in_use}}

  def take_document({:error, %{code: :conflict} = error}, _dataset),
    do: {:error, %{error | code: :dataset_changed}}

  def take_document(error, _dataset), do: error

  # Every edit ends with this function, which saves the dataset if autosave is on.
  defp commit_edit(%__MODULE__{autosave?: true} = dataset), do: save(%{dataset | unsaved?: true})
  defp commit_edit(%__MODULE__{} = dataset), do: {:ok, %{dataset | unsaved?: true}}

  # The following functions edit sessions.

  @doc "Returns the session with that name. Error: `:no_session`, which suggests the nearest name."
  @spec session(t(), String.t()) :: {:ok, Session.t()} | {:error, Error.t()}
  def session(%__MODULE__{} = dataset, name),
    do: NameRules.fetch_named(dataset.sessions, name, :no_session, "session", "the dataset")

  @doc "Adds a session: a struct, or a name with options of `Situ.Dataset.Session.new/2`. Error: `:duplicate_name`."
  @spec add_session(t(), String.t() | Session.t(), keyword()) :: result()
  def add_session(dataset, name, opts \\ [])

  def add_session(%__MODULE__{} = dataset, name, opts) when is_binary(name),
    do: add_session(dataset, Session.new(name, opts), [])

  def add_session(%__MODULE__{} = dataset, %Session{} = session, _opts) do
    with {:ok, dataset} <- put_session(dataset, session), do: commit_edit(dataset)
  end

  defp put_session(dataset, session) do
    with :ok <- NameRules.check_valid(session.name, "session"),
         :ok <- NameRules.check_free(session.name, dataset.sessions, "the dataset") do
      {:ok, %{dataset | sessions: dataset.sessions ++ [session]}}
    end
  end

  @doc "Adds the recording at `path` as a new session with one partition; both names default to the recording's name."
  @spec add_recording(t(), Path.t(), keyword()) :: result()
  def add_recording(%__MODULE__{} = dataset, path, opts \\ []) do
    partition = Partition.new(opts[:partition], path, Keyword.take(opts, [:reader]))
    session = Session.new(opts[:session] || partition.name)

    with {:ok, session} <- Session.add_partition(session, partition),
         do: add_session(dataset, session)
  end

  @doc "Removes a session from the dataset; its recordings are not deleted."
  @spec remove_session(t(), String.t()) :: result()
  def remove_session(%__MODULE__{} = dataset, name) do
    with {:ok, session} <- session(dataset, name),
         do: commit_edit(%{dataset | sessions: List.delete(dataset.sessions, session)})
  end

  @doc "Renames a session."
  @spec rename_session(t(), String.t(), String.t()) :: result()
  def rename_session(%__MODULE__{} = dataset, from, to) do
    with {:ok, session} <- session(dataset, from),
         :ok <- NameRules.check_valid(to, "session"),
         :ok <- NameRules.check_free(to, List.delete(dataset.sessions, session), "the dataset") do
      commit_edit(replace_session(dataset, from, %{session | name: to}))
    end
  end

  @doc """
  Changes one session with a function `session -> {:ok, session} | {:error, error}`, which can use every edit of
  `Situ.Dataset.Session`.

      Situ.Dataset.update_session(dataset, "p01", &Situ.Dataset.Session.remove_partition(&1, "Room"))
  """
  @spec update_session(t(), String.t(), (Session.t() -> {:ok, Session.t()} | {:error, Error.t()})) ::
          result()
  def update_session(%__MODULE__{} = dataset, name, fun) do
    with {:ok, session} <- session(dataset, name),
         {:ok, %Session{} = session} <- fun.(session),
         do: commit_edit(replace_session(dataset, name, %{session | name: name}))
  end

  defp replace_session(dataset, name, session) do
    swap = &if(&1.name == name, do: session, else: &1)
    %{dataset | sessions: Enum.map(dataset.sessions, swap)}
  end

  @doc "Adds the recording at `path` to a session (options: `Situ.Dataset.Partition.new/3`). Error: `:duplicate_name`."
  @spec add_partition(t(), String.t(), String.t() | nil, Path.t(), keyword()) :: result()
  def add_partition(%__MODULE__{} = dataset, session, name, path, opts \\ []),
    do:
      update_session(
        dataset,
        session,
        &Session.add_partition(&1, Partition.new(name, path, opts))
      )

  @doc "Appends all sessions of another dataset; `:duplicate_name` if a name exists already, and nothing is added."
  @spec append_sessions(t(), t()) :: result()
  def append_sessions(%__MODULE__{} = dataset, %__MODULE__{sessions: sessions}) do
    added =
      Enum.reduce_while(sessions, {:ok, dataset}, fn session, {:ok, dataset} ->
        case put_session(dataset, session) do
          {:ok, dataset} -> {:cont, {:ok, dataset}}
          {:error, error} -> {:halt, {:error, error}}
        end
      end)

    with {:ok, dataset} <- added, do: commit_edit(dataset)
  end

  @doc "Changes `name`, `metadata` or `tags` of the dataset."
  @spec put_fields(t(), keyword()) :: result()
  def put_fields(%__MODULE__{} = dataset, changes) do
    changes =
      Options.validate!(changes,
        name: [type: :string],
        metadata: [type: :map],
        tags: [type: {:list, :string}]
      )

    commit_edit(struct!(dataset, changes))
  end

  # The following functions are queries.

  @doc """
  Returns time spans, sizes and counts over all sessions. Opens every recording, several concurrently. Recordings that
  cannot be read are counted in the field `unknown` of the summary.
  """
  @spec summary(t()) :: Summary.t()
  def summary(%__MODULE__{} = dataset),
    do: dataset.sessions |> map_concurrently(&Session.summary/1) |> Summary.sum()

  @doc "Returns the summary of every session as `[{session_name, summary}]`."
  @spec session_summaries(t()) :: [{String.t(), Summary.t()}]
  def session_summaries(%__MODULE__{} = dataset),
    do: map_concurrently(dataset.sessions, &{&1.name, Session.summary(&1)})

  @doc "Lists missing and damaged recordings as `[{session, partition, error}]`."
  @spec troubles(t()) :: [{String.t(), String.t(), Error.t()}]
  def troubles(%__MODULE__{} = dataset) do
    dataset.sessions
    |> map_concurrently(fn session ->
      for {p, e} <- Session.troubles(session), do: {session.name, p, e}
    end)
    |> Enum.concat()
  end

  defp map_concurrently(sessions, fun) do
    sessions
    |> Task.async_stream(fun, timeout: :infinity, max_concurrency: 2 * System.schedulers_online())
    |> Enum.map(fn {:ok, result} -> result end)
  end

  @doc """
  Stores a checksum over all bytes of every recording in the dataset, so that the data can be verified years later.
  Option: `progress:`, which is called as `fun.(done, total)`.

  A checksum is `sha256:` and the hex digest of the list of files (name, size, digest of the content; sorted by name).
  Lock files and the marks of running writers are excluded.
  """
  @spec seal(t(), keyword()) :: result()
  def seal(%__MODULE__{} = dataset, opts \\ []) do
    with {:ok, checksums} <- Checksum.compute_all(list_partitions(dataset), opts),
         do: put_checksums(dataset, checksums)
  end

  @doc "Returns the partitions of all sessions."
  @spec list_partitions(t()) :: [Partition.t()]
  def list_partitions(%__MODULE__{sessions: sessions}),
    do: Enum.flat_map(sessions, & &1.partitions)

  @doc "Stores checksums, a map from paths to checksums, in the partitions with these paths. `seal/2` computes them."
  @spec put_checksums(t(), %{Path.t() => String.t()}) :: result()
  def put_checksums(%__MODULE__{} = dataset, checksums) do
    sessions =
      for session <- dataset.sessions do
        partitions =
          for p <- session.partitions, do: %{p | checksum: checksums[p.path] || p.checksum}

        %{session | partitions: partitions}
      end

    commit_edit(%{dataset | sessions: sessions})
  end

  @doc "Returns the sessions that have all `tags:` and whose name matches the pattern `name:` (`*` and `?`)."
  @spec select_sessions(t(), keyword()) :: [Session.t()]
  def select_sessions(%__MODULE__{} = dataset, opts) do
    tags = opts[:tags] || []
    fits? = NameRules.pattern_matcher(opts[:name] || "*")
    Enum.filter(dataset.sessions, &(tags -- &1.tags == [] and fits?.(&1.name)))
  end

  # The following function runs pipelines over the sessions.

  @doc """
  Runs a pipeline over every session and adds its output to each as a new partition.

      loudness = fn _p, importer, exporter ->
        importer
        |> Situ.Dataset.Importer.stream("Level")
        |> Situ.map(&abs/1)
        |> Situ.Store.write(exporter, "Loudness")
      end

      {:ok, dataset, report} =
        Situ.Dataset.derive(dataset, loudness, output: "Loudness", parallel: 2,
          progress: fn progress -> IO.write("\\r\#{round(100 * progress.done)} %") end)

  `compute` is a function of the pipeline, the session's `Situ.Dataset.Importer` and a store to write to (`nil` without
  `output:`), or a module with `build/2`, whose options contain `importer:`, `exporter:` and `session:` in addition to
  the options in `options:`. For a `Situ.Dataset.Task`, `options:` is checked and `output:` defaults to the task's.

  Returns the updated dataset, even if sessions failed or the run was cancelled. A dataset with a file is saved after
  every session. Errors before the run starts: `:partition_exists`, `:no_session`.

  A session's output gets its final name only when it is complete. A failed session leaves no output, and the other
  sessions continue. A cancelled run keeps the completed sessions. The next run of the same output resumes a run that
  was killed, cancelled or had failures, and runs only the remaining sessions. A journal next to the dataset file
  (`FILE.OUTPUT.run`) records which sessions were started and completed.

  #{Options.docs(Derivation.options())}

  ## The report

  The report has the fields `output`, `duration` (ns), `cancelled?` and `results`, one map for each session that was
  started, in the order of the sessions:

  | key | meaning |
  |---|---|
  | `session` | the session's name |
  | `status` | `:done`, `:kept` (completed by an earlier, interrupted run), `:failed` or `:cancelled` |
  | `error` | the `Situ.Error` of a failed session, or `nil` |
  | `result` | the return value of `compute` |
  | `took` | the time in ns |

  `progress:` receives `done` (0.0 to 1.0, sessions weighted by their duration), `finished` of `total` sessions, and
  `running`, a list of `{session, fraction}`.
  """
  @spec derive(t(), Derivation.Job.compute(), keyword()) ::
          {:ok, t(), Derivation.Report.t()} | {:error, Error.t()}
  def derive(%__MODULE__{} = dataset, compute, opts \\ []) do
    with {:ok, opts} <- Situ.Dataset.Task.complete_options(compute, opts),
         {:ok, sessions} <- choose_sessions(dataset, opts[:sessions]),
         do: Derivation.run(sessions, compute, dataset.file, {dataset, &put_result/3}, opts)
  end

  defp choose_sessions(dataset, nil), do: {:ok, dataset.sessions}

  defp choose_sessions(dataset, names) do
    with nil <- Enum.find_value(names, &find_unknown(dataset, &1)),
         do: {:ok, Enum.filter(dataset.sessions, &(&1.name in names))}
  end

  defp find_unknown(dataset, name) do
    case session(dataset, name) do
      {:ok, _} -> nil
      error -> error
    end
  end

  defp put_result(dataset, %{name: name}, partition) do
    put = fn session ->
      case Session.fetch_partition(session, partition.name) do
        {:ok, _} -> Session.replace_partition(session, partition)
        {:error, _} -> Session.add_partition(session, partition)
      end
    end

    update(dataset, &update_session(&1, name, put))
  end

  defimpl Inspect do
    def inspect(%{sessions: sessions} = dataset, _opts) do
      file = if dataset.file, do: ", #{Kernel.inspect(dataset.file)}", else: ""
      "#Situ.Dataset<#{Kernel.inspect(dataset.name)}, #{length(sessions)} sessions#{file}>"
    end
  end
end
