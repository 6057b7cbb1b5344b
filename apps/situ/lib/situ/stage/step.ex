defmodule Situ.Stage.Step do
  @moduledoc false
  # One step of a stage: a component, or a chain of light operators, with its ports. The state of a stage is a list of
  # steps (see State). Everything that happens to one step is a function of the step; `host` holds the values that all
  # steps of a stage share.
  alias Situ.{Clock, Error, Runtime}
  alias Situ.Clock.Timers
  alias Situ.Component.{Callback, Context}
  alias Situ.Graph.Vertex
  alias Situ.Operator.Chain
  alias Situ.Ports.{Address, ErrorCounters, Inputs, Outputs}
  alias Situ.Stage.{SourceState, Work}

  @never 9_000_000_000_000_000_000

  @enforce_keys [:host, :index, :vertices, :worker, :context, :outputs, :source]
  defstruct [
    :host,
    :index,
    :vertices,
    :worker,
    :context,
    :outputs,
    :source,
    inputs: %Inputs{},
    timers: %Timers{},
    work: %Work{},
    phase: :starting
  ]

  @typedoc """
  `owner` is the pipeline's server and the stage's id there. `control` holds shared cells: the time up to which messages
  count, and whether the stage is patient. With `restarts?`, another process replaces this one when it dies. With
  `shared?`, other stages run in its process. Clock and control are known when the stage is wired.
  """
  @type host :: %{
          owner: {server :: pid(), id :: pos_integer()},
          errors: ErrorCounters.t(),
          restarts?: boolean(),
          shared?: boolean(),
          simulated?: boolean(),
          clock: Clock.t() | nil,
          control: :atomics.atomics_ref() | nil
        }
  @typedoc """
  `index` is the position of its first vertex in the stage. In phase `:failed` the step takes no
  more messages.
  """
  @type t :: %__MODULE__{
          host: host(),
          index: non_neg_integer(),
          vertices: [Vertex.t(), ...],
          worker: Callback.t() | Chain.t(),
          context: Context.t(),
          outputs: Outputs.t(),
          source: SourceState.t(),
          inputs: Inputs.t(),
          timers: Timers.t(),
          work: Work.t(),
          phase: :starting | :running | :failed
        }

  @doc "Returns the content of the control cell until the pipeline stops: no final time."
  @spec no_final_time() :: integer()
  def no_final_time, do: @never

  @doc "Groups the vertices of a stage into steps: each component, and each chain of operators."
  @spec group_vertices([Vertex.t(), ...]) :: [{non_neg_integer(), [Vertex.t(), ...]}]
  def group_vertices(vertices) do
    vertices
    |> Enum.with_index()
    |> Enum.chunk_by(fn {vertex, index} ->
      if vertex.module == :operator, do: :chain, else: index
    end)
    |> Enum.map(fn [{_, index} | _] = group -> {index, Enum.map(group, &elem(&1, 0))} end)
  end

  @doc "Builds the step of `vertices`; `first_mark` is the place of its first output in the stage's marks."
  @spec new({non_neg_integer(), [Vertex.t(), ...]}, host(), map(), non_neg_integer()) :: t()
  def new({index, [head | _] = vertices}, host, args, first_mark) do
    chain? = head.module == :operator

    %__MODULE__{
      host: host,
      index: index,
      vertices: vertices,
      worker: if(chain?, do: Chain.compile(vertices, index), else: Callback.new(head)),
      context: %Context{path: head.path, pipeline: args.handle},
      source: SourceState.new(head),
      outputs: Outputs.new(List.last(vertices), args[:marks], first_mark)
    }
  end

  @doc "Returns the component, or the first operator of the chain."
  @spec head_vertex(t()) :: Vertex.t()
  def head_vertex(%__MODULE__{vertices: [head | _]}), do: head

  @doc "Updates the component, or the first operator of the chain."
  @spec update_head(t(), (Vertex.t() -> Vertex.t())) :: t()
  def update_head(%__MODULE__{vertices: [head | rest]} = step, fun),
    do: %{step | vertices: [fun.(head) | rest]}

  @doc "Replaces the component's options."
  @spec put_options(t(), keyword()) :: t()
  def put_options(%__MODULE__{worker: worker} = step, opts),
    do: update_head(%{step | worker: %{worker | opts: opts}}, &%{&1 | opts: opts})

  @doc "Reads the pipeline's clock: the callbacks that follow begin at this time."
  @spec read_clock(t()) :: t()
  def read_clock(%__MODULE__{host: %{clock: clock}, context: context} = step),
    do: %{step | context: %{context | now: Clock.now(clock)}}

  @doc "Counts `n` messages, out of `taken`, that were handled together from the monotonic time `started` (ns) on."
  @spec count_handled(t(), non_neg_integer(), pos_integer(), integer()) :: t()
  def count_handled(%__MODULE__{work: work} = step, n, taken, started) do
    time = monotonic_time(step)
    %{step | work: Work.count_slice(work, n, taken, {busy_time(step, time - started), time})}
  end

  @doc "Counts `n` messages that a source has posted from the monotonic time `started` (ns) on."
  @spec count_produced(t(), non_neg_integer(), integer()) :: t()
  def count_produced(%__MODULE__{work: work} = step, n, started) do
    elapsed = busy_time(step, monotonic_time(step) - started)
    %{step | work: Work.note_time(work, n, elapsed)}
  end

  @doc "Returns the monotonic time, ns. In a simulation the schedule decides it."
  @spec monotonic_time(t()) :: integer()
  def monotonic_time(%__MODULE__{host: %{simulated?: false}}),
    do: :erlang.monotonic_time(:nanosecond)

  def monotonic_time(_step), do: Runtime.monotonic_time()

  @doc "Returns a deadline as a time of the VM. In a simulation it has always passed, or never."
  @spec vm_deadline(t(), integer() | :never) :: integer() | :never
  def vm_deadline(%__MODULE__{host: %{simulated?: false}}, deadline), do: deadline

  def vm_deadline(_step, _deadline),
    do: if(Runtime.choose_number(2) == 1, do: -@never, else: :never)

  # On a manual clock, a test decides how long a message takes.
  defp busy_time(%{host: %{clock: %{kind: :manual} = clock}, context: %{now: now}}, _elapsed),
    do: Clock.now(clock) - now

  defp busy_time(_step, elapsed), do: elapsed

  @doc "Returns the time up to which messages count."
  @spec final_time(t()) :: integer()
  def final_time(%__MODULE__{host: %{control: nil}}), do: @never
  def final_time(%__MODULE__{host: %{control: control}}), do: :atomics.get(control, 1)

  @doc "Sets whether messages are taken and sent."
  @spec set_demand(t(), :accumulate | :forward) :: t()
  def set_demand(%__MODULE__{} = step, mode) do
    set_patience(step, mode == :accumulate or step.outputs.dispatcher != nil)
    wake_source(%{step | outputs: %{step.outputs | demand: mode}})
  end

  @doc "Sets whether the stage waits for the outside world or for the clock, so that it does not count as stuck."
  @spec set_patience(t(), boolean()) :: :ok
  def set_patience(%__MODULE__{host: %{control: nil}}, _waits?), do: :ok

  def set_patience(%__MODULE__{host: %{control: control}}, waits?),
    do: :atomics.put(control, 2, if(waits?, do: 1, else: 0))

  @doc "Wakes a source without messages after an event that it may have been waiting for."
  @spec wake_source(t()) :: t()
  def wake_source(%__MODULE__{source: %{idle: false}} = step), do: step
  def wake_source(%__MODULE__{} = step), do: %{step | source: SourceState.wake(step.source)}

  @doc "Reports an event to the pipeline's server."
  @spec report_event(t(), term()) :: term()
  def report_event(%__MODULE__{host: %{owner: {server, id}}}, event),
    do: send(server, {:situ_stage, id, event})

  @doc "Sends a message to this stage itself, to be handled later."
  @spec send_to_stage(host(), term()) :: term()
  def send_to_stage(%{shared?: true, owner: {_server, id}}, message),
    do: Address.push_local(id, message)

  def send_to_stage(_host, message), do: send(self(), message)

  @doc "Updates the outputs."
  @spec map_outputs(t(), (Situ.Ports.Output.t() -> Situ.Ports.Output.t())) :: t()
  def map_outputs(%__MODULE__{} = step, fun),
    do: %{step | outputs: Outputs.map_outputs(step.outputs, fun)}

  @spec put_input(t(), Situ.Ports.Input.t()) :: t()
  def put_input(%__MODULE__{} = step, input),
    do: %{step | inputs: Inputs.put(step.inputs, input)}

  @doc "Returns the error for an output that the component or the stage does not have."
  @spec unknown_output(t(), term()) :: Error.t()
  def unknown_output(%__MODULE__{} = step, name) do
    path = head_vertex(step).path
    known = step.outputs |> Outputs.list_names() |> Enum.map_join(", ", &inspect/1)

    Error.new(:unknown_output, "#{path} has no output #{inspect(name)}",
      fix: "its outputs: " <> if(known == "", do: "none", else: known),
      meta: %{component: path}
    )
  end
end
