defmodule Situ.Pipeline.Performer do
  @moduledoc false
  # Performs the actions of the life cycle. Only this module turns a decision into a message, a process or a log line.
  alias Situ.{Clock, Error, Graph, Lifecycle, Telemetry}
  alias Situ.Clock.Timing
  alias Situ.Graph.{Cycle, Plan}
  alias Situ.Lifecycle.Errors
  alias Situ.Pipeline.{Dynamic, Handlers, Inspection, Stages, State}
  alias Situ.Pipeline.Dynamic.Extension
  alias Situ.Ports.Tally
  require Logger

  @doc "Applies one event and performs all actions that follow from it."
  @spec apply(State.t(), Lifecycle.event()) :: State.t()
  def apply(state, event) do
    {life, actions} = Lifecycle.apply(state.life, event, State.now(state))
    Enum.reduce(actions, %{state | life: life}, &perform/2)
  end

  @spec apply_all(State.t(), [Lifecycle.event()]) :: State.t()
  def apply_all(state, events), do: Enum.reduce(events, state, &__MODULE__.apply(&2, &1))

  @doc "Handles the end of a linked process."
  @spec exited(State.t(), pid(), term()) :: State.t()
  def exited(%{handlers: pid} = state, pid, reason) do
    error = %{Errors.crashed(reason) | what: "a handler died: #{inspect(reason, limit: 8)}"}
    state = %{state | handlers: nil}

    if state.life.step == :handlers do
      __MODULE__.apply(state, {:handled, :run, {:error, error}})
    else
      state = __MODULE__.apply(state, {:handler_failed, error})
      over? = state.life.phase == :completed
      if over?, do: __MODULE__.apply(state, {:handled, :completed}), else: state
    end
  end

  def exited(state, pid, reason) do
    case Map.pop(state.pids, pid) do
      {nil, _} -> state
      {id, pids} -> stage_exited(%{state | pids: pids}, id, reason)
    end
  end

  defp stage_exited(state, id, reason) do
    error = Errors.killed(hd(state.stages[id].vertices).path, reason)
    reached = Stages.reached(state, id)
    state = state |> interrupted(id) |> __MODULE__.apply({:exited, id, error, reached})
    if Extension.forgotten?(state, id), do: __MODULE__.apply(state, {:left, id}), else: state
  end

  @doc "Fails the requests of all callers that wait for this stage."
  @spec interrupted(State.t(), pos_integer()) :: State.t()
  def interrupted(state, id) do
    state = Dynamic.Replacement.interrupted(state, id)
    {state, events} = Dynamic.Input.interrupted(state, id)
    {state, more} = Dynamic.Tap.interrupted(state, id)
    apply_all(state, events ++ more)
  end

  @doc "Handles handlers that have returned, perhaps after adding to the graph."
  @spec handled(State.t(), atom(), :ok | {:error, Error.t()}, Graph.t()) :: State.t()
  def handled(state, :run, result, graph),
    do: __MODULE__.apply(%{state | graph: graph}, {:handled, :run, result})

  def handled(state, event, result, graph) do
    more = Enum.drop(graph.handlers, length(state.graph.handlers))
    state = %{state | graph: %{state.graph | handlers: state.graph.handlers ++ more}}

    state =
      if Graph.Extension.grown?(graph, %Graph{}),
        do: __MODULE__.apply(state, {:handler_failed, late_building(event)}),
        else: state

    state =
      case result do
        {:error, error} -> __MODULE__.apply(state, {:handler_failed, error})
        :ok -> state
      end

    if event == :completed, do: __MODULE__.apply(state, {:handled, :completed}), else: state
  end

  defp late_building(event) do
    error = Graph.Builder.running()
    %{error | what: "the #{inspect(event)} handler added components: #{error.what}"}
  end

  @doc "Logs an error that does not end the pipeline and calls the `:error` handlers."
  @spec noted(State.t(), Error.t()) :: State.t()
  def noted(state, error) do
    Logger.warning(Exception.message(error))
    told(state, error)
  end

  defp told(state, error) do
    Telemetry.execute(
      [:situ, :component, :error],
      %{originating_time: error.meta[:originating_time]},
      %{
        pipeline: state.settings.name,
        component: error.meta[:component],
        error: error
      }
    )

    call_handlers(state, :error, error)
  end

  @doc "Adds the cycle that caused it to the error of a non-increasing time."
  @spec explained(Error.t(), State.t()) :: Error.t()
  def explained(error, state), do: Cycle.explain(error, state.graph)

  # Actions

  defp perform({:tell, id, request}, state), do: Stages.tell(state, id, request)
  defp perform({:spawn, ids}, state), do: Stages.spawn(state, ids)
  defp perform({:start, ids}, state), do: Stages.start(state, ids)
  defp perform({:run, ids}, state), do: Enum.reduce(ids, state, &Stages.tell(&2, &1, :run))
  defp perform({:rewire, id, links}, state), do: Stages.rewire(state, id, links)
  defp perform({:cut, ids, time}, state), do: Stages.cut(state, ids, time)

  defp perform({:lend, tag}, state), do: Extension.lend(state, tag)

  # A stage whose process is still alive leaves when the process ends.
  defp perform({:forget, ids}, state) do
    ended = Enum.filter(ids, &Stages.ended?(state, &1))
    state |> Extension.forget(ids) |> apply_all(Enum.map(ended, &{:left, &1}))
  end

  defp perform({:drop, id}, state), do: state |> Dynamic.Tap.drop(id) |> Stages.drop(id)
  defp perform({:unwire, tag}, state), do: Stages.unwire(state, tag)
  defp perform({:release, ids}, state), do: Stages.release(state, ids)

  defp perform({:event, event}, state), do: __MODULE__.apply(state, event)

  # An exit signal from its parent makes the stage run terminate/2 and end.
  defp perform({:shutdown, id}, state) do
    Process.exit(state.stages[id].pid, :shutdown)
    state
  end

  defp perform({:kill, id}, state) do
    Process.exit(state.stages[id].pid, :kill)
    state
  end

  defp perform({:reply, nil, _answer}, state), do: state

  defp perform({:reply, from, answer}, state) do
    GenServer.reply(from, answer)
    state
  end

  defp perform({:after, ms, event}, state) do
    Process.send_after(self(), {:situ_event, event}, ms)
    state
  end

  defp perform({:watch, ms, which}, state) do
    Process.send_after(self(), {:situ_watch, which, Stages.fingerprint(state, which)}, ms)
    state
  end

  defp perform({:measure, :drain}, state),
    do: __MODULE__.apply(state, {:measured, :drain, Stages.look(state)})

  # An error that ends the pipeline is logged once, here.
  defp perform({:failed, error}, state) do
    Logger.error(Exception.message(error))
    told(state, error)
  end

  defp perform({:noted, error}, state), do: noted(state, error)

  defp perform({:restarted, id, error}, state) do
    Tally.restarted(state.stages[id].tally, 0)
    noted(state, error)
  end

  defp perform({:handle, :run}, state) do
    start = Timing.new(state.settings, state.graph.proposals).start_time

    if Handlers.any?(state.graph, :run),
      do: call_handlers(state, :run, start),
      else: __MODULE__.apply(state, {:handled, :run, :ok})
  end

  defp perform({:handle, :completed}, state) do
    state = call_handlers(state, :progress, 1.0)

    if Handlers.any?(state.graph, :completed) or state.handlers != nil,
      do: call(state, {:completed, Inspection.report(state)}),
      else: __MODULE__.apply(state, {:handled, :completed})
  end

  defp perform({:handle, event, argument}, state), do: call_handlers(state, event, argument)

  defp perform(:plan, state) do
    case Plan.compile(state.graph) do
      {:ok, plan} ->
        {state, members} = Stages.lay_out(state, plan)
        state = resend_early(state)
        __MODULE__.apply(state, {:planned, members, state.wires.links})

      {:error, error} ->
        __MODULE__.apply(state, {:plan_failed, error})
    end
  end

  defp perform(:start_clock, state) do
    Telemetry.execute([:situ, :pipeline, :start], %{system_time: :os.system_time()}, %{
      pipeline: state.settings.name
    })

    timing = Timing.new(state.settings, state.graph.proposals)
    Clock.listen(timing.clock)
    Inspection.begin(%{state | timing: timing})
  end

  # Messages that arrived during the start are handled now.
  defp perform(:running, state), do: state |> resend_early() |> progress()

  defp perform(:abandoned, state) do
    Handlers.abandoned(state.handle, nil)
    state
  end

  defp perform(:finished, state) do
    state = Inspection.advance_progress(state)
    result = Inspection.result(state)
    duration = System.monotonic_time() - state.view.begun

    Telemetry.execute([:situ, :pipeline, :stop], %{duration: duration}, %{
      pipeline: state.settings.name,
      errors: length(state.life.errors)
    })

    %{state | view: %{state.view | outcome: result}}
  end

  @doc "Calls the `:progress` handlers and schedules the next call."
  @spec progress(State.t()) :: State.t()
  def progress(%{life: %{phase: :completed}} = state), do: state

  def progress(state) do
    if Handlers.any?(state.graph, :progress) do
      Process.send_after(self(), :situ_progress, state.settings.progress_every)
      state = Inspection.advance_progress(state)
      call_handlers(state, :progress, state.view.progress)
    else
      state
    end
  end

  defp call_handlers(state, event, argument) do
    if Handlers.any?(state.graph, event), do: call(state, {event, argument}), else: state
  end

  # Only `:run` handlers may build on the graph, so it is not copied for others.
  defp call(state, {event, _argument} = job) do
    graph = if event == :run, do: state.graph, else: %Graph{handlers: state.graph.handlers}
    %{state | handlers: Handlers.call(state.handlers, job, graph, state.handle)}
  end

  # Messages that are still too early are deferred again.
  defp resend_early(state) do
    for message <- Enum.reverse(state.early), do: send(self(), message)
    %{state | early: []}
  end
end
