defmodule Situ.Store.Query do
  @moduledoc false
  # Reads open recordings of any format. `Situ.Store` is the public interface and has the documentation.
  alias Situ.{Error, Message, Options, VideoPacket}

  alias Situ.Recording
  alias Situ.Recording.Formats

  alias Situ.Store.{
    Locator,
    NativeErrors,
    NativeFormat,
    SchemaEvolution,
    SegmentedRecording,
    StreamInfo,
    VideoCoder
  }

  @open_options [
    verify: [
      type: {:in, [:all, :small]},
      default: :all,
      doc:
        "`:small` does not verify the checksums of large payloads (images), which makes reading them faster."
    ],
    max_unpacked: [
      type: :pos_integer,
      default: 64 * 1024 * 1024,
      doc:
        "The size limit of decompressed messages in bytes, because a small file may contain very large ones."
    ],
    reader: [
      type: :module,
      doc: "The `Situ.Recording.Format` to use, regardless of the file extension."
    ],
    reader_opts: [type: :keyword, default: [], doc: "Options of that reader."]
  ]

  @envelopes [
    type: :boolean,
    default: false,
    doc: "Leave the data `nil` where decoding is expensive."
  ]

  @packets [
    type: :boolean,
    default: false,
    doc: "Return images that are stored as video as `Situ.VideoPacket`, without decoding them."
  ]

  @message_options [
    from: [type: {:optional, :integer}, doc: "The first originating time."],
    to: [
      type: {:or, [{:optional, :integer}, {:in, [:unbounded]}]},
      doc: "The last originating time (inclusive)."
    ],
    index: [
      type: {:optional, :integer},
      doc: "Start at this ordinal. A negative ordinal counts from the end."
    ],
    type: [
      type: :any,
      doc:
        "The requested type: a `Situ.Type` that matches the recorded type, or a struct whose fields " <>
          "may have changed since recording."
    ],
    skip_damage: [
      type: :boolean,
      default: false,
      doc: "Skip damaged chunks. Otherwise the `Situ.Error` is raised."
    ],
    envelopes: @envelopes,
    packets: @packets
  ]

  @read_options @message_options ++
                  [
                    limit: [
                      type: :pos_integer,
                      default: 1_000,
                      doc: "The maximum number of messages."
                    ]
                  ]
  @at_options [envelopes: @envelopes, packets: @packets]

  # The number of messages per read.
  @batch 1_000

  @type name :: String.t() | StreamInfo.t()

  @spec open_options() :: Options.schema()
  def open_options, do: @open_options
  @spec message_options() :: Options.schema()
  def message_options, do: @message_options
  @spec read_options() :: Options.schema()
  def read_options, do: @read_options
  @spec at_options() :: Options.schema()
  def at_options, do: @at_options

  @spec open(Path.t(), keyword()) :: {:ok, Recording.t()} | {:error, Error.t()}
  def open(path, opts \\ []) do
    with {:ok, opts} <- Options.validate(opts, @open_options),
         {:ok, found, module} <- Locator.find_recording(path, opts[:reader]),
         {:ok, state} <- module.open(found, reader_opts(module, opts)) do
      # The recording of an address keeps it, wherever its files are.
      path = if Formats.for_address(path), do: path, else: found
      {:ok, %Recording{path: path, module: module, state: state}}
    end
  end

  defp reader_opts(module, opts) when module in [NativeFormat, SegmentedRecording],
    do: Keyword.take(opts, [:verify, :max_unpacked]) ++ opts[:reader_opts]

  defp reader_opts(_module, opts), do: opts[:reader_opts]

  @spec open!(Path.t(), keyword()) :: Recording.t()
  def open!(path, opts \\ []), do: unwrap!(open(path, opts))

  @spec info(Recording.t()) :: map()
  def info(%Recording{} = store), do: store.module.info(store.state)

  @spec closed?(Recording.t()) :: boolean()
  def closed?(store), do: info(store).closed?

  @spec live?(Recording.t()) :: boolean()
  def live?(store), do: info(store).live?

  @spec streams(Recording.t()) :: [StreamInfo.t()]
  def streams(%Recording{} = store), do: store.module.streams(store.state)

  @spec stream_info(Recording.t(), name()) :: {:ok, StreamInfo.t()} | {:error, Error.t()}
  def stream_info(_store, %StreamInfo{} = info), do: {:ok, info}

  def stream_info(store, name) when is_binary(name) do
    if Recording.implements?(store, :stream, 2),
      do: store.module.stream(store.state, name),
      else: find_by_name(streams(store), name, store)
  end

  defp find_by_name(all, name, store) do
    case Enum.find(all, &(&1.name == name)) do
      nil -> {:error, NativeErrors.no_stream_error(name, Enum.map(all, & &1.name), store.path)}
      info -> {:ok, info}
    end
  end

  @spec has_stream?(Recording.t(), String.t()) :: boolean()
  def has_stream?(store, name), do: match?({:ok, _}, stream_info(store, name))

  @spec metadata(Recording.t(), name()) :: {:ok, term()} | {:error, Error.t()}
  def metadata(store, name) do
    with {:ok, info} <- stream_info(store, name), do: StreamInfo.metadata(info)
  end

  @spec metadata(Recording.t(), name(), Situ.Type.t()) :: {:ok, term()} | {:error, Error.t()}
  def metadata(store, name, type) do
    with {:ok, term} <- metadata(store, name) do
      if Situ.Type.valid_value?(type, term),
        do: {:ok, term},
        else:
          {:error,
           Error.new(:type_mismatch, "the metadata of #{inspect(name)} is not #{inspect(type)}")}
    end
  end

  @spec messages(Recording.t(), name(), keyword()) :: Enumerable.t()
  def messages(store, name, opts \\ []) do
    opts = Options.validate!(opts, @message_options)
    info = unwrap!(stream_info(store, name))
    read = batch_reader(store, info, opts)

    Stream.resource(
      fn -> first_ordinal(store, info, opts) end,
      fn ordinal ->
        case read.(ordinal, @batch) do
          {[], _} -> {:halt, ordinal}
          batch -> batch
        end
      end,
      fn _ -> :ok end
    )
  end

  defp batch_reader(store, info, opts) do
    type = if opts[:envelopes], do: nil, else: opts[:type]
    upgrade = SchemaEvolution.build_upgrade!(info, type)
    to = opts[:to] || :unbounded

    fn ordinal, size ->
      case read_batch(store, info, ordinal, to, size, opts) do
        {:ok, messages, next} -> {upgrade.(messages), next}
        {:error, error} -> raise error
      end
    end
  end

  @doc "Returns the ordinal at which reading with these options begins."
  @spec first_ordinal(Recording.t(), StreamInfo.t(), keyword()) :: non_neg_integer()
  def first_ordinal(store, info, opts) do
    cond do
      index = opts[:index] -> if index < 0, do: max(count(store, info) + index, 0), else: index
      from = opts[:from] -> unwrap!(seek_ordinal(store, info, from))
      true -> 0
    end
  end

  defp unwrap!({:ok, value}), do: value
  defp unwrap!({:error, error}), do: raise(error)

  @spec read(Recording.t(), name(), keyword()) :: {:ok, [Message.t()]} | {:error, Error.t()}
  def read(store, name, opts \\ []) do
    with {:ok, opts} <- Options.validate(opts, @read_options) do
      {limit, opts} = Keyword.pop(opts, :limit)
      info = unwrap!(stream_info(store, name))
      read = batch_reader(store, info, [total: limit] ++ opts)
      {:ok, read |> read_batches(first_ordinal(store, info, opts), limit) |> Enum.take(limit)}
    end
  rescue
    error in Error -> {:error, error}
  end

  defp read_batches(_read, _ordinal, limit) when limit <= 0, do: []

  defp read_batches(read, ordinal, limit) do
    case read.(ordinal, min(limit, @batch)) do
      {[], _} -> []
      {messages, next} -> messages ++ read_batches(read, next, limit - length(messages))
    end
  end

  @spec at(Recording.t(), name(), integer(), keyword()) ::
          {:ok, Message.t() | nil} | {:error, Error.t()}
  def at(store, name, index, opts \\ []) do
    with {:ok, opts} <- Options.validate(opts, @at_options),
         {:ok, info} <- stream_info(store, name) do
      read_message(store, info, if(index < 0, do: count(store, info) + index, else: index), opts)
    end
  end

  defp read_message(store, info, ordinal, opts \\ [])
  defp read_message(_store, _info, ordinal, _opts) when ordinal < 0, do: {:ok, nil}

  defp read_message(store, info, ordinal, opts) do
    {to, opts} = Keyword.pop(opts, :to, :unbounded)

    with {:ok, messages, _} <- read_batch(store, info, ordinal, to, 1, [exact: true] ++ opts),
         do: {:ok, List.first(messages)}
  end

  @spec count(Recording.t(), name()) :: non_neg_integer()
  def count(store, %StreamInfo{} = info) do
    if Recording.implements?(store, :count, 2),
      do: store.module.count(store.state, info),
      else: unwrap!(stream_info(store, info.name)).count
  end

  def count(store, name), do: unwrap!(stream_info(store, name)).count

  @spec count(Recording.t(), name(), Situ.Time.t(), Situ.Time.t()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def count(store, name, from, to) do
    with {:ok, first} <- ordinal(store, name, from),
         {:ok, next} <- ordinal(store, name, to + 1),
         do: {:ok, max(next - first, 0)}
  end

  @spec ordinal(Recording.t(), name(), Situ.Time.t()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def ordinal(store, name, time) do
    with {:ok, info} <- stream_info(store, name), do: seek_ordinal(store, info, time)
  end

  @spec latest_at(Recording.t(), name(), Situ.Time.t()) ::
          {:ok, Message.t() | nil} | {:error, Error.t()}
  def latest_at(store, name, time) do
    with {:ok, info} <- stream_info(store, name) do
      if Recording.implements?(store, :latest_at, 3),
        do: find_latest(store, info, time),
        else: seek_latest(store, info, time)
    end
  end

  # A packet is decoded where it is read by its ordinal.
  defp find_latest(store, info, time) do
    result = store.module.latest_at(store.state, info, time)
    packet? = info.type == Situ.Image and match?({:ok, %{data: %VideoPacket{}}}, result)
    if packet?, do: seek_latest(store, info, time), else: result
  end

  defp seek_latest(store, info, time) do
    with {:ok, ordinal} <- seek_ordinal(store, info, time + 1),
         do: read_message(store, info, ordinal - 1, to: time)
  end

  @spec first_at(Recording.t(), name(), Situ.Time.t()) ::
          {:ok, Message.t() | nil} | {:error, Error.t()}
  def first_at(store, name, time) do
    with {:ok, info} <- stream_info(store, name),
         {:ok, ordinal} <- seek_ordinal(store, info, time),
         do: read_message(store, info, ordinal)
  end

  @doc "Returns the ordinal of the first message at or after `time`, or the next new ordinal if there is none."
  @spec seek_ordinal(Recording.t(), StreamInfo.t(), Situ.Time.t()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def seek_ordinal(store, info, time), do: store.module.seek(store.state, info, time)

  @doc "Reads about `limit` messages from an ordinal on, and returns the next ordinal; see `Situ.Recording`."
  @spec read_batch(
          Recording.t(),
          StreamInfo.t(),
          non_neg_integer(),
          Situ.Time.t() | :unbounded,
          pos_integer(),
          keyword()
        ) :: {:ok, [Message.t()], non_neg_integer()} | {:error, Error.t()}
  def read_batch(store, info, ordinal, to, limit, opts) do
    result = store.module.read(store.state, info, ordinal, to, limit, opts)
    VideoCoder.decode_batch(store, info, result, {ordinal, to, opts})
  end

  @spec gaps(Recording.t(), name(), Situ.Time.duration()) :: [{Situ.Time.t(), Situ.Time.t()}]
  def gaps(store, name, least) do
    if Recording.implements?(store, :gaps, 3),
      do: store.module.gaps(store.state, unwrap!(stream_info(store, name)), least),
      else: []
  end

  @spec missing_files(Recording.t()) :: [String.t()]
  def missing_files(store) do
    if Recording.implements?(store, :missing_files, 1),
      do: store.module.missing_files(store.state),
      else: []
  end

  @spec notify(Recording.t(), non_neg_integer(), non_neg_integer()) :: :ok
  def notify(store, known \\ 0, tag \\ 0) do
    if Recording.implements?(store, :notify, 4) do
      store.module.notify(store.state, known, self(), tag)
    else
      send(self(), {:situ_store, tag, {:ended, known}})
      :ok
    end
  end

  @spec interval(Recording.t() | [StreamInfo.t()]) :: {Situ.Time.t(), Situ.Time.t()} | nil
  def interval(%Recording{} = store), do: store |> streams() |> interval()
  def interval(streams), do: time_span(streams, & &1.first, & &1.last)

  @spec creation_interval(Recording.t()) :: {Situ.Time.t(), Situ.Time.t()} | nil
  def creation_interval(store),
    do: store |> streams() |> time_span(& &1.first_creation, & &1.last_creation)

  defp time_span(streams, first, last) do
    case Enum.filter(streams, & &1.first) do
      [] -> nil
      some -> {some |> Enum.map(first) |> Enum.min(), some |> Enum.map(last) |> Enum.max()}
    end
  end
end
