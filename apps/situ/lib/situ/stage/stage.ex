defmodule Situ.Stage do
  @moduledoc false
  # The process of one component, or of one chain of light operators: state and mailbox. It owns no rule of its own:
  #
  #   Request  what the pipeline's server asks       Turn    a call into the component, and what came of it
  #   Pump     takes messages, one or a batch         Run     a batch through a chain of operators
  #   Source   produces on demand, and stops          Fault   what an error does
  #   Alarm    timers and messages ahead of time      Ports   inputs (Inlet) and outputs (Outlet, Subscriber)
  #
  # It speaks GenStage's messages with its neighbours (see Situ.GenStage), `{:situ, request}` from its pipeline's server
  # and `{:situ_stage, id, event}` to it.
  use GenServer

  alias Situ.Component.Context
  alias Situ.Stage.{Alarm, Call, Inlet, Ports, Pump, Request, Setup, Turn}

  @never 9_000_000_000_000_000_000

  defstruct [
    :id,
    :server,
    :kind,
    :vertices,
    :head,
    :module,
    :opts,
    :core,
    :chain,
    :tail,
    :fast,
    :clock,
    :control,
    :context,
    :tally,
    :alarm,
    :stopping,
    :completing,
    :final,
    enforce: false,
    phase: :starting,
    source: nil,
    completed: false,
    idle: false,
    failed: false,
    lossy: false,
    batch: false,
    scheduled: false,
    slice: 16,
    wide: false,
    timers: [],
    probes: [],
    early: [],
    quitting: false,
    strikes: 0,
    inlets: %{},
    outlets: %{}
  ]

  @type t :: %__MODULE__{}

  @doc "No final time yet: what the control cell holds until the pipeline stops."
  @spec never() :: integer()
  def never, do: @never

  @doc "Starts the process; it reports `:up` or `{:down, error}` to the server by itself."
  @spec spawn_link(map()) :: pid()
  def spawn_link(args),
    do: :proc_lib.spawn_opt(__MODULE__, :init_it, [args], [:link, fullsweep_after: 30])

  def init_it(args) do
    Process.flag(:trap_exit, true)
    Process.put(:situ_pipeline, args.server)
    state = Setup.state(args)

    case Setup.core(state) do
      {:ok, state} ->
        report(state, :up)
        :gen_server.enter_loop(__MODULE__, [], state)

      {:error, error} ->
        report(state, {:init_failed, error})
        exit(:normal)
    end
  end

  @impl true
  def init(_), do: :ignore

  @impl true
  def handle_info({:"$gen_consumer", {_, tag}, batch} = message, state) when is_list(batch) do
    case state.inlets do
      %{^tag => inlet} ->
        {:noreply, Pump.pump(Ports.put_inlet(state, tag, Inlet.push(inlet, batch)))}

      _ ->
        {:noreply, Turn.other(state, message)}
    end
  end

  def handle_info({:"$gen_producer", {_pid, tag}, {:ask, n}}, state),
    do: state |> Ports.asked(tag, n) |> Pump.pump() |> unless_over()

  def handle_info({:"$gen_consumer", {_, tag}, {:cancel, reason}} = message, state) do
    case state.inlets do
      %{^tag => inlet} ->
        {:noreply, Pump.pump(Ports.put_inlet(state, tag, Ports.closing(inlet, reason, state)))}

      _ ->
        {:noreply, Turn.other(state, message)}
    end
  end

  def handle_info({:"$gen_producer", from, {:subscribe, _cancel, opts}}, state),
    do: {:noreply, Ports.subscribe(state, from, opts)}

  def handle_info({:"$gen_producer", {pid, tag}, {:cancel, reason}}, state) do
    send(pid, {:"$gen_consumer", {self(), tag}, {:cancel, reason}})
    state |> Ports.unsubscribe(&(&1.tag == tag and &1.pid == pid)) |> Pump.pump() |> unless_over()
  end

  def handle_info(:situ_pump, state), do: {:noreply, Pump.pump(%{state | scheduled: false})}
  def handle_info({:situ_alarm, _}, state), do: {:noreply, Alarm.ring(%{state | alarm: nil})}
  def handle_info({:situ, request}, state), do: Request.handle(request, state)

  # A hold that was renewed or ended meanwhile is not this one's to end.
  def handle_info({:situ_hold, tag, token}, state) do
    case state.inlets do
      %{^tag => %{held: {_timer, ^token}} = inlet} ->
        state = Ports.put_inlet(state, tag, %{inlet | held: nil})
        {:noreply, Turn.other(state, {:hold_ended, inlet.name})}

      _ ->
        {:noreply, state}
    end
  end

  def handle_info({:DOWN, ref, :process, pid, _} = message, state) do
    if Enum.any?(state.outlets, fn {_, o} -> Enum.any?(o.subs, &(&1.monitor == ref)) end),
      do:
        state
        |> Ports.unsubscribe(&(&1.pid == pid and &1.monitor == ref))
        |> Pump.pump()
        |> unless_over(),
      else: {:noreply, Turn.other(state, message)}
  end

  def handle_info({:EXIT, _pid, :normal}, state), do: {:noreply, state}
  def handle_info(message, state), do: {:noreply, Turn.other(state, message)}

  @impl true
  def terminate(_reason, %{kind: :chain}), do: :ok

  def terminate(reason, state),
    do: Call.terminate(state.module, reason, state.core, state.head.path)

  defp unless_over(%{quitting: true} = state) do
    if Ports.drained?(state), do: {:stop, :normal, state}, else: {:noreply, state}
  end

  defp unless_over(state), do: {:noreply, state}

  # A crash report names the component; payloads and options have no place in a log.
  @impl true
  def format_status(_reason, [_dictionary, state]), do: [data: [{~c"State", summary(state)}]]

  defp summary(%__MODULE__{} = state),
    do: %{component: state.head.path, phase: state.phase, inputs: map_size(state.inlets)}

  defp summary(_state), do: %{}

  @doc "Tells the server."
  @spec report(t(), term()) :: term()
  def report(state, event), do: send(state.server, {:situ_stage, state.id, event})

  @doc "The context a component sees before the pipeline has a clock."
  @spec context(map()) :: Context.t()
  def context(args), do: %Context{path: hd(args.vertices).path, pipeline: args.handle}
end
