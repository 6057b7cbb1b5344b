defmodule Situ.Stage do
  @moduledoc false
  # The process of one component, or of one chain of light operators: its mailbox. A message passes through these
  # modules:
  #
  #   Stage            takes an entry from the mailbox
  #   RequestHandler   handles requests of the pipeline's server
  #   Subscriptions    adds and removes connections
  #   Loop             runs a time slice: selects the next step, and sends what all of them have posted
  #   StepRunner       runs the next messages through one step: its component or its operators (BatchRunner)
  #   Production       makes sources produce messages, and stops them
  #   CallbackRunner   calls the component and handles errors (ErrorPolicy)
  #   ActionRunner     applies the actions: posts messages, closes outputs, sets timers
  #   State, Step      the state of the stage and of its steps: Inputs, Outputs, Timers, SourceState, Work
  #
  # It uses GenStage's messages with its neighbours (see Situ.GenStage). It receives `{:situ, request}` from its
  # pipeline's server and sends `{:situ_stage, id, event}` to it.
  use GenServer
  require Logger

  alias Situ.{Clock, Runtime}
  alias Situ.Component.Callback
  alias Situ.Ports.Outputs
  alias Situ.Stage.{Loop, Relocation, RequestHandler, State, Step, Subscriptions}

  # A plain message that took this long (ns) is overtaken by requests: many more may be waiting.
  @slow_ns 1_000_000

  @doc "Returns the value that the control cell has until the pipeline stops: no final time is set."
  @spec no_final_time() :: integer()
  defdelegate no_final_time, to: Step

  @doc "Returns whether the stage with this control cell waits for the outside world or for the clock."
  @spec patient?(:atomics.atomics_ref()) :: boolean()
  def patient?(control), do: :atomics.get(control, 2) == 1

  @doc "Starts the process; it reports `:up` or `{:init_failed, error}` to the server by itself."
  @spec spawn_link(map()) :: pid()
  def spawn_link(args), do: spawn_process(hd(args.vertices), :init_it, [args])

  @doc "Starts the process of a stage that leaves the process `shared`, with its state (see Relocation)."
  @spec spawn_relocated(State.t(), pid()) :: pid()
  def spawn_relocated(state, shared),
    do: spawn_process(State.head_vertex(state), :continue_it, [state, shared, self()])

  defp spawn_process(vertex, function, args) do
    opts = [:link, fullsweep_after: 30, min_heap_size: 4_181]
    Runtime.spawn_process(:proc_lib, vertex.path, {__MODULE__, function, args}, opts)
  end

  @doc false
  def continue_it(state, shared, server) do
    Process.flag(:trap_exit, true)
    Process.put(:situ_pipeline, server)

    case Relocation.take_over(state, shared, &handle_info/2) do
      {:ok, state} ->
        send(self(), :situ_turn)
        Runtime.enter_loop(__MODULE__, state)

      :ended ->
        exit(:normal)
    end
  end

  @doc false
  def init_it(args) do
    Process.flag(:trap_exit, true)
    Process.put(:situ_pipeline, args.server)
    Logger.metadata(pipeline: args.pipeline, component: hd(args.vertices).path)

    case start_component(args) do
      {:ok, state} -> Runtime.enter_loop(__MODULE__, state)
      :error -> exit(:normal)
    end
  end

  @doc "Initializes the state and the component of a stage, and reports the outcome to the server."
  @spec start_component(map()) :: {:ok, State.t()} | :error
  def start_component(args) do
    state = State.new(args)

    case Subscriptions.start_component(state) do
      {:ok, state} ->
        report(state, :up)
        {:ok, state}

      {:error, error} ->
        report(state, {:init_failed, error})
        :error
    end
  end

  defp report(%{steps: steps}, event), do: Step.report_event(elem(steps, 0), event)

  @impl true
  def init(_), do: :ignore

  # These calls and casts are GenStage's own; all others are for the component.
  @impl true
  def handle_call(:"$estimate_buffered_count", _from, state),
    do: {:reply, Outputs.buffered_count(elem(State.last_step(state), 1).outputs), state}

  def handle_call({:"$info", message}, _from, state),
    do: {:reply, :ok, Loop.handle_plain_message(state, message)}

  def handle_call(request, from, state), do: {:noreply, Loop.handle_request(state, request, from)}

  @impl true
  def handle_cast({:"$demand", mode}, state) when mode in [:forward, :accumulate],
    do: {:noreply, state |> State.map_steps(&Step.set_demand(&1, mode)) |> Loop.run_slice()}

  def handle_cast({:"$info", message}, state),
    do: {:noreply, Loop.handle_plain_message(state, message)}

  def handle_cast(request, state), do: {:noreply, Loop.handle_request(state, request, nil)}

  @impl true
  def handle_info({:"$gen_consumer", {_, tag}, {:cancel, reason}} = message, state) do
    case State.find_input(state, tag) do
      nil -> {:noreply, handle_unknown(state, tag, message)}
      found -> state |> Loop.handle_closing(found, closing_time(reason, state)) |> unless_over()
    end
  end

  def handle_info({:"$gen_consumer", {_, tag}, batches} = message, state) do
    case State.find_input(state, tag) do
      nil -> {:noreply, handle_unknown(state, tag, message)}
      found -> {:noreply, Loop.handle_batches(state, found, batches)}
    end
  end

  # A restarted stage has neither its neighbours nor its dispatcher yet.
  def handle_info(
        {:"$gen_producer", {_address, tag}, _request} = message,
        %{steps: steps} = state
      )
      when not is_integer(tag) and elem(steps, 0).phase == :starting,
      do: {:noreply, Loop.keep_early(state, message)}

  def handle_info({:"$gen_producer", {address, _tag} = from, {:ask, n} = request}, state)
      when (is_pid(address) or is_tuple(address)) and is_integer(n) and n > 0 do
    case State.update_outputs(state, &Outputs.add_demand(&1, from, n)) do
      {:ok, state} ->
        state |> Subscriptions.wake_sources() |> Loop.handle_demand() |> unless_over()

      :error ->
        {:noreply, Subscriptions.handle_consumer_request(state, from, request)}
    end
  end

  def handle_info({:"$gen_producer", {address, _tag} = from, request}, state)
      when is_pid(address) or is_tuple(address),
      do:
        state
        |> Subscriptions.handle_consumer_request(from, request)
        |> Loop.run_slice()
        |> unless_over()

  def handle_info(:situ_turn, state), do: {:noreply, Loop.run_scheduled_slice(state)}
  def handle_info({:situ_alarm, _}, state), do: {:noreply, Loop.handle_alarm(state)}
  def handle_info({:situ, request}, state), do: RequestHandler.handle_request(request, state)

  # A hold that was renewed or has ended in the meantime must not be ended by an old timer.
  def handle_info({:situ_hold, tag, token}, state) do
    case State.find_input(state, tag) do
      {i, %{held: {_timer, ^token}} = input} ->
        state = State.put_input(state, i, %{input | held: nil})
        {:noreply, Loop.handle_plain_message(state, {:hold_ended, input.name})}

      _ ->
        {:noreply, state}
    end
  end

  # Without the process that forwards its messages, the stage could only wait.
  def handle_info({:DOWN, ref, :process, _pid, reason}, %{relay: ref} = state) do
    if reason == :normal, do: {:noreply, state}, else: {:stop, {:shutdown, reason}, state}
  end

  def handle_info({:DOWN, ref, :process, _pid, _} = message, state) do
    if Enum.any?(State.list_subscribers(state), &(&1.monitor == ref)),
      do: state |> Subscriptions.remove_by_monitor(ref) |> Loop.run_slice() |> unless_over(),
      else: {:noreply, Loop.handle_plain_message(state, message)}
  end

  # GenStage processes do not send such messages, so they are ignored.
  def handle_info({protocol, _from, _request}, state)
      when protocol in [:"$gen_producer", :"$gen_consumer"],
      do: {:noreply, state}

  def handle_info({:EXIT, _pid, :normal}, state), do: {:noreply, state}

  def handle_info(message, state) do
    started = State.monotonic_time(state)
    state = Loop.handle_plain_message(state, message)
    slow? = State.monotonic_time(state) - started > @slow_ns
    {:noreply, if(slow?, do: RequestHandler.handle_overtaking(state), else: state)}
  end

  @impl true
  def terminate(reason, state) do
    for %{worker: %Callback{} = worker} <- State.list_steps(state),
        do: Callback.stop_component(worker, reason)
  end

  # A restarted neighbour repeats the closing mark of an input that has closed, and a last message may cross the end of
  # the connection (tags of the pipeline are numbers).
  defp handle_unknown(state, tag, _message) when is_integer(tag), do: state
  defp handle_unknown(state, _tag, message), do: Loop.handle_plain_message(state, message)

  defp unless_over(state),
    do: if(State.over?(state), do: {:stop, :normal, state}, else: {:noreply, state})

  defp closing_time({:shutdown, {:closed, time}}, _state), do: time
  defp closing_time(_reason, state), do: Clock.now(state.host.clock)

  # A crash report names the component, and omits payloads and options.
  @impl true
  def format_status(_reason, [_dictionary, state]), do: [data: [{~c"State", summary(state)}]]

  defp summary(%State{} = state) do
    steps =
      for step <- State.list_steps(state) do
        %{
          component: Step.head_vertex(step).path,
          phase: step.phase,
          inputs: map_size(step.inputs.by_tag)
        }
      end

    %{steps: steps}
  end

  defp summary(_state), do: %{}
end
