defmodule Situ.Stage.State do
  @moduledoc false
  # The state of a stage: its steps in the order in which messages pass through them, and what concerns its mailbox.
  # Messages between two steps go from the output of one to the input of the other without a queue between processes.
  alias Situ.{Delivery, Error, Runtime}
  alias Situ.Graph.Vertex
  alias Situ.Ports.{Address, Counters, Input, Output, Outputs, Subscriber}
  alias Situ.Stage.{ErrorPolicy, Load, Step}

  @enforce_keys [:host, :steps]
  defstruct [
    :host,
    :steps,
    :memory,
    :relay,
    links: %{},
    early: [],
    scheduled: false,
    ready: false,
    load: %Load{},
    quitting: false,
    large_heap: false
  ]

  @typedoc """
  `links` maps the tag of each connection between two steps to the position of the second one. `early` holds
  messages from outside that arrived before the stage was running, newest first. With `scheduled`, a message to itself
  asks for another time slice. With `quitting`, the stage ends once its outputs are drained. `memory` is the snapshot
  that it starts with (see Checkpoint).

  `ready` and `load` are for a shared process: whether it is going to run a time slice of the stage, and how much the
  stage has to do. `relay` monitors the shared process that the stage has left (see Relocation).
  """
  @type t :: %__MODULE__{
          host: Step.host(),
          steps: tuple(),
          memory: map() | nil,
          relay: reference() | nil,
          links: %{term() => non_neg_integer()},
          early: [term()],
          scheduled: boolean(),
          ready: boolean(),
          load: Load.t(),
          quitting: boolean(),
          large_heap: boolean()
        }

  @spec new(map()) :: t()
  def new(%{vertices: vertices} = args) do
    host = %{
      owner: {args.server, args.id},
      errors: args.tally,
      restarts?: args[:marks] != nil,
      shared?: args[:shared?] == true,
      simulated?: Runtime.simulated?(),
      clock: nil,
      control: nil
    }

    {steps, _outputs} =
      vertices
      |> Step.group_vertices()
      |> Enum.map_reduce(0, fn {_index, group} = vertices, first ->
        {Step.new(vertices, host, args, first), first + length(List.last(group).outputs)}
      end)

    state = %__MODULE__{host: host, steps: List.to_tuple(steps), memory: args[:memory]}
    connect_steps(state, args)
  end

  # The connection between a component and the operators after it is counted like a queue.
  defp connect_steps(%{steps: {first, second}} = state, args) do
    policy = Delivery.unlimited(window: :infinity)
    opts = %{type: :any, check: :off, counters: args.tail_counters, sizes: args.sizes}
    tag = {:step, args.id}
    address = if state.host.shared?, do: {:local, args.id}, else: self()
    Counters.forget_unhandled(args.tail_counters)
    sub = Subscriber.new_local(tag, address, args.tail_counters)
    first = Step.map_outputs(first, &Output.subscribe(&1, sub))
    second = Step.put_input(second, Input.new(:in, tag, nil, policy, opts))
    %{state | steps: {first, second}, links: %{tag => 1}}
  end

  defp connect_steps(state, _args), do: state

  @doc "Returns the monotonic time, ns; see `Situ.Stage.Step.monotonic_time/1`."
  @spec monotonic_time(t()) :: integer()
  def monotonic_time(%__MODULE__{steps: steps}), do: Step.monotonic_time(elem(steps, 0))

  @doc "Returns the component or the first operator of the stage."
  @spec head_vertex(t()) :: Vertex.t()
  def head_vertex(%__MODULE__{steps: steps}), do: Step.head_vertex(elem(steps, 0))

  @spec list_steps(t()) :: [Step.t(), ...]
  def list_steps(%__MODULE__{steps: steps}), do: Tuple.to_list(steps)

  @spec map_steps(t(), (Step.t() -> Step.t())) :: t()
  def map_steps(%__MODULE__{steps: steps} = state, fun),
    do:
      0..(tuple_size(steps) - 1)
      |> Enum.reduce(state, &put_step(&2, &1, fun.(elem(&2.steps, &1))))

  @doc "Replaces the step at position `i`. If it has failed, the whole stage fails."
  @spec put_step(t(), non_neg_integer(), Step.t()) :: t()
  def put_step(%__MODULE__{steps: {_, _} = steps} = state, i, %{phase: :failed} = step) do
    if elem(steps, i).phase == :failed,
      do: %{state | steps: put_elem(steps, i, step)},
      else: fail_steps(%{state | steps: put_elem(steps, i, step)}, step.work.failure)
  end

  def put_step(%__MODULE__{steps: steps} = state, i, step),
    do: %{state | steps: put_elem(steps, i, step)}

  defp fail_steps(%{steps: steps} = state, error) do
    steps = for step <- Tuple.to_list(steps), do: ErrorPolicy.abandon_step(step, error)
    %{state | steps: List.to_tuple(steps)}
  end

  @spec update_step(t(), non_neg_integer(), (Step.t() -> Step.t())) :: t()
  def update_step(%__MODULE__{steps: steps} = state, i, fun),
    do: put_step(state, i, fun.(elem(steps, i)))

  @doc "Returns the position of the step with the input `tag`, and the input."
  @spec find_input(t(), term()) :: {non_neg_integer(), Input.t()} | nil
  def find_input(%__MODULE__{steps: steps}, tag), do: find_input(steps, tag, 0)

  defp find_input(steps, _tag, i) when i == tuple_size(steps), do: nil

  defp find_input(steps, tag, i) do
    case elem(steps, i).inputs.by_tag do
      %{^tag => input} -> {i, input}
      _ -> find_input(steps, tag, i + 1)
    end
  end

  @doc "Updates the outputs with `fun` in the first step for which it does not return `:error`."
  @spec update_outputs(t(), (Outputs.t() -> {:ok, Outputs.t()} | :error)) :: {:ok, t()} | :error
  def update_outputs(%__MODULE__{} = state, fun),
    do: update_outputs(state, fun, tuple_size(state.steps) - 1)

  defp update_outputs(_state, _fun, -1), do: :error

  defp update_outputs(state, fun, i) do
    step = elem(state.steps, i)

    case fun.(step.outputs) do
      {:ok, outputs} -> {:ok, put_step(state, i, %{step | outputs: outputs})}
      :error -> update_outputs(state, fun, i - 1)
    end
  end

  @doc "Updates the outputs of every step."
  @spec map_outputs(t(), (Outputs.t() -> Outputs.t())) :: t()
  def map_outputs(%__MODULE__{} = state, fun),
    do: map_steps(state, &%{&1 | outputs: fun.(&1.outputs)})

  @spec list_subscribers(t()) :: [Subscriber.t()]
  def list_subscribers(%__MODULE__{} = state),
    do: for(step <- list_steps(state), sub <- Outputs.list_subscribers(step.outputs), do: sub)

  @spec find_subscriber(t(), term()) :: Subscriber.t() | nil
  def find_subscriber(state, tag), do: Enum.find(list_subscribers(state), &(&1.tag == tag))

  @doc "Returns whether every subscriber has received all its messages and the closing mark."
  @spec drained?(t()) :: boolean()
  def drained?(%__MODULE__{} = state),
    do: Enum.all?(list_steps(state), &Outputs.drained?(&1.outputs))

  @doc "Returns whether a stage that is to end has nothing left to send."
  @spec over?(t()) :: boolean()
  def over?(%__MODULE__{quitting: quitting?} = state), do: quitting? and drained?(state)

  @doc "Returns the last step, whose outputs others can subscribe to."
  @spec last_step(t()) :: {non_neg_integer(), Step.t()}
  def last_step(%__MODULE__{steps: steps}) do
    i = tuple_size(steps) - 1
    {i, elem(steps, i)}
  end

  @doc "Returns the position of the step that holds the stage's vertex at `index`, and the step."
  @spec step_at(t(), non_neg_integer()) :: {non_neg_integer(), Step.t()}
  def step_at(%__MODULE__{} = state, index) do
    state
    |> list_steps()
    |> Enum.with_index(&{&2, &1})
    |> Enum.find(fn {_i, step} -> index < step.index + length(step.vertices) end)
  end

  @doc "Sets the clock, the neighbours and their counters, which are known once every stage is up."
  @spec wire_neighbours(t(), map()) :: t()
  def wire_neighbours(%__MODULE__{host: host} = state, wiring) do
    host = %{host | clock: wiring.clock, control: wiring.control}
    state = map_steps(%{state | host: host}, &wire_step(%{&1 | host: host}, wiring))

    state
    |> update_step(0, &wire_inputs(&1, wiring))
    |> update_step(tuple_size(state.steps) - 1, &wire_outputs(&1, wiring))
  end

  defp wire_step(step, wiring) do
    context = %{
      step.context
      | start_time: wiring.start_time,
        now: wiring.now,
        replay_start: wiring.replay_start,
        replay_end: wiring.replay_end,
        enforced?: wiring.enforce and Step.head_vertex(step).holds
    }

    %{step | context: context}
  end

  defp wire_inputs(step, wiring) do
    head = Step.head_vertex(step)

    Enum.reduce(wiring.inlets, step, fn inlet, step ->
      port = Keyword.fetch!(head.inputs, inlet.name)
      opts = %{type: port.type, check: head.check, counters: inlet.counters, sizes: wiring.sizes}
      input = Input.new(inlet.name, inlet.tag, inlet.producer, inlet.policy, opts)
      Step.put_input(step, input)
    end)
  end

  defp wire_outputs(step, wiring) do
    Step.map_outputs(step, fn %{port: %{name: name}} = output ->
      subs =
        for {tag, pid, counters, policy} <- Map.get(wiring.subs, name, []) do
          sub = Subscriber.new(tag, pid, counters, policy)
          if step.host.restarts?, do: Subscriber.resume_after_restart(sub), else: sub
        end

      %{output | subs: subs}
    end)
  end

  @doc """
  Returns whether the messages taken by the stage may count as handled. A process that replaces it receives all others
  again, so no results of handled messages may still wait here.
  """
  @spec may_acknowledge?(t()) :: boolean()
  def may_acknowledge?(%__MODULE__{host: %{restarts?: false}}), do: true

  def may_acknowledge?(%__MODULE__{} = state) do
    Enum.all?(list_steps(state), fn step ->
      not Enum.any?(step.inputs.by_tag, &local_waiting?/1) and
        (step.phase == :failed or Outputs.all_sent?(step.outputs))
    end)
  end

  defp local_waiting?({_tag, %{producer: nil} = input}), do: Input.has_entry?(input)
  defp local_waiting?(_from_another_process), do: false

  @doc "Replaces the pid of a restarted neighbour."
  @spec replace_neighbour(t(), term(), Address.t()) :: t()
  def replace_neighbour(%__MODULE__{} = state, tag, pid) do
    state =
      case find_input(state, tag) do
        nil -> state
        {i, input} -> put_input(state, i, Input.replace_producer(input, pid))
      end

    map_outputs(
      state,
      &Outputs.map_tagged(&1, tag, fn sub -> Subscriber.replace_consumer(sub, pid) end)
    )
  end

  @spec put_input(t(), non_neg_integer(), Input.t()) :: t()
  def put_input(%__MODULE__{} = state, i, input),
    do: update_step(state, i, &Step.put_input(&1, input))

  @doc "Returns the output named in `output: name`; a single output needs no name."
  @spec find_output(t(), keyword()) :: {:ok, Output.t()} | {:error, Error.t()}
  def find_output(%__MODULE__{} = state, opts) do
    {_i, step} = last_step(state)

    case {Keyword.fetch(opts, :output), Outputs.list_all(step.outputs)} do
      {:error, [output]} ->
        {:ok, output}

      {:error, _} ->
        {:error, Step.unknown_output(step, nil)}

      {{:ok, name}, _} ->
        with(
          :error <- Outputs.fetch(step.outputs, name),
          do: {:error, Step.unknown_output(step, name)}
        )
    end
  end
end
