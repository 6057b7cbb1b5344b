defmodule Situ.Stage.State do
  @moduledoc false
  # The state of a stage: one part for each concern, owned by the module of its type. This module only builds and wires
  # the state.
  alias Situ.{Clock, Error}
  alias Situ.Clock.Timers
  alias Situ.Component.{Callback, Context}
  alias Situ.Graph.Vertex
  alias Situ.Operator.Chain
  alias Situ.Ports.{Input, Inputs, Output, Outputs, Subscriber, ErrorCounters}
  alias Situ.Stage.{Scheduling, SourceState}

  @never 9_000_000_000_000_000_000

  @enforce_keys [:owner, :vertices, :context, :tally, :source, :outputs]
  defstruct [
    :owner,
    :vertices,
    :context,
    :tally,
    :source,
    :outputs,
    :callback,
    :chain,
    :clock,
    :control,
    :memory,
    inputs: %Inputs{},
    timers: %Timers{},
    pace: %Scheduling{},
    phase: :starting
  ]

  @typedoc """
  `owner` is the pipeline's server and the stage's id there. `callback` is the component; `chain` its light
  operators, or those after it (one of the two may be `nil`). `control` holds shared cells: the time up to which
  messages count, and whether the stage is patient. In phase `:failed` it takes no more messages. `memory` is the
  snapshot that it starts with (see Memory).
  """
  @type t :: %__MODULE__{
          owner: {server :: pid(), id :: pos_integer()},
          vertices: [Vertex.t(), ...],
          context: Context.t(),
          tally: ErrorCounters.t(),
          source: SourceState.t(),
          outputs: Outputs.t(),
          callback: Callback.t() | nil,
          chain: Chain.t() | nil,
          clock: Clock.t() | nil,
          control: :atomics.atomics_ref() | nil,
          memory: map() | nil,
          inputs: Inputs.t(),
          timers: Timers.t(),
          pace: Scheduling.t(),
          phase: :starting | :running | :failed
        }

  @doc "Returns the content of the control cell until the pipeline stops: no final time."
  @spec no_final_time() :: integer()
  def no_final_time, do: @never

  @spec new(map()) :: t()
  def new(%{vertices: [head | _] = vertices} = args) do
    %__MODULE__{
      owner: {args.server, args.id},
      vertices: vertices,
      context: %Context{path: head.path, pipeline: args.handle},
      tally: args.tally,
      memory: args[:memory],
      source: SourceState.new(head),
      outputs: Outputs.new(vertices, args[:marks]),
      callback: if(head.module != :operator, do: Callback.new(head)),
      chain: chain(vertices, args)
    }
  end

  # Behind a component the edge into the operators is counted like a queue.
  defp chain([%{module: :operator} | _] = vertices, _args), do: Chain.compile(vertices, 0)
  defp chain([_component], _args), do: nil

  defp chain([_component | operators], args) do
    chain = Chain.compile(operators, 1)
    %{chain | counters: args[:tail_counters], sizes: args[:sizes]}
  end

  @doc "Initializes the component's state."
  @spec init(t()) :: {:ok, t()} | {:error, Error.t()}
  def init(%{callback: nil} = state), do: {:ok, state}

  def init(state) do
    with {:ok, callback} <- Callback.start_component(state.callback),
         do: {:ok, %{state | callback: callback}}
  end

  @doc "Sets the clock, the neighbours and their counters, which are known once every stage is up."
  @spec wire_neighbours(t(), map()) :: t()
  def wire_neighbours(state, wiring) do
    outputs =
      Enum.reduce(wiring.subs, state.outputs, fn {name, subs}, outputs ->
        subs =
          for {tag, pid, counters, policy} <- subs, do: Subscriber.new(tag, pid, counters, policy)

        Outputs.update_open(outputs, name, &%{&1 | subs: subs})
      end)

    context = %{
      state.context
      | start_time: wiring.start_time,
        now: wiring.now,
        replay_start: wiring.replay_start,
        replay_end: wiring.replay_end,
        enforced?: wiring.enforce and hd(state.vertices).holds
    }

    inputs = Inputs.new(for inlet <- wiring.inlets, do: input(state, inlet, wiring.sizes))

    %{
      state
      | clock: wiring.clock,
        control: wiring.control,
        context: context,
        outputs: outputs,
        inputs: inputs
    }
  end

  defp input(%{vertices: [head | _]}, inlet, sizes) do
    port = Keyword.fetch!(head.inputs, inlet.name)
    extra = %{type: port.type, check: head.check, counters: inlet.counters, sizes: sizes}
    Input.new(inlet.name, inlet.tag, inlet.producer, inlet.policy, extra)
  end

  @doc "Replaces the pid of a restarted neighbour."
  @spec replace_neighbour(t(), term(), pid()) :: t()
  def replace_neighbour(state, tag, pid) do
    inputs =
      case state.inputs.by_tag do
        %{^tag => input} -> Inputs.put(state.inputs, Input.replace_producer(input, pid))
        _ -> state.inputs
      end

    outputs =
      Outputs.map_outputs(state.outputs, fn %Output{} = output ->
        subs =
          Enum.map(
            output.subs,
            &if(&1.tag == tag, do: Subscriber.replace_consumer(&1, pid), else: &1)
          )

        %{output | subs: subs}
      end)

    %{state | inputs: inputs, outputs: outputs}
  end

  @doc "Returns the output named in `output: name`; a single output needs no name."
  @spec find_output(t(), keyword()) :: {:ok, Output.t()} | {:error, Error.t()}
  def find_output(state, opts) do
    case {Keyword.fetch(opts, :output), Outputs.open_outputs(state.outputs)} do
      {:error, [{_, output}]} -> {:ok, output}
      {:error, _} -> {:error, no_output(state, opts)}
      {{:ok, name}, open} -> check_output(List.keyfind(open, name, 0), state, opts)
    end
  end

  defp check_output({_, output}, _state, _opts), do: {:ok, output}
  defp check_output(nil, state, opts), do: {:error, no_output(state, opts)}

  @doc "Returns the component, or the first operator of a chain."
  @spec head_vertex(t()) :: Vertex.t()
  def head_vertex(%{vertices: [head | _]}), do: head

  @doc "Replaces the component, or the first operator of a chain."
  @spec put_head(t(), Vertex.t()) :: t()
  def put_head(%{vertices: [_ | rest]} = state, head), do: %{state | vertices: [head | rest]}

  @doc "Returns the context for a callback, with the current time."
  @spec context_at(t(), Situ.Time.t()) :: Context.t()
  def context_at(%{context: context}, now), do: %{context | now: now}

  @doc "Returns the time up to which messages count."
  @spec final_time(t()) :: integer()
  def final_time(%{control: nil}), do: @never
  def final_time(%{control: control}), do: :atomics.get(control, 1)

  @doc "Sets whether messages are taken and sent."
  @spec set_demand(t(), :accumulate | :forward) :: t()
  def set_demand(state, mode),
    do: set_patience(%{state | outputs: %{state.outputs | demand: mode}}, mode == :accumulate)

  @doc "Sets whether the stage waits for the outside world or for the clock, so that it does not count as stuck."
  @spec set_patience(t(), boolean()) :: t()
  def set_patience(%{control: nil} = state, _waits?), do: state

  def set_patience(state, waits?) do
    :atomics.put(state.control, 2, if(waits?, do: 1, else: 0))
    state
  end

  @spec patient?(:atomics.atomics_ref()) :: boolean()
  def patient?(control), do: :atomics.get(control, 2) == 1

  @doc "Wakes a source without messages after an event that it may have been waiting for."
  @spec wake_source(t()) :: t()
  def wake_source(%{source: %{idle: false}} = state), do: state
  def wake_source(state), do: %{state | source: SourceState.wake(state.source)}

  @doc "Reports an event to the pipeline's server."
  @spec report_event(t(), term()) :: term()
  def report_event(%{owner: {server, id}}, event), do: send(server, {:situ_stage, id, event})

  defp no_output(state, opts) do
    known = state.outputs |> Outputs.open_outputs() |> Enum.map_join(", ", &inspect(elem(&1, 0)))

    Error.new(
      :unknown_output,
      "#{head_vertex(state).path} has no output #{inspect(opts[:output])}",
      fix: "subscribe with output: one of " <> known
    )
  end
end
