defmodule Situ.Pipeline do
  @moduledoc """
  A pipeline is a graph of components, run as a supervised set of processes.

      defmodule Lobby do
        use Situ.Pipeline

        @impl true
        def build(p, _opts) do
          p |> Situ.source(Camera) |> Situ.map(&Blob.find/1) |> Situ.each(&IO.inspect/1)
        end
      end

      {:ok, report} = Situ.Pipeline.run(Lobby, [])      # blocks, as fast as possible
      children = [{Lobby, []}]                          # or supervised, in real time

  A pipeline is also a function, for scripts and tests:

      iex> {:ok, report} = Situ.Pipeline.run(fn _p -> :nothing end)
      iex> {report.result, report.errors}
      {:nothing, []}

  ## Options of a pipeline's module

  A module can declare its options with a schema (`Situ.Options`). They are checked before `build/2` is called, defaults
  are filled in, and `situ run` accepts them on the command line:

      defmodule Lobby do
        use Situ.Pipeline,
          options: [threshold: [type: :float, default: 0.4, doc: "How loud a voice is, from 0 to 1."]]

        @impl true
        def build(p, opts), do: detect_voices(p, opts[:threshold])
      end

  ## Settings, under the reserved key `pipeline:` of the options

  #{Situ.Options.docs(Situ.Pipeline.Settings.schema())}

  `run/2` defaults to speed `:max`, `start_link/2` and `child_spec/1` to real time (`1.0`).

  ## Processes

      your supervisor
        └── pipeline        owns the life cycle; parent of its components; traps exits
              ├── component or chain of operators, linked; traps exits, so that `terminate/2` runs
              └── ...

  A component that dies is restarted in its place (`on_error: :restart` or `:skip`), or the pipeline ends with an error.
  When the pipeline's process dies, its components release their resources and end. The guide "When things fail" has
  the complete table.

  ## Recompiling

  When the module of a running pipeline is recompiled (`r Lobby` in IEx), its operators switch to the new functions and
  keep their state, even while the pipeline is starting. The compiler waits until they have switched, so a module can be
  recompiled any number of times. The VM keeps two versions of a module: if an operator takes longer than five seconds
  for one message, a second compilation ends the pipeline with a `BadFunctionError`. Functions given as `&Module.name/1`
  always use the newest version and have no such limit.

  ## Changing a running pipeline

  `extend/2`, `remove/3`, `stop_part/3`, `start_part/3`, `replace/4`, `pause/1`, `checkpoint/3` and `Situ.attach_tap/3`
  can be called at any time, from any number of processes. Changes of the same components take effect one after the
  other, in the order of the calls; so do `pause/1` and `checkpoint/3`, which concern the whole pipeline. All others run
  concurrently. A change is made completely, or refused with the reason. `list_changes/1` returns the last ones.

  ## Building from outside

  `new/1` opens an empty pipeline in state `:building`. Add components to it from any process, then call `launch/1`:

      iex> p = Situ.Pipeline.new()
      iex> numbers = Situ.from_enumerable(p, 1..3, every: 1, name: "Numbers")
      iex> numbers.name
      "Numbers"
      iex> {:ok, _report} = Situ.Pipeline.stop(p)
      iex> {:error, error} = Situ.Pipeline.stop(p)
      iex> error.code
      :not_running
  """
  alias Situ.{Argument, Error, Graph, Node, Stream}
  alias Situ.Application.{CodeReload, Directory}
  alias Situ.Graph.{Builder, Handle, StreamNames}
  alias Situ.Pipeline.{Client, Launcher, Report}

  @typedoc "A handle, passed to `build/2` and returned by `new/1`."
  @type t :: Handle.t()
  @type spec :: module() | (t() -> term())
  @typedoc "A running pipeline: handle, process, registered name, label (`name:` as a string), or one of its streams."
  @type target :: t() | pid() | GenServer.name() | String.t() | Stream.t()
  @type result :: {:ok, Report.t()} | {:error, Error.t()}

  @doc "Builds the graph. Its return value becomes the report's `result`."
  @callback build(t(), opts :: keyword()) :: term()

  @doc "Returns the schema of the options of `build/2`. Without it, any options are passed on."
  @callback options() :: Situ.Options.schema()
  @optional_callbacks options: 0

  @doc false
  defmacro __using__(opts) do
    quote do
      @behaviour Situ.Pipeline
      @after_compile Situ.Pipeline
      @situ_child Situ.Pipeline.child_overrides!(unquote(Keyword.delete(opts, :options)))

      unquote(define_options(opts[:options]))

      def child_spec(opts),
        do: Supervisor.child_spec(Situ.Pipeline.child_spec({__MODULE__, opts}), @situ_child)

      def start_link(opts), do: Situ.Pipeline.start_link(__MODULE__, opts)
      defoverridable child_spec: 1
    end
  end

  defp define_options(nil), do: nil

  defp define_options(schema) do
    quote do
      Situ.Options.add_to_moduledoc(__MODULE__, unquote(schema))

      @impl true
      def options, do: unquote(schema)
    end
  end

  # The compiler calls this after it has loaded a new version of the pipeline's module.
  @doc false
  def __after_compile__(%Macro.Env{module: module}, _bytecode),
    do: CodeReload.await_reload(module)

  @doc false
  # The fields of a child specification that `use Situ.Pipeline` sets.
  @spec child_overrides!(keyword()) :: keyword()
  def child_overrides!(opts),
    do:
      Situ.Options.validate!(opts, id: [type: :any], restart: [type: :any], shutdown: [type: :any])

  @doc """
  Returns a child specification for a module or function, or for `{module_or_fun, opts}`. It is transient, so failures
  restart the pipeline, and a pipeline that has completed stays ended. With a name, its id is `{module_or_fun, name}`,
  so a supervisor can have several pipelines of one module.

      iex> spec = Situ.Pipeline.child_spec({Lobby, pipeline: [name: "Door"]})
      iex> {spec.id, spec.restart, spec.shutdown}
      {{Lobby, "Door"}, :transient, 10_000}

  Change it with `Supervisor.child_spec({Lobby, opts}, restart: :permanent)`, or for all pipelines of a module with
  `use Situ.Pipeline, restart: :permanent`.
  """
  @spec child_spec(spec() | {spec(), keyword()}) :: Supervisor.child_spec()
  def child_spec(spec) when is_atom(spec) or is_function(spec, 1), do: child_spec({spec, []})

  def child_spec({spec, opts}) do
    name = opts[:pipeline][:name]

    %{
      id: if(name, do: {spec, name}, else: spec),
      start: {__MODULE__, :start_link, [spec, opts]},
      type: :supervisor,
      restart: :transient,
      shutdown: 10_000
    }
  end

  @doc """
  Checks the options of a pipeline against the schema of its module, and fills in defaults. Modules without a schema
  accept any options, and functions none.

      iex> {:error, error} = Situ.Pipeline.validate_options(fn _p -> :ok end, name: "Hall")
      iex> {error.code, error.fix}
      {:unknown_option, ~s(write pipeline: [name: "Hall"])}
  """
  @spec validate_options(spec(), keyword()) :: {:ok, keyword()} | {:error, Error.t()}
  def validate_options(spec, opts), do: Launcher.validate_options(spec, opts)

  @doc """
  Builds the pipeline, runs it to completion and returns the report, or the first error (`error.meta.errors` holds all
  of them).

  A pipeline without finite sources runs until another process stops it.

      iex> build = fn p -> p |> Situ.from_enumerable(1..3, every: Situ.Time.ms(10)) |> Situ.each(& &1) end
      iex> {:ok, report} = Situ.Pipeline.run(build, pipeline: [name: "Count"])
      iex> {report.name, report.errors}
      {"Count", []}

  `spec` is a module with `build/2`, or a function of the pipeline. `opts` are the options of the module, and the
  settings of the pipeline under `pipeline:` (see the documentation of this module). By default it runs as fast as
  possible; `pipeline: [replay: [speed: 1.0]]` runs it in real time.
  """
  @spec run(spec(), keyword()) :: result()
  def run(spec, opts \\ []), do: Launcher.run(spec, opts)

  @doc """
  Builds and starts a pipeline linked to the caller; returns as soon as `build` has returned. Takes the same arguments
  as `run/2`, but runs in real time by default.

      iex> {:ok, p} = Situ.Pipeline.start_link(fn p -> Situ.timer(p, every: Situ.Time.s(1)) end)
      iex> {:ok, report} = Situ.Pipeline.stop(p)
      iex> report.errors
      []

  In an application, write `{Lobby, opts}` or `{Situ.Pipeline, {fun, opts}}` in a list of children (`child_spec/1`).
  """
  @spec start_link(spec(), keyword()) :: {:ok, pid()} | {:error, Error.t()}
  def start_link(spec, opts \\ []), do: Launcher.start_link(spec, opts)

  @doc "Starts a pipeline like `start_link/2`, but without the link; only `await/2` reports a failure."
  @spec start(spec(), keyword()) :: {:ok, pid()} | {:error, Error.t()}
  def start(spec, opts \\ []), do: Launcher.start(spec, opts)

  @doc "Opens an empty pipeline to build from outside and start with `launch/1`; it ends with its caller."
  @spec new(keyword()) :: t()
  def new(settings \\ []), do: Launcher.new(settings)

  @doc "Runs a pipeline that was opened with `new/1` and built from outside."
  @spec launch(t()) :: :ok | {:error, Error.t()}
  def launch(%Handle{} = p), do: Client.call(p, :launch)
  def launch(other), do: Argument.raise_invalid!(other, :handle, "Situ.Pipeline.launch(p)")

  @doc """
  Stops a pipeline: sources stop first, messages posted until now are delivered, then every output closes, upstream
  first.

  A source that lags behind the clock may continue up to the clock's time, for at most `catch_up:` ms (1,000); with
  `catch_up: 0` it ends at its current position. `timeout:` limits how long the caller waits, not the stop.

  Every caller that asks before the end receives the report once everything has ended. A caller that asks later
  receives `{:error, %Situ.Error{code: :not_running}}`. Called from inside one of the pipeline's own components, the
  function returns `:ok` immediately and the pipeline stops later.
  """
  @spec stop(target(), keyword()) :: result() | :ok
  def stop(p, opts \\ []), do: Client.stop_pipeline(p, opts)

  @doc """
  Ends a pipeline immediately, for callers that continue it elsewhere from a checkpoint. Messages in flight are not
  delivered, components release their resources, and the result is an error (`:abandoned`).

      iex> {:ok, p} = Situ.Pipeline.start(&Situ.from_enumerable(&1, Stream.cycle([1]), every: Situ.Time.s(1)))
      iex> :ok = Situ.Pipeline.abandon(p)
      iex> {:error, %Situ.Error{code: code}} = Situ.Pipeline.await(p)
      iex> code
      :abandoned
  """
  @spec abandon(target()) :: :ok | {:error, Error.t()}
  def abandon(p), do: Client.abandon_pipeline(p)

  @doc """
  Stops a composite or a component, given as a path or a `Situ.Node`; the rest of the pipeline keeps running.

  At the time of the stop, the part's sources stop and its inputs from outside close; it still receives the messages
  posted up to then. Its outputs close at that time, upstream first, so listeners outside see the end of those streams
  (`handle_closed/4` is called, windows and joins flush). Its processes end and release their devices and files, and
  diagnostics list its components as `:closed`. `start_part/3` starts the part again; with `checkpoint: true`, it can
  start with the state that it had when it stopped.

  The stopped part no longer affects when the pipeline ends. The remaining sources decide that; if there are none, the
  pipeline stops as after `stop/2`. It also takes the options of `stop/2`. Returns `:ok` when the whole part has closed;
  called from inside one of the pipeline's own components, it returns immediately.

      iex> {:ok, p} = Situ.Pipeline.start(fn p ->
      ...>   clock = Situ.timer(p, every: Situ.Time.ms(1))
      ...>   Situ.composite(clock, "Side", fn ticks -> Situ.each(ticks, & &1) end)
      ...>   Situ.each(clock, & &1, name: "Main")
      ...> end, [])
      iex> :ok = Situ.Pipeline.stop_part(p, "Side")
      iex> {:error, error} = Situ.Pipeline.stop_part(p, "Side")
      iex> {error.code, Situ.Pipeline.state(p)}
      {:not_running, :running}
      iex> {:ok, _report} = Situ.Pipeline.stop(p)
      iex> :done
      :done

  Errors: `:unknown_component`; `:not_running` if the part has ended; `:shared_process` if a synchronous policy put one
  of its operators into the same process as an operator outside; `:component_killed` if a component was stuck for
  `stop_timeout:` and had to be killed.
  """
  @spec stop_part(target(), String.t() | Node.t(), keyword()) :: :ok | {:error, Error.t()}
  def stop_part(p, part, opts \\ []), do: Client.stop_part(p, part, opts)

  @doc """
  Starts a part again that was stopped with `stop_part/3`, or has ended by itself, while the rest of the pipeline keeps
  running.

  With `from: :fresh` (the default), its components start with their initial state. With `from: :checkpoint`, they start
  with the state that they had when the part was stopped with `checkpoint: true`: sources continue after the last
  message that they posted, and no message is posted twice. Windows and joins have flushed what they held.

  Its inputs receive the messages from now on; they miss the messages between the stop and this call. Streams inside the
  part are connected again. Components outside have seen the end of the part's streams and receive nothing more: stop
  and start them again after the part, or add new ones with `extend/2`.

      iex> me = self()
      iex> {:ok, p} = Situ.Pipeline.start(fn p ->
      ...>   ticks = Situ.timer(p, every: Situ.Time.ms(1))
      ...>   Situ.composite(ticks, "Side", fn ticks ->
      ...>     ticks |> Situ.scan(0, fn _, n -> n + 1 end) |> Situ.each(&send(me, {:count, &1}))
      ...>   end)
      ...>   Situ.each(ticks, & &1)
      ...> end)
      iex> receive do {:count, 5} -> :ok end
      iex> :ok = Situ.Pipeline.stop_part(p, "Side", checkpoint: true)
      iex> :ok = Situ.Pipeline.start_part(p, "Side", from: :checkpoint)
      iex> receive do {:count, n} when n > 5 -> :counting end
      :counting
      iex> {:ok, _report} = Situ.Pipeline.stop(p)
      iex> :done
      :done

  When this function returns, either the whole part is running or none of it. If the part is still being stopped, the
  call waits. `timeout:` limits how long the caller waits.

  Errors: `:unknown_component`; `:still_running` if a component of the part is running; `:no_checkpoint` if a component
  reported no state when it stopped, and `:no_snapshot` if its state is not plain data; `:not_running`; and errors of
  `init/1` and `handle_start/2`.
  """
  @spec start_part(target(), String.t() | Node.t(), keyword()) :: :ok | {:error, Error.t()}
  def start_part(p, part, opts \\ []), do: Client.start_part(p, part, opts)

  @doc """
  Adds components to a running pipeline. `fun` receives a handle and builds as `build/2` does. The new components may
  listen to running streams (see `stream/2`) from a message boundary on: they miss the last message before it and
  receive every later one.

  When this function returns, either all new components are running or none of them. In the latter case it returns the
  error and the pipeline keeps running as before. A pipeline waits for the end of added finite sources, but their end
  alone does not end it. Use `remove/3` to remove the components again.

      iex> me = self()
      iex> {:ok, p} = Situ.Pipeline.start(fn p -> p |> Situ.timer(every: Situ.Time.ms(1)) |> Situ.name("Ticks") end)
      iex> {:ok, _} = Situ.Pipeline.extend(p, fn p ->
      ...>   ticks = Situ.Pipeline.stream(p, "Ticks")
      ...>   Situ.composite(ticks, "Watch", fn ticks -> Situ.each(ticks, &send(me, {:tick, &1})) end)
      ...> end)
      iex> receive do {:tick, _} -> :seen end
      :seen
      iex> Situ.Pipeline.remove(p, "Watch")
      :ok
      iex> {:ok, _} = Situ.Pipeline.stop(p)
      iex> :done
      :done

  Errors: the errors of building; `:inside_chain` if a stream has no output outside its process; `:fixed_inputs` if the
  function connects an input of a running component; `:not_running`; and errors of `init/1` and `handle_start/2` of the
  new components.
  """
  @spec extend(target(), (t() -> result)) :: {:ok, result} | {:error, Error.t()}
        when result: term()
  def extend(p, fun) when is_function(fun, 1), do: Client.extend_pipeline(p, fun)

  def extend(_p, other) do
    takes = "a function that builds as its second argument"

    Argument.raise_invalid!(
      other,
      takes,
      "Situ.Pipeline.extend(p, fn p -> Situ.source(p, Camera) end)"
    )
  end

  @doc """
  Stops a part as `stop_part/3` does and removes it from the pipeline, which frees its names.

  A part that was stopped, is being stopped, or has ended by itself can also be removed.
  """
  @spec remove(target(), String.t() | Node.t(), keyword()) :: :ok | {:error, Error.t()}
  def remove(p, part, opts \\ []), do: Client.stop_part(p, part, [{:forget?, true} | opts])

  @doc "Returns a stream of the pipeline being built or extended, by name. Raises `Situ.Error` (`:unknown_stream`)."
  @spec stream(t(), String.t()) :: Stream.t()
  def stream(%Handle{} = p, name),
    do: Builder.update_graph(p, &{Graph.fetch_stream!(&1, p, name), &1})

  def stream(other, name),
    do: Argument.raise_invalid!(other, :handle, "Situ.Pipeline.stream(p, #{inspect(name)})")

  @doc """
  Returns the names of the streams of a pipeline that is being built or extended, in order: all streams, or with
  `:named` only the streams that were named explicitly (`name:` or `Situ.name/2`).

      iex> {:ok, report} = Situ.Pipeline.run(fn p ->
      ...>   p |> Situ.from_enumerable(1..3, every: 1) |> Situ.map(&(&1 + 1), name: "Next")
      ...>   {Situ.Pipeline.stream_names(p), Situ.Pipeline.stream_names(p, :named)}
      ...> end)
      iex> report.result
      {["Enumerable", "Next"], ["Next"]}
  """
  @spec stream_names(t(), :all | :named) :: [String.t()]
  def stream_names(p, which \\ :all)

  def stream_names(%Handle{} = p, which) when which in [:all, :named],
    do: Builder.update_graph(p, &{StreamNames.list_names(&1, which), &1})

  def stream_names(%Handle{}, other),
    do: Argument.raise_invalid!(other, ":all or :named", "Situ.Pipeline.stream_names(p, :named)")

  def stream_names(other, _which),
    do: Argument.raise_invalid!(other, :handle, "Situ.Pipeline.stream_names(p)")

  @doc "Waits for the end; after `timeout` ms returns a `Situ.Error` (`:timeout`), and the pipeline keeps running."
  @spec await(target(), timeout()) :: result()
  def await(p, timeout \\ :infinity), do: Client.await_result(p, timeout)

  @doc """
  Returns a `Situ.Diagnostics.Snapshot`: graph, counters, queues, latencies and processes. Calls no component.
  `Situ.inspect/2` prints it as a table.

      iex> {:ok, p} = Situ.Pipeline.start(fn p -> Situ.timer(p, every: 1_000_000, name: "Tick") end)
      iex> for node <- Situ.Pipeline.info(p).nodes, do: {node.path, node.kind, node.errors}
      [{"Tick", :source, 0}]
      iex> {:ok, _report} = Situ.Pipeline.stop(p)
      iex> :done
      :done
  """
  @spec info(target()) :: Situ.Diagnostics.Snapshot.t()
  def info(p), do: Client.call!(p, :info)

  @doc """
  Returns the changes to the running pipeline, the newest first: all changes that wait or run, and the last hundred
  that have ended.

  Each change has an `id` that grows with the order of the requests, the kind of `change`, its `subject` (a path or the
  name of a stream), the process that has requested it (`by`), its `state` (`:waiting`, `:running`, `:applied` or
  `{:refused, error}`), and the times of the pipeline's clock at which it was `accepted` and `ended`.

      iex> ticks = fn p -> Situ.timer(p, every: Situ.Time.ms(1), name: "Ticks") end
      iex> {:ok, p} = Situ.Pipeline.start(ticks, pipeline: [replay: [interval: {0, :unbounded}]])
      iex> {:error, _} = Situ.Pipeline.remove(p, "Tocks")
      iex> :ok = Situ.Pipeline.pause(p)
      iex> for change <- Situ.Pipeline.list_changes(p), do: {change.change, change.subject, change.by == self()}
      [{:pause, nil, true}, {:remove, "Tocks", true}]
      iex> [_, %{state: {:refused, error}}] = Situ.Pipeline.list_changes(p)
      iex> error.code
      :unknown_component
      iex> {:ok, _} = Situ.Pipeline.stop(p)
      iex> :done
      :done
  """
  @spec list_changes(target()) :: [
          %{
            id: term(),
            change: atom(),
            subject: String.t() | nil,
            by: pid() | nil,
            state: :waiting | :running | :applied | {:refused, Error.t()},
            accepted: Situ.Time.t(),
            ended: Situ.Time.t() | nil
          }
        ]
  def list_changes(p), do: Client.call!(p, :changes)

  @doc """
  Returns the pipelines of this node, each with its label, process and state.

      iex> build = fn p -> Situ.timer(p, every: Situ.Time.ms(1)) end
      iex> {:ok, p} = Situ.Pipeline.start(build, pipeline: [name: "Doc clock"])
      iex> for %{name: "Doc clock", pid: pid} <- Situ.Pipeline.list(), do: pid == p
      [true]
      iex> {:ok, _} = Situ.Pipeline.stop("Doc clock")
      iex> for %{name: "Doc clock"} = entry <- Situ.Pipeline.list(), do: entry
      []
  """
  @spec list() :: [%{name: String.t(), pid: pid(), state: atom()}]
  def list do
    for {name, pid} <- Directory.list_pipelines(),
        state = Client.pipeline_state(pid),
        state != :completed,
        do: %{name: name, pid: pid, state: state}
  end

  @doc "Returns the state: `:building`, `:starting`, `:running`, `:stopping` or `:completed`."
  @spec state(target()) :: atom()
  def state(p), do: Client.pipeline_state(p)

  @doc "Returns the current time of the pipeline's clock, in ns."
  @spec now(target()) :: Situ.Time.t()
  def now(p) do
    pid = Client.resolve_pid(p)

    if is_pid(pid) and node(pid) != node(),
      do: Client.call_on_node(pid, __MODULE__, :now),
      else: p |> clock() |> Situ.Clock.now()
  end

  @doc "Returns the pipeline's clock; available once the pipeline has started."
  @spec clock(target()) :: Situ.Clock.t()
  def clock(p), do: Client.call!(p, :clock)

  @doc "Returns the progress of the replay or the finite sources, 0.0 to 1.0; never decreases, 1.0 only at the end."
  @spec progress(target()) :: float()
  def progress(p), do: Client.call!(p, :progress)

  @doc "Pauses the clock of a running pipeline; replayed and timed messages wait."
  @spec pause(target()) :: :ok | {:error, Error.t()}
  def pause(p), do: Client.call(p, {:clock, :pause})

  @doc "Resumes a paused clock from the time at which it was paused."
  @spec resume(target()) :: :ok | {:error, Error.t()}
  def resume(p), do: Client.call(p, {:clock, :resume})

  @doc "Changes the speed of a running pipeline's clock (1.0 is real time)."
  @spec set_speed(target(), number()) :: :ok | {:error, Error.t()}
  def set_speed(p, speed) when is_number(speed) and speed > 0,
    do: Client.call(p, {:clock, {:set_speed, speed}})

  def set_speed(_p, other) do
    takes = "a number above 0 as its second argument"
    Argument.raise_invalid!(other, takes, "Situ.Pipeline.set_speed(p, 2.0)")
  end

  @doc """
  Replaces the module or the options of a running component; its edges, queues and position in the graph stay the same.

  `node` is a `Situ.Node` or a path. If the new module defines `migrate/3`, it converts the state; otherwise the
  component starts with a fresh state. Returns an error that gives the reason if ports or types do not fit.
  """
  @spec replace(target(), Node.t() | String.t(), {module(), keyword()} | keyword(), keyword()) ::
          :ok | {:error, Error.t()}
  def replace(p, node, change, opts \\ []) do
    timeout = Keyword.get(opts, :timeout, 30_000)
    Client.call(p, {:replace, %{node: node, change: change, timeout: timeout}})
  end

  @doc """
  Takes a checkpoint: calls `fun` with a map from component path to snapshot (plain data), while sources are paused and
  no messages are in flight. A pipeline with the same graph that starts with `pipeline: [resume: memories]` continues
  from there, in another process or on another machine; messages that were posted before are not posted again.

  A component whose state is plain data needs no extra code. A component with handles in its state defines
  `c:Situ.Component.snapshot/1` and `c:Situ.Component.restore/2`.

      iex> count = fn p ->
      ...>   numbers = Situ.from_enumerable(p, Stream.cycle(1..4), every: Situ.Time.s(1))
      ...>   Situ.scan(numbers, 0, &(&1 + &2), name: "Sum")
      ...> end
      iex> {:ok, p} = Situ.Pipeline.start(count)
      iex> {:ok, paths} = Situ.Pipeline.checkpoint(p, &Enum.sort(Map.keys(&1)))
      iex> paths
      ["Enumerable", "Sum"]
      iex> {:ok, _} = Situ.Pipeline.stop(p)
      iex> :done
      :done

  Options: `timeout:`, the time to wait for the checkpoint, in ms (5,000). Errors: `:no_snapshot` names a component
  whose state is not plain data; `:not_settled` if messages were in flight, or other changes running, all the time;
  `:busy` inside the function of another checkpoint; `:not_running`.
  """
  @spec checkpoint(target(), (%{String.t() => map()} -> result), keyword()) ::
          {:ok, result} | {:error, Error.t()}
        when result: term()
  def checkpoint(p, fun, opts \\ [])

  def checkpoint(p, fun, opts) when is_function(fun, 1),
    do: Client.with_checkpoint(p, fun, Keyword.get(opts, :timeout, 5_000))

  def checkpoint(_p, other, _opts) do
    takes = "a function of the memories as its second argument"

    Argument.raise_invalid!(
      other,
      takes,
      "Situ.Pipeline.checkpoint(p, fn memories -> memories end)"
    )
  end

  @doc """
  Adds a component without connecting it (`Situ.source/3` and `Situ.via/3` do both). `opts` are the component's options
  and the options of `Situ.Graph.Placement`.

  `on_same_time:` is for sources whose messages may have equal times (a coarse clock, a log with whole seconds):
  `:error` (the default), `:drop` to drop the later message, or `:nudge` to move it to 1 ns after the previous one. A
  time that goes backwards is always an error.

      iex> enumerable = [{10, :a}, {10, :b}, {10, :c}, {20, :d}]
      iex> replay = [replay: [interval: {0, 100}, speed: :max]]
      iex> Situ.to_list(&Situ.from_enumerable(&1, enumerable, on_same_time: :nudge), times: true, pipeline: replay)
      [{10, :a}, {11, :b}, {12, :c}, {20, :d}]
      iex> Situ.to_list(&Situ.from_enumerable(&1, enumerable, on_same_time: :drop), times: true, pipeline: replay)
      [{10, :a}, {20, :d}]
  """
  @spec add(t(), module(), keyword()) :: Node.t()
  def add(p, module, opts \\ [])

  def add(%Handle{} = p, module, opts),
    do: Builder.update_graph(p, &Graph.add_component(&1, p, module, opts))

  def add(other, module, _opts),
    do: Argument.raise_invalid!(other, :handle, "Situ.Pipeline.add(p, #{inspect(module)})")

  @doc "Connects `stream` to the `input` of `node`; the option `policy:` is a `Situ.Delivery`."
  @spec connect(Stream.t(), Node.t(), atom(), keyword()) :: :ok
  def connect(stream, node, input, opts \\ [])

  def connect(%Stream{} = stream, %Node{} = node, input, opts),
    do: Builder.update_graph(stream.pipeline, &Graph.connect(&1, stream, node, input, opts))

  def connect(other, _node, _input, _opts),
    do: Argument.raise_invalid!(other, :stream, "Situ.Pipeline.connect(stream, node, :in)")

  @doc """
  Announces, during `build`, the span of originating times that a source is going to replay.

  Proposals are merged into the smallest span that contains all of them, and limited by `replay: [interval: ...]`; the
  clock starts at the beginning of the result.
  """
  @spec propose_replay(t(), {Situ.Time.t(), Situ.Time.t() | :unbounded}) :: :ok
  def propose_replay(%Handle{} = p, {from, to})
      when is_integer(from) and (is_integer(to) or to == :unbounded) do
    Builder.update_graph(p, &{:ok, %{&1 | proposals: [{from, to} | &1.proposals]}})
  end

  def propose_replay(%Handle{}, other) do
    raise ArgumentError,
          "a proposed replay is {from, to}, ns, with a known start (the end may be :unbounded), got: #{inspect(other)}"
  end

  def propose_replay(other, _span),
    do: Argument.raise_invalid!(other, :handle, "Situ.Pipeline.propose_replay(p, {from, to})")

  @doc """
  Registers `fun` to be called for an event; only during `build`.

    * `:run`: `fun.(start_time)` before any source starts; raising fails the start
    * `:completed`: `fun.(report)` after everything has ended, before `run/2` returns
    * `:component_completed`: `fun.({path, final_time})` when a finite source reports its end
    * `:error`: `fun.(error)` for each error
    * `:progress`: `fun.(progress)` every `progress_every:` ms and at the end: 0.0 to 1.0, never decreasing
    * `:abandoned`: `fun.(error | nil)` if `build` failed, or if the owner of an empty pipeline ended before the
      pipeline was started; no other handler will be called

  A `resource` is a value in the options of components, such as the writer of a recording. If the pipeline is divided
  into parts that run on several nodes, the handler moves to the node of the components that use the resource.
  """
  @spec on(t(), event, (term() -> any()), resource :: term()) :: :ok
        when event: :run | :completed | :component_completed | :error | :progress | :abandoned
  def on(p, event, fun, resource \\ nil)

  def on(%Handle{} = p, event, fun, resource)
      when event in [:run, :completed, :component_completed, :error, :progress, :abandoned] and
             is_function(fun, 1) do
    Builder.update_graph(p, fn graph ->
      resources = if resource, do: Map.put(graph.resources, fun, resource), else: graph.resources
      {:ok, %{graph | handlers: graph.handlers ++ [{event, fun}], resources: resources}}
    end)
  end

  def on(other, _event, _fun, _resource),
    do:
      Argument.raise_invalid!(
        other,
        :handle,
        "Situ.Pipeline.on(p, :error, fn error -> error end)"
      )

  @doc """
  Returns the replay interval, `{from | :unbounded, to | :unbounded}`, for importers during `build`.
  """
  @spec replay_interval(t()) :: {Situ.Time.t() | :unbounded, Situ.Time.t() | :unbounded}
  def replay_interval(%Handle{} = p), do: Builder.update_graph(p, &{&1.replay, &1})

  def replay_interval(other),
    do: Argument.raise_invalid!(other, :handle, "Situ.Pipeline.replay_interval(p)")
end
