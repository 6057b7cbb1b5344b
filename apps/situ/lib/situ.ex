defmodule Situ do
  @moduledoc """
  Programs that see, hear and act in the world, built as pipelines of components connected by timestamped streams.

  This module is the API for writing pipelines. It has functions that add sources, transform streams and combine
  streams. `Situ.Pipeline` runs the pipelines.

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
  reaction to errors. The functions on streams take the placement options, too. `Situ.Graph.Placement` lists them; the
  documentation of a function lists only its own options. A component with several outputs returns a map of streams.
  Libraries wrap this in functions that take the same options (`Situ.Media.Camera.open/2`, `Situ.Infer.voice/2`).
  `composite/3` groups components under one name.

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
  | `Situ.Pipeline.replace/3` | a component's module or options |
  | `Situ.Pipeline.stop_part/3`, `Situ.Pipeline.start_part/3` | stop a part of the graph, and start it again |

  ## Next steps

  Read the guides in this order: *Your first pipeline*, *Writing a component*, *Fusing streams*, *Operators* (every
  function in one table), *Choosing a delivery policy*, *When things fail*, *Situ in your application*. `Situ.Test`
  tests pipelines with a clock that the test advances.
  """
  import Kernel, except: [min: 2, max: 2, abs: 1, inspect: 1, inspect: 2]
  alias Situ.Diagnostics.Trace
  alias Situ.Graph.{Builder, Composite, Handle}

  alias Situ.{
    Aggregate,
    Argument,
    Collector,
    Error,
    Filter,
    Fusion,
    Generator,
    Graph,
    Interpolator,
    Interval,
    MapAsync,
    Message,
    Node,
    Options,
    Parallel,
    Pipeline,
    Selection,
    StateMachine,
    Stream,
    Tap,
    Time,
    Window
  }

  @statistic Aggregate.option_schema()

  @typedoc "An interpolator, or a tolerance in ns or a window, which mean `Situ.Reproducible.nearest/2`."
  @type interpolator :: Interpolator.t() | Time.duration() | Interval.t()

  @typedoc "Streams of which `collect/2` and `to_list/2` return the messages."
  @type streams :: Stream.t() | [Stream.t()] | %{term() => Stream.t()} | keyword(Stream.t())

  # Components

  @doc """
  Adds a source and returns its stream, or a map of streams if it has several outputs.

      iex> defmodule Countdown do
      ...>   use Situ.Component, outputs: [out: :integer], options: [from: [type: :pos_integer]]
      ...>   def init(opts), do: {:ok, opts[:from]}
      ...>   def handle_demand(_n, _context, 0), do: {[{:close, :out}], 0}
      ...>   def handle_demand(_n, _context, n), do: {[{:out, -n, n}], n - 1}
      ...> end
      iex> Situ.Test.run([], fn _, p -> Situ.source(p, Countdown, from: 2) end)
      {:ok, [{-2, 2}, {-1, 1}]}

  `opts` are the component's own options and the options of `Situ.Graph.Placement` (`name:`, `on_error:` ...).
  """
  @doc group: "Components"
  @spec source(Pipeline.t(), module(), keyword()) :: Stream.t() | %{atom() => Stream.t()}
  def source(p, module, opts \\ [])

  def source(%Handle{} = p, module, opts), do: p |> Pipeline.add(module, opts) |> Node.streams()

  def source(other, module, _opts),
    do: Argument.raise_invalid!(other, :handle, "Situ.source(p, #{Kernel.inspect(module)})")

  @doc """
  Sends a stream (or `[input: stream, ...]`) through a component. Returns the same as `source/3`.

      iex> defmodule Rise do
      ...>   use Situ.Component, inputs: [in: :number], outputs: [out: :number]
      ...>   def init(_opts), do: {:ok, 0}
      ...>   def handle_message(:in, %{data: n}, _context, last) when n <= last, do: {[], last}
      ...>   def handle_message(:in, m, _context, _last), do: {[{:out, m.originating_time, m.data}], m.data}
      ...> end
      iex> Situ.Test.run([n: [{0, 1}, {5, 0}, {10, 2}]], &Situ.via(&1.n, Rise, name: "Rise"))
      {:ok, [{0, 1}, {10, 2}]}

  `opts` are the component's own options and the placement options of `Situ.Graph.Placement` (`name:`, `policy:`,
  `on_error:` ...).
  """
  @doc group: "Components"
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

  defp only_input(%Node{inputs: [{input, _}]}), do: input

  defp only_input(node) do
    raise ArgumentError,
          "#{node.path} has #{length(node.inputs)} inputs; name each: Situ.via([left: stream, ...], ...)"
  end

  @doc """
  Groups the components that `fun` adds under one name, drawn as one box. Returns the result of `fun`. The first
  argument is a pipeline that is being built, or a stream of it; `fun` receives the same inside the group.

  A composite restarts as a unit: all its components run `terminate/2`, start again with fresh state on the same edges,
  and count as one restart for `max_restarts:`. Components with their own `on_error:`, `:skip` or `:restart`, keep it.

      iex> inputs = [n: [{0, 1}, {10, 2}]]
      iex> Situ.Test.run(inputs, &Situ.composite(&1.n, "Double", fn n -> Situ.map(n, fn x -> 2 * x end) end))
      {:ok, [{0, 2}, {10, 4}]}

  #{Options.docs(Graph.scope_schema())}
  """
  @doc group: "Components"
  @spec composite(Pipeline.t() | Stream.t(), String.t(), (term() -> result), keyword()) :: result
        when result: term()
  defdelegate composite(stream, name, fun, opts \\ []), to: Composite, as: :build

  @doc """
  Names a stream. Raises `Situ.Error` (`:duplicate_name`) if another stream of the pipeline has the same name.

      iex> build = fn p -> p |> Situ.from_enumerable([{0, 1}]) |> Situ.count() |> Situ.name("Visitors") end
      iex> Situ.Test.run_pipeline(build, ["Visitors"])
      {:ok, %{"Visitors" => [{0, 1}]}}
  """
  @doc group: "Components"
  @spec name(Stream.t(), String.t()) :: Stream.t()
  def name(%Stream{} = stream, name) when is_binary(name) do
    :ok = Builder.update_graph(stream.pipeline, &Graph.name_stream(&1, stream, name))
    %{stream | name: name}
  end

  def name(other, _name),
    do: Argument.raise_invalid!(other, :stream, ~s|Situ.name(stream, "Front")|)

  # Functions on data

  @doc """
  Applies `fun` to the data (or to the data and the message, whose `originating_time` is in ns).

  Like every function on streams, it also takes the options `name:`, `policy:`, `on_error:` and `async:` of
  `Situ.Graph.Placement`.

      iex> Situ.to_list(fn p -> p |> Situ.from_enumerable([1, 2, 3], every: 10) |> Situ.map(&(&1 * 2)) end)
      [2, 4, 6]

  With `columns: true`, plain numbers are computed many at a time, for example by `Nx`:

      iex> double = fn columns -> for n <- Situ.Columns.values(columns), do: n * 2 end
      iex> build = fn p -> p |> Situ.from_enumerable([1, 2, 3], every: 10) |> Situ.map(double, columns: true) end
      iex> Situ.to_list(build)
      [2, 4, 6]

  #{Options.docs(Selection.option_schema(:columns))}
  """
  @doc group: "Functions on data"
  @spec map(Stream.t(), (term() -> term()) | (term(), Message.t() -> term()), keyword()) ::
          Stream.t()
  defdelegate map(stream, fun, opts \\ []), to: Selection

  @doc """
  Applies `fun` to the data, except that `nil` stays `nil`.

      iex> Situ.Test.run([n: [{0, 1}, {10, nil}]], &Situ.map_present(&1.n, fn n -> n + 1 end))
      {:ok, [{0, 2}, {10, nil}]}
  """
  @doc group: "Functions on data"
  @spec map_present(Stream.t(), (term() -> term()), keyword()) :: Stream.t()
  defdelegate map_present(stream, fun, opts \\ []), to: Selection

  @doc """
  Applies `fun` (of the data, or of the data and the message) to up to `max:` messages concurrently, each in its own
  process, and emits the results in order.

  Use it for functions that wait (for a server or a file) or that use more than one core. Cheap functions are faster in
  `map/3`, because a process per message costs a few microseconds.

      iex> square = fn v -> v * v end
      iex> build = fn p -> p |> Situ.from_enumerable(1..5, every: 10) |> Situ.map_async(square, max: 2) end
      iex> Situ.to_list(build, pipeline: [replay: [interval: {0, :unbounded}, speed: :max]])
      [1, 4, 9, 16, 25]

  When `max:` messages are in progress, the stream waits. If the function raises, exits or exceeds `timeout:`, that is
  an error at its message's time, which is handled as `on_error:` specifies: `:stop` emits the results of older
  messages, and `:skip` and `:restart` emit all other results (`:restart` up to the pipeline's `max_restarts:`). If the
  process is killed, the messages in progress are handled again. Reproducible: yes, if `fun` is.

  #{Options.docs(MapAsync.option_schema())}
  """
  @doc group: "Functions on data"
  @spec map_async(Stream.t(), (term() -> term()) | (term(), Message.t() -> term()), keyword()) ::
          Stream.t()
  defdelegate map_async(stream, fun, opts \\ []), to: MapAsync

  @doc """
  Passes only the messages for which `fun` (of the data, or of the data and the message) returns true.

  Like every function on streams, it also takes the options `name:`, `policy:`, `on_error:` and `async:` of
  `Situ.Graph.Placement`.

      iex> Situ.Test.run([n: [{0, 1}, {10, 2}, {20, 3}]], &Situ.filter(&1.n, fn n -> n != 2 end))
      {:ok, [{0, 1}, {20, 3}]}
  """
  @doc group: "Functions on data"
  @spec filter(Stream.t(), (term() -> boolean()) | (term(), Message.t() -> boolean()), keyword()) ::
          Stream.t()
  defdelegate filter(stream, fun, opts \\ []), to: Selection

  @doc """
  Calls `fun` (of the data, or of the data and the message; with `columns: true`, of `Situ.Columns`) for its side effect
  and passes the message through.

  An exception in `fun` ends the pipeline, unless `on_error: :skip` is given. Like every function on streams, it also
  takes the options `name:`, `policy:` and `async:` of `Situ.Graph.Placement`.

      iex> me = self()
      iex> Situ.Test.run([n: [{0, 1}, {10, 2}]], &Situ.each(&1.n, fn n -> send(me, n) end))
      {:ok, [{0, 1}, {10, 2}]}
  """
  @doc group: "Functions on data"
  @spec each(Stream.t(), (term() -> any()) | (term(), Message.t() -> any()), keyword()) ::
          Stream.t()
  defdelegate each(stream, fun, opts \\ []), to: Selection

  @doc """
  Folds the stream and emits the accumulator after every message. `fun` is `fun.(data, acc)` or
  `fun.(data, message, acc)`.

  The initial value itself is not emitted.

      iex> Situ.Test.run([n: [{0, 1}, {10, 2}, {20, 3}]], &Situ.scan(&1.n, 100, fn n, sum -> sum + n end))
      {:ok, [{0, 101}, {10, 103}, {20, 106}]}
  """
  @doc group: "Functions on data"
  @spec scan(
          Stream.t(),
          acc,
          (term(), acc -> acc) | (term(), Message.t(), acc -> acc),
          keyword()
        ) :: Stream.t()
        when acc: term()
  defdelegate scan(stream, acc, fun, opts \\ []), to: Aggregate

  @doc """
  Folds a stream without an initial value. The first message passes unchanged; each later output is
  `fun.(data, previous_output)`.

      iex> Situ.Test.run([n: [{0, 3}, {10, 5}, {20, 4}]], &Situ.reduce(&1.n, fn n, most -> max(n, most) end))
      {:ok, [{0, 3}, {10, 5}, {20, 5}]}
  """
  @doc group: "Functions on data"
  @spec reduce(Stream.t(), (term(), term() -> term()), keyword()) :: Stream.t()
  defdelegate reduce(stream, fun, opts \\ []), to: Aggregate

  @doc """
  Emits any number of messages for each input message: `fun.(message, state)` returns `{[{time, data}], state}`. Times
  must strictly increase.

      # Emits each word of a sentence as a separate message, 1 ns apart.
      Situ.process(sentences, nil, fn message, state ->
        words = String.split(message.data)
        {Enum.with_index(words, fn word, i -> {message.originating_time + i, word} end), state}
      end)

      iex> split = fn message, nil ->
      ...>   words = message.data |> String.split() |> Enum.with_index()
      ...>   {for({word, i} <- words, do: {message.originating_time + i, word}), nil}
      ...> end
      iex> Situ.Test.run([s: [{0, "good day"}, {10, "bye"}]], &Situ.process(&1.s, nil, split))
      {:ok, [{0, "good"}, {1, "day"}, {10, "bye"}]}

  #{Options.docs(Selection.option_schema(:process))}
  """
  @doc group: "Functions on data"
  @spec process(
          Stream.t(),
          state,
          (Message.t(), state -> {[{Time.t(), term()}], state}),
          keyword()
        ) :: Stream.t()
        when state: term()
  defdelegate process(stream, state, fun, opts \\ []), to: Selection

  @doc """
  Runs a finite state machine over a stream and emits the values that it returns. `machine` is a module with the
  behaviour `Situ.StateMachine`, or a function of (state, event, data). Reproducible: yes.

      iex> door = fn
      ...>   :closed, {:message, %{data: :push}}, n -> {:next_state, :open, n + 1, [{:emit, {:opened, n + 1}}]}
      ...>   :open, {:message, %{data: :pull}}, n -> {:next_state, :closed, n}
      ...>   _state, _event, n -> {:keep_state, n}
      ...> end
      iex> inputs = [e: [{0, :push}, {10, :pull}, {20, :push}]]
      iex> Situ.Test.run(inputs, &Situ.state_machine(&1.e, door, init: {:closed, 0}))
      {:ok, [{0, {:opened, 1}}, {20, {:opened, 2}}]}

  #{Options.docs(StateMachine.option_schema())}
  """
  @doc group: "Functions on data"
  @spec state_machine(
          Stream.t(),
          module()
          | (StateMachine.state(), StateMachine.event(), StateMachine.data() ->
               StateMachine.answer()),
          keyword()
        ) :: Stream.t()
  defdelegate state_machine(stream, machine, opts \\ []), to: StateMachine

  # Fusion: streams combined by time

  @doc """
  Joins each message of the first stream, the primary, with a value of each other stream at its time. By default this
  is the message with the same originating time. Outputs have the primary's time. Reproducible: yes, without
  `give_up_after:` and `max_queue:`. Interpolators that are not reproducible are rejected.

      iex> inputs = [camera: [{0, :c0}, {20, :c20}], tracker: [{2, :door}, {17, :lamp}]]
      iex> Situ.Test.run(inputs, fn s -> Situ.join(s.camera, s.tracker, 5) end)
      {:ok, [{0, {:c0, :door}}, {20, {:c20, :lamp}}]}

  ## Forms

  | call | output |
  |---|---|
  | `join(a, b)` | `{a, b}` |
  | `join(a, [b, c])` | `{a, [b, c]}` |
  | `join([a, b, c])` | `[a, b, c]`; the first stream is the primary |
  | `join(a, %{left: b, right: c})` | `{a, %{left: b, right: c}}`; inputs can be added and removed (`add_input/4`) |

  An interpolator follows the streams: `join(a, b, Situ.Reproducible.linear())`. A tolerance (ns) or a window in its
  place means `Situ.Reproducible.nearest/2`.

  If a stream's type is a tuple, as a join's is, its elements are flattened: `a |> join(b) |> join(c)` emits
  `{a, b, c}`. A default that is not a tuple applies to each element of its side. `with: fun` builds the output with
  `fun.(primary, secondary)`.

  ## Waiting

  Each primary waits until every secondary can be decided. A secondary that falls silent without ending makes
  primaries wait (see the queue lengths in the diagnostics); `give_up_after:` and `max_queue:` limit this. A lossy
  policy on an input drops messages before the operator sees them. The remaining messages are joined by the same rule,
  but which messages remain depends on timing.

  ## Options

  #{Options.docs(Fusion.option_schema(:fuse))}

  `policy:` may be a list with one policy per input, primary first. `name:`, `on_error:` and the other options of
  `Situ.Graph.Placement` are possible, too.
  """
  @doc group: "Fusion: streams brought together by time"
  @spec join(
          Stream.t() | [Stream.t()],
          Stream.t() | [Stream.t()] | %{term() => Stream.t()} | interpolator() | keyword(),
          interpolator() | keyword(),
          keyword()
        ) :: Stream.t()
  defdelegate join(first, second \\ [], third \\ [], opts \\ []), to: Fusion

  @doc """
  Fuses streams like `join/4`, with any interpolator: `fuse(a, b, Situ.Available.last())`. The forms are the same.
  Reproducible: if the interpolator is.

      iex> inputs = [a: [{0, 1}, {10, 2}], b: [{0, :x}, {10, :y}]]
      iex> Situ.Test.run(inputs, &Situ.fuse(&1.a, &1.b, Situ.Reproducible.exact()))
      {:ok, [{0, {1, :x}}, {10, {2, :y}}]}

  #{Options.docs(Fusion.option_schema(:fuse))}

  `policy:` may be a list with one policy per input, primary first.
  """
  @doc group: "Fusion: streams brought together by time"
  @spec fuse(
          Stream.t() | [Stream.t()],
          Stream.t() | [Stream.t()] | %{term() => Stream.t()} | interpolator(),
          interpolator() | keyword(),
          keyword()
        ) :: Stream.t()
  defdelegate fuse(first, second, third \\ [], opts \\ []), to: Fusion

  @doc """
  Pairs each primary with the latest secondary that has arrived. Primaries before the first secondary are dropped,
  unless `initial:` is given. Reproducible: no.

  Pairs depend on arrival: when a recording is read as fast as possible (speed `:max`), all primaries may arrive
  before the first secondary, and then there are no pairs. `join/4` with `Situ.Reproducible.last()` returns the latest
  secondary by originating time, at any speed.

      iex> t = Situ.Test.start([:a, :b], &Situ.pair(&1.a, &1.b))
      iex> Situ.Test.advance(t, 20)
      iex> Situ.Test.feed(t, :b, {5, :x})
      iex> Situ.Test.feed(t, :a, {10, 1})
      iex> Situ.Test.outputs(t)
      [{10, {1, :x}}]

  #{Options.docs(Fusion.option_schema(:pair))}
  """
  @doc group: "Fusion: streams brought together by time"
  @spec pair(Stream.t(), Stream.t(), keyword()) :: Stream.t()
  defdelegate pair(primary, secondary, opts \\ []), to: Fusion

  @doc """
  Groups the messages of all streams by originating time. Each output is the list of messages at that time, in the
  order of the streams. A group is emitted when every stream has reached its time or ended. Reproducible: yes.

      iex> Situ.Test.run([a: [{0, 1}, {10, 2}], b: [{10, :y}]], &Situ.zip(&1.a, &1.b))
      {:ok, [{0, [1]}, {10, [2, :y]}]}
  """
  @doc group: "Fusion: streams brought together by time"
  @spec zip(Stream.t() | [Stream.t()], Stream.t() | keyword(), keyword()) :: Stream.t()
  defdelegate zip(first, second \\ [], opts \\ []), to: Fusion

  @doc """
  Emits the messages of all streams as they arrive, each as a complete `Situ.Message`, with the clock's time.
  Reproducible: no.

      iex> inputs = [left: [{0, :a}, {10, :b}], right: [{5, :c}]]
      iex> {:ok, merged} = Situ.Test.run(inputs, &Situ.merge(&1.left, &1.right))
      iex> Enum.sort(for {_time, message} <- merged, do: {message.originating_time, message.data})
      [{0, :a}, {5, :c}, {10, :b}]

  Streams can be added and removed while the pipeline is running (`add_input/4`, `remove_input/3`). The initial
  streams have the keys 0, 1, 2 ...
  """
  @doc group: "Fusion: streams brought together by time"
  @spec merge(Stream.t() | [Stream.t()], Stream.t() | keyword(), keyword()) :: Stream.t()
  defdelegate merge(first, second \\ [], opts \\ []), to: Fusion

  @doc """
  Adds a stream to a join or fusion over a map, or to a merge, while the pipeline is running. Its key is `key`.

      iex> t = Situ.Test.start([:image, :left, :right], fn s ->
      ...>   Situ.name(s.right, "Right")
      ...>   s.image |> Situ.join(%{left: s.left}) |> Situ.name("All")
      ...> end)
      iex> {:ok, :start} = Situ.add_input({t.pipeline, "All"}, :right, "Right")
      iex> for input <- [:image, :left, :right], do: Situ.Test.feed(t, input, {0, input})
      iex> Situ.Test.outputs(t)
      [{0, {:image, %{left: :left, right: :right}}}]
      iex> {:ok, _report} = Situ.Test.stop(t)
      iex> :done
      :done

  `fused` and `stream` are streams of the same running pipeline, or `{pipeline, name}` and a name. Returns the
  originating time from which the input takes part, or `:start` if no message has arrived yet. Primaries from that
  time on need its value. Earlier primaries are unaffected by it, and its earlier messages are ignored. The default
  is the earliest time for which this is exact: after the last primary that has arrived, and after the last message
  that `stream` has sent. `from:` sets a later time, which makes the outputs independent of the moment of adding. A
  merge takes messages from now on.

  Options: `from:` (ns), `interpolator:` (default: the operator's), `policy:`. Errors: `:too_late` (with the
  `earliest` time in `meta`), `:duplicate_input`, `:not_reproducible`, `:fixed_inputs` (an operator of a different
  form), `:circle` (the stream depends on the operator), `:inside_chain`, `:unknown_stream`, `:not_running`.
  """
  @doc group: "Fusion: streams brought together by time"
  @spec add_input(
          Stream.t() | {Pipeline.target(), String.t()},
          key :: term(),
          Stream.t() | String.t(),
          keyword()
        ) :: {:ok, Time.t() | :start} | {:error, Error.t()}
  defdelegate add_input(fused, key, stream, opts \\ []), to: Fusion.DynamicInputs

  @doc """
  Removes the input `key` of a join or fusion over a map, or of a merge, while the pipeline is running. The input may
  have been added later or present from the start.

      iex> t = Situ.Test.start([:image, :left], fn s ->
      ...>   s.image |> Situ.join(%{left: s.left}) |> Situ.name("All")
      ...> end)
      iex> Situ.remove_input({t.pipeline, "All"}, :left)
      {:ok, :start}
      iex> Situ.Test.feed(t, :image, {0, :image})
      iex> Situ.Test.outputs(t)
      [{0, {:image, %{}}}]
      iex> {:ok, _report} = Situ.Test.stop(t)
      iex> :done
      :done

  Returns the originating time from which primaries no longer need the input, or `:start` if no primary has arrived
  yet. The default, and earliest, time is after the last primary that has arrived; `until:` sets a later time. Earlier
  primaries still wait for the input, and then it is disconnected. Errors: `:too_late`, `:unknown_input`,
  `:fixed_inputs`, `:not_running`.
  """
  @doc group: "Fusion: streams brought together by time"
  @spec remove_input(Stream.t() | {Pipeline.target(), String.t()}, key :: term(), keyword()) ::
          {:ok, Time.t() | :start} | {:error, Error.t()}
  defdelegate remove_input(fused, key, opts \\ []), to: Fusion.DynamicInputs

  @doc """
  Emits the stream's value at every tick, by default the nearest message. Ticks come from another stream (`clock`) or
  from an interval in ns, counted from the pipeline's start or aligned with `align:` (a time). Ticks end with the
  stream; a tick without a value has no output. Reproducible: if the interpolator is.

      Situ.sample(level, Situ.Time.ms(20), Situ.Reproducible.linear())

      iex> inputs = [v: [{0, 0.0}, {10, 1.0}], tick: [{5, :t}, {10, :t}]]
      iex> Situ.Test.run(inputs, &Situ.sample(&1.v, &1.tick, Situ.Reproducible.linear()))
      {:ok, [{5, 0.5}, {10, 1.0}]}

  #{Options.docs(Fusion.option_schema(:sample))}
  """
  @doc group: "Fusion: streams brought together by time"
  @spec sample(Stream.t(), Stream.t() | Time.duration(), interpolator() | keyword(), keyword()) ::
          Stream.t()
  defdelegate sample(stream, clock, interpolator \\ Interval.infinite(), opts \\ []), to: Fusion

  # Windows

  @doc """
  Emits each message together with its neighbours, as a list of data. `fun` builds the output from that list.

  | window | contains | partial windows |
  |---|---|---|
  | a range of indices, `-2..0` | this message and the two before it | no output |
  | a `Situ.Interval` of ns | messages whose time is in the interval around this one's | output, also at the end |

  The output has the originating time of the message that the window belongs to (its anchor). It is emitted as soon as
  the window is known to be complete. If the left end of a window is after its right end, the ends are swapped.
  Reproducible: yes.

      Situ.window(level, -9..0, &Enum.max/1)                                  # maximum of the last ten
      Situ.window(level, Situ.Interval.past(Situ.Time.s(1)), &Enum.max/1)     # maximum of the last second

      iex> Situ.to_list(fn p -> p |> Situ.from_enumerable(1..5, every: 10) |> Situ.window(-2..0) end)
      [[1, 2, 3], [2, 3, 4], [3, 4, 5]]

  #{Options.docs(Window.option_schema(:window))}
  """
  @doc group: "Windows"
  @spec window(
          Stream.t(),
          Range.t() | Interval.t(),
          (list() -> term()) | nil | keyword(),
          keyword()
        ) :: Stream.t()
  defdelegate window(stream, window, fun \\ nil, opts \\ []), to: Window

  @doc """
  Emits a window per message of `windows`, also if the window is empty. `interval.(message)` returns
  `{interval, obsolete}`: the span of `stream` in the window (a `Situ.Interval` of time points), and the time before
  which no later window will need the stream. The output is at the window message's time. Reproducible: yes.

      iex> last_ten = fn %{originating_time: t} -> {Situ.Interval.closed(t - 10, t), t - 10} end
      iex> Situ.Test.run([n: [{0, 1}, {8, 2}, {20, 3}], t: [{9, :t}, {20, :t}]], &Situ.window_by(&1.n, &1.t, last_ten))
      {:ok, [{9, [1, 2]}, {20, [3]}]}

  #{Options.docs(Window.option_schema(:window_by))}
  """
  @doc group: "Windows"
  @spec window_by(
          Stream.t(),
          Stream.t(),
          (Message.t() -> {Interval.t(), Time.t()}),
          keyword()
        ) :: Stream.t()
  defdelegate window_by(stream, windows, interval, opts \\ []), to: Window

  # Statistics

  @doc """
  Computes the sum. `nil` adds nothing.

  ## Covered messages

  All statistics take `over:`, which selects the messages that they cover:

  | `over:` | statistic of | output |
  |---|---|---|
  | `:all` (default) | all messages so far | with each message |
  | `:list` | the list that each message carries | with each message |
  | `{:last, n}` | the last `n` messages | from the `n`-th message on |
  | `{:past, span}` | the messages of the last `span` ns, both ends included | with each message |

  Outputs keep the originating time of the message that causes them. Reproducible: yes.

      Situ.average(level, over: {:past, Situ.Time.s(1)})
      Situ.count(words, where: &(&1 != ""))
      Situ.max(faces, over: :list, by: & &1.score, nullable: true)

  ## Values

  Values are numbers or `:nan`, `:infinity`, `:neg_infinity` (as in IEEE 754; `:nan` propagates), or `nil` (no
  value). `nil` adds 0 to a sum, and is ignored by everything else except the count. If all values are `nil`, the
  result is `nil` (for a sum: 0). Integers stay integers in sums, minimum and maximum; averages and deviations are
  floats.

  ## Options

      iex> Situ.Test.run([n: [{0, 1}, {10, 2}]], &Situ.sum(&1.n))
      {:ok, [{0, 1}, {10, 3}]}

  #{Options.docs(Keyword.take(@statistic, [:over, :where, :by]))}
  """
  @doc group: "Statistics"
  @spec sum(Stream.t(), keyword()) :: Stream.t()
  defdelegate sum(stream, opts \\ []), to: Aggregate

  @doc """
  Counts the messages (or elements). `sum/2` describes `over:`.

      iex> Situ.Test.run([n: [{0, :a}, {10, :b}]], &Situ.count(&1.n))
      {:ok, [{0, 1}, {10, 2}]}

  #{Options.docs(Keyword.take(@statistic, [:over, :where]))}
  """
  @doc group: "Statistics"
  @spec count(Stream.t(), keyword()) :: Stream.t()
  defdelegate count(stream, opts \\ []), to: Aggregate

  @doc """
  Computes the minimum, of any terms of one kind. The minimum of an empty list raises `Situ.Error` `:empty_list`, or is
  `nil` with `nullable: true`. `sum/2` describes `over:` and values.

      iex> Situ.Test.run([n: [{0, 2}, {10, 1}, {20, 3}]], &Situ.min(&1.n))
      {:ok, [{0, 2}, {10, 1}, {20, 1}]}

  #{Options.docs(Keyword.take(@statistic, [:over, :where, :by, :nullable, :compare]))}
  """
  @doc group: "Statistics"
  @spec min(Stream.t(), keyword()) :: Stream.t()
  defdelegate min(stream, opts \\ []), to: Aggregate

  @doc """
  Computes the maximum, of any terms of one kind. The maximum of an empty list raises `Situ.Error` `:empty_list`, or is
  `nil` with `nullable: true`. `sum/2` describes `over:` and values.

      iex> Situ.Test.run([n: [{0, 2}, {10, 1}, {20, 3}]], &Situ.max(&1.n))
      {:ok, [{0, 2}, {10, 2}, {20, 3}]}

  #{Options.docs(Keyword.take(@statistic, [:over, :where, :by, :nullable, :compare]))}
  """
  @doc group: "Statistics"
  @spec max(Stream.t(), keyword()) :: Stream.t()
  defdelegate max(stream, opts \\ []), to: Aggregate

  @doc """
  Computes the mean, as a float. The mean of an empty list raises `Situ.Error` `:empty_list`, or is `nil` with
  `nullable: true`. `sum/2` describes `over:` and values.

      iex> Situ.to_list(fn p -> p |> Situ.from_enumerable(1..5, every: 10) |> Situ.average(over: {:last, 2}) end)
      [1.5, 2.5, 3.5, 4.5]

  #{Options.docs(Keyword.take(@statistic, [:over, :where, :by, :nullable]))}
  """
  @doc group: "Statistics"
  @spec average(Stream.t(), keyword()) :: Stream.t()
  defdelegate average(stream, opts \\ []), to: Aggregate

  @doc """
  Computes the sample standard deviation (n - 1). A list of fewer than two numbers has a deviation of 0.0. `sum/2`
  describes `over:` and values.

      iex> Situ.Test.run([n: [{0, 1}, {10, 3}, {20, 5}]], &Situ.std(&1.n))
      {:ok, [{0, :nan}, {10, 1.4142135623730951}, {20, 2.0}]}

  #{Options.docs(Keyword.take(@statistic, [:over, :where, :by, :initial]))}
  """
  @doc group: "Statistics"
  @spec std(Stream.t(), keyword()) :: Stream.t()
  defdelegate std(stream, opts \\ []), to: Aggregate

  @doc """
  Emits the next number minus the current one, at the **current** message's originating time. Each difference is
  emitted when the next message arrives, so the last message has no output. `where:` filters first. Reproducible: yes.

      iex> Situ.Test.run([n: [{0, 1}, {10, 4}, {20, 2}]], &Situ.delta(&1.n))
      {:ok, [{0, 3}, {10, -2}]}
  """
  @doc group: "Statistics"
  @spec delta(Stream.t(), keyword()) :: Stream.t()
  defdelegate delta(stream, opts \\ []), to: Aggregate

  @doc """
  Emits the absolute value of each number. `where:` filters first.

      iex> Situ.Test.run([n: [{0, -1}, {10, 2}]], &Situ.abs(&1.n))
      {:ok, [{0, 1}, {10, 2}]}
  """
  @doc group: "Statistics"
  @spec abs(Stream.t(), keyword()) :: Stream.t()
  defdelegate abs(stream, opts \\ []), to: Aggregate

  @doc """
  Emits the logarithm of each number: natural, or to `base:`. `where:` filters first.

      iex> Situ.Test.run([n: [{0, 1}, {10, 0.5}]], &Situ.log(&1.n))
      {:ok, [{0, 0.0}, {10, -0.6931471805599453}]}
  """
  @doc group: "Statistics"
  @spec log(Stream.t(), keyword()) :: Stream.t()
  defdelegate log(stream, opts \\ []), to: Aggregate

  # Picking, moving, editing

  @doc """
  Emits the first `n` messages. The stream then stays open without further messages.

      iex> Situ.Test.run([n: [{0, :a}, {10, :b}, {20, :c}]], &Situ.first(&1.n, 2))
      {:ok, [{0, :a}, {10, :b}]}
  """
  @doc group: "Picking, moving, editing"
  @spec first(Stream.t(), non_neg_integer() | keyword(), keyword()) :: Stream.t()
  defdelegate first(stream, n \\ 1, opts \\ []), to: Selection

  @doc """
  Emits the last `n` messages, with their times, when the stream ends.

      iex> Situ.to_list(fn p -> p |> Situ.from_enumerable(1..9, every: 10) |> Situ.last(2) end)
      [8, 9]
  """
  @doc group: "Picking, moving, editing"
  @spec last(Stream.t(), non_neg_integer() | keyword(), keyword()) :: Stream.t()
  defdelegate last(stream, n \\ 1, opts \\ []), to: Selection

  @doc """
  Emits the originating time of each message as its data, ns.

      iex> Situ.Test.run([n: [{0, :a}, {10, :b}]], &Situ.time_of(&1.n))
      {:ok, [{0, 0}, {10, 10}]}
  """
  @doc group: "Picking, moving, editing"
  @spec time_of(Stream.t(), keyword()) :: Stream.t()
  defdelegate time_of(stream, opts \\ []), to: Selection

  @doc """
  Emits creation time minus originating time of each message as its data, ns, which is how late the message is here.
  Reproducible: no.

      iex> t = Situ.Test.start([:n], &Situ.latency(&1.n), start: 100)
      iex> Situ.Test.feed(t, :n, {70, :late})
      iex> Situ.Test.outputs(t)
      [{70, 30}]
      iex> {:ok, _report} = Situ.Test.stop(t)
      iex> :done
      :done
  """
  @doc group: "Picking, moving, editing"
  @spec latency(Stream.t(), keyword()) :: Stream.t()
  defdelegate latency(stream, opts \\ []), to: Selection

  @doc """
  Holds each message until its creation time plus `duration` (ns) on the pipeline's clock. Its times and data are
  unchanged, and no message is lost: when the stream ends, the held messages are emitted immediately. Without an
  enforced clock (speed `:max`), messages are not held.

  Reproducible: yes. The clock decides when a message is emitted, not whether it is. Operators that depend on arrival
  (`pair/3`, `merge/3`) see it later.

      iex> t = Situ.Test.start([:n], &Situ.delay(&1.n, 5))
      iex> Situ.Test.feed(t, :n, {0, :a})
      iex> Situ.Test.advance(t, 4)
      iex> early = Situ.Test.outputs(t)
      iex> Situ.Test.advance(t, 1)
      iex> {early, Situ.Test.outputs(t)}
      {[], [{0, :a}]}
  """
  @doc group: "Picking, moving, editing"
  @spec delay(Stream.t(), Time.duration(), keyword()) :: Stream.t()
  defdelegate delay(stream, duration, opts \\ []), to: Selection

  @doc """
  Applies edits to a stream: `{time, {:put, data}}` replaces the message at that time or inserts one, and
  `{time, :delete}` removes it. Edits may be in any order; the last of several edits at one time applies.

      iex> Situ.Test.run([n: [{0, :a}, {10, :b}, {20, :c}]], &Situ.edit(&1.n, [{10, :delete}, {15, {:put, :new}}]))
      {:ok, [{0, :a}, {15, :new}, {20, :c}]}
  """
  @doc group: "Picking, moving, editing"
  @spec edit(Stream.t(), [{Time.t(), {:put, term()} | :delete}], keyword()) :: Stream.t()
  defdelegate edit(stream, edits, opts \\ []), to: Selection

  @doc """
  Orders messages by a separate time (such as a device's timestamp). Each message waits until a message more than
  `lateness` ns later has arrived, or the stream ends. The first of several messages at one time is kept.

      iex> inputs = [n: [{0, {30, :b}}, {10, {20, :a}}, {20, {40, :c}}]]
      iex> Situ.Test.run(inputs, &Situ.reorder(&1.n, 15, time: fn m -> elem(m.data, 0) end))
      {:ok, [{20, {20, :a}}, {30, {30, :b}}, {40, {40, :c}}]}

  #{Options.docs(Selection.option_schema(:reorder))}
  """
  @doc group: "Picking, moving, editing"
  @spec reorder(Stream.t(), Time.duration(), keyword()) :: Stream.t()
  defdelegate reorder(stream, lateness, opts \\ []), to: Selection

  # Generators

  @doc """
  Emits `initial`, `next.(initial)`, and so on.

      Situ.sequence(p, 1, &(&1 * 2), every: Situ.Time.ms(100))     # 1, 2, 4 ... endlessly

  ## Times

  Times are exact, however long it takes to produce the items: the pipeline's start, start + `every:`, and so on. With
  `align: time`, they are congruent to that time modulo `every:`, beginning at or after the start. Items are produced on
  demand up to the replay's end; in real time, each item is produced when its time comes. Reproducible: yes.

  ## The end

  A generator ends with its last item. With `keep_open: true`, or without `count:`, it never ends. A source that never
  ends does not keep a pipeline running after the finite sources have ended. The end of a replay ends all sources.

  ## Options

      iex> replay = [replay: [interval: {0, 30}, speed: :max]]
      iex> Situ.to_list(fn p -> Situ.sequence(p, 1, &(&1 * 2), every: 10, align: 0) end, pipeline: replay)
      [1, 2, 4, 8]

  #{Options.docs(Generator.option_schema(:sequence))}
  """
  @doc group: "Generators"
  @spec sequence(Pipeline.t(), value, (value -> value), keyword()) :: Stream.t()
        when value: term()
  defdelegate sequence(p, initial, next, opts), to: Generator

  @doc """
  Emits the same value repeatedly. `sequence/4` describes the times and the end.

      iex> replay = [replay: [interval: {0, 100}, speed: :max]]
      iex> Situ.to_list(fn p -> Situ.repeat(p, :tick, every: 30, align: 10) end, times: true, pipeline: replay)
      [{10, :tick}, {40, :tick}, {70, :tick}, {100, :tick}]

  #{Options.docs(Generator.option_schema(:repeat))}
  """
  @doc group: "Generators"
  @spec repeat(Pipeline.t(), term(), keyword()) :: Stream.t()
  defdelegate repeat(p, value, opts), to: Generator

  @doc """
  Emits one value at the pipeline's start. Reproducible: yes.

      iex> Situ.to_list(fn p -> Situ.return(p, :hello) end)
      [:hello]

  #{Options.docs(Generator.option_schema(:return))}
  """
  @doc group: "Generators"
  @spec return(Pipeline.t(), term(), keyword()) :: Stream.t()
  defdelegate return(p, value, opts \\ []), to: Generator

  @doc """
  Emits the items of any enumerable. With `every:` (and `align:`) the items are values at that interval. Otherwise they
  are `{time, value}` pairs, messages or `Situ.Columns`, whose times must strictly increase. The enumerable is read
  lazily, so it may be infinite or expensive.

      Situ.from_enumerable(p, 0..9, every: Situ.Time.ms(100))      # 0, 1 ... 9, a tenth of a second apart
      Situ.from_enumerable(p, File.stream!("level.csv"), every: Situ.Time.ms(20))
      Situ.from_enumerable(p, [{10, :a}, {25, :b}])                # with times

  Items before the requested or proposed start of the replay are skipped. `sequence/4` describes the times and the end.
  Reproducible: yes.

      iex> Situ.to_list(fn p -> Situ.from_enumerable(p, [{5, :a}, {7, :b}]) end, times: true)
      [{5, :a}, {7, :b}]

  #{Options.docs(Generator.option_schema(:from_enumerable))}
  """
  @doc group: "Generators"
  @spec from_enumerable(Pipeline.t(), Enumerable.t(), keyword()) :: Stream.t()
  defdelegate from_enumerable(p, enumerable, opts \\ []), to: Generator

  @doc """
  Emits a message every `every:` ns of the clock, with the clock's time. Its data is the time since the start (ns), or
  the result of `fun:`. Missed ticks are not emitted later. A timer never ends.

  Reproducible: no. `repeat/3` has exact times, independent of the clock.

      iex> t = Situ.Test.start([], fn _, p -> Situ.timer(p, every: 10) end)
      iex> Situ.Test.advance(t, 10)
      iex> Situ.Test.advance(t, 10)
      iex> Situ.Test.outputs(t)
      [{10, 10}, {20, 20}]
      iex> {:ok, _report} = Situ.Test.stop(t)
      iex> :done
      :done

  #{Options.docs(Generator.option_schema(:timer))}
  """
  @doc group: "Generators"
  @spec timer(Pipeline.t(), keyword()) :: Stream.t()
  defdelegate timer(p, opts), to: Generator

  @doc """
  Emits data that other processes post. When the pipeline starts, `subscribe.(post)` is called. Any process may then
  call `post.(data)`, which emits a message with the clock's time. Messages with the same time are separated by 1 ns
  unless `on_same_time:` is set. The source never ends.

  Reproducible: no, since times depend on when data is posted. Record the stream to replay it.

      iex> me = self()
      iex> t = Situ.Test.start([], fn _, p -> Situ.event_source(p, &send(me, {:post, &1})) end, start: 100)
      iex> post = receive do {:post, post} -> post end
      iex> post.(:bell)
      iex> Situ.Test.outputs(t)
      [{100, :bell}]
      iex> {:ok, _report} = Situ.Test.stop(t)
      iex> :done
      :done

  #{Options.docs(Generator.option_schema(:event_source))}
  """
  @doc group: "Generators"
  @spec event_source(Pipeline.t(), ((term() -> :ok) -> handle), keyword()) :: Stream.t()
        when handle: term()
  defdelegate event_source(p, subscribe, opts \\ []), to: Generator

  # Filters

  @doc """
  Passes frequencies below `cutoff:`.

  `lowpass/2`, `highpass/2`, `bandpass/2` and `bandstop/2` resample their input every 1/rate seconds (rounded to ns), by
  linear interpolation, and emit at the ticks. They are reproducible.

      Situ.lowpass(level, rate: 100, cutoff: 5)

  ## Samples

  Samples are numbers, `:nan`, `:infinity` or `:neg_infinity`, which propagate as in `sum/2`. In a median (`denoise/2`)
  or a finite filter, they affect the output while they are among the samples in use. In an infinite filter and in
  `one_euro/2`, where each output feeds into the next, they affect all later outputs. `nil` (no value) is passed through
  and does not change the filter's state; the same applies to ticks between a number and `nil`. Any other value is an
  error, `:not_a_number`.

  ## Responses

  A finite filter is a windowed sinc (Hamming). Its phase is linear, and it delays by half its order. Its transition
  bands are about 3.3 times the rate divided by the order wide, so a narrow band needs a high order. SciPy calls it
  `firwin`. An infinite filter is a Butterworth filter with `order` poles per edge, as in SciPy and MATLAB. Its gain at
  the edges is -3 dB.

  ## Options

      iex> inputs = [n: for(i <- 0..99, do: {i * 10_000_000, 1.0})]
      iex> {:ok, outputs} = Situ.Test.run(inputs, &Situ.lowpass(&1.n, rate: 100, cutoff: 5))
      iex> outputs |> List.last() |> elem(1) |> Float.round(3)
      1.0

  #{Options.docs(Filter.option_schema(:edge))}
  """
  @doc group: "Filters"
  @spec lowpass(Stream.t(), keyword()) :: Stream.t()
  defdelegate lowpass(stream, opts), to: Filter

  @doc """
  Passes frequencies above `cutoff:`. `lowpass/2` describes samples and responses.

      iex> inputs = [n: for(i <- 0..99, do: {i * 10_000_000, 1.0})]
      iex> {:ok, outputs} = Situ.Test.run(inputs, &Situ.highpass(&1.n, rate: 100, cutoff: 5))
      iex> outputs |> List.last() |> elem(1) |> abs() |> Kernel.<(0.1)
      true

  #{Options.docs(Filter.option_schema(:edge))}
  """
  @doc group: "Filters"
  @spec highpass(Stream.t(), keyword()) :: Stream.t()
  defdelegate highpass(stream, opts), to: Filter

  @doc """
  Passes frequencies inside `band:`. `lowpass/2` describes samples and responses.

      iex> inputs = [n: for(i <- 0..199, do: {i * 10_000_000, 1.0})]
      iex> {:ok, outputs} = Situ.Test.run(inputs, &Situ.bandpass(&1.n, rate: 100, band: {2, 10}))
      iex> outputs |> List.last() |> elem(1) |> abs() |> Kernel.<(0.1)
      true

  #{Options.docs(Filter.option_schema(:band))}
  """
  @doc group: "Filters"
  @spec bandpass(Stream.t(), keyword()) :: Stream.t()
  defdelegate bandpass(stream, opts), to: Filter

  @doc """
  Passes frequencies outside `band:`. `lowpass/2` describes samples and responses.

      iex> inputs = [n: for(i <- 0..199, do: {i * 10_000_000, 1.0})]
      iex> {:ok, outputs} = Situ.Test.run(inputs, &Situ.bandstop(&1.n, rate: 100, band: {2, 10}))
      iex> outputs |> List.last() |> elem(1) |> Float.round(3)
      1.0

  #{Options.docs(Filter.option_schema(:band))}
  """
  @doc group: "Filters"
  @spec bandstop(Stream.t(), keyword()) :: Stream.t()
  defdelegate bandstop(stream, opts), to: Filter

  @doc """
  Emits the median of the last samples (fewer at the start), which removes single outliers. Outputs have the input's
  time. Reproducible: yes.

      iex> Situ.to_list(fn p -> p |> Situ.from_enumerable([1, 1, 50, 1], every: 10) |> Situ.denoise(order: 3) end)
      [1, 1.0, 1, 1]

  #{Options.docs(Filter.option_schema(:denoise))}
  """
  @doc group: "Filters"
  @spec denoise(Stream.t(), keyword()) :: Stream.t()
  defdelegate denoise(stream, opts \\ []), to: Filter

  @doc """
  Smooths samples with the 1 euro filter, an adaptive low-pass filter for irregular samples (Casiez, Roussel, Vogel,
  1 euro filter, CHI 2012). It smooths slow changes and passes fast ones. Outputs have the input's time. Reproducible:
  yes.

      gaze |> Situ.map(& &1.x) |> Situ.one_euro(min_cutoff: 1.5, slope: 0.01)

      iex> {:ok, outputs} = Situ.Test.run([n: [{0, 1.0}, {10_000_000, 1.2}, {20_000_000, 0.9}]], &Situ.one_euro(&1.n))
      iex> for {_time, value} <- outputs, do: Float.round(value, 2)
      [1.0, 1.01, 1.01]

  #{Options.docs(Filter.option_schema(:one_euro))}
  """
  @doc group: "Filters"
  @spec one_euro(Stream.t(), keyword()) :: Stream.t()
  defdelegate one_euro(stream, opts \\ []), to: Filter

  # Parallel branches

  @doc """
  Sends the parts of each message through separate branches, and recombines the results.

      # Lists of a fixed or varying length: one branch per position.
      Situ.parallel(channels, fn channel -> Situ.average(channel, over: {:last, 10}) end)

      # Maps: one branch per key, as long as the key is present.
      Situ.parallel(faces, fn id, face -> face |> Situ.map(& &1.mouth) |> Situ.delta() end)

      iex> inputs = [counts: [{0, %{ann: 1, bob: 5}}, {10, %{ann: 3}}]]
      iex> Situ.Test.run(inputs, fn s -> Situ.parallel(s.counts, fn _key, branch -> Situ.sum(branch) end) end)
      {:ok, [{0, %{ann: 1, bob: 5}}, {10, %{ann: 4}}]}

  The function builds a branch, which is a part of a pipeline from a stream (or a key and a stream) to a stream. Each
  branch has its own state. Results are emitted at the message's time, as a list or a map like the input. Results of a
  branch at other times are dropped. If the function does not return a stream, the operator has no output.

  | form | input | branches | output |
  |---|---|---|---|
  | fixed, `size: n` | lists of n elements (other lengths are errors) | n | a list of n |
  | variable | lists | one per position, started by the first list that long | a list as long as the input's |
  | sparse | maps, or data with `split:` | one per key, started by its first message | a map of the live keys |

  The form follows from the stream's type, `size:`, and the function. A function with a key as its first argument means
  sparse, unless the type is a list. `of: :lists` or `of: :maps` sets the form explicitly.

  If a branch has no result at a time, the complete output is dropped. With `or_default: value`, the value is used
  instead. One such case is a key that is kept alive without being in the message.

  ## When a key's branch ends

  | `until:` | the branch ends | at the time of |
  |---|---|---|
  | `:absent` (default) | with the first message without the key | the last message with it |
  | `{:absent, n}` | with the message after `n` in a row without it | the last message at which it was alive |
  | `:never` | with the stream | |
  | `fun.(key, map, time)` | when it returns `{:close, time}` (called with every message; else `:keep`) | `time` |

  Results that a branch emits while it ends (`last/2` ...) still count. Its state is released, and the same key
  later starts a new branch.

  ## Values, processes or nodes

  By default a branch is a value inside the operator's process. A process can hold a hundred thousand of them, but they
  share one core, and may not contain sources, `timer/2`, `delay/3`, or components with timers or processes
  (`Situ.Error` `:not_in_branch`). With `branches: :processes`, each branch is a separate pipeline, started at the time
  of its first part. It may contain any component, such as sources, timers, delays, and components that are slow or do
  I/O. Outputs, their times and their order are the same, as long as the branch itself is reproducible. Use this for
  tens to thousands of branches.

      Situ.parallel(faces, fn _id, face -> Recognizer.who(face) end, branches: :processes)

  With `branches: {:nodes, fun}`, each branch is a pipeline on the connected node that `fun.(key)` returns. That node
  builds the branch, so it needs the same code. `Situ.Cluster.choose_node/2` chooses among the members of a cluster. A
  branch on another node has that node's wall clock, or a clock that starts at the time of its first part, and follows
  neither a pause nor a change of speed. If its node is lost, the messages in flight are lost with it.

  The output of a time waits until each branch has emitted a result for it or for a later time, or has ended. A branch
  that is a linear chain of light operators is known to have no result as soon as it has handled the part. When about
  256 outputs are waiting, the input waits too, as long as a branch is working. The operator is one box in the
  diagnostics, which shows the number of live branches.

  ## When a branch fails

  A branch that fails, or is killed, fails the operator like any other error, with a name such as `Parallel[key].Step`,
  and `on_error:` decides. With `on_branch_error: :restart`, only that branch is restarted with its next part, and
  messages in flight in it count as missing. A branch fails, too, when its node is lost.

  A checkpoint contains the branches that are values. An operator whose branches are pipelines cannot be saved.

  ## Options

  #{Options.docs(Parallel.option_schema())}
  """
  @doc group: "Parallel"
  @spec parallel(Stream.t(), (Stream.t() -> term()) | (term(), Stream.t() -> term()), keyword()) ::
          Stream.t()
  defdelegate parallel(stream, fun, opts \\ []), to: Parallel

  # Streams as lists and enumerables

  @doc """
  Runs a pipeline to its end and returns the messages of the streams that `build` returned. A stream becomes a list of
  `Situ.Message`; a list or map of streams becomes a list or map of such lists. The pipeline runs as fast as possible
  unless `pipeline:` sets a speed.

      iex> {:ok, %{odd: odd}} = Situ.collect(fn p ->
      ...>   %{odd: p |> Situ.from_enumerable(0..4, every: 10) |> Situ.filter(&(rem(&1, 2) == 1))}
      ...> end)
      iex> Enum.map(odd, & &1.data)
      [1, 3]
  """
  @doc group: "Collecting"
  @spec collect((Pipeline.t() -> streams()), keyword()) :: {:ok, term()} | {:error, Error.t()}
  defdelegate collect(build, opts \\ []), to: Collector

  @doc """
  Runs a pipeline like `collect/2`, but returns only the data and raises errors. With `times: true`, returns
  `{originating_time, data}` pairs.

      iex> Situ.to_list(fn p -> p |> Situ.from_enumerable(1..5, every: 10) |> Situ.map(&(&1 * &1)) end)
      [1, 4, 9, 16, 25]
  """
  @doc group: "Collecting"
  @spec to_list((Pipeline.t() -> streams()), keyword()) :: term()
  defdelegate to_list(build, opts \\ []), to: Collector

  @doc """
  Returns the data of the stream that `build` returns as an Elixir `Stream`. Reading it runs a separate pipeline,
  which runs ahead only as far as its back-pressure allows and is stopped when reading stops. With `messages: true`,
  returns complete messages.

      iex> fn p -> Situ.sequence(p, 1, &(&1 * 3), every: 10) end |> Situ.to_stream() |> Enum.take(4)
      [1, 3, 9, 27]
  """
  @doc group: "Collecting"
  @spec to_stream((Pipeline.t() -> Stream.t()), keyword()) :: Enumerable.t()
  defdelegate to_stream(build, opts \\ []), to: Collector

  # Running pipelines

  @doc """
  Attaches a tap to a stream of a running pipeline: `fun` receives every `Situ.Message` from now on. `target` is a
  stream, or `{pipeline, stream_name}`. `detach_tap/1` removes the tap.

      iex> me = self()
      iex> connector = Situ.Connector.new("taps")
      iex> {:ok, p} = Situ.Pipeline.start(fn p ->
      ...>   p |> Situ.Connector.receive(connector) |> Situ.map(&(&1 * 2), name: "Doubled")
      ...> end, [])
      iex> {:ok, tap} = Situ.attach_tap({p, "Doubled"}, &send(me, {:seen, &1.data}))
      iex> Situ.Connector.deliver_messages(connector, [%Situ.Message{data: 21, originating_time: 1}])
      iex> receive do {:seen, n} -> n end
      42
      iex> Situ.detach_tap(tap)
      :ok
      iex> {:ok, _} = Situ.Pipeline.stop(p)
      iex> Situ.detach_tap(tap)
      :ok

  The function runs in its own process, which has a lossy queue, so a slow or stuck tap costs the pipeline only the
  copying of messages. If the function raises, the message is skipped. The tap ends with its pipeline and with the
  process that attached it. The function runs on the node of the process that attached the tap. If the pipeline is on
  another node, one message at a time is in flight.

  In a pipeline that is being built, `each/3` with a lossy `policy:` has the same effect.

  #{Options.docs(Tap.option_schema())}
  """
  @doc group: "Running pipelines"
  @spec attach_tap(
          Stream.t() | {Pipeline.target(), String.t()},
          (Message.t() -> any()),
          keyword()
        ) :: {:ok, Tap.t()} | {:error, Error.t()}
  defdelegate attach_tap(target, fun, opts \\ []), to: Tap, as: :attach

  @doc """
  Removes a tap that `attach_tap/3` added. Does nothing if its pipeline has already ended.

      iex> t = Situ.Test.start([:n], &Situ.map(&1.n, fn n -> n end, name: "Same"))
      iex> {:ok, tap} = Situ.attach_tap({t.pipeline, "Same"}, &IO.inspect/1)
      iex> Situ.detach_tap(tap)
      :ok
      iex> {:ok, _report} = Situ.Test.stop(t)
      iex> :done
      :done
  """
  @doc group: "Running pipelines"
  @spec detach_tap(Tap.t()) :: :ok
  defdelegate detach_tap(tap), to: Tap, as: :detach

  @doc """
  Prints a running pipeline as a table of edges (counts, queues, drops, latencies) and processes.

      iex> t = Situ.Test.start([:n], &Situ.map(&1.n, fn n -> n end, name: "Same"))
      iex> table = ExUnit.CaptureIO.capture_io(fn -> Situ.inspect(t.pipeline) end)
      iex> table =~ "Same"
      true
      iex> {:ok, _report} = Situ.Test.stop(t)
      iex> :done
      :done

  With `refresh: ms` the table is printed repeatedly until the pipeline ends, or at most `times:` times.
  """
  @doc group: "Running pipelines"
  @spec inspect(Pipeline.target(), keyword()) :: :ok
  def inspect(p, opts \\ []) do
    case Options.validate!(opts, refresh: [type: :pos_integer], times: [type: :pos_integer]) do
      [] ->
        IO.puts(Situ.Diagnostics.format(Pipeline.info(p)))

      opts ->
        Pipeline.Client.print_live_table(p, opts[:refresh] || 1_000, opts[:times] || :infinity)
    end
  end

  @doc """
  Returns where in a running pipeline the message with an originating time is now, and where it waited. Calls no
  component. `Situ.Diagnostics.format/1` formats the result for printing.

    * `time`: the requested originating time; `now`: the time of the pipeline's clock
    * `hops`: one map for each connection between processes, in order of construction:
      `%{from, to, state, sent, taken, waited, queue}`
    * `inside`: paths of the components that have taken the message but have not sent any message with that time or a
      later one: the message is in the component, or ended there (in a sink or a filter)

  `state` of a hop is `:coming` (no message with that time or later was sent), `:waiting` (sent, but `to` has not
  finished with it: it is in the queue, or is being handled) or `:passed` (taken, or dropped by the policy). `sent`
  and `taken` are times of the pipeline's clock, accurate to a millisecond, or `:forgotten` if they are too old (at
  least 128 ms in which messages were sent). `waited` is the time from `sent` to `taken`, or to now while the message
  is waiting. `queue` is the number of messages waiting there.

      iex> {:ok, p} = Situ.Pipeline.start(fn p ->
      ...>   p |> Situ.timer(every: Situ.Time.ms(1)) |> Situ.each(& &1, name: "Sink", async: true)
      ...> end)
      iex> trace = Situ.trace(p, Situ.Pipeline.now(p) + Situ.Time.s(3600))
      iex> for hop <- trace.hops, do: {hop.from, hop.to, hop.state}
      [{"Timer", "Sink", :coming}]
      iex> {:ok, _} = Situ.Pipeline.stop(p)
      iex> :done
      :done
  """
  @doc group: "Running pipelines"
  @spec trace(Pipeline.target(), Time.t()) :: Trace.t()
  def trace(p, time) when is_integer(time), do: Pipeline.Client.call!(p, {:trace, time})

  def trace(_p, other) do
    takes = "an originating time in ns as its second argument"
    Argument.raise_invalid!(other, takes, "Situ.trace(p, Situ.Pipeline.now(p))")
  end
end
