defmodule Situ.Store do
  @moduledoc """
  Recordings: many streams in one store on disk, written while a pipeline runs, read by time, by index, live, or replayed.

      {:ok, store} = Situ.Store.open("recordings/lobby")        # the newest lobby.NNNN
      Situ.Store.streams(store)                                 # names, types, counts, times, sizes, latency
      {:ok, message} = Situ.Store.latest_at(store, "Lobby.Speaking", time)
      store |> Situ.Store.messages("Lobby.Speaking", from: t0, to: t1) |> Enum.each(&IO.inspect/1)
      {:ok, width, bins} = Situ.Store.summary(store, "Lobby.Loudness", t0, t1, 1_500)

  A foreign file (WAV, CSV, MP4 and other media, and what `Situ.Store.Reader`s are configured for) opens in the same way.
  Recording and replay in a pipeline: `create/4`, `write/4`, `importer/3`, `stream/3`. Without a pipeline: `Situ.Store.Writer`.

  Reading trusts nothing: checksums are verified, no atoms or functions come out of a file. Data of a struct that this system
  does not have is a map with the key `"__struct__"`; bytes of an unknown codec are a `Situ.Store.Undecoded`.
  """
  alias Situ.{Error, Message, Options}
  alias Situ.Store.{Failure, Folder, Local, Native, Reader, StreamInfo}

  @enforce_keys [:path, :module, :state]
  defstruct [:path, :module, :state]
  @type t :: %__MODULE__{path: Path.t(), module: module(), state: term()}
  @type name :: String.t() | StreamInfo.t()
  @type bin ::
          {start :: Situ.Time.t(), min :: float(), max :: float(), last :: float(),
           count :: pos_integer()}

  @open_options [
    verify: [
      type: {:in, [:all, :small]},
      default: :all,
      doc:
        "`:small` leaves out the checksums of large payloads (images): reading them costs no pass over the bytes."
    ],
    reader: [type: :module, doc: "The `Situ.Store.Reader` to use, whatever the file's ending."],
    reader_opts: [type: :keyword, default: [], doc: "That reader's own options."]
  ]

  @doc """
  Opens a store's folder, the newest version of `root/name`, or a foreign file.

  #{Options.docs(@open_options)}
  """
  @spec open(Path.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def open(path, opts \\ []) do
    with {:ok, opts} <- Options.validate(opts, @open_options),
         {:ok, path, module} <- find(path, opts[:reader]),
         reader_opts = [{:verify, opts[:verify]} | opts[:reader_opts]],
         {:ok, state} <-
           module.open(path, if(module == Local, do: reader_opts, else: opts[:reader_opts])) do
      {:ok, %__MODULE__{path: path, module: module, state: state}}
    end
  end

  defp find(path, reader) do
    path = Path.expand(path)
    folder = Folder.resolve(path)

    cond do
      folder && Folder.store?(folder) -> {:ok, folder, reader || Local}
      reader != nil -> {:ok, path, reader}
      File.regular?(path) -> find_reader(path)
      true -> find_folder(path, folder)
    end
  end

  # A folder with a version's name whose store lost its files is still ours.
  defp find_folder(path, folder) do
    case {Reader.for_folder(path), folder} do
      {{module, path}, _} -> {:ok, path, module}
      {nil, nil} -> {:error, Failure.error(:no_store, path)}
      {nil, folder} -> {:ok, folder, Local}
    end
  end

  defp find_reader(path) do
    case Reader.for_file(path) do
      nil ->
        known = Reader.all() |> Enum.flat_map(& &1.extensions()) |> Enum.join(", ")

        {:error,
         Error.new(:unknown_format, "no reader for #{path}",
           why: "readers are known for #{known} and for store folders",
           fix: "name one with `reader: Module`"
         )}

      module ->
        {:ok, path, module}
    end
  end

  @doc "As `open/2`, but raises the error."
  @spec open!(Path.t(), keyword()) :: t()
  def open!(path, opts \\ []) do
    case open(path, opts) do
      {:ok, store} -> store
      {:error, error} -> raise error
    end
  end

  # In pipelines

  @doc """
  During `build`: a new store that the pipeline records to. `path` is the folder it goes to (`path/name.NNNN`), or `nil` for a store in memory.

  Raises the `Situ.Error` when it cannot be made. Options: as `Situ.Store.Writer.create/3`.
  """
  @spec create(Situ.Pipeline.t(), String.t(), Path.t() | nil, keyword()) ::
          Situ.Store.Exporter.t()
  defdelegate create(p, name, path, opts \\ []), to: Situ.Store.Exporter

  @doc """
  Records a stream under `name`; returns the stream.

  Options: `type:`, `compression:`, `large:`, `metadata:` (see `Situ.Store.Writer.stream/3`), `policy:` (a `Situ.Delivery`; lossless, whatever the pipeline's default), `envelopes: true` (only the
  envelopes), `keys: true` (the keys of the stream's maps are kept in its metadata, see `Situ.Store.Keys`), `on_error:`.
  """
  @spec write(Situ.Stream.t(), Situ.Store.Exporter.t(), String.t(), keyword()) :: Situ.Stream.t()
  defdelegate write(stream, exporter, name, opts \\ []), to: Situ.Store.Exporter

  @doc """
  During `build`: a store (its path, or what `open/2` gave) that the pipeline replays.

  #{Options.docs(Situ.Store.Importer.options())}
  """
  @spec importer(Situ.Pipeline.t(), Path.t() | t(), keyword()) :: Situ.Store.Importer.t()
  def importer(p, path, opts \\ []), do: Situ.Store.Importer.open(p, path, opts)

  @doc """
  A recorded stream as a stream of the pipeline. Its span is proposed as the pipeline's replay interval (not while it is being written).

  #{Options.docs(Situ.Store.Importer.stream_options())}
  """
  @spec stream(Situ.Store.Importer.t(), String.t(), keyword()) :: Situ.Stream.t()
  def stream(importer, name, opts \\ []), do: Situ.Store.Importer.stream(importer, name, opts)

  # Reading

  @doc "`name`, `created`, `closed?`, `live?`, `damage` and more of the store."
  @spec info(t()) :: map()
  def info(%__MODULE__{} = store), do: store.module.info(store.state)

  @doc "The streams there are now, with their statistics."
  @spec streams(t()) :: [StreamInfo.t()]
  def streams(%__MODULE__{} = store), do: store.module.streams(store.state)

  @doc "One stream's metadata."
  @spec stream_info(t(), name()) :: {:ok, StreamInfo.t()} | {:error, Error.t()}
  def stream_info(_store, %StreamInfo{} = info), do: {:ok, info}

  def stream_info(store, name) when is_binary(name) do
    all = streams(store)

    case Enum.find(all, &(&1.name == name)) do
      nil -> {:error, Failure.no_stream(name, Enum.map(all, & &1.name), store.path)}
      info -> {:ok, info}
    end
  end

  @doc "Whether the store has such a stream."
  @spec has_stream?(t(), String.t()) :: boolean()
  def has_stream?(store, name), do: Enum.any?(streams(store), &(&1.name == name))

  @doc """
  The stream's supplemental metadata; an error when it has none. Atoms and structs that this system does not have are strings
  and maps, as in messages.
  """
  @spec metadata(t(), name()) :: {:ok, term()} | {:error, Error.t()}
  def metadata(store, name) do
    with {:ok, info} <- stream_info(store, name), do: supplemental(info)
  end

  defp supplemental(%{supplemental: nil, name: name}),
    do: {:error, Error.new(:no_metadata, "stream #{inspect(name)} has no metadata")}

  defp supplemental(%{supplemental: {_type, bytes}, name: name}) do
    case Local.term(bytes) do
      %Situ.Store.Undecoded{reason: reason} ->
        {:error,
         Error.new(:damaged, "the metadata of #{inspect(name)} cannot be decoded", why: reason)}

      term ->
        {:ok, term}
    end
  end

  @doc "As `metadata/2`, checked against a `Situ.Type`."
  @spec metadata(t(), name(), Situ.Type.t()) :: {:ok, term()} | {:error, Error.t()}
  def metadata(store, name, type) do
    with {:ok, term} <- metadata(store, name) do
      if Situ.Type.valid?(type, term),
        do: {:ok, term},
        else:
          {:error,
           Error.new(:type_mismatch, "the metadata of #{inspect(name)} is not #{inspect(type)}")}
    end
  end

  @reading [
    from: [type: {:optional, :integer}, doc: "The first originating time."],
    to: [
      type: {:or, [{:optional, :integer}, {:in, [:unbounded]}]},
      doc: "The last one; both ends are included."
    ],
    index: [
      type: {:optional, :integer},
      doc: "Start at this ordinal; negative ones count from the end."
    ],
    type: [
      type: :any,
      doc:
        "What the messages have to be: a `Situ.Type` that fits the recorded one, or a struct whose fields may have changed since (`Situ.Store.Evolution`)."
    ],
    skip_damage: [
      type: :boolean,
      doc: "Go on behind damaged chunks; else the `Situ.Error` is raised."
    ],
    envelopes: [
      type: :boolean,
      doc: "The data may be `nil`: a reader that has to decode need not."
    ]
  ]

  @doc """
  The messages of a stream as an `Enumerable`, read in batches as they are taken.

  #{Options.docs(@reading)}
  """
  @spec messages(t(), name(), keyword()) :: Enumerable.t()
  def messages(store, name, opts \\ []) do
    _ = Options.validate!(opts, @reading)
    info = ok!(stream_info(store, name))
    type = if opts[:envelopes], do: nil, else: opts[:type]
    upgrade = Situ.Store.Evolution.upgrade!(info, type)
    to = opts[:to] || :unbounded

    Stream.resource(
      fn -> first_ordinal(store, info, opts) end,
      fn ordinal ->
        case store.module.read(store.state, info, ordinal, to, 1_000, opts) do
          {:ok, [], _} -> {:halt, ordinal}
          {:ok, messages, next} -> {upgrade.(messages), next}
          {:error, error} -> raise error
        end
      end,
      fn _ -> :ok end
    )
  end

  defp first_ordinal(store, info, opts) do
    cond do
      index = opts[:index] -> if index < 0, do: max(count(store, info) + index, 0), else: index
      from = opts[:from] -> ok!(store.module.seek(store.state, info, from))
      true -> 0
    end
  end

  defp ok!({:ok, value}), do: value
  defp ok!({:error, error}), do: raise(error)

  @doc "Up to `limit` messages from a time on: `{:ok, messages}`. Options as `messages/3` and `limit:` (1,000)."
  @spec read(t(), name(), keyword()) :: {:ok, [Message.t()]} | {:error, Error.t()}
  def read(store, name, opts \\ []) do
    {limit, opts} = Keyword.pop(opts, :limit, 1_000)
    {:ok, store |> messages(name, opts) |> Enum.take(limit)}
  rescue
    error in Error -> {:error, error}
  end

  @doc """
  The message with this ordinal (0 is the first, -1 the last): `{:ok, message}` or `{:ok, nil}`. Option `envelopes:` as `messages/3`.
  """
  @spec at(t(), name(), integer(), keyword()) :: {:ok, Message.t() | nil} | {:error, Error.t()}
  def at(store, name, index, opts \\ []) do
    with {:ok, info} <- stream_info(store, name) do
      one(store, info, if(index < 0, do: count(store, info) + index, else: index), opts)
    end
  end

  defp one(store, info, ordinal, opts \\ [])
  defp one(_store, _info, ordinal, _opts) when ordinal < 0, do: {:ok, nil}

  defp one(store, info, ordinal, opts) do
    opts = [exact: true] ++ opts

    with {:ok, messages, _} <-
           store.module.read(store.state, info, ordinal, :unbounded, 1, opts),
         do: {:ok, List.first(messages)}
  end

  @doc "The number of messages in a stream now."
  @spec count(t(), name()) :: non_neg_integer()
  def count(%{module: Local} = store, %StreamInfo{id: id}) do
    Native.reader_refresh(store.state.ref)
    Native.reader_count(store.state.ref, id)
  end

  def count(store, name), do: ok!(stream_info(store, to_name(name))).count

  defp to_name(%StreamInfo{name: name}), do: name
  defp to_name(name), do: name

  @doc "The last message at or before `time`: `{:ok, message}` or `{:ok, nil}`."
  @spec latest_at(t(), name(), Situ.Time.t()) :: {:ok, Message.t() | nil} | {:error, Error.t()}
  def latest_at(store, name, time) do
    with {:ok, info} <- stream_info(store, name),
         {:ok, ordinal} <- store.module.seek(store.state, info, time + 1) do
      one(store, info, ordinal - 1)
    end
  end

  @doc "The first message at or after `time`: `{:ok, message}` or `{:ok, nil}`."
  @spec first_at(t(), name(), Situ.Time.t()) :: {:ok, Message.t() | nil} | {:error, Error.t()}
  def first_at(store, name, time) do
    with {:ok, info} <- stream_info(store, name),
         {:ok, ordinal} <- store.module.seek(store.state, info, time) do
      one(store, info, ordinal)
    end
  end

  @doc """
  The signal of a numeric or audio stream over `from..to`, folded for `pixels` columns: `{:ok, width, bins}`.

  `width` is a power of two nanoseconds, at most `(to - from) / pixels`; bins `{start, min, max, last, count}` start at its
  multiples, so panning reuses them; empty bins are left out. Milliseconds whatever the span. Integers come as floats.
  """
  @spec summary(t(), name(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
          {:ok, width :: pos_integer(), [bin()]} | {:error, Error.t()}
  def summary(store, name, from, to, pixels)
      when is_integer(from) and is_integer(to) and is_integer(pixels) and pixels > 0 do
    with {:ok, info} <- stream_info(store, name) do
      if function_exported?(store.module, :summary, 5),
        do: store.module.summary(store.state, info, from, to, pixels),
        else: Situ.Store.Summary.fold(store, info, from, to, pixels)
    end
  end

  @doc "Spans of at least `least` ns without a message, as far as the index tells (between chunks)."
  @spec gaps(t(), name(), Situ.Time.duration()) :: [{Situ.Time.t(), Situ.Time.t()}]
  def gaps(%{module: Local} = store, name, least),
    do: Local.gaps(store.state, ok!(stream_info(store, name)), least)

  def gaps(_store, _name, _least), do: []

  @doc "Files of the store that its index names and that are not there (any more): their messages cannot be read."
  @spec missing_files(t()) :: [String.t()]
  def missing_files(%{module: Local} = store), do: Local.missing(store.state)
  def missing_files(_store), do: []

  @doc """
  Asks to be told once of the next commit: `{:situ_store, tag, {:published, n}}`, or `{:ended, n}` when the writer closed or
  died. `known` is the `n` of the last news (0 at first). Works across operating system processes, without polling.
  """
  @spec notify(t(), known :: non_neg_integer(), tag :: non_neg_integer()) :: :ok
  def notify(store, known \\ 0, tag \\ 0) do
    if function_exported?(store.module, :await, 4) do
      store.module.await(store.state, known, self(), tag)
    else
      send(self(), {:situ_store, tag, {:ended, known}})
      :ok
    end
  end

  @doc "The originating times all streams span, `{first, last}`, or `nil` when there is no message."
  @spec interval(t() | [StreamInfo.t()]) :: {Situ.Time.t(), Situ.Time.t()} | nil
  def interval(%__MODULE__{} = store), do: store |> streams() |> interval()

  def interval(streams) do
    case Enum.filter(streams, & &1.first) do
      [] ->
        nil

      some ->
        {some |> Enum.map(& &1.first) |> Enum.min(), some |> Enum.map(& &1.last) |> Enum.max()}
    end
  end

  @doc "The creation times all streams span, or `nil`."
  @spec creation_interval(t()) :: {Situ.Time.t(), Situ.Time.t()} | nil
  def creation_interval(store) do
    case store |> streams() |> Enum.filter(& &1.first) do
      [] ->
        nil

      some ->
        {some |> Enum.map(& &1.first_creation) |> Enum.min(),
         some |> Enum.map(& &1.last_creation) |> Enum.max()}
    end
  end

  @doc "Whether `path` is a store (or the name of one with versions), or a foreign recording that is a folder."
  @spec exists?(Path.t()) :: boolean()
  def exists?(path) do
    path = Path.expand(path)
    Folder.resolve(path) != nil or Reader.for_folder(path) != nil
  end

  @doc "Whether every stream of the store was closed and the writer finished."
  @spec closed?(t()) :: boolean()
  def closed?(store), do: info(store).closed?

  @doc "Whether a writer in some process holds the store now."
  @spec live?(t()) :: boolean()
  def live?(store), do: info(store).live?

  @doc "The folder of the newest version of store `name` below `root`."
  @spec newest(String.t(), Path.t()) :: Path.t() | nil
  def newest(name, root), do: Folder.newest(name, Path.expand(root))

  @doc "All stores in a folder; with `recursive: true` below it too."
  @spec list(Path.t(), keyword()) :: [Path.t()]
  def list(root, opts \\ []), do: Folder.all(Path.expand(root), opts[:recursive] == true)

  defdelegate verify(path, opts \\ []), to: Situ.Store.Mending
  defdelegate repair(path, opts \\ []), to: Situ.Store.Mending
  defdelegate copy(from, to, opts \\ []), to: Situ.Store.Copying
  defdelegate crop(from, to, opts), to: Situ.Store.Copying
  defdelegate concat(from, to, opts \\ []), to: Situ.Store.Copying
  defdelegate edit(from, to, edits, opts \\ []), to: Situ.Store.Editing
  defdelegate delete(path), to: Situ.Store.Mending
  defdelegate rename(path, name), to: Situ.Store.Mending
end
