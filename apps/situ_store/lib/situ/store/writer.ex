defmodule Situ.Store.Writer do
  @moduledoc """
  Writes a store without a pipeline. `Situ.Store.write/4` uses this interface.

      iex> {:ok, writer} = Situ.Store.Writer.create("notes", System.tmp_dir!() <> "/situ-doc-writer")
      iex> {:ok, stream} = Situ.Store.Writer.stream(writer, "Numbers", type: :integer)
      iex> messages = [%Situ.Message{data: 7, originating_time: 1, creation_time: 2, sequence_id: 1}]
      iex> {:ok, stream} = Situ.Store.Writer.append(stream, messages)
      iex> {:ok, _} = Situ.Store.Writer.close_stream(stream, 1)
      iex> :ok = Situ.Store.Writer.close(writer)
      iex> {:ok, store} = Situ.Store.open(writer.path)
      iex> Enum.map(Situ.Store.messages(store, "Numbers"), & &1.data)
      [7]
      iex> Situ.Store.delete(writer.path)
      :ok

  ## Durability: data loss after a crash

  | `durability:` | the process is killed (-9) | the power fails | cost |
  |---|---|---|---|
  | `:none` | nothing is lost | data not yet written by the kernel, up to about 30 s (Linux's `dirty_expire`); the store opens, `verify` reports the chunks that did not reach the disk and `repair` removes them | none |
  | `{:interval, ms}` | nothing is lost | data committed in the last `ms` or since the previous commit, whichever is longer | an `fdatasync` every `ms` |
  | `:each` | nothing is lost | no messages for which `append/2` has returned | two `fdatasync` per commit: 1 to 10 ms on most disks |

  "Nothing is lost" refers to committed data. Data is committed when `append/2` returns. A pipeline collects data for up
  to 20 ms before it commits (`Situ.Store.write/4`); with `:each`, every delivery is committed immediately. Disks that
  misreport the state of their cache lose more.

  When `append/2` returns, the messages are committed. Readers in any process see them, and a kill of this process does
  not lose them. On an error, none of the messages is written and the writer is unchanged.
  """

  @program "situ #{Mix.Project.config()[:version]}"

  @options [
    versioned: [type: :boolean, default: true, doc: "Create a subfolder `NAME.NNNN`."],
    durability: [
      type: {:or, [{:in, [:none, :each]}, {:tuple, [{:in, [:interval]}, :pos_integer]}]},
      default: :none,
      doc:
        "When commits are synced to disk: `:none`, `{:interval, ms}` or `:each`. It decides which data a power " <>
          "failure can lose (see `Situ.Store.Writer`). A killed process never loses committed data."
    ],
    first_extent: [
      type: :pos_integer,
      default: 4 * 1024 * 1024,
      doc: "The size of the first extent in bytes."
    ],
    max_extent: [
      type: :pos_integer,
      default: 256 * 1024 * 1024,
      doc: "The size of the largest extent in bytes."
    ],
    mode: [
      type: :non_neg_integer,
      doc:
        "The permissions of the recording, as for `File.chmod/2` (`0o600`, `0o644`, ...). Its files get this " <>
          "mode, and its folder gets the same mode plus search permission for readers. Default: `0o640` within " <>
          "the process's file mode mask (`umask`)."
    ],
    volatile: [
      type: :boolean,
      default: false,
      doc: "Record that the store is in memory. `Situ.Store.create/4` sets it."
    ]
  ]
  @stream_options [
    type: [type: :any, default: :any, doc: "The `Situ.Type` of the messages."],
    compression: [
      type: {:in, [:none, :lz4, :zstd]},
      default: :none,
      doc: "The compression of payloads."
    ],
    large: [type: :boolean, default: false, doc: "Store every message in the large extents."],
    metadata: [type: :any, doc: "Supplemental metadata: any plain term."]
  ]

  Situ.Options.add_to_moduledoc(__MODULE__, @options, "Options of `create/3`")
  Situ.Options.add_to_moduledoc(__MODULE__, @stream_options, "Options of `stream/3`")

  # Compression has no dictionary for small messages. Messages of 141 bytes take 125 bytes each
  # with zstd alone, 54 with a dictionary of 16 KiB, and 35 in a chunk of 500. A chunk and its
  # index entry take 176 bytes, so a dictionary saves little where chunks are small and nothing
  # where they are full. `situ store copy --compression zstd` makes full chunks.
  alias Situ.{Error, Message, Options}

  alias Situ.Store.{
    AtomicFile,
    Catalog,
    Codecs,
    NativeErrors,
    Folder,
    Native,
    TermCodec,
    TypeName
  }

  @enforce_keys [:ref, :path, :name]
  defstruct [:ref, :path, :name]
  @type t :: %__MODULE__{ref: reference(), path: Path.t(), name: String.t()}

  defmodule Stream do
    @moduledoc false
    # A stream that is being written. Use the stream returned by `append/2` for the next call.
    @enforce_keys [:writer, :id, :name]
    defstruct [:writer, :id, :name, codecs: %{}, fields: nil]
    @type t :: %__MODULE__{}
  end

  @doc false
  def create_options, do: @options
  @doc false
  def stream_options, do: @stream_options

  @doc "Creates a store `name` in `root` and opens it for writing. The module documentation lists the options."
  @spec create(String.t(), Path.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def create(name, root, opts \\ []) do
    with {:ok, opts} <- Options.validate(opts, @options),
         {:ok, path} <- Folder.create_store_folder(name, root, opts[:versioned], opts[:mode]),
         {:ok, ref} <-
           path
           |> Native.writer_create(
             opts[:first_extent],
             opts[:max_extent],
             native_durability(opts[:durability]),
             opts[:mode]
           )
           |> NativeErrors.wrap_error(path) do
      # Messages on disk can only be found if the folder's name is on disk, too.
      if opts[:durability] != :none, do: AtomicFile.sync_folder(Path.dirname(path))
      writer = %__MODULE__{ref: ref, path: path, name: name}
      record = %{kind: "store", name: name, writer: @program, volatile: opts[:volatile]}

      case append_catalog(writer, record) do
        {:ok, _} -> {:ok, writer}
        error -> give_up(writer, error)
      end
    end
  end

  # Deletes the folder of a recording that failed to start.
  defp give_up(writer, error) do
    _ = close(writer)
    _ = Folder.remove_store(writer.path)
    error
  end

  defp native_durability({:interval, ms}), do: ms
  defp native_durability(other), do: other

  @doc "Adds a stream. Stream names are unique in a store. The module documentation lists the options."
  @spec stream(t(), String.t(), keyword()) :: {:ok, Stream.t()} | {:error, Error.t()}
  def stream(%__MODULE__{} = writer, name, opts \\ []) when is_binary(name) do
    with {:ok, opts} <- Options.validate(opts, @stream_options),
         record = %{
           type: TypeName.format_type(opts[:type]),
           opened: Situ.Time.now(),
           large: opts[:large],
           compression: opts[:compression]
         },
         {:ok, stream} <- add_recorded_stream(writer, name, record),
         :ok <-
           if(Keyword.has_key?(opts, :metadata),
             do: put_metadata(stream, opts[:metadata]),
             else: :ok
           ) do
      {:ok, stream}
    end
  end

  @doc false
  # Adds a stream with the catalog record `record`.
  @spec add_recorded_stream(t(), String.t(), map()) :: {:ok, Stream.t()} | {:error, Error.t()}
  def add_recorded_stream(writer, name, %{compression: compression, large: large?} = record) do
    with {:ok, id} <-
           writer.ref
           |> Native.writer_stream(name, compression, large?)
           |> NativeErrors.wrap_error(writer.path, name),
         {:ok, _} <-
           append_catalog(writer, Map.merge(record, %{kind: "stream", id: id, name: name})) do
      {:ok, %Stream{writer: writer, id: id, name: name}}
    end
  end

  @doc "Sets (or replaces) the stream's supplemental metadata: any plain term."
  @spec put_metadata(Stream.t(), term()) :: :ok | {:error, Error.t()}
  def put_metadata(%Stream{} = stream, term) do
    with {:ok, bytes} <-
           term |> TermCodec.encode() |> NativeErrors.wrap_error(stream.writer.path, stream.name),
         record = %{
           kind: "metadata",
           id: stream.id,
           type: kind_of(term),
           term: Base.encode64(bytes)
         },
         {:ok, _} <- append_catalog(stream.writer, record),
         do: :ok
  end

  defp kind_of(%module{}), do: inspect(module)
  defp kind_of(term) when is_integer(term), do: ":integer"
  defp kind_of(term) when is_float(term), do: ":float"
  defp kind_of(term) when is_boolean(term), do: ":boolean"
  defp kind_of(term) when is_binary(term), do: ":string"
  defp kind_of(term) when is_list(term), do: ":list"
  defp kind_of(term) when is_map(term), do: ":map"
  defp kind_of(term) when is_tuple(term), do: ":tuple"
  defp kind_of(_), do: ":any"

  @doc """
  Appends and commits all messages, or none of them. The next call takes the returned stream. Originating times must
  increase. `creation_time` and `sequence_id` are kept.
  """
  @spec append(Stream.t(), [Message.t()]) :: {:ok, Stream.t()} | {:error, Error.t()}
  def append(stream, []), do: {:ok, stream}

  def append(%Stream{} = stream, messages) do
    if plain_data?(messages),
      do: append_plain(stream, [messages]),
      else: append_runs(stream, messages)
  end

  defp plain_data?([%{data: %{__struct__: _}} | _]), do: false
  defp plain_data?([_ | rest]), do: plain_data?(rest)
  defp plain_data?([]), do: true

  @doc false
  # Appends lists of messages without structs, unchanged.
  @spec append_plain(Stream.t(), [[Message.t()]]) :: {:ok, Stream.t()} | {:error, Error.t()}
  def append_plain(stream, batches) do
    case Native.writer_append(stream.writer.ref, stream.id, batches) do
      {:ok, _} -> {:ok, stream}
      {:error, reason} -> {:error, NativeErrors.to_error(reason, stream.writer.path, stream.name)}
    end
  rescue
    error in ArgumentError -> explain_refusal(batches, stream, error, __STACKTRACE__)
  end

  # Times in a store have 64 bits; recordings of other systems may have any time.
  defp explain_refusal(batches, stream, error, stack) do
    times = for batch <- batches, m <- batch, do: [m.originating_time, m.creation_time]
    far? = &(is_integer(&1) and abs(&1) > 0x7FFFFFFFFFFFFFFF)

    case times |> List.flatten() |> Enum.find(far?) do
      nil ->
        reraise error, stack

      time ->
        {:error,
         Error.new(:bad_time, "a message of #{stream.name} has the time #{time} ns",
           why: "a store supports times from 1677-09-21 to 2262-04-11",
           fix: "remove the message, for example with `situ store crop`"
         )}
    end
  end

  # Appends runs of messages with the same codec (or with none) in one commit.
  defp append_runs(stream, messages) do
    runs = Enum.chunk_by(messages, &Codecs.module_for(&1.data))

    with {:ok, stream} <- record_runs(stream, runs),
         runs = Enum.map(runs, &encode_run(&1, stream)),
         {:ok, _} <-
           stream.writer.ref
           |> Native.writer_append_runs(stream.id, runs)
           |> NativeErrors.wrap_error(stream.writer.path, stream.name),
         do: {:ok, stream}
  rescue
    error in ArgumentError -> explain_refusal([messages], stream, error, __STACKTRACE__)
  end

  # Records codecs and fields, which readers need before the first message that uses them.
  defp record_runs(stream, runs) do
    Enum.reduce_while(runs, {:ok, stream}, fn [first | _] = run, {:ok, stream} ->
      result =
        case Codecs.module_for(first.data) do
          nil -> note_fields(stream, run)
          module -> note_codec(stream, module)
        end

      if match?({:ok, _}, result), do: {:cont, result}, else: {:halt, result}
    end)
  end

  defp encode_run([first | _] = messages, stream) do
    case Codecs.module_for(first.data) do
      nil ->
        {0, messages, []}

      module ->
        encoded =
          for m <- messages,
              do: {m.sequence_id, m.originating_time, m.creation_time, module.encode(m.data)}

        {Map.fetch!(stream.codecs, module), encoded, signal_points(module, messages)}
    end
  end

  defp signal_points(module, messages) do
    if function_exported?(module, :points, 2),
      do: Enum.flat_map(messages, &message_points(module, &1)),
      else: []
  end

  defp message_points(module, message) do
    for {time, min, max, last, count} <- module.points(message.data, message.originating_time),
        do: {time, min / 1, max / 1, last / 1, count}
  end

  defp note_codec(%{codecs: codecs} = stream, module) when is_map_key(codecs, module),
    do: {:ok, stream}

  defp note_codec(%{codecs: codecs} = stream, module) do
    number = map_size(codecs) + 1

    record = %{
      kind: "codec",
      id: stream.id,
      number: number,
      name: module.codec_name(),
      module: Atom.to_string(module)
    }

    with {:ok, _} <- append_catalog(stream.writer, record),
         do: {:ok, %{stream | codecs: Map.put(codecs, module, number)}}
  end

  # Records the first struct's fields, so that a reader detects a changed struct when it opens the stream.
  defp note_fields(%{fields: nil} = stream, messages) do
    case Enum.find(messages, &is_struct(&1.data)) do
      nil ->
        {:ok, stream}

      %{data: %module{} = data} ->
        fields = data |> Map.from_struct() |> Map.keys() |> Enum.map(&to_string/1)

        record = %{
          kind: "fields",
          id: stream.id,
          module: Atom.to_string(module),
          fields: fields
        }

        with {:ok, _} <- append_catalog(stream.writer, record),
             do: {:ok, %{stream | fields: fields}}
    end
  end

  defp note_fields(stream, _messages), do: {:ok, stream}

  @doc "Records that the stream closed at this originating time. Later messages are not replayed."
  @spec close_stream(Stream.t(), Situ.Time.t()) :: {:ok, non_neg_integer()} | {:error, Error.t()}
  def close_stream(%Stream{} = stream, time),
    do: append_catalog(stream.writer, %{kind: "closed", id: stream.id, time: time})

  @doc "Returns the number of bytes written, without the space allocated for later data."
  @spec stored_bytes(t()) :: non_neg_integer()
  def stored_bytes(%__MODULE__{} = writer), do: Native.writer_bytes(writer.ref)

  @doc "Waits until all committed data is on disk."
  @spec sync(t()) :: :ok | {:error, Error.t()}
  def sync(%__MODULE__{} = writer) do
    with {:ok, _} <- writer.ref |> Native.writer_sync() |> NativeErrors.wrap_error(writer.path),
         do: :ok
  end

  @doc "Closes the store: trims unused space, marks it as closed, and releases the lock. May be called repeatedly."
  @spec close(t()) :: :ok | {:error, Error.t()}
  def close(%__MODULE__{} = writer) do
    with {:ok, _} <- writer.ref |> Native.writer_close() |> NativeErrors.wrap_error(writer.path),
         do: :ok
  end

  @doc false
  # Appends a record to stream 0. Its time is now, or just after the last record if the clock was set back.
  @spec append_catalog(t(), map()) :: {:ok, non_neg_integer()} | {:error, Error.t()}
  def append_catalog(writer, record) do
    writer.ref
    |> Native.writer_record(Catalog.encode_record(record), Situ.Time.now())
    |> NativeErrors.wrap_error(writer.path)
  end

  defimpl Inspect do
    def inspect(writer, _opts), do: "#Situ.Store.Writer<#{Kernel.inspect(writer.path)}>"
  end

  defimpl Inspect, for: Stream do
    def inspect(%{writer: %{path: path}, name: name}, _opts),
      do: "#Situ.Store.Writer.Stream<#{Kernel.inspect(name)}, #{Kernel.inspect(path)}>"
  end
end
