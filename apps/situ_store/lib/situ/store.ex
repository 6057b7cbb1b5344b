defmodule Situ.Store do
  @moduledoc """
  Recordings store many streams on disk while a pipeline is running. They can be read by time, by index or live, and
  replayed into a pipeline.

      {:ok, store} = Situ.Store.open("recordings/lobby")        # the newest lobby.NNNN
      Situ.Store.streams(store)                                 # names, types, counts, times, sizes, latency
      {:ok, message} = Situ.Store.latest_at(store, "Lobby.Speaking", time)
      store |> Situ.Store.messages("Lobby.Speaking", from: t0, to: t1) |> Enum.each(&IO.inspect/1)
      {:ok, width, bins} = Situ.Store.summary(store, "Lobby.Loudness", t0, t1, 1_500)

  A pipeline records and replays:

      iex> root = Path.join(System.tmp_dir!(), "situ-doc-store")
      iex> {:ok, _report} =
      ...>   Situ.Pipeline.run(fn p ->
      ...>     store = Situ.Store.create(p, "squares", root)
      ...>     numbers = Situ.from_enumerable(p, 1..3, every: Situ.Time.ms(10))
      ...>     numbers |> Situ.map(&(&1 * &1)) |> Situ.Store.write(store, "Square")
      ...>   end, pipeline: [replay: [interval: {0, :unbounded}, speed: :max]])
      iex> {:ok, store} = Situ.Store.open(Path.join(root, "squares"))
      iex> Enum.map(Situ.Store.messages(store, "Square"), & &1.data)
      [1, 4, 9]
      iex> Situ.Store.delete(store.path)
      :ok

  An external file (WAV, CSV, MP4 and other media, and every other `Situ.Recording.Format`) opens in the same way.
  Use `Situ.Store.Writer` to write without a pipeline, and `Situ.Store.Summary` to draw timelines. The file format is
  described in `priv/schema/store.md`.

  Reading treats files as untrusted: it verifies checksums, creates no atoms or functions from a file, and bounds its
  memory use. Data of a struct that this system does not have becomes a map with the key `"__struct__"`. Bytes of an
  unknown codec become a `Situ.Store.Undecoded`.
  """

  alias Situ.Recording.Formats

  alias Situ.Store.{
    Columns,
    Copying,
    Editing,
    Exporter,
    Folder,
    Importer,
    Maintenance,
    Query,
    Summary
  }

  alias Situ.{Error, Message, Options}
  alias Situ.Store.StreamInfo

  @type t :: Situ.Recording.t()
  @type name :: String.t() | StreamInfo.t()

  # Opening

  @doc """
  Opens a store's folder, the newest version of `root/name`, or an external file.

  #{Options.docs(Query.open_options())}
  """
  @spec open(Path.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  defdelegate open(path, opts \\ []), to: Query

  @doc "Works like `open/2`, but raises the error."
  @spec open!(Path.t(), keyword()) :: t()
  defdelegate open!(path, opts \\ []), to: Query

  # In pipelines

  @doc """
  Creates a store that the pipeline records to. Call it during `build`. `path` is the parent folder (the store becomes
  `path/name.NNNN`), or `nil` for a store in memory. Raises the `Situ.Error` if the store cannot be created.

  An endless recording can be split into segments, of which only the latest are kept:

      Situ.Store.create(p, "hall", "recordings", split: Situ.Time.min(10), keep: {:span, Situ.Time.h(2)})

  `split: {:bytes, n}` splits by size. Every segment is a complete store (`hall.0000`, `hall.0001` ...), and
  `Situ.Store.concat/3` joins several into one.

  #{Options.docs(Exporter.create_options())}
  """
  @spec create(Situ.Pipeline.t(), String.t(), Path.t() | nil, keyword()) :: Exporter.t()
  defdelegate create(p, name, path, opts \\ []), to: Exporter

  @doc """
  Records a stream under `name` and returns the stream. If the stream or the store is `nil`, nothing is recorded and the
  stream is returned unchanged, so optional streams and optional recording need no `if`.

  #{Options.docs(Exporter.write_options())}
  """
  @spec write(Situ.Stream.t() | nil, Exporter.t() | nil, String.t(), keyword()) ::
          Situ.Stream.t() | nil
  defdelegate write(stream, exporter, name, opts \\ []), to: Exporter

  @doc """
  Opens a store (a path, or a store from `open/2`) for the pipeline to replay. Call it during `build`.

  #{Options.docs(Importer.open_options())}
  """
  @spec importer(Situ.Pipeline.t(), Path.t() | t(), keyword()) :: Importer.t()
  def importer(p, path, opts \\ []), do: Importer.open_recording(p, path, opts)

  @doc """
  Returns a recorded stream as a stream of the pipeline. Unless the store is still being written, the stream's time span
  is proposed as the pipeline's replay interval.

  #{Options.docs(Importer.stream_options())}
  """
  @spec stream(Importer.t(), String.t(), keyword()) :: Situ.Stream.t()
  defdelegate stream(importer, name, opts \\ []), to: Importer

  # The store

  @doc "Returns `name`, `created`, `closed?`, `live?`, `damage` and more facts about the store."
  @spec info(t()) :: map()
  defdelegate info(store), to: Query

  @doc "Returns whether every stream of the store was closed and the writer finished."
  @spec closed?(t()) :: boolean()
  defdelegate closed?(store), to: Query

  @doc "Returns whether a writer in any process holds the store now."
  @spec live?(t()) :: boolean()
  defdelegate live?(store), to: Query

  @doc "Returns the current streams with their statistics."
  @spec streams(t()) :: [StreamInfo.t()]
  defdelegate streams(store), to: Query

  @doc "Returns one stream with its statistics."
  @spec stream_info(t(), name()) :: {:ok, StreamInfo.t()} | {:error, Error.t()}
  defdelegate stream_info(store, name), to: Query

  @doc "Returns whether the store has a stream of this name."
  @spec has_stream?(t(), String.t()) :: boolean()
  defdelegate has_stream?(store, name), to: Query

  @doc """
  Returns the stream's supplemental metadata, or an error if it has none. As in messages, atoms and structs that this
  system does not have become strings and maps.
  """
  @spec metadata(t(), name()) :: {:ok, term()} | {:error, Error.t()}
  defdelegate metadata(store, name), to: Query

  @doc "Works like `metadata/2`, and checks the metadata against a `Situ.Type`."
  @spec metadata(t(), name(), Situ.Type.t()) :: {:ok, term()} | {:error, Error.t()}
  defdelegate metadata(store, name, type), to: Query

  @doc "Returns the span of originating times of all streams, `{first, last}`, or `nil` if there are no messages."
  @spec interval(t() | [StreamInfo.t()]) :: {Situ.Time.t(), Situ.Time.t()} | nil
  defdelegate interval(store), to: Query

  @doc "Returns the span of creation times of all streams, or `nil`."
  @spec creation_interval(t()) :: {Situ.Time.t(), Situ.Time.t()} | nil
  defdelegate creation_interval(store), to: Query

  @doc "Returns the files that the store's index names but that no longer exist. Their messages cannot be read."
  @spec missing_files(t()) :: [String.t()]
  defdelegate missing_files(store), to: Query

  # Messages

  @doc """
  Returns the messages of a stream as an `Enumerable` that reads in batches on demand.

  #{Options.docs(Query.message_options())}
  """
  @spec messages(t(), name(), keyword()) :: Enumerable.t()
  defdelegate messages(store, name, opts \\ []), to: Query

  @doc """
  Returns the messages of a stream as an `Enumerable` of parts in order. A part with plain numbers is a
  `Situ.Store.Columns` of many thousand messages; any other part is a list of messages.

  #{Options.docs(Columns.PartReader.column_options())}
  """
  @spec columns(t(), name(), keyword()) :: Enumerable.t()
  defdelegate columns(store, name, opts \\ []), to: Columns.PartReader

  @doc """
  Reads up to `limit` messages, starting at a time: `{:ok, messages}`.

  #{Options.docs(Query.read_options())}
  """
  @spec read(t(), name(), keyword()) :: {:ok, [Message.t()]} | {:error, Error.t()}
  defdelegate read(store, name, opts \\ []), to: Query

  @doc """
  Returns the message with this ordinal (0 is the first, -1 the last): `{:ok, message}` or `{:ok, nil}`.

  #{Options.docs(Query.at_options())}
  """
  @spec at(t(), name(), integer(), keyword()) :: {:ok, Message.t() | nil} | {:error, Error.t()}
  defdelegate at(store, name, index, opts \\ []), to: Query

  @doc "Returns the current number of messages in a stream."
  @spec count(t(), name()) :: non_neg_integer()
  defdelegate count(store, name), to: Query

  @doc "Counts the messages with an originating time in `from..to` (both ends included), without reading their data."
  @spec count(t(), name(), Situ.Time.t(), Situ.Time.t()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  defdelegate count(store, name, from, to), to: Query

  @doc "Returns the ordinal of the first message at or after `time`, or the message count if there is none."
  @spec ordinal(t(), name(), Situ.Time.t()) :: {:ok, non_neg_integer()} | {:error, Error.t()}
  defdelegate ordinal(store, name, time), to: Query

  @doc "Returns the last message at or before `time`: `{:ok, message}` or `{:ok, nil}`."
  @spec latest_at(t(), name(), Situ.Time.t()) :: {:ok, Message.t() | nil} | {:error, Error.t()}
  defdelegate latest_at(store, name, time), to: Query

  @doc "Returns the first message at or after `time`: `{:ok, message}` or `{:ok, nil}`."
  @spec first_at(t(), name(), Situ.Time.t()) :: {:ok, Message.t() | nil} | {:error, Error.t()}
  defdelegate first_at(store, name, time), to: Query

  @doc """
  Summarizes the signal of a numeric or audio stream over `from..to` for `pixels` columns: `{:ok, width, bins}`. See
  `Situ.Store.Summary`.
  """
  @spec summary(t(), name(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
          {:ok, width :: pos_integer(), [Summary.bin()]} | {:error, Error.t()}
  defdelegate summary(store, name, from, to, pixels), to: Summary, as: :read_numbers

  @doc "Returns spans of at least `least` ns without a message. Finds only gaps between chunks."
  @spec gaps(t(), name(), Situ.Time.duration()) :: [{Situ.Time.t(), Situ.Time.t()}]
  defdelegate gaps(store, name, least), to: Query

  @doc """
  Requests one message at the next commit: `{:situ_store, tag, {:published, n}}`, or `{:ended, n}` if the writer closed
  or died. `known` is the `n` of the previous message (0 at first). It works across operating system processes without
  polling.
  """
  @spec notify(t(), known :: non_neg_integer(), tag :: non_neg_integer()) :: :ok
  defdelegate notify(store, known \\ 0, tag \\ 0), to: Query

  # Folders

  @doc """
  Returns whether `path` is a store (or the name of a store with versions), an external recording that is a folder, or
  an address. An address is not contacted.
  """
  @spec exists?(Path.t()) :: boolean()
  def exists?(path) do
    here = Path.expand(path)

    Formats.for_address(path) != nil or Folder.resolve_store(here) != nil or
      Formats.for_folder(here) != nil
  end

  @doc "Returns the folder of the newest version of store `name` in `root`, or `nil`."
  @spec newest(String.t(), Path.t()) :: Path.t() | nil
  def newest(name, root), do: Folder.newest_version(name, Path.expand(root))

  @list_options [
    recursive: [type: :boolean, default: false, doc: "Search subfolders, too."]
  ]

  @doc """
  Lists all stores in a folder.

  #{Options.docs(@list_options)}
  """
  @spec list(Path.t(), keyword()) :: [Path.t()]
  def list(root, opts \\ []),
    do: Folder.list_stores(Path.expand(root), Options.validate!(opts, @list_options)[:recursive])

  defdelegate verify(path, opts \\ []), to: Maintenance
  defdelegate repair(path, opts \\ []), to: Maintenance
  defdelegate delete(path), to: Maintenance
  defdelegate rename(path, name), to: Maintenance
  defdelegate copy(from, to, opts \\ []), to: Copying
  defdelegate compact(path, opts \\ []), to: Copying
  defdelegate crop(from, to, opts), to: Copying
  defdelegate concat(from, to, opts \\ []), to: Copying
  defdelegate edit(from, to, edits, opts \\ []), to: Editing
end
