defmodule Situ do
  @moduledoc """
  Programs that see, hear and act in the world, built as pipelines of components connected by timestamped streams.

  This module is the API for writing pipelines. It has functions that add sources, transform streams and combine
  streams. Each function is documented with its options in the module it comes from (`Situ.Fusion`, `Situ.Window`,
  `Situ.Aggregate` ...). `Situ.Pipeline` runs the pipelines.

  ## A first pipeline

  A thermometer is read every 20 ms, and a door sensor reports knocks. What was the temperature at each knock?

      iex> build = fn p ->
      ...>   degrees = Situ.sequence(p, 200, &(&1 + 1), every: Situ.Time.ms(20), count: 50)
      ...>   knocks = Situ.from_enumerable(p, [{Situ.Time.ms(110), :knock}, {Situ.Time.ms(790), :knock}])
      ...>
      ...>   knocks
      ...>   |> Situ.join(degrees, Situ.Reproducible.nearest(Situ.Time.ms(15)))
      ...>   |> Situ.map(fn {:knock, tenths} -> tenths / 10 end)
      ...> end
      iex> Situ.to_list(build, pipeline: [replay: [interval: {0, :unbounded}]])
      [20.6, 24.0]

  `build` describes a graph; nothing runs until a pipeline is started with it. `to_list/2` runs the pipeline to its
  end as fast as possible and collects the stream. Run it again on a busy machine, in real time or at ten times the
  speed, and you get the same values with the same times. The rest of this page explains how.

  ## Messages and time

  A stream carries messages. Each message has data and an **originating time**, the moment in the world that the data
  describes, in integer nanoseconds since 1970 (`Situ.Time`). The originating time of a camera image is its time of
  exposure. A face found in that image 80 ms later has the same originating time, because operators preserve it. The
  time at which a message was created is its *creation time*; the difference is its latency. Within one stream,
  originating times strictly increase.

  Streams are therefore combined by the times that their data describes, not by when messages happen to arrive.
  `join/4` above waited, for each knock, until no later reading could be nearer. Such operators are **reproducible**.
  The few that depend on arrival order or on the clock (`pair/3`, `merge/3`, `latency/2`, `timer/2`, `event_source/3`,
  `fuse/4` with `Situ.Available`) say *Reproducible: no* in their documentation.

  ## Components

  Functions on data (`map/3`, `filter/3`, `scan/4`, statistics, windows) cover most needs. For an operation with its
  own state, several inputs or outputs, a device or a file, write a component, which is a module with pure callbacks
  (`Situ.Component`). These functions add components:

      camera = Situ.source(p, Camera, device: "/dev/video0", name: "Front")            # no inputs
      faces = Situ.via(camera, FaceDetector, min_score: 0.6, policy: Situ.Delivery.latest())
      cropped = Situ.via([image: camera, rect: rectangles], ImageCrop)                 # several inputs

  One keyword list holds the component's own options and its placement options: its name, its delivery policy and its
  reaction to errors (`Situ.Graph.Placement`). A component with several outputs returns a map of streams. Libraries
  wrap this in functions that take the same options (`Situ.Media.Camera.open/2`, `Situ.Infer.voice/2`). `composite/3`
  groups components under one name.

  ## Running

  A program is a module with `build/2`, or a function:

      defmodule Doorbell do
        use Situ.Pipeline

        @impl true
        def build(p, opts) do
          p |> Situ.source(Camera, device: opts[:device]) |> Situ.via(FaceDetector) |> Situ.each(&Bell.ring/1)
        end
      end

      {:ok, report} = Situ.Pipeline.run(Doorbell, device: "porch.mp4")    # to its end, as fast as possible
      children = [{Doorbell, device: "/dev/video0"}]                      # supervised, in real time

  Each component is a process, supervised by its pipeline; a linear chain of light operators shares one process.
  Processes request messages, so memory use stays bounded, and a slow consumer slows down files and generators. A
  camera cannot wait, so a delivery policy decides which images to drop (`Situ.Delivery`). When a component raises,
  its `on_error:` option decides whether to stop the pipeline, skip the message or restart the component. You can
  inspect and change a running pipeline:

  | | |
  |---|---|
  | `Situ.inspect/2`, `Situ.Pipeline.info/1` | queues, latencies and drops of every edge |
  | `attach_tap/3` | the messages of any stream, by its name |
  | `add_input/4`, `remove_input/3` | streams that are added to and removed from a join |
  | `Situ.Pipeline.replace/3`, `Situ.Pipeline.stop_part/3` | a component's module or options; a part of the graph |

  ## Next steps

  Read the guides in this order: *Your first pipeline*, *Writing a component*, *Fusing streams*, *Operators* (every
  function in one table), *Choosing a delivery policy*, *When things fail*, *Situ in your application*. `Situ.Test`
  tests pipelines with a clock that the test advances.
  """
  import Kernel, except: [min: 2, max: 2, abs: 1, inspect: 1, inspect: 2]
  alias Situ.{Argument, Node, Operator, Pipeline, Stream}

  @doc """
  Adds a source and returns its stream, or a map of streams if it has several outputs.

  `opts` are the component's own options and the options of `Situ.Graph.Placement` (`name:`, `on_error:` ...).
  """
  @spec source(Pipeline.t(), module(), keyword()) :: Stream.t() | %{atom() => Stream.t()}
  def source(p, module, opts \\ [])

  def source(%Situ.Graph.Handle{} = p, module, opts),
    do: p |> Pipeline.add(module, opts) |> Node.streams()

  def source(other, module, _opts),
    do: Argument.raise_invalid!(other, :handle, "Situ.source(p, #{Kernel.inspect(module)})")

  @doc """
  Sends a stream (or `[input: stream, ...]`) through a component. Returns the same as `source/3`.

  `opts` are the component's own options and the placement options of `Situ.Graph.Placement` (`name:`, `policy:`,
  `on_error:` ...).
  """
  @spec via(Stream.t() | keyword(Stream.t()), module(), keyword()) ::
          Stream.t() | %{atom() => Stream.t()}
  def via(streams, module, opts \\ [])

  def via(%Stream{} = stream, module, opts) do
    node = Pipeline.add(stream.pipeline, module, opts)
    Pipeline.connect(stream, node, only_input(node))
    Node.streams(node)
  end

  def via([{_, %Stream{} = first} | _] = streams, module, opts) do
    node = Pipeline.add(first.pipeline, module, opts)
    Enum.each(streams, fn {input, stream} -> Pipeline.connect(stream, node, input) end)
    Node.streams(node)
  end

  def via(other, module, _opts),
    do: Argument.raise_invalid!(other, :stream, "Situ.via(stream, #{Kernel.inspect(module)})")

  @doc """
  Groups components under one name. If the first argument is a stream, `fun` receives that stream inside the group.
  The options are `policy:` and `on_error:`; see `Situ.Pipeline.composite/4`.
  """
  @spec composite(Pipeline.t() | Stream.t(), String.t(), (term() -> result), keyword()) :: result
        when result: term()
  def composite(stream, name, fun, opts \\ [])

  def composite(%Situ.Graph.Handle{} = p, name, fun, opts),
    do: Pipeline.composite(p, name, fun, opts)

  def composite(%Stream{} = stream, name, fun, opts),
    do: Pipeline.composite(stream.pipeline, name, fn p -> fun.(%{stream | pipeline: p}) end, opts)

  def composite(other, _name, _fun, _opts) do
    takes = "a stream, or a pipeline that is being built"

    Argument.raise_invalid!(
      other,
      takes,
      ~s|Situ.composite(stream, "Mouth", fn stream -> stream end)|
    )
  end

  @doc "Applies `fun` to the data (or to the data and the message). Options: `Situ.Graph.Placement`."
  @spec map(Stream.t(), (term() -> term()) | (term(), Situ.Message.t() -> term()), keyword()) ::
          Stream.t()
  def map(stream, fun, opts \\ []),
    do: stream |> ensure_stream!("map") |> Operator.attach("Map", {:map, fun}, opts)

  @doc "See `Situ.MapAsync.map_async/3`."
  @spec map_async(Stream.t(), (term() -> term()), keyword()) :: Stream.t()
  defdelegate map_async(stream, fun, opts \\ []), to: Situ.MapAsync

  @doc "Passes only the messages for which `fun` (of the data, or of the data and the message) returns true."
  @spec filter(
          Stream.t(),
          (term() -> boolean()) | (term(), Situ.Message.t() -> boolean()),
          keyword()
        ) ::
          Stream.t()
  def filter(stream, fun, opts \\ []) do
    stream = ensure_stream!(stream, "filter")
    Operator.attach(stream, "Filter", {:filter, fun}, opts, stream.type)
  end

  @doc "Calls `fun` (of the data, or of the data and the message) for its side effect and passes the message through."
  @spec each(Stream.t(), (term() -> any()) | (term(), Situ.Message.t() -> any()), keyword()) ::
          Stream.t()
  def each(stream, fun, opts \\ []) do
    stream = ensure_stream!(stream, "each")
    Operator.attach(stream, "Each", {:each, fun}, opts, stream.type)
  end

  defp ensure_stream!(stream, name),
    do: Argument.ensure_stream!(stream, "Situ.#{name}(stream, fn data -> data end)")

  @doc """
  Folds the stream and emits the accumulator after every message. `fun` is `fun.(data, acc)` or
  `fun.(data, message, acc)`.

  The initial value itself is not emitted.
  """
  @spec scan(
          Stream.t(),
          acc,
          (term(), acc -> acc) | (term(), Situ.Message.t(), acc -> acc),
          keyword()
        ) ::
          Stream.t()
        when acc: term()
  def scan(stream, acc, fun, opts \\ [])

  def scan(%Stream{} = stream, acc, fun, opts) when is_function(fun, 2) do
    step = fn data, _message, acc ->
      acc = fun.(data, acc)
      {:emit, acc, acc}
    end

    Operator.attach(stream, "Scan", {:step, step, acc}, opts)
  end

  def scan(%Stream{} = stream, acc, fun, opts) when is_function(fun, 3) do
    step = fn data, message, acc ->
      acc = fun.(data, message, acc)
      {:emit, acc, acc}
    end

    Operator.attach(stream, "Scan", {:step, step, acc}, opts)
  end

  def scan(other, _acc, _fun, _opts),
    do:
      Argument.raise_invalid!(
        other,
        :stream,
        "Situ.scan(stream, 0, fn data, acc -> data + acc end)"
      )

  @doc "Names a stream; see `Situ.Stream.name/2`."
  @spec name(Stream.t(), String.t()) :: Stream.t()
  defdelegate name(stream, name), to: Stream

  # Fusion: streams combined by time

  @doc "See `Situ.Fusion.join/4`."
  @doc group: "Fusion: streams brought together by time"
  defdelegate join(first, second \\ [], third \\ [], opts \\ []), to: Situ.Fusion

  @doc "See `Situ.Fusion.fuse/4`."
  @doc group: "Fusion: streams brought together by time"
  defdelegate fuse(first, second, third \\ [], opts \\ []), to: Situ.Fusion

  @doc "See `Situ.Fusion.pair/3`."
  @doc group: "Fusion: streams brought together by time"
  defdelegate pair(primary, secondary, opts \\ []), to: Situ.Fusion

  @doc "See `Situ.Fusion.zip/3`."
  @doc group: "Fusion: streams brought together by time"
  defdelegate zip(first, second \\ [], opts \\ []), to: Situ.Fusion

  @doc "See `Situ.Fusion.merge/3`."
  @doc group: "Fusion: streams brought together by time"
  defdelegate merge(first, second \\ [], opts \\ []), to: Situ.Fusion

  @doc "See `Situ.Fusion.add_input/4`."
  @doc group: "Fusion: streams brought together by time"
  defdelegate add_input(fused, key, stream, opts \\ []), to: Situ.Fusion

  @doc "See `Situ.Fusion.remove_input/3`."
  @doc group: "Fusion: streams brought together by time"
  defdelegate remove_input(fused, key, opts \\ []), to: Situ.Fusion

  @doc "See `Situ.Fusion.sample/4`."
  @doc group: "Fusion: streams brought together by time"
  defdelegate sample(stream, clock, interpolator \\ Situ.Interval.infinite(), opts \\ []),
    to: Situ.Fusion

  # Windows

  @doc "See `Situ.Window.window/4`."
  @doc group: "Windows"
  defdelegate window(stream, window, fun \\ nil, opts \\ []), to: Situ.Window

  @doc "See `Situ.Window.window_by/4`."
  @doc group: "Windows"
  defdelegate window_by(stream, windows, interval, opts \\ []), to: Situ.Window

  # Statistics

  @doc "See `Situ.Aggregate.reduce/3`."
  @doc group: "Statistics"
  defdelegate reduce(stream, fun, opts \\ []), to: Situ.Aggregate

  @doc "See `Situ.Aggregate.count/2`."
  @doc group: "Statistics"
  defdelegate count(stream, opts \\ []), to: Situ.Aggregate

  @doc "See `Situ.Aggregate.sum/2`."
  @doc group: "Statistics"
  defdelegate sum(stream, opts \\ []), to: Situ.Aggregate

  @doc "See `Situ.Aggregate.min/2`."
  @doc group: "Statistics"
  defdelegate min(stream, opts \\ []), to: Situ.Aggregate

  @doc "See `Situ.Aggregate.max/2`."
  @doc group: "Statistics"
  defdelegate max(stream, opts \\ []), to: Situ.Aggregate

  @doc "See `Situ.Aggregate.average/2`."
  @doc group: "Statistics"
  defdelegate average(stream, opts \\ []), to: Situ.Aggregate

  @doc "See `Situ.Aggregate.std/2`."
  @doc group: "Statistics"
  defdelegate std(stream, opts \\ []), to: Situ.Aggregate

  @doc "See `Situ.Aggregate.delta/2`."
  @doc group: "Statistics"
  defdelegate delta(stream, opts \\ []), to: Situ.Aggregate

  @doc "See `Situ.Aggregate.abs/2`."
  @doc group: "Statistics"
  defdelegate abs(stream, opts \\ []), to: Situ.Aggregate

  @doc "See `Situ.Aggregate.log/2`."
  @doc group: "Statistics"
  defdelegate log(stream, opts \\ []), to: Situ.Aggregate

  # Picking, moving, editing

  @doc "See `Situ.Selection.first/3`."
  @doc group: "Picking, moving, editing"
  defdelegate first(stream, n \\ 1, opts \\ []), to: Situ.Selection

  @doc "See `Situ.Selection.last/3`."
  @doc group: "Picking, moving, editing"
  defdelegate last(stream, n \\ 1, opts \\ []), to: Situ.Selection

  @doc "See `Situ.Selection.map_present/3`."
  @doc group: "Picking, moving, editing"
  defdelegate map_present(stream, fun, opts \\ []), to: Situ.Selection

  @doc "See `Situ.Selection.time_of/2`."
  @doc group: "Picking, moving, editing"
  defdelegate time_of(stream, opts \\ []), to: Situ.Selection

  @doc "See `Situ.Selection.latency/2`."
  @doc group: "Picking, moving, editing"
  defdelegate latency(stream, opts \\ []), to: Situ.Selection

  @doc "See `Situ.Selection.delay/3`."
  @doc group: "Picking, moving, editing"
  defdelegate delay(stream, duration, opts \\ []), to: Situ.Selection

  @doc "See `Situ.Selection.process/4`."
  @doc group: "Picking, moving, editing"
  defdelegate process(stream, state, fun, opts \\ []), to: Situ.Selection

  @doc "See `Situ.StateMachine.state_machine/3`."
  @doc group: "Picking, moving, editing"
  defdelegate state_machine(stream, machine, opts \\ []), to: Situ.StateMachine

  @doc "See `Situ.Selection.edit/3`."
  @doc group: "Picking, moving, editing"
  defdelegate edit(stream, edits, opts \\ []), to: Situ.Selection

  @doc "See `Situ.Selection.reorder/3`."
  @doc group: "Picking, moving, editing"
  defdelegate reorder(stream, lateness, opts \\ []), to: Situ.Selection

  # Generators

  @doc "See `Situ.Generator.sequence/4`."
  @doc group: "Generators"
  defdelegate sequence(p, initial, next, opts), to: Situ.Generator

  @doc "See `Situ.Generator.repeat/3`."
  @doc group: "Generators"
  defdelegate repeat(p, value, opts), to: Situ.Generator

  @doc "See `Situ.Generator.return/3`."
  @doc group: "Generators"
  defdelegate return(p, value, opts \\ []), to: Situ.Generator

  @doc "See `Situ.Generator.from_enumerable/3`."
  @doc group: "Generators"
  defdelegate from_enumerable(p, enumerable, opts \\ []), to: Situ.Generator

  @doc "See `Situ.Generator.timer/2`."
  @doc group: "Generators"
  defdelegate timer(p, opts), to: Situ.Generator

  @doc "See `Situ.Generator.event_source/3`."
  @doc group: "Generators"
  defdelegate event_source(p, subscribe, opts \\ []), to: Situ.Generator

  # Filters

  @doc "See `Situ.Filter.lowpass/2`."
  @doc group: "Filters"
  defdelegate lowpass(stream, opts), to: Situ.Filter

  @doc "See `Situ.Filter.highpass/2`."
  @doc group: "Filters"
  defdelegate highpass(stream, opts), to: Situ.Filter

  @doc "See `Situ.Filter.bandpass/2`."
  @doc group: "Filters"
  defdelegate bandpass(stream, opts), to: Situ.Filter

  @doc "See `Situ.Filter.bandstop/2`."
  @doc group: "Filters"
  defdelegate bandstop(stream, opts), to: Situ.Filter

  @doc "See `Situ.Filter.denoise/2`."
  @doc group: "Filters"
  defdelegate denoise(stream, opts \\ []), to: Situ.Filter

  @doc "See `Situ.Filter.one_euro/2`."
  @doc group: "Filters"
  defdelegate one_euro(stream, opts \\ []), to: Situ.Filter

  # Parallel branches

  @doc "See `Situ.Parallel.parallel/3`."
  @doc group: "Parallel"
  defdelegate parallel(stream, fun, opts \\ []), to: Situ.Parallel

  # Streams as lists and enumerables

  @doc "See `Situ.Collector.collect/2`."
  @doc group: "Collecting"
  defdelegate collect(build, opts \\ []), to: Situ.Collector

  @doc "See `Situ.Collector.to_list/2`."
  @doc group: "Collecting"
  defdelegate to_list(build, opts \\ []), to: Situ.Collector

  @doc "See `Situ.Collector.to_stream/2`."
  @doc group: "Collecting"
  defdelegate to_stream(build, opts \\ []), to: Situ.Collector

  @doc """
  Attaches a tap to a stream of a running pipeline. `fun` receives every `Situ.Message` in its own process, which has
  a lossy queue.

  `target` is a stream, or `{pipeline, stream_name}`. The options are `policy:` and `name:`. `detach_tap/1` removes
  the tap.
  """
  @spec attach_tap(
          Stream.t() | {Pipeline.target(), String.t()},
          (Situ.Message.t() -> any()),
          keyword()
        ) :: {:ok, Situ.Tap.t()} | {:error, Situ.Error.t()}
  defdelegate attach_tap(target, fun, opts \\ []), to: Situ.Tap, as: :attach

  @doc "Removes a tap that `attach_tap/3` added."
  @spec detach_tap(Situ.Tap.t()) :: :ok
  defdelegate detach_tap(tap), to: Situ.Tap, as: :detach

  @doc """
  Prints a running pipeline as a table of edges (counts, queues, drops, latencies) and processes.

  With `refresh: ms` the table is printed repeatedly until the pipeline ends, or at most `times:` times.
  """
  @spec inspect(Pipeline.target(), keyword()) :: :ok
  def inspect(p, opts \\ []) do
    case Situ.Options.validate!(opts, refresh: [type: :pos_integer], times: [type: :pos_integer]) do
      [] ->
        IO.puts(Situ.Diagnostics.format(Pipeline.info(p)))

      opts ->
        Pipeline.Client.print_live_table(p, opts[:refresh] || 1_000, opts[:times] || :infinity)
    end
  end

  @doc """
  Reports where in a running pipeline the message with an originating time is now, and where it waited. Print the
  result with `Situ.Diagnostics.Trace.format/1`.
  """
  @spec trace(Pipeline.target(), Situ.Time.t()) :: Situ.Diagnostics.Trace.t()
  defdelegate trace(p, time), to: Pipeline

  defp only_input(%Node{inputs: [{input, _}]}), do: input

  defp only_input(node) do
    raise ArgumentError,
          "#{node.path} has #{length(node.inputs)} inputs; name each: Situ.via([left: stream, ...], ...)"
  end
end
