defmodule Situ.Pipeline.LifecycleRunner do
  @moduledoc false
  # Performs the actions of the life cycle. Only this module turns a decision into a message, a process or a log line.
  alias Situ.{Clock, Error, Graph, Lifecycle, Runtime, Telemetry}
  alias Situ.Clock.Timing
  alias Situ.Graph.{Cycle, Plan}
  alias Situ.Lifecycle.Errors

  alias Situ.Pipeline.{
    Dynamic,
    Handlers,
    Inspection,
    PendingCheckpoint,
    StageProcesses,
    Stages,
    State
  }

  alias Situ.Pipeline.Dynamic.Extension
  alias Situ.Ports.ErrorCounters
  require Logger

  @doc "Applies one event and performs all actions that follow from it."
  @spec apply_event(State.t(), Lifecycle.event()) :: State.t()
  def apply_event(state, event) do
    {life, actions} = Lifecycle.apply_event(state.life, event, State.now(state))
    # An operation ends when everything that it has caused is done; others may begin then.
    {last, first} = Enum.split_with(actions, &match?({:reply, {:operation, _id}, _answer}, &1))
    Enum.reduce(first ++ last, %{state | life: life}, &perform_action/2)
  end

  @spec apply_events(State.t(), [Lifecycle.event()]) :: State.t()
  def apply_events(state, events), do: Enum.reduce(events, state, &__MODULE__.apply_event(&2, &1))

  @doc "Handles the end of a linked process."
  @spec handle_exit(State.t(), pid(), term()) :: State.t()
  def handle_exit(%{handlers: pid} = state, pid, reason) do
    error = %{
      Errors.pipeline_crashed(reason)
      | what: "a handler died: #{inspect(reason, limit: 8)}"
    }

    state = %{state | handlers: nil}

    if state.life.step == :handlers do
      __MODULE__.apply_event(state, {:handled, :run, {:error, error}})
    else
      state = __MODULE__.apply_event(state, {:handler_failed, error})
      over? = state.life.phase == :completed
      if over?, do: __MODULE__.apply_event(state, {:handled, :completed}), else: state
    end
  end

  def handle_exit(state, pid, reason) do
    case Map.pop(state.pids, pid) do
      {nil, _} -> state
      {ids, pids} -> Enum.reduce(ids, %{state | pids: pids}, &handle_stage_exit(&2, &1, reason))
    end
  end

  @doc "Handles the end of a stage whose process continues with other stages."
  @spec handle_stage_end(State.t(), pos_integer()) :: State.t()
  def handle_stage_end(state, id),
    do: state |> StageProcesses.remove_stage(id) |> handle_stage_exit(id, :normal)

  # The end of another stage of the process may have dropped this one.
  defp handle_stage_exit(%{stages: stages} = state, id, _reason) when not is_map_key(stages, id),
    do: state

  defp handle_stage_exit(state, id, reason) do
    error = Errors.component_killed(hd(state.stages[id].vertices).path, reason)
    reached = Stages.reached_time(state, id)
    state = end_stage(state, id, {:exited, id, error, reached})

    if Extension.stage_removed?(state, id),
      do: __MODULE__.apply_event(state, {:left, id}),
      else: state
  end

  @doc "Handles a stage that failed to initialize. Its process ends by itself, so its stage is free for another one."
  @spec handle_init_failure(State.t(), pos_integer(), Error.t()) :: State.t()
  def handle_init_failure(state, id, error) do
    state |> end_stage(id, {:init_failed, id, error}) |> handle_stage_end(id)
  end

  # Refuses the operations that the stage was performing. The ones that waited for them find its next process.
  defp end_stage(state, id, event) do
    {state, replaced} = Dynamic.Replacement.fail_pending(state, id)
    {state, attached} = Dynamic.Input.fail_pending(state, id)
    {state, tapped} = Dynamic.Tap.fail_pending(state, id)
    {state, saved} = PendingCheckpoint.fail_pending(state, id)
    events = replaced ++ attached ++ tapped ++ saved
    {refused, before} = Enum.split_with(events, &match?({:finished, _, _}, &1))
    apply_events(state, before ++ [event | refused])
  end

  @doc "Adds an operation to the log of the life cycle. Its caller waits no longer than the request's timeout, if any."
  @spec accept_operation(State.t(), tuple(), GenServer.from() | nil) :: State.t()
  def accept_operation(state, request, from) do
    id = state.life.operations.last + 1
    schedule_expiry(request, id)
    __MODULE__.apply_event(state, {:accept, request, Dynamic.scope(state, request), from})
  end

  defp schedule_expiry({:replace, %{timeout: ms}}, id) when is_integer(ms),
    do: send_expiry(id, Errors.request_timeout(:replace, ms), ms)

  defp schedule_expiry({:checkpoint, ms}, id), do: send_expiry(id, Errors.checkpoint_late(), ms)
  defp schedule_expiry(_request, _id), do: :ok

  defp send_expiry(id, error, ms),
    do: Runtime.send_after({:situ_event, {:expired, id, error}}, ms)

  @doc "Returns whether this process has received a checkpoint that it still uses."
  @spec holds_checkpoint?(State.t(), pid()) :: boolean()
  def holds_checkpoint?(%{dynamic: %{checkpoint: %{ref: op, step: :held}}} = state, pid),
    do: match?(%{^op => %{by: ^pid}}, state.life.operations.open)

  def holds_checkpoint?(_state, _pid), do: false

  @doc "Handles handlers that have returned, perhaps after adding to the graph."
  @spec finish_handlers(State.t(), atom(), :ok | {:error, Error.t()}, Graph.t()) :: State.t()
  def finish_handlers(state, :run, result, graph),
    do: __MODULE__.apply_event(%{state | graph: graph}, {:handled, :run, result})

  def finish_handlers(state, event, result, graph) do
    more = Enum.drop(graph.handlers, length(state.graph.handlers))
    state = %{state | graph: %{state.graph | handlers: state.graph.handlers ++ more}}

    state =
      if Graph.Additions.has_additions?(graph, %Graph{}),
        do: __MODULE__.apply_event(state, {:handler_failed, late_building_error(event)}),
        else: state

    state =
      case result do
        {:error, error} -> __MODULE__.apply_event(state, {:handler_failed, error})
        :ok -> state
      end

    if event == :completed, do: __MODULE__.apply_event(state, {:handled, :completed}), else: state
  end

  defp late_building_error(event) do
    error = Graph.Builder.already_running_error()
    %{error | what: "the #{inspect(event)} handler added components: #{error.what}"}
  end

  @doc "Logs an error that does not end the pipeline and calls the `:error` handlers."
  @spec report_error(State.t(), Error.t()) :: State.t()
  def report_error(state, error) do
    Logger.warning(Exception.message(error), log_metadata(state, error))
    emit_error(state, error)
  end

  defp log_metadata(state, %Error{meta: meta}) do
    [pipeline: state.settings.name] ++
      for key <- [:component, :originating_time], value = meta[key], do: {key, value}
  end

  defp emit_error(state, error) do
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

  @doc "Adds the cycle to an error about a time that does not increase, because the cycle caused it."
  @spec explain_error(Error.t(), State.t()) :: Error.t()
  def explain_error(error, state), do: Cycle.explain_error(error, state.graph)

  # Actions

  defp perform_action({:tell, id, request}, state), do: Stages.send_request(state, id, request)
  defp perform_action({:spawn, ids}, state), do: StageProcesses.spawn_stages(state, ids)
  defp perform_action({:start, ids}, state), do: Stages.start_stages(state, ids)

  defp perform_action({:run, ids}, state),
    do: Enum.reduce(ids, state, &Stages.send_request(&2, &1, :run))

  defp perform_action({:rewire, id, links}, state), do: Stages.rewire_stage(state, id, links)
  defp perform_action({:cut, ids, time}, state), do: Stages.limit_stages(state, ids, time)

  defp perform_action({:lend, tag}, state), do: Extension.lend_output(state, tag)

  defp perform_action({:reset, ref, ids, from}, state) do
    {result, state} =
      case Stages.reset_stages(state, ids, from) do
        {:ok, state} -> {:ok, state}
        {:error, error} -> {{:error, error}, state}
      end

    __MODULE__.apply_event(state, {:reset, ref, result})
  end

  # A stage whose process is still alive leaves when the process ends.
  defp perform_action({:forget, ids}, state) do
    ended = Enum.filter(ids, &StageProcesses.process_ended?(state, &1))
    state |> Extension.remove_vertices(ids) |> apply_events(Enum.map(ended, &{:left, &1}))
  end

  defp perform_action({:drop, id}, state),
    do: state |> Dynamic.Tap.delete_tap(id) |> Stages.drop_stage(id)

  defp perform_action({:unwire, tag}, state), do: Stages.drop_link(state, tag)
  defp perform_action({:release, ids}, state), do: Stages.release_stages(state, ids)

  defp perform_action({:event, event}, state), do: __MODULE__.apply_event(state, event)

  # An exit signal from its parent makes the stage run terminate/2 and end.
  defp perform_action({:shutdown, id}, state) do
    Process.exit(state.stages[id].pid, :shutdown)
    state
  end

  defp perform_action({:kill, id}, state) do
    Process.exit(state.stages[id].pid, :kill)
    state
  end

  defp perform_action({:perform, id, request, from}, state) do
    {state, events} = Dynamic.perform(state, id, request, from)
    apply_events(state, events)
  end

  defp perform_action({:reply, nil, _answer}, state), do: state

  defp perform_action({:reply, {:operation, id}, answer}, state),
    do: __MODULE__.apply_event(state, {:finished, id, answer})

  defp perform_action({:reply, from, answer}, state) do
    GenServer.reply(from, answer)
    state
  end

  defp perform_action({:after, ms, event}, state) do
    Runtime.send_after({:situ_event, event}, ms)
    state
  end

  defp perform_action({:watch, ms, which}, state) do
    Runtime.send_after({:situ_watch, which, Stages.fingerprint(state, which)}, ms)
    state
  end

  defp perform_action({:measure, :drain}, state),
    do: __MODULE__.apply_event(state, {:measured, :drain, Stages.measure_drain(state)})

  # An error that ends the pipeline is logged once, here.
  defp perform_action({:failed, error}, state) do
    Logger.error(Exception.message(error), log_metadata(state, error))
    emit_error(state, error)
  end

  defp perform_action({:noted, error}, state), do: report_error(state, error)

  defp perform_action({:restarted, id, error}, state) do
    ErrorCounters.count_restart(state.stages[id].tally, 0)
    report_error(state, error)
  end

  defp perform_action({:handle, :run}, state) do
    start = Timing.new(state.settings, state.graph.proposals).start_time

    if Handlers.any?(state.graph, :run),
      do: call_handlers(state, :run, start),
      else: __MODULE__.apply_event(state, {:handled, :run, :ok})
  end

  defp perform_action({:handle, :completed}, state) do
    state = call_handlers(state, :progress, 1.0)

    if Handlers.any?(state.graph, :completed) or state.handlers != nil,
      do: run_handlers(state, {:completed, Inspection.build_report(state)}),
      else: __MODULE__.apply_event(state, {:handled, :completed})
  end

  defp perform_action({:handle, event, argument}, state),
    do: call_handlers(state, event, argument)

  # No stage may begin with functions of an earlier version, so the plan waits for the functions of the newest.
  defp perform_action(:plan, state) do
    case Dynamic.Reload.begin(state) do
      %{code: {_version, nil}} = state -> plan_graph(state)
      state -> state
    end
  end

  defp perform_action(:start_clock, state) do
    Telemetry.execute([:situ, :pipeline, :start], %{system_time: :os.system_time()}, %{
      pipeline: state.settings.name
    })

    timing = Timing.new(state.settings, state.graph.proposals)
    Clock.subscribe(timing.clock)
    Inspection.start_averaging(%{state | timing: timing})
  end

  # Messages that arrived during the start are handled now.
  defp perform_action(:running, state), do: state |> resend_early() |> report_progress()

  defp perform_action(:abandoned, state) do
    Handlers.run_abandoned(state.handle, nil)
    state
  end

  defp perform_action(:finished, state) do
    state = Inspection.advance_progress(state)
    result = Inspection.build_result(state)
    duration = System.monotonic_time() - state.view.begun

    Telemetry.execute([:situ, :pipeline, :stop], %{duration: duration}, %{
      pipeline: state.settings.name,
      errors: length(state.life.errors),
      report: fetch_report(result)
    })

    %{state | view: %{state.view | outcome: result}}
  end

  defp fetch_report({:ok, report}), do: report
  defp fetch_report({:error, error}), do: error.meta.report

  @doc "Calls the `:progress` handlers and schedules the next call."
  @spec report_progress(State.t()) :: State.t()
  def report_progress(%{life: %{phase: :completed}} = state), do: state

  def report_progress(state) do
    if Handlers.any?(state.graph, :progress) do
      Runtime.send_after(:situ_progress, state.settings.progress_every, :background)
      state = Inspection.advance_progress(state)
      call_handlers(state, :progress, state.view.progress)
    else
      state
    end
  end

  defp plan_graph(state) do
    case Plan.compile(state.graph) do
      {:ok, plan} ->
        {state, members} = Stages.install_plan(state, plan)
        __MODULE__.apply_event(state, {:planned, members, state.wires.links})

      {:error, error} ->
        __MODULE__.apply_event(state, {:plan_failed, error})
    end
  end

  defp call_handlers(state, event, argument) do
    if Handlers.any?(state.graph, event), do: run_handlers(state, {event, argument}), else: state
  end

  # Only `:run` handlers may build on the graph, so it is not copied for others.
  defp run_handlers(state, {event, _argument} = job) do
    graph = if event == :run, do: state.graph, else: %Graph{handlers: state.graph.handlers}
    %{state | handlers: Handlers.call_handlers(state.handlers, job, graph, state.handle)}
  end

  # Messages that are still too early are deferred again.
  defp resend_early(state) do
    for message <- Enum.reverse(state.early), do: send(self(), message)
    %{state | early: []}
  end
end
