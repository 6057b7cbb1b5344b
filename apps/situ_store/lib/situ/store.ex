defmodule Situ.Store do
  @moduledoc """
  Recordings store many streams on disk while a pipeline is running. They can be read by time, by index or live, and
  replayed into a pipeline.

      {:ok, store} = Situ.Store.open("recordings/lobby")        # the newest lobby.NNNN, or all of its segments
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
  described in `priv/schema/store.md` of this app.

  Reading treats files as untrusted: it verifies checksums, creates no atoms or functions from a file, and bounds its
  memory use. Data of a struct that this system does not have becomes a map with the key `"__struct__"`. Bytes of an
  unknown codec become a `Situ.Store.Undecoded`.
  """

  alias Situ.Recording.Formats

  alias Situ.Store.{
    Compaction,
    Copying,
    Editing,
    Exporter,
    Folder,
    Importer,
    Maintenance,
    Moving,
    PartReader,
    Query,
    S3,
    SegmentedRecording,
    Segments,
    Summary
  }

  alias Situ.{Error, Message, Options}
  alias Situ.Store.StreamInfo

  @type t :: Situ.Recording.t()
  @type name :: String.t() | StreamInfo.t()
  @typedoc "A store that a pipeline is writing, as `create/4` returns it."
  @type exporter :: Exporter.t()
  @typedoc "A damaged position: the file, the byte offset, and a description of the damage."
  @type damage :: %{file: String.t(), offset: non_neg_integer(), why: String.t()}
  @typedoc "A change of one message, found by its exact originating time."
  @type edit :: {:upsert, Situ.Time.t(), term()} | {:delete, Situ.Time.t()}

  # Opening

  @doc """
  Opens a store's folder, the newest version of `root/name`, or an external file.

      {:ok, store} = Situ.Store.open("recordings/hall")
      for info <- Situ.Store.streams(store), do: {info.name, info.type, info.count}

  If the newest version is a segment of a recording (`split:` of `create/4`), `root/name` opens all of its segments as
  one recording, over restarts of the recorder. Where a later run of the recorder recorded the same times again, its
  messages replace the earlier ones. `segments/1` lists the segments.

  #{Options.docs(Query.open_options())}

  ## CSV files

  One column of a CSV or TSV file contains times, and every other column becomes a stream. Options of `reader_opts:`:

    * `time:` the name or number (0 is the first) of the time column. Default: the first column whose name looks like a
      time, or else the first column
    * `unit:` `:auto` (default), `:s`, `:ms`, `:us`, `:ns` or `:iso8601`. `:auto` detects ISO 8601, and reads numbers in
      the unit that the column's name contains (`t_ms`, `Timestamp (us)`) or else in seconds
    * `start:` ns added to every time, default 0
    * `separator:` default: `,`, `;` or tab, whichever occurs most often in the first line

  Fields that look like numbers are numbers, and all others are strings. A column is `:integer`, `:float` or `:string`,
  depending on all its fields. An empty field produces no message. Quoting follows RFC 4180. Rows that are invalid or
  whose time does not increase are skipped and reported as damage by `info/1`.
  """
  @spec open(Path.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  defdelegate open(path, opts \\ []), to: Query

  @doc "Works like `open/2`, but raises the error."
  @spec open!(Path.t(), keyword()) :: t()
  defdelegate open!(path, opts \\ []), to: Query

  # In pipelines

  @doc """
  Creates a store that the pipeline records to. Call it during `build`. `path` is the parent folder (the store becomes
  `path/name.NNNN`), or `nil` for a store in memory. The store is closed when the pipeline has completed, whether it
  succeeded or failed. Raises the `Situ.Error` if the store cannot be created.

      Situ.Pipeline.run(fn p ->
        store = Situ.Store.create(p, "hall", "recordings")
        p |> Situ.timer(every: Situ.Time.s(1)) |> Situ.Store.write(store, "Clock")
      end)

  Any process on the machine can read a store in memory while this system is running. It is never written to disk.

  An endless recording can be split into segments, of which only the latest are kept:

      Situ.Store.create(p, "hall", "recordings", split: Situ.Time.min(10), keep: {:span, Situ.Time.h(2)})

  `split: {:bytes, n}` splits by size. Every segment is a complete store (`hall.0000`, `hall.0001` ...), and
  `Situ.Store.open("recordings/hall")` reads all of them as one recording.

  #{Options.docs(Exporter.create_options())}
  """
  @spec create(Situ.Pipeline.t(), String.t(), Path.t() | nil, keyword()) :: exporter()
  defdelegate create(p, name, path, opts \\ []), to: Exporter

  @doc """
  Records a stream under `name` and returns the stream, so it can stand in the middle of a chain of functions. If the
  stream or the store is `nil`, nothing is recorded and the stream is returned unchanged, so optional streams and
  optional recording need no `if`.

      level |> Situ.Store.write(store, "Level") |> Situ.filter(&(&1 > 0.5)) |> Situ.Store.write(store, "Loud")

  Messages are collected for up to 20 ms and committed together, or earlier if a stream has 512 messages or 64 KiB of
  payload (4,096 or 256 KiB if they are numbers, booleans or short binaries). With `durability: :each` (`create/4`),
  every delivery is on disk before the next is processed.

  #{Options.docs(Exporter.write_options())}

  ## Video

  With `encode: :h264`, images are recorded as video: an hour of 1080p takes about 1 GB. Each image keeps its own time
  and sequence id, and reading returns images (with the pixels that a decoder makes of the compressed ones). `:vp8` and
  `:vp9` are possible, too, and replace H.264 with a warning if FFmpeg cannot encode it.

      Situ.Store.write(camera, store, "Camera", encode: {:h264, quality: 20, keyframe_every: Situ.Time.s(1)})

  | option | |
  |---|---|
  | `quality:` | 0 to 51, default 23; lower values mean better quality and larger recordings (x264's CRF) |
  | `bitrate:` | bits per second, instead of a constant quality |
  | `keyframe_every:` | the time between key frames in ns, default 2 s; a jump decodes from the key frame before |
  | `preset:` | `:ultrafast`, `:veryfast` (default), `:fast`, `:medium` or `:slow` |
  | `threads:` | encoder threads; 0 (default): one per core |

  An image is recorded when it is encoded, without waiting for later ones. Images of 16 bits or with transparency are
  refused. A crop begins with the key frame at or before its start, and single images cannot be edited.
  """
  @spec write(Situ.Stream.t() | nil, exporter() | nil, String.t(), keyword()) ::
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

  @doc """
  Returns facts about the store as a map: `name`, `created` (ns or `nil`), `closed?` (whether its writer finished),
  `live?` (whether it is being written now), and `damage` (a list of sentences, or of maps with `offset` and `why`).
  Formats add facts of their own.
  """
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

      iex> root = Path.join(System.tmp_dir!(), "situ-doc-messages")
      iex> {:ok, _report} = Situ.Pipeline.run(fn p ->
      ...>   store = Situ.Store.create(p, "hall", root)
      ...>   p |> Situ.from_enumerable([{10, 0.5}, {20, 0.7}, {30, 0.6}]) |> Situ.Store.write(store, "Level")
      ...> end)
      iex> {:ok, store} = Situ.Store.open(Path.join(root, "hall"))
      iex> for m <- Situ.Store.messages(store, "Level", from: 20), do: {m.originating_time, m.data}
      [{20, 0.7}, {30, 0.6}]
      iex> Situ.Store.delete(store.path)
      :ok

  With `type:`, messages are read as structs that may have changed since they were recorded. Every recorded field must
  still exist, and every new field must have a default (it must not be in `@enforce_keys`); old messages get the
  defaults. All other differences raise the `Situ.Error` `:schema_mismatch` when reading begins.

  #{Options.docs(Query.message_options())}
  """
  @spec messages(t(), name(), keyword()) :: Enumerable.t()
  defdelegate messages(store, name, opts \\ []), to: Query

  @doc """
  Returns the messages of a stream as an `Enumerable` of parts in order. A part with plain numbers is a
  `Situ.Columns` of many thousand messages; any other part is a list of messages.

  #{Options.docs(PartReader.column_options())}
  """
  @spec columns(t(), name(), keyword()) :: Enumerable.t()
  defdelegate columns(store, name, opts \\ []), to: PartReader

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

  @doc "Returns the ordinal of the first message at or after `time`, or the next new ordinal if there is none."
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

  @doc """
  Returns the folder of the newest version of store `name` in `root`, or `nil`. If that is a segment, returns
  `root/name`, which opens all segments.
  """
  @spec newest(String.t(), Path.t()) :: Path.t() | nil
  def newest(name, root) do
    path = root |> Path.expand() |> Path.join(name)
    if Segments.segmented?(path), do: path, else: Folder.newest_version(name, Path.dirname(path))
  end

  @list_options [
    recursive: [type: :boolean, default: false, doc: "Search subfolders, too."],
    segments: [
      type: :boolean,
      default: false,
      doc: "List the segments of a segmented recording, instead of the recording."
    ]
  ]

  @doc """
  Lists all stores in a folder, or the recordings at an address. A segmented recording is listed as `ROOT/NAME`.

  #{Options.docs(@list_options)}
  """
  @spec list(Path.t(), keyword()) :: [Path.t()]
  def list(root, opts \\ []) do
    opts = Options.validate!(opts, @list_options)

    case Formats.for_address(root) do
      nil -> list_folder(Path.expand(root), opts)
      S3 -> Situ.Error.unwrap!(S3.list(root, recursive: opts[:recursive]))
      _ -> Formats.list_recordings(root)
    end
  end

  defp list_folder(root, opts) do
    paths = Folder.list_stores(root, opts[:recursive])
    if opts[:segments], do: paths, else: Segments.combine_segments(paths)
  end

  @typedoc """
  A segment of a recording: its folder, its number, the run of the recorder (`nil` for earlier releases), the wall clock
  at its creation, the span of its originating times (`nil` without messages), the number of its messages, and whether
  it was closed or is being written.
  """
  @type segment :: %{
          path: Path.t(),
          number: non_neg_integer(),
          run: String.t() | nil,
          created: Situ.Time.t(),
          first: Situ.Time.t() | nil,
          last: Situ.Time.t() | nil,
          count: non_neg_integer(),
          closed?: boolean(),
          live?: boolean()
        }

  @doc "Returns the segments of a segmented recording, oldest first, or an empty list for any other recording."
  @spec segments(t()) :: [segment()]
  def segments(%{module: SegmentedRecording} = store), do: SegmentedRecording.list_segments(store)
  def segments(_store), do: []

  @doc """
  Reads the complete store and verifies all checksums: `{:ok, %{chunks, damage}}`.

  #{Options.docs(Maintenance.verify_options())}
  """
  @spec verify(Path.t(), keyword()) ::
          {:ok, %{chunks: non_neg_integer(), damage: [damage()]}} | {:error, Error.t()}
  defdelegate verify(path, opts \\ []), to: Maintenance

  @doc """
  Repairs a store that was not closed or is damaged, and returns `{:ok, report}`.

  An intact store that was merely not closed is trimmed and marked as closed. All readable chunks are kept. Data files
  are not rewritten, except for damaged extent headers. The old index is kept as `index.situ.before-repair`, with a
  number appended if that file exists.

  | key of the report | meaning |
  |---|---|
  | `kept` | chunks in the repaired store |
  | `dropped` | damaged chunks that were removed |
  | `recovered` | chunks whose damaged or lost index entries were rebuilt from the data; only chunks that are known to have been committed |
  | `unconfirmed` | chunks of the last commit of a killed writer that were removed, because without the index there is no evidence that the commit was acknowledged |
  | `rebuilt?` | whether the index was rebuilt |
  | `damage` | a list of `t:damage/0` |

  #{Options.docs(Maintenance.repair_options())}
  """
  @spec repair(Path.t(), keyword()) :: {:ok, map()} | {:error, Error.t()}
  defdelegate repair(path, opts \\ []), to: Maintenance

  @doc """
  Deletes a store's files, and its folder if it contains nothing else. Deletes all segments of a segmented
  recording, the oldest first. Fails while the store is being written.
  """
  @spec delete(Path.t()) :: :ok | {:error, Error.t()}
  defdelegate delete(path), to: Maintenance

  @doc """
  Renames a store (its folder, which becomes the next version of the new name): `{:ok, new_path}`. All segments of a
  segmented recording get the new name, which must be free. If the program is killed in between, both names return the
  error `:rename_interrupted`, and `repair/2` or another call completes it.
  """
  @spec rename(Path.t(), String.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  defdelegate rename(path, name), to: Maintenance

  @doc """
  Moves a recording to another folder, also on another file system: `{:ok, new_path}`. All segments of a segmented
  recording move, and the annotations and bookmarks next to it. Everything keeps its name, which must be free. If the
  program is killed in between, both paths return the error `:move_interrupted`, and another call completes it.

  Options:
  #{Options.docs(Moving.move_options())}
  """
  @spec move(Path.t(), Path.t(), keyword()) :: {:ok, Path.t()} | {:error, Error.t()}
  defdelegate move(path, folder, opts \\ []), to: Moving

  @doc """
  Copies a store (or an external file) into a new one: `{:ok, path}`.

  `to` is `{name, root}`, or a path whose last part is the name. By default the copy becomes a new version of that
  name.

  #{Options.docs(Copying.copy_options())}
  """
  @spec copy(Path.t(), Path.t() | {String.t(), Path.t()}, keyword()) ::
          {:ok, Path.t()} | {:error, Error.t()}
  defdelegate copy(from, to, opts \\ []), to: Copying

  @doc """
  Rewrites a store in place: combines many small commits into full chunks, and drops gaps and retracted data. Returns
  `{:ok, path}`.

  The new store is complete and on disk before the two stores exchange their names in one step. The old store is deleted
  last. If the program is killed during compaction, the recording keeps its name. On a file system that cannot exchange
  names, the old store may remain as `NAME.before-compaction`, and `repair/2` restores it. Damage is an error unless
  `skip_damage: true` is given. The segments of a segmented recording are rewritten one by one and remain segments.

  #{Options.docs(Compaction.compact_options())}
  """
  @spec compact(Path.t(), keyword()) :: {:ok, Path.t()} | {:error, Error.t()}
  defdelegate compact(path, opts \\ []), to: Compaction

  @doc """
  Copies an interval: `from:` and `to:` (times), or `start:` and `length:`. Takes these options and those of `copy/3`.

  #{Options.docs(Copying.interval_options())}
  """
  @spec crop(Path.t(), Path.t() | {String.t(), Path.t()}, keyword()) ::
          {:ok, Path.t()} | {:error, Error.t()}
  defdelegate crop(from, to, opts), to: Copying

  @doc """
  Concatenates several stores into one. Streams of the same name are appended in time order. They must have the same
  type and must not overlap. Takes the options of `copy/3`.
  """
  @spec concat([Path.t()], Path.t() | {String.t(), Path.t()}, keyword()) ::
          {:ok, Path.t()} | {:error, Error.t()}
  defdelegate concat(paths, to, opts \\ []), to: Copying

  @doc """
  Creates a new store with edits applied by exact originating time. `edits` is a map of stream names to
  `[{:upsert, time, data} | {:delete, time}]`. An upsert replaces the message at that time or inserts one. Its data must
  match the stream's type. Everything else is copied unchanged.

  #{Options.docs(Editing.edit_options())}
  """
  @spec edit(Path.t(), Path.t() | {String.t(), Path.t()}, %{String.t() => [edit()]}, keyword()) ::
          {:ok, Path.t()} | {:error, Error.t()}
  defdelegate edit(from, to, edits, opts \\ []), to: Editing
end
