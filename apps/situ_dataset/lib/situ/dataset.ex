defmodule Situ.Dataset do
  @moduledoc """
  A study as data: sessions, each with its recordings (partitions), metadata and tags, in one JSON file that people
  may edit.

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

  `open/1` takes a dataset file (`Situ.Dataset.Document`), a `.pds` of \\psi, a folder of recordings, or one
  recording. A dataset is a plain value: edits answer `{:ok, dataset}`, and with `autosave: true` are on disk by then
  (whole or not at all); else `unsaved?` is true. Edits that another program has saved are never overwritten:
  `save/1` refuses then, and `update/2` edits the file as it is. `Situ.Dataset.Server` is a process that holds one for
  several users and tells them of changes.

  | to | see |
  |---|---|
  | read the streams of a session | `Situ.Dataset.OpenSession` |
  | replay a session in a pipeline | `Situ.Dataset.Importer` |
  | know spans, sizes, counts | `summary/1`, `Situ.Dataset.Session.summary/1`, `Situ.Dataset.Partition.summary/1` |
  | know what is missing or damaged | `troubles/1` |
  """
  alias Situ.Dataset.{
    Checksum,
    DatasetFile,
    Derivation,
    Discovery,
    Document,
    Names,
    Partition,
    Session,
    Summary
  }

  alias Situ.{Error, Options}

  @options [
    file: [type: {:optional, :string}, doc: "Where it is saved."],
    autosave: [type: :boolean, default: false, doc: "Save after every edit; needs `file:`."],
    metadata: [type: :map, default: %{}, doc: "Anything that JSON can say."],
    tags: [type: {:list, :string}, default: [], doc: "Words to find it by."]
  ]

  defstruct name: "Untitled Dataset",
            file: nil,
            autosave?: false,
            unsaved?: false,
            sessions: [],
            metadata: %{},
            tags: [],
            extra: %{},
            digest: nil

  @type t :: %__MODULE__{
          name: String.t(),
          file: Path.t() | nil,
          autosave?: boolean(),
          unsaved?: boolean(),
          sessions: [Session.t()],
          metadata: map(),
          tags: [String.t()],
          extra: map(),
          digest: String.t() | nil
        }
  @type result :: {:ok, t()} | {:error, Error.t()}

  # Making, opening, saving

  @doc """
  An empty dataset; with `file:` and `autosave: true` it is saved at once.

  #{Options.docs(@options)}
  """
  @spec new(String.t(), keyword()) :: result()
  def new(name \\ "Untitled Dataset", opts \\ []) do
    with {:ok, opts} <- Options.validate(opts, @options),
         {:ok, dataset} <- autosaving(%__MODULE__{name: name}, opts[:file], opts[:autosave]) do
      commit(%{dataset | metadata: opts[:metadata], tags: opts[:tags]})
    end
  end

  defp autosaving(_dataset, nil, true) do
    {:error,
     Error.new(:no_file, "a dataset without a file cannot save itself", fix: "give file:")}
  end

  defp autosaving(dataset, file, autosave?),
    do: {:ok, %{dataset | file: file && Path.expand(file), autosave?: autosave?}}

  @doc """
  Opens a dataset file, a `.pds` file, a folder of recordings (each folder in it a session) or one recording (one
  session of it).

  Option `autosave:` (false). A `.pds` has no `file`: it is saved under another name, and not overwritten.
  """
  @spec open(Path.t(), keyword()) :: result()
  def open(path, opts \\ []) do
    path = Situ.Store.Formats.expand(path)

    cond do
      Situ.Store.exists?(path) ->
        found(Discovery.recording(path))

      File.dir?(path) ->
        found(Discovery.folder(path))

      Document.dataset?(path) ->
        load(path, opts)

      File.regular?(path) and Situ.Store.Formats.for_file(path) != nil ->
        found(Discovery.recording(path))

      true ->
        load(path, opts)
    end
  end

  defp found({:ok, name, sessions}),
    do: {:ok, %__MODULE__{name: name, sessions: sessions, unsaved?: true}}

  defp found({:error, error}), do: {:error, error}

  @doc "Opens a dataset file, and nothing else. Options as `open/2`."
  @spec load(Path.t(), keyword()) :: result()
  def load(path, opts \\ []) do
    path = Path.expand(path)

    with {:ok, found, digest} <- Document.read_digested(path) do
      dataset = struct!(%__MODULE__{digest: digest}, found)
      file = if Path.extname(path) == ".pds", do: nil, else: path
      autosaving(dataset, file, (opts[:autosave] && file != nil) || false)
    end
  end

  @doc """
  Writes the dataset to its file, whole or not at all. Error: `:no_file`, `:not_saved`, `:dataset_in_use`;
  `:dataset_changed` when another program has saved the file since this dataset was read from it or saved to it.
  """
  @spec save(t()) :: result()
  def save(%__MODULE__{file: nil}) do
    {:error,
     Error.new(:no_file, "the dataset has no file yet", fix: "save it with `save_as/2` (or -o)")}
  end

  def save(%__MODULE__{file: file} = dataset) do
    DatasetFile.lock(file, fn ->
      with :ok <- DatasetFile.check_unchanged(file, dataset.digest), do: write(dataset)
    end)
  end

  @doc """
  Writes the dataset to another file, which becomes its file; paths in it are relative to that. An existing file is
  replaced.
  """
  @spec save_as(t(), Path.t()) :: result()
  def save_as(%__MODULE__{} = dataset, path),
    do: save(%{dataset | file: Path.expand(path), digest: nil})

  @doc """
  Reads the dataset from its file, changes it by a function `dataset -> {:ok, dataset} | {:error, error}`, and saves it.
  Use this for files that other programs edit, too. They wait meanwhile, so `fun` must be quick and must not save the
  dataset itself. A dataset without a file is changed as it is.

      Situ.Dataset.update(dataset, &Situ.Dataset.put(&1, tags: ["pilot" | &1.tags]))

  Errors: those of `fun` and of `save/1`. `:dataset_changed` only if the dataset has unsaved edits.
  """
  @spec update(t(), (t() -> result())) :: result()
  def update(%__MODULE__{file: nil} = dataset, fun), do: fun.(dataset)

  def update(%__MODULE__{file: file} = dataset, fun) do
    DatasetFile.lock(file, fn ->
      with {:ok, dataset} <- refresh(dataset),
           {:ok, changed} <- fun.(%{dataset | autosave?: false}),
           {:ok, saved} <- write(changed),
           do: {:ok, %{saved | autosave?: dataset.autosave?}}
    end)
  end

  defp refresh(%{file: file, digest: digest} = dataset) do
    case DatasetFile.check_unchanged(file, digest) do
      {:error, %{code: :dataset_changed}} when not dataset.unsaved? ->
        load(file, autosave: dataset.autosave?)

      :ok ->
        {:ok, dataset}

      error ->
        error
    end
  end

  defp write(dataset) do
    with {:ok, digest} <- DatasetFile.write(dataset.file, Document.render(dataset, dataset.file)),
         do: {:ok, %{dataset | unsaved?: false, digest: digest}}
  end

  # Every edit ends here.
  defp commit(%__MODULE__{autosave?: true} = dataset), do: save(%{dataset | unsaved?: true})
  defp commit(%__MODULE__{} = dataset), do: {:ok, %{dataset | unsaved?: true}}

  # Sessions

  @doc "The session of that name. Error: `:no_session`, with the nearest name."
  @spec session(t(), String.t()) :: {:ok, Session.t()} | {:error, Error.t()}
  def session(%__MODULE__{} = dataset, name),
    do: Names.fetch(dataset.sessions, name, :no_session, "session", "the dataset")

  @doc "Adds a session (a name with options of `Situ.Dataset.Session.new/2`, or a session). Error: `:duplicate_name`."
  @spec add_session(t(), String.t() | Session.t(), keyword()) :: result()
  def add_session(dataset, name, opts \\ [])

  def add_session(%__MODULE__{} = dataset, name, opts) when is_binary(name),
    do: add_session(dataset, Session.new(name, opts), [])

  def add_session(%__MODULE__{} = dataset, %Session{} = session, _opts) do
    with {:ok, dataset} <- added(dataset, session), do: commit(dataset)
  end

  defp added(dataset, session) do
    with :ok <- Names.check(session.name, "session"),
         :ok <- Names.free(session.name, dataset.sessions, "the dataset") do
      {:ok, %{dataset | sessions: dataset.sessions ++ [session]}}
    end
  end

  @doc "Adds the recording at `path` as a session of its own with one partition; both names default to the recording's."
  @spec add_recording(t(), Path.t(), keyword()) :: result()
  def add_recording(%__MODULE__{} = dataset, path, opts \\ []) do
    partition = Partition.new(opts[:partition], path, Keyword.take(opts, [:reader]))
    session = Session.new(opts[:session] || partition.name)
    with {:ok, session} <- Session.add(session, partition), do: add_session(dataset, session)
  end

  @doc "Takes a session out; its recordings stay where they are."
  @spec remove_session(t(), String.t()) :: result()
  def remove_session(%__MODULE__{} = dataset, name) do
    with {:ok, found} <- session(dataset, name),
         do: commit(%{dataset | sessions: List.delete(dataset.sessions, found)})
  end

  @doc "Gives a session another name."
  @spec rename_session(t(), String.t(), String.t()) :: result()
  def rename_session(%__MODULE__{} = dataset, from, to) do
    with {:ok, found} <- session(dataset, from),
         :ok <- Names.check(to, "session"),
         :ok <- Names.free(to, List.delete(dataset.sessions, found), "the dataset") do
      commit(swap(dataset, from, %{found | name: to}))
    end
  end

  @doc """
  Changes one session by a function `session -> {:ok, session} | {:error, error}`: the way to every edit of
  `Situ.Dataset.Session`.

      Situ.Dataset.update_session(dataset, "p01", &Situ.Dataset.Session.remove(&1, "Room"))
  """
  @spec update_session(t(), String.t(), (Session.t() -> {:ok, Session.t()} | {:error, Error.t()})) ::
          result()
  def update_session(%__MODULE__{} = dataset, name, fun) do
    with {:ok, found} <- session(dataset, name),
         {:ok, %Session{} = session} <- fun.(found),
         do: commit(swap(dataset, name, %{session | name: name}))
  end

  defp swap(dataset, name, session) do
    swap = &if(&1.name == name, do: session, else: &1)
    %{dataset | sessions: Enum.map(dataset.sessions, swap)}
  end

  @doc "Adds the recording at `path` to a session. Options as `Situ.Dataset.Partition.new/3`. Error: `:duplicate_name`."
  @spec add_partition(t(), String.t(), String.t() | nil, Path.t(), keyword()) :: result()
  def add_partition(%__MODULE__{} = dataset, session, name, path, opts \\ []),
    do: update_session(dataset, session, &Session.add(&1, Partition.new(name, path, opts)))

  @doc "Adds all sessions of another dataset behind these, or none: `:duplicate_name` when one is here already."
  @spec append(t(), t()) :: result()
  def append(%__MODULE__{} = dataset, %__MODULE__{sessions: sessions}) do
    added =
      Enum.reduce_while(sessions, {:ok, dataset}, fn session, {:ok, dataset} ->
        case added(dataset, session) do
          {:ok, dataset} -> {:cont, {:ok, dataset}}
          {:error, error} -> {:halt, {:error, error}}
        end
      end)

    with {:ok, dataset} <- added, do: commit(dataset)
  end

  @doc "Changes `name`, `metadata` or `tags` of the dataset itself."
  @spec put(t(), keyword()) :: result()
  def put(%__MODULE__{} = dataset, changes) do
    changes =
      Options.validate!(changes,
        name: [type: :string],
        metadata: [type: :map],
        tags: [type: {:list, :string}]
      )

    commit(struct!(dataset, changes))
  end

  # Asking

  @doc """
  Spans, sizes and counts over all sessions: opens every recording, several at once. `Situ.Dataset.Summary.unknown`
  counts those that cannot be read.
  """
  @spec summary(t()) :: Summary.t()
  def summary(%__MODULE__{} = dataset),
    do: dataset.sessions |> at_once(&Session.summary/1) |> Summary.sum()

  @doc "Of every session: `[{session_name, summary}]`."
  @spec summaries(t()) :: [{String.t(), Summary.t()}]
  def summaries(%__MODULE__{} = dataset),
    do: at_once(dataset.sessions, &{&1.name, Session.summary(&1)})

  @doc "Missing and damaged recordings: `[{session, partition, error}]`."
  @spec troubles(t()) :: [{String.t(), String.t(), Error.t()}]
  def troubles(%__MODULE__{} = dataset) do
    dataset.sessions
    |> at_once(fn session -> for {p, e} <- Session.troubles(session), do: {session.name, p, e} end)
    |> Enum.concat()
  end

  defp at_once(sessions, fun) do
    sessions
    |> Task.async_stream(fun, timeout: :infinity, max_concurrency: 2 * System.schedulers_online())
    |> Enum.map(fn {:ok, result} -> result end)
  end

  @doc """
  Notes the checksum of every recording (`Situ.Dataset.Checksum`; reads all bytes). Option `progress:`, `fun.(done,
  total)`.
  """
  @spec seal(t(), keyword()) :: result()
  def seal(%__MODULE__{} = dataset, opts \\ []) do
    with {:ok, checksums} <- Checksum.all(partitions(dataset), opts),
         do: put_checksums(dataset, checksums)
  end

  @doc "Returns the partitions of all sessions."
  @spec partitions(t()) :: [Partition.t()]
  def partitions(%__MODULE__{sessions: sessions}), do: Enum.flat_map(sessions, & &1.partitions)

  @doc "Puts the checksums of `Situ.Dataset.Checksum.all/2` into the partitions, by their paths."
  @spec put_checksums(t(), %{Path.t() => String.t()}) :: result()
  def put_checksums(%__MODULE__{} = dataset, checksums) do
    sessions =
      for session <- dataset.sessions do
        partitions =
          for p <- session.partitions, do: %{p | checksum: checksums[p.path] || p.checksum}

        %{session | partitions: partitions}
      end

    commit(%{dataset | sessions: sessions})
  end

  @doc "Sessions that have all `tags:` and whose name fits the pattern `name:` (`*` and `?`)."
  @spec select(t(), keyword()) :: [Session.t()]
  def select(%__MODULE__{} = dataset, opts) do
    tags = opts[:tags] || []
    fits? = Names.matcher(opts[:name] || "*")
    Enum.filter(dataset.sessions, &(tags -- &1.tags == [] and fits?.(&1.name)))
  end

  # Running

  @doc """
  Runs a pipeline over every session and adds its output to each as a new partition.

      {:ok, dataset, report} =
        Situ.Dataset.derive(dataset, Study.Loudness, output: "Loudness", parallel: 2,
          progress: fn progress -> IO.write("\\r\#{round(100 * progress.done)} %") end)

      Situ.Dataset.Derivation.Report.failures(report)

  Answers with the dataset as it is then, also when sessions failed or the run was cancelled; a dataset that has a file
  is saved after every session. How to write the pipeline, and what happens to a run that is killed:
  `Situ.Dataset.Derivation`. Errors before anything runs: `:partition_exists`, `:no_session`.

  #{Options.docs(Derivation.options())}
  """
  @spec derive(t(), Derivation.Job.compute(), keyword()) ::
          {:ok, t(), Derivation.Report.t()} | {:error, Error.t()}
  def derive(%__MODULE__{} = dataset, compute, opts \\ []) do
    with {:ok, sessions} <- chosen(dataset, opts[:sessions]),
         do: Derivation.run(sessions, compute, dataset.file, {dataset, &taken/3}, opts)
  end

  defp chosen(dataset, nil), do: {:ok, dataset.sessions}

  defp chosen(dataset, names) do
    with nil <- Enum.find_value(names, &unknown(dataset, &1)),
         do: {:ok, Enum.filter(dataset.sessions, &(&1.name in names))}
  end

  defp unknown(dataset, name) do
    case session(dataset, name) do
      {:ok, _} -> nil
      error -> error
    end
  end

  defp taken(dataset, %{name: name}, partition) do
    put = fn session ->
      case Session.partition(session, partition.name) do
        {:ok, _} -> Session.replace(session, partition)
        {:error, _} -> Session.add(session, partition)
      end
    end

    update(dataset, &update_session(&1, name, put))
  end
end
