defmodule Situ.Store.Exporter do
  @moduledoc false
  # A store that a pipeline is writing, created by `Situ.Store.create/4` and passed to
  # `Situ.Store.write/4`, which document it.
  alias Situ.{Options, Pipeline, Stream}

  alias Situ.Store.{
    Folder,
    KeyRecorder,
    Rotation,
    Query,
    SharedWriter,
    Sink,
    MemoryStores,
    VideoCoder,
    Writer
  }

  alias Situ.Store.Rotation.SplitPoint

  @write_options Keyword.delete(Writer.stream_options(), :type) ++
                   [
                     type: [
                       type: :any,
                       doc: "The `Situ.Type` to record. Default: the stream's type."
                     ],
                     encode: [
                       type: :any,
                       doc:
                         "For a stream of images: record them as video, `:h264`, `:vp8`, `:vp9` or " <>
                           "`{codec, options}`. See the section on video."
                     ],
                     envelopes: [
                       type: :boolean,
                       default: false,
                       doc: "Record only the envelopes; the data become `nil`."
                     ],
                     keys: [
                       type: :boolean,
                       default: false,
                       doc:
                         "Store the sorted keys of the stream's maps in its metadata under `\"keys\"`, so that a " <>
                           "viewer can offer them without reading the recording."
                     ],
                     after_commit: [
                       type: :boolean,
                       default: false,
                       doc:
                         "Return the messages once they are committed, instead of the given stream. Every " <>
                           "delivery is then committed immediately."
                     ],
                     policy: [
                       type: :any,
                       doc:
                         "A `Situ.Delivery`. Default: lossless, regardless of the pipeline's default."
                     ],
                     name: [type: :string, doc: "The component's name."],
                     on_error: [type: :any, doc: "The error policy, as for every component."]
                   ]

  # `path` is the store's folder.
  @create_options [
    split: [
      type: {:or, [:pos_integer, {:tuple, [{:in, [:bytes]}, :pos_integer]}]},
      doc:
        "Record in segments: begin a new store (the next version of the name) after this many ns of " <>
          "originating time, or (`{:bytes, n}`) once a segment occupies this many bytes on disk. A segment " <>
          "then exceeds the limit by the data in flight."
    ],
    keep: [
      type:
        {:or,
         [
           {:tuple, [{:in, [:span]}, :pos_integer]},
           {:tuple, [{:in, [:bytes]}, :pos_integer]}
         ]},
      doc:
        "With `split:`: delete the oldest segments, including segments of earlier runs, to keep at least " <>
          "`{:span, ns}` or at most `{:bytes, n}`. A span is the time recorded in complete segments before " <>
          "the newest, without pauses. For segments split by size, it is the time since they ended, measured " <>
          "by the computer's clock. An incorrect time in a message never causes a deletion."
    ]
  ]

  @enforce_keys [:path, :shared]
  defstruct [:path, :shared, :rotation, eager: false]

  @type t :: %__MODULE__{
          path: Path.t(),
          shared: SharedWriter.t() | nil,
          rotation: {pid(), SplitPoint.t()} | nil,
          eager: boolean()
        }

  @doc false
  @spec write_options() :: Options.schema()
  def write_options, do: @write_options

  @doc false
  @spec create_options() :: Options.schema()
  def create_options, do: @create_options ++ Writer.create_options()

  @doc false
  @spec create(Pipeline.t(), String.t(), Path.t() | nil, keyword()) :: t()
  def create(%Situ.Graph.Handle{} = p, name, root, opts)
      when is_binary(name) and (is_binary(root) or root == nil) and is_list(opts) do
    {root, opts} =
      if root in [nil, ""],
        do: {MemoryStores.root_folder(), [{:volatile, true} | opts]},
        else: {Path.expand(root), opts}

    opts = Options.validate!(opts, create_options())
    {rotation, opts} = Keyword.split(opts, [:split, :keep])

    if rotation[:split],
      do: create_segmented(p, {name, root, opts}, rotation[:split], rotation[:keep]),
      else: create_single_store(p, name, root, opts)
  end

  def create(p, name, root, opts) do
    wrong =
      cond do
        not is_struct(p, Situ.Graph.Handle) -> "the first argument is #{inspect(p, limit: 5)}"
        not is_binary(name) -> "the name is #{inspect(name, limit: 5)}"
        not (is_binary(root) or root == nil) -> "the folder is #{inspect(root, limit: 5)}"
        true -> "the options are #{inspect(opts, limit: 5)}"
      end

    raise ArgumentError,
          "Situ.Store.create/4 takes the pipeline, a name, a folder (nil: in memory) and options, but #{wrong}\n" <>
            ~s|  Write: Situ.Store.create(p, "lobby", "recordings")|
  end

  # `path` is the name without a version, which opens all segments.
  defp create_segmented(p, {name, root, opts}, split, keep) do
    cut = SplitPoint.new(split)

    {:ok, rotation} =
      Rotation.start_link({name, root, Keyword.put(opts, :versioned, true)}, cut, keep)

    :ok = Pipeline.on(p, :completed, fn _report -> Rotation.close_all(rotation) end, rotation)
    :ok = Pipeline.on(p, :abandoned, fn _error -> Rotation.close_all(rotation) end, rotation)
    eager = opts[:durability] == :each
    %__MODULE__{path: Path.join(root, name), shared: nil, rotation: {rotation, cut}, eager: eager}
  end

  defp create_single_store(p, name, root, opts) do
    case Writer.create(name, root, opts) do
      {:ok, writer} ->
        shared = SharedWriter.new(writer)
        :ok = Pipeline.on(p, :completed, fn _report -> SharedWriter.close(shared) end, shared)
        :ok = Pipeline.on(p, :abandoned, fn _error -> discard_if_empty(shared) end, shared)
        %__MODULE__{path: writer.path, shared: shared, eager: opts[:durability] == :each}

      {:error, error} ->
        raise error
    end
  end

  @doc false
  @spec write(Stream.t() | nil, t() | nil, String.t(), keyword()) :: Stream.t() | nil
  def write(nil, _exporter, _name, _opts), do: nil
  def write(%Stream{} = stream, nil, _name, _opts), do: stream

  def write(%Stream{} = stream, %__MODULE__{} = exporter, name, opts) when is_binary(name) do
    opts = Options.validate!(opts, @write_options)
    type = recorded_type(stream, opts)
    written = encode_images(stream, name, opts)

    result =
      if exporter.rotation,
        do: write_segmented(written, exporter, name, stream_options_for(opts, type), opts),
        else: write_single_store(written, exporter, name, stream_options_for(opts, type), opts)

    if opts[:after_commit], do: result, else: stream
  end

  def write(stream, exporter, name, _opts) do
    wrong =
      cond do
        not (is_struct(stream, Stream) or stream == nil) ->
          "the stream is #{inspect(stream, limit: 5)}"

        not (is_struct(exporter, __MODULE__) or exporter == nil) ->
          "the store is #{inspect(exporter, limit: 5)}"

        true ->
          "the name is #{inspect(name, limit: 5)}"
      end

    raise ArgumentError,
          "Situ.Store.write/4 takes a stream, a store from Situ.Store.create/4, and a name, but #{wrong}\n" <>
            ~s|  Write: store = Situ.Store.create(p, "lobby", "recordings"); Situ.Store.write(stream, store, "Level")|
  end

  # By the type of encoded images, readers know that they have to decode them.
  defp recorded_type(stream, opts) do
    cond do
      opts[:encode] -> Situ.Image
      opts[:type] -> opts[:type]
      opts[:envelopes] -> :any
      true -> stream.type
    end
  end

  # The encoder has its own name, and receives the same images as the recording would.
  defp encode_images(stream, name, opts) do
    cond do
      opts[:encode] == nil ->
        stream

      opts[:envelopes] or opts[:after_commit] or opts[:keys] ->
        raise ArgumentError, "encode: cannot be combined with envelopes:, keys: or after_commit:"

      true ->
        own = Keyword.take(component_options(name, opts), [:policy, :on_error])
        name = "Encode " <> String.replace(name, ".", " ")
        VideoCoder.encode_stream(stream, opts[:encode], [name: name] ++ own)
    end
  end

  defp stream_options_for(opts, type) do
    opts |> Keyword.take(Keyword.keys(Writer.stream_options())) |> Keyword.put(:type, type)
  end

  defp write_segmented(stream, exporter, name, of_stream, opts) do
    {rotation, cut} = exporter.rotation
    given = [rotation: {rotation, cut, name, of_stream}, envelopes: opts[:envelopes]]
    add_sink(stream, exporter, given ++ component_options(name, opts), opts)
  end

  defp add_sink(stream, exporter, component, opts) do
    pass? = opts[:after_commit]
    outputs = if pass?, do: [outputs: [out: stream.type]], else: []
    own = [eager: exporter.eager or pass?, pass: pass?] ++ outputs
    written = Situ.via(stream, Sink, own ++ component)
    if pass?, do: written, else: stream
  end

  defp write_single_store(stream, exporter, name, of_stream, opts) do
    shared = exporter.shared

    case Writer.stream(shared.writer, name, of_stream) do
      {:ok, writer_stream} ->
        SharedWriter.add_user(shared)
        given = [shared: shared, stream: writer_stream, envelopes: opts[:envelopes]]
        if opts[:keys], do: record_keys(stream, shared, writer_stream, opts[:metadata])
        add_sink(stream, exporter, given ++ component_options(name, opts), opts)

      {:error, error} ->
        raise error
    end
  end

  # A lossy default policy of the pipeline must not thin out its recording. Recordings are lossless unless the caller
  # requests otherwise.
  defp component_options(name, opts) do
    [policy: Situ.Delivery.unlimited(), name: "Write " <> String.replace(name, ".", " ")]
    |> Keyword.merge(Keyword.take(opts, [:policy, :name, :on_error]))
  end

  defp record_keys(stream, shared, writer_stream, metadata) do
    SharedWriter.add_user(shared)
    own = [shared: shared, stream: writer_stream, metadata: metadata || %{}]
    name = "Keys " <> String.replace(writer_stream.name, ".", " ")
    Situ.via(stream, KeyRecorder, own ++ [name: name, policy: Situ.Delivery.unlimited()])
  end

  # The pipeline never ran. An empty recording would hide the previous version.
  defp discard_if_empty(%{writer: writer} = shared) do
    SharedWriter.close(shared)

    with {:ok, store} <- Query.open(writer.path),
         nil <- Query.interval(store),
         do: Folder.remove_store(writer.path)
  end

  defimpl Inspect do
    def inspect(exporter, _opts) do
      split = if exporter.rotation, do: ", split", else: ""
      "#Situ.Store<writing #{Kernel.inspect(exporter.path)}#{split}>"
    end
  end
end
