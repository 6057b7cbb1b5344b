defmodule Situ.Stage.Relocation do
  @moduledoc false
  # Moves a stage from a shared process to a separate one, where it cannot delay others. Pure, except for the loop in
  # which the new process takes over. Nothing changes for neighbours in other processes: they keep sending to the shared
  # process, which forwards their messages (`relay`). No message can overtake another one in this way.
  #
  #   shared process   sends {:relocating, state} to the pipeline's server, and keeps the messages for the stage
  #   server           starts a process with the state, and sends the shared process {:relocated, id, pid}
  #   shared process   forwards the messages that it has kept, and from then on every message for the stage
  #   new process      takes only forwarded messages until all that were kept have arrived (`take_over/2`)
  alias Situ.Clock.Timers
  alias Situ.Ports.{Input, Inputs, Output, Subscriber}
  alias Situ.Stage.{State, Step}

  @doc "Returns whether the stage can move: no process outside the pipeline watches it or is watched by it."
  @spec movable?(State.t()) :: boolean()
  def movable?(%State{quitting: quitting?} = state) do
    not quitting? and Enum.all?(State.list_steps(state), &(&1.phase == :running)) and
      Enum.all?(State.list_subscribers(state), &(&1.monitor == nil))
  end

  @doc """
  Returns the state of the stage for its own process, and where its requests and its consumers' requests come from:
  the producers in other processes by `{:producer, tag}`, and `{:consumer, tag}` for each consumer in the process
  `shared`, which the stage leaves.
  """
  @spec prepare_state(State.t(), pid()) ::
          {State.t(), %{({:producer, term()} | {:consumer, term()}) => pid()}}
  def prepare_state(%State{} = state, shared) do
    producers =
      for step <- State.list_steps(state),
          {tag, %Input{producer: producer}} when is_pid(producer) <- step.inputs.by_tag,
          do: {{:producer, tag}, producer}

    consumers =
      for %{pid: {:local, _}, tag: tag} <- State.list_subscribers(state),
          do: {{:consumer, tag}, shared}

    relays = Map.new(producers ++ consumers)
    state = %{state | host: %{state.host | shared?: false}, ready: false, large_heap: false}
    {State.map_steps(state, &readdress_step(&1, state.host, shared)), relays}
  end

  defp readdress_step(step, host, shared) do
    input_address = fn
      %{producer: nil} = input -> input
      %{producer: {:local, _, _}} = input -> Input.separate_producer(input, shared)
      input -> %{input | producer: {:relay, shared}}
    end

    output_address = fn
      %{pid: {:local, _}} = sub -> %{sub | pid: shared}
      sub -> sub
    end

    step =
      map_inputs(%{step | host: host, timers: Timers.clear_alarm(step.timers)}, input_address)

    Step.map_outputs(step, &map_subscribers(&1, output_address))
  end

  @doc """
  Continues a stage in the calling process: handles the forwarded messages, with `handle`, until all that the shared
  process had kept have arrived. Returns `:ended` if the stage ends with one of them.
  """
  @spec take_over(State.t(), pid(), (term(), State.t() -> tuple())) :: {:ok, State.t()} | :ended
  def take_over(%State{} = state, shared, handle) do
    own_address = fn
      %{demand: :local} = sub -> %{sub | pid: self()}
      sub -> sub
    end

    state =
      State.map_steps(state, fn step ->
        Step.map_outputs(step, &map_subscribers(&1, own_address))
      end)

    relay = Process.monitor(shared)
    handle_forwarded(%{state | scheduled: false, relay: relay}, handle)
  end

  defp handle_forwarded(%{relay: relay} = state, handle) do
    receive do
      {:situ_forwarded, message} ->
        case handle.(message, state) do
          {:noreply, state} -> handle_forwarded(state, handle)
          {:stop, :normal, _state} -> :ended
        end

      :situ_forwarding_ended ->
        {:ok, state}

      {:DOWN, ^relay, :process, _pid, _reason} ->
        :ended
    end
  end

  @doc "Changes the address of the stage `id`, which has moved to the process `pid`, in another stage."
  @spec readdress_neighbor(State.t(), pos_integer(), pid()) :: State.t()
  def readdress_neighbor(%State{} = state, id, pid) do
    input_address = fn
      %{producer: {:local, ^id, _}} = input -> Input.separate_producer(input, pid)
      input -> input
    end

    output_address = fn
      %{pid: {:local, ^id}} = sub -> %{sub | pid: pid}
      sub -> sub
    end

    State.map_steps(state, fn step ->
      step
      |> map_inputs(input_address)
      |> Step.map_outputs(&map_subscribers(&1, output_address))
    end)
  end

  defp map_inputs(%{inputs: inputs} = step, fun),
    do: %{
      step
      | inputs: Enum.reduce(Map.values(inputs.by_tag), inputs, &Inputs.put(&2, fun.(&1)))
    }

  @spec map_subscribers(Output.t(), (Subscriber.t() -> Subscriber.t())) :: Output.t()
  defp map_subscribers(%Output{subs: subs} = output, fun),
    do: %{output | subs: Enum.map(subs, fun)}
end
