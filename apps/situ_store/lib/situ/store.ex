defmodule Situ.Store do
  alias Situ.Store.{
    Columns,
    Copying,
    Editing,
    Exporter,
    Folder,
    Formats,
    Importer,
    Mending,
    Reading,
    Summary
  }

  @moduledoc """
  Recordings: many streams in one store on disk, written while a pipeline runs, read by time, by index, live, or
  replayed.

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

  A foreign file (WAV, CSV, MP4 and other media, and everything a `Situ.Store.Reader` is known for) opens in the same
  way. Without a pipeline: `Situ.Store.Writer`. For timelines: `Situ.Store.Summary`. The bytes:
  `priv/schema/store.md`.

  Reading trusts nothing: checksums are verified, no atoms or functions come out of a file, memory is bounded. Data of
  a struct that this system does not have is a map with the key `"__struct__"`; bytes of an unknown codec are a
  `Situ.Store.Undecoded`.
  """
  alias Situ.{Error, Message, Options}
  alias Situ.Store.{Handle, StreamInfo}

  @type t :: Handle.t()
  @type name :: String.t() | StreamInfo.t()

  # Opening

  @doc """
  Opens a store's folder, the newest version of `root/name`, or a foreign file.

  #{Options.docs(Reading.open_options())}
  """
  @spec open(Path.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  defdelegate open(path, opts \\ []), to: Reading

  @doc "As `open/2`, but raises the error."
  @spec open!(Path.t(), keyword()) :: t()
  defdelegate open!(path, opts \\ []), to: Reading

  # In pipelines

  @doc """
  During `build`: a new store that the pipeline records to. `path` is the folder it goes to (`path/name.NNNN`), or
  `nil` for a store in memory. Raises the `Situ.Error` when it cannot be made.

  A recording without end is made in pieces, of which the latest are kept:

      Situ.Store.create(p, "hall", "recordings", split: Situ.Time.minutes(10), keep: {:span, Situ.Time.hours(2)})

  `split: {:bytes, n}` cuts by size. Every piece is a whole store (`hall.0000`, `hall.0001` ...);
  `Situ.Store.concat/3` makes one of several.

  #{Options.docs(Exporter.create_options())}
  """
  @spec create(Situ.Pipeline.t(), String.t(), Path.t() | nil, keyword()) :: Exporter.t()
  defdelegate create(p, name, path, opts \\ []), to: Exporter

  @doc """
  Records a stream under `name`; returns the stream. No stream (`nil`) is not recorded and stays `nil`, and without a
  store (`nil`) nothing is recorded: an application's optional streams and optional recording need no `if`.

  #{Options.docs(Exporter.write_options())}
  """
  @spec write(Situ.Stream.t() | nil, Exporter.t() | nil, String.t(), keyword()) ::
          Situ.Stream.t() | nil
  defdelegate write(stream, exporter, name, opts \\ []), to: Exporter

  @doc """
  During `build`: a store (its path, or what `open/2` gave) that the pipeline replays.

  #{Options.docs(Importer.options())}
  """
  @spec importer(Situ.Pipeline.t(), Path.t() | t(), keyword()) :: Importer.t()
  def importer(p, path, opts \\ []), do: Importer.open(p, path, opts)

  @doc """
  A recorded stream as a stream of the pipeline. Its span is proposed as the pipeline's replay interval (not while it
  is being written).

  #{Options.docs(Importer.stream_options())}
  """
  @spec stream(Importer.t(), String.t(), keyword()) :: Situ.Stream.t()
  defdelegate stream(importer, name, opts \\ []), to: Importer

  # The store

  @doc "`name`, `created`, `closed?`, `live?`, `damage` and more of the store."
  @spec info(t()) :: map()
  defdelegate info(store), to: Reading

  @doc "Whether every stream of the store was closed and the writer finished."
  @spec closed?(t()) :: boolean()
  defdelegate closed?(store), to: Reading

  @doc "Whether a writer in some process holds the store now."
  @spec live?(t()) :: boolean()
  defdelegate live?(store), to: Reading

  @doc "The streams there are now, with their statistics."
  @spec streams(t()) :: [StreamInfo.t()]
  defdelegate streams(store), to: Reading

  @doc "One stream, with its statistics."
  @spec stream_info(t(), name()) :: {:ok, StreamInfo.t()} | {:error, Error.t()}
  defdelegate stream_info(store, name), to: Reading

  @doc "Whether the store has such a stream."
  @spec has_stream?(t(), String.t()) :: boolean()
  defdelegate has_stream?(store, name), to: Reading

  @doc """
  The stream's supplemental metadata; an error when it has none. Atoms and structs that this system does not have are
  strings and maps, as in messages.
  """
  @spec metadata(t(), name()) :: {:ok, term()} | {:error, Error.t()}
  defdelegate metadata(store, name), to: Reading

  @doc "As `metadata/2`, checked against a `Situ.Type`."
  @spec metadata(t(), name(), Situ.Type.t()) :: {:ok, term()} | {:error, Error.t()}
  defdelegate metadata(store, name, type), to: Reading

  @doc "The originating times all streams span, `{first, last}`, or `nil` when there is no message."
  @spec interval(t() | [StreamInfo.t()]) :: {Situ.Time.t(), Situ.Time.t()} | nil
  defdelegate interval(store), to: Reading

  @doc "The creation times all streams span, or `nil`."
  @spec creation_interval(t()) :: {Situ.Time.t(), Situ.Time.t()} | nil
  defdelegate creation_interval(store), to: Reading

  @doc "Files of the store that its index names and that are not there (any more): their messages cannot be read."
  @spec missing_files(t()) :: [String.t()]
  defdelegate missing_files(store), to: Reading

  # Messages

  @doc """
  The messages of a stream as an `Enumerable`, read in batches as they are taken.

  #{Options.docs(Reading.message_options())}
  """
  @spec messages(t(), name(), keyword()) :: Enumerable.t()
  defdelegate messages(store, name, opts \\ []), to: Reading

  @doc """
  The messages of a stream as an `Enumerable` of parts in order: a `Situ.Store.Columns` where messages are plain numbers
  (many thousand at once), else a list of messages.

  #{Options.docs(Columns.Reading.options())}
  """
  @spec columns(t(), name(), keyword()) :: Enumerable.t()
  defdelegate columns(store, name, opts \\ []), to: Columns.Reading

  @doc """
  Up to `limit` messages from a time on: `{:ok, messages}`.

  #{Options.docs(Reading.read_options())}
  """
  @spec read(t(), name(), keyword()) :: {:ok, [Message.t()]} | {:error, Error.t()}
  defdelegate read(store, name, opts \\ []), to: Reading

  @doc """
  The message with this ordinal (0 is the first, -1 the last): `{:ok, message}` or `{:ok, nil}`.

  #{Options.docs(Reading.at_options())}
  """
  @spec at(t(), name(), integer(), keyword()) :: {:ok, Message.t() | nil} | {:error, Error.t()}
  defdelegate at(store, name, index, opts \\ []), to: Reading

  @doc "The number of messages in a stream now."
  @spec count(t(), name()) :: non_neg_integer()
  defdelegate count(store, name), to: Reading

  @doc "The number of messages whose originating time lies in `from..to`, both ends included; their data are not read."
  @spec count(t(), name(), Situ.Time.t(), Situ.Time.t()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  defdelegate count(store, name, from, to), to: Reading

  @doc "The ordinal of the first message at or after `time`; the count when there is none."
  @spec ordinal(t(), name(), Situ.Time.t()) :: {:ok, non_neg_integer()} | {:error, Error.t()}
  defdelegate ordinal(store, name, time), to: Reading

  @doc "The last message at or before `time`: `{:ok, message}` or `{:ok, nil}`."
  @spec latest_at(t(), name(), Situ.Time.t()) :: {:ok, Message.t() | nil} | {:error, Error.t()}
  defdelegate latest_at(store, name, time), to: Reading

  @doc "The first message at or after `time`: `{:ok, message}` or `{:ok, nil}`."
  @spec first_at(t(), name(), Situ.Time.t()) :: {:ok, Message.t() | nil} | {:error, Error.t()}
  defdelegate first_at(store, name, time), to: Reading

  @doc """
  The signal of a numeric or audio stream over `from..to`, folded for `pixels` columns: `{:ok, width, bins}`; see
  `Situ.Store.Summary`.
  """
  @spec summary(t(), name(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
          {:ok, width :: pos_integer(), [Summary.bin()]} | {:error, Error.t()}
  defdelegate summary(store, name, from, to, pixels), to: Summary, as: :numbers

  @doc "Spans of at least `least` ns without a message, as far as the index tells (between chunks)."
  @spec gaps(t(), name(), Situ.Time.duration()) :: [{Situ.Time.t(), Situ.Time.t()}]
  defdelegate gaps(store, name, least), to: Reading

  @doc """
  Asks to be told once of the next commit: `{:situ_store, tag, {:published, n}}`, or `{:ended, n}` when the writer
  closed or died. `known` is the `n` of the last news (0 at first). Works across operating system processes, without
  polling.
  """
  @spec notify(t(), known :: non_neg_integer(), tag :: non_neg_integer()) :: :ok
  defdelegate notify(store, known \\ 0, tag \\ 0), to: Reading

  # Folders

  @doc """
  Whether `path` is a store (or the name of one with versions), a foreign recording that is a folder, or an address
  (which is not asked).
  """
  @spec exists?(Path.t()) :: boolean()
  def exists?(path) do
    here = Path.expand(path)

    Formats.for_address(path) != nil or Folder.resolve(here) != nil or
      Formats.for_folder(here) != nil
  end

  @doc "The folder of the newest version of store `name` below `root`."
  @spec newest(String.t(), Path.t()) :: Path.t() | nil
  def newest(name, root), do: Folder.newest(name, Path.expand(root))

  @list_options [
    recursive: [type: :boolean, default: false, doc: "Look into the folders below, too."]
  ]

  @doc """
  All stores in a folder.

  #{Options.docs(@list_options)}
  """
  @spec list(Path.t(), keyword()) :: [Path.t()]
  def list(root, opts \\ []),
    do: Folder.all(Path.expand(root), Options.validate!(opts, @list_options)[:recursive])

  defdelegate verify(path, opts \\ []), to: Mending
  defdelegate repair(path, opts \\ []), to: Mending
  defdelegate delete(path), to: Mending
  defdelegate rename(path, name), to: Mending
  defdelegate copy(from, to, opts \\ []), to: Copying
  defdelegate compact(path, opts \\ []), to: Copying
  defdelegate crop(from, to, opts), to: Copying
  defdelegate concat(from, to, opts \\ []), to: Copying
  defdelegate edit(from, to, edits, opts \\ []), to: Editing
end
