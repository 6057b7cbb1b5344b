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
  recording. A dataset is a plain value: edits answer `{:ok, dataset}`, and with `autosave: true` are on disk by
  then (whole or not at all); else `unsaved?` is true. `Situ.Dataset.Server` is a process that holds one for several
  users and tells them of changes.

  | to | see |
  |---|---|
  | read the streams of a session | `Situ.Dataset.OpenSession` |
  | replay a session in a pipeline | `Situ.Dataset.Importer` |
  | know spans, sizes, counts | `summary/1`, `Situ.Dataset.Session.summary/1`, `Situ.Dataset.Partition.summary/1` |
  | know what is missing or damaged | `troubles/1` |
  """
  alias Situ.Dataset.{
    Checksum,
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
            extra: %{}

  @type t :: %__MODULE__{
          name: String.t(),
          file: Path.t() | nil,
          autosave?: boolean(),
          unsaved?: boolean(),
          sessions: [Session.t()],
          metadata: map(),
          tags: [String.t()],
          extra: map()
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

    with {:ok, found} <- Document.read(path) do
      file = if Path.extname(path) == ".pds", do: nil, else: path
      autosaving(struct!(__MODULE__, found), file, (opts[:autosave] && file != nil) || false)
    end
  end

  @doc "Writes the dataset to its file, whole or not at all. Error: `:no_file`, `:not_saved`."
  @spec save(t()) :: result()
  def save(%__MODULE__{file: nil}) do
    {:error,
     Error.new(:no_file, "the dataset has no file yet", fix: "save it with `save_as/2` (or -o)")}
  end

  def save(%__MODULE__{file: file} = dataset) do
    with :ok <- write(file, Document.render(dataset, file)),
         do: {:ok, %{dataset | unsaved?: false}}
  end

  @doc "Writes the dataset to another file, which is its own from now on; paths in it are relative to that."
  @spec save_as(t(), Path.t()) :: result()
  def save_as(%__MODULE__{} = dataset, path), do: save(%{dataset | file: Path.expand(path)})

  defp write(path, text) do
    temporary = "#{path}.#{System.pid()}-#{System.unique_integer([:positive])}.tmp"

    with :ok <- File.mkdir_p(Path.dirname(path)),
         {:ok, device} <- :file.open(temporary, [:write, :raw, :binary, :exclusive]),
         :ok <- synced(device, text),
         :ok <- File.rename(temporary, path) do
      :ok
    else
      {:error, reason} ->
        _ = File.rm(temporary)

        {:error,
         Error.new(:not_saved, "the dataset cannot be saved to #{path}",
           why: to_string(:file.format_error(reason)),
           fix: "the file has not changed; check the folder, or save elsewhere"
         )}
    end
  end

  # Through :file, whose errors are values: :file.write/2 to a full disk answers :enospc.
  defp synced(device, text) do
    with :ok <- :file.write(device, text), do: :file.sync(device)
  after
    :file.close(device)
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
    progress = opts[:progress] || fn _, _ -> :ok end
    total = dataset.sessions |> Enum.map(&length(&1.partitions)) |> Enum.sum()
    counted = :counters.new(1, [])

    sealed =
      Enum.reduce_while(dataset.sessions, {:ok, []}, fn session, {:ok, done} ->
        case seal_all(session.partitions, [], fn -> count(counted, total, progress) end) do
          {:ok, partitions} -> {:cont, {:ok, [%{session | partitions: partitions} | done]}}
          {:error, error} -> {:halt, {:error, error}}
        end
      end)

    with {:ok, sessions} <- sealed, do: commit(%{dataset | sessions: Enum.reverse(sessions)})
  end

  defp seal_all([], done, _tick), do: {:ok, Enum.reverse(done)}

  defp seal_all([partition | rest], done, tick) do
    with {:ok, checksum} <- Checksum.of(partition.path) do
      tick.()
      seal_all(rest, [%{partition | checksum: checksum} | done], tick)
    end
  end

  defp count(counter, total, progress) do
    :counters.add(counter, 1, 1)
    progress.(:counters.get(counter, 1), total)
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

    with {:ok, dataset} <- update_session(dataset, name, put),
         do: if(dataset.file, do: save(dataset), else: {:ok, dataset})
  end
end
