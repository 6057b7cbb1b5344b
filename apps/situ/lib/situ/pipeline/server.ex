defmodule Situ.Pipeline.Server do
  @moduledoc false
  # The process of one pipeline and the parent of its stages. It makes no life-cycle decisions: it turns messages into
  # events for `Situ.Lifecycle` and performs the actions that the life cycle returns.
  #
  #   caller/supervisor
  #     └── Server (traps exits)
  #           ├── Stage 1    linked; if a stage dies, the life cycle decides by its `on_error`
  #           ├── Stage n    if the server dies, its stages release their resources and end
  #           └── Handlers   linked; runs the functions given to `Situ.Pipeline.on/3`
  use GenServer

  require Logger

  alias Situ.{Clock, Lifecycle}
  alias Situ.Graph.Builder
  alias Situ.Lifecycle.Errors

  alias Situ.Pipeline.{Dynamic, Handlers, Inspection, LifecycleRunner, PendingCheckpoint}
  alias Situ.Pipeline.{StageProcesses, Stages, Termination}

  # The operations of Lifecycle.Operations. Like some other requests, they wait until a starting pipeline is running.
  @operations [:extend, :replace, :tap, :stop_part, :start_part, :attach, :detach, :checkpoint] ++
                [:clock]
  @patient [:subscription | @operations]

  @impl true
  def init(_), do: :ignore

  # A start or a stop that fails halfway cannot be completed, so the pipeline ends with the error.
  @impl true
  def handle_call(request, from, state)
      when request in [:launch, :abandon] or (is_tuple(request) and elem(request, 0) == :stop),
      do: guard_step(state, fn -> handle_request(request, from, state) end)

  # Any other request that raises leaves the state unchanged, and the caller receives the error.
  def handle_call(request, from, state) do
    handle_request(request, from, state)
  catch
    kind, reason ->
      Logger.error(Exception.format(kind, reason, __STACKTRACE__))
      {:reply, {:error, Errors.request_failed(request, {kind, reason, __STACKTRACE__})}, state}
  end

  # No code sends casts; a stray one must not end the pipeline.
  @impl true
  def handle_cast(_message, state), do: {:noreply, state}

  @impl true
  def handle_info(message, state), do: guard_step(state, fn -> handle_message(message, state) end)

  # A step that fails halfway leaves a state from which no orderly end is possible. The pipeline ends with an error
  # immediately, and its components release their resources.
  defp guard_step(state, step) do
    step.()
  catch
    kind, reason ->
      Logger.error(Exception.format(kind, reason, __STACKTRACE__))
      Termination.crash_pipeline(Errors.pipeline_crashed({kind, reason, __STACKTRACE__}), state)
  end

  # Requests

  defp handle_request(:reload, _from, state) do
    state = begin_reload(state)
    {:reply, Dynamic.Reload.process(state), state}
  end

  defp handle_request({:build, change}, _from, %{life: %{phase: :building}} = state) do
    {:reply, {:ok, Builder.update_graph(state.handle, change)}, state}
  rescue
    error in Situ.Error -> {:reply, {:error, error}, state}
  end

  defp handle_request({:build, _change}, _from, state),
    do: {:reply, {:error, Builder.already_running_error()}, state}

  defp handle_request(:launch, from, %{life: %{phase: :building}} = state) do
    GenServer.reply(from, :ok)
    apply_event(%{state | graph: Builder.close_graph(state.handle)}, :start)
  end

  defp handle_request(:launch, _from, state),
    do: {:reply, {:error, Builder.already_running_error()}, state}

  defp handle_request({:stop, catch_up}, from, state),
    do: apply_event(%{state | waiters: [from | state.waiters]}, {:stop, catch_up})

  defp handle_request(:abandon, _from, state) do
    {:stop, reason, state} = Termination.crash_pipeline(Errors.pipeline_abandoned(), state)
    {:stop, reason, :ok, state}
  end

  defp handle_request(:await, from, state),
    do: {:noreply, %{state | waiters: [from | state.waiters]}}

  defp handle_request(:state, _from, state), do: {:reply, state.life.phase, state}

  defp handle_request(:clock, from, %{life: %{phase: :starting}, timing: nil} = state),
    do: {:noreply, defer_message({:"$gen_call", from, :clock}, state)}

  defp handle_request(:clock, _from, %{timing: nil} = state), do: {:reply, Clock.real(), state}
  defp handle_request(:clock, _from, state), do: {:reply, state.timing.clock, state}

  # Serves pipelines inside this pipeline's components.
  defp handle_request(:timing, _from, %{timing: nil} = state),
    do: {:reply, {:error, Errors.not_running()}, state}

  defp handle_request(:timing, _from, state),
    do: {:reply, Map.take(state.timing, [:clock, :enforce, :replay_end]), state}

  defp handle_request(:mark, _from, state), do: {:reply, Stages.fingerprint(state, :all), state}

  defp handle_request(:quiet?, _from, state),
    do: {:reply, state.life.phase == :running and Stages.no_messages_in_flight?(state), state}

  defp handle_request(:info, _from, state) do
    snapshot = Inspection.build_snapshot(state)
    {:reply, snapshot, state |> Inspection.mark_totals() |> Inspection.request_descriptions()}
  end

  # Processes of this node can read the counters without further requests.
  defp handle_request(:counters, _from, state), do: {:reply, state.wires.counters, state}

  defp handle_request({:trace, time}, _from, state),
    do: {:reply, Inspection.trace_message(state, time), state}

  defp handle_request(:changes, _from, state),
    do: {:reply, Inspection.list_changes(state), state}

  defp handle_request(:progress, _from, state) do
    state = Inspection.advance_progress(state)
    {:reply, state.view.progress, state}
  end

  # These two requests make the pipeline look like a supervisor.
  defp handle_request(:which_children, _from, state),
    do: {:reply, StageProcesses.list_children(state), state}

  defp handle_request(:count_children, _from, state) do
    children = StageProcesses.list_children(state)
    active = Enum.count(children, fn {_, pid, _, _} -> is_pid(pid) end)
    n = length(children)
    {:reply, [specs: n, active: active, supervisors: 0, workers: n], state}
  end

  defp handle_request(request, from, %{life: %{phase: :starting}} = state)
       when is_tuple(request) and elem(request, 0) in @patient,
       do: {:noreply, defer_message({:"$gen_call", from, request}, state)}

  defp handle_request(:extension, from, %{life: %{phase: :starting}} = state),
    do: {:noreply, defer_message({:"$gen_call", from, :extension}, state)}

  defp handle_request({:untap, id}, _from, state) do
    {state, events} = Dynamic.Tap.detach(state, id)
    reply_and_continue(:ok, LifecycleRunner.apply_events(state, events))
  end

  defp handle_request(request, from, %{life: %{phase: :running}} = state),
    do: handle_running_request(request, from, state)

  # An output that waits for its consumer may still have messages after all sources have ended.
  defp handle_request({:subscription, which}, _from, %{life: %{phase: :stopping}} = state),
    do: {:reply, Dynamic.Tap.fetch_subscription(state, which), state}

  defp handle_request(_request, _from, state), do: {:reply, {:error, Errors.not_running()}, state}

  defp handle_running_request(:extension, _from, state) do
    {graph, state} = Dynamic.Extension.reserve_ids(state)
    {:reply, {:ok, {state.handle, graph}}, state}
  end

  defp handle_running_request({:subscription, which}, _from, state),
    do: {:reply, Dynamic.Tap.fetch_subscription(state, which), state}

  # A process that holds a checkpoint would wait for itself.
  defp handle_running_request({:checkpoint, _timeout} = request, {pid, _tag} = from, state) do
    if LifecycleRunner.holds_checkpoint?(state, pid),
      do: {:reply, {:error, Errors.checkpoint_in_use()}, state},
      else: accept_operation(request, from, state)
  end

  defp handle_running_request(request, from, state)
       when is_tuple(request) and elem(request, 0) in @operations,
       do: accept_operation(request, from, state)

  defp handle_running_request(_request, _from, state),
    do: {:reply, {:error, Errors.unknown_request()}, state}

  defp accept_operation(request, from, state),
    do: state |> LifecycleRunner.accept_operation(request, from) |> Termination.stop_if_finished()

  defp defer_message(message, state), do: %{state | early: [message | state.early]}

  defp apply_dynamic({state, events}),
    do: Termination.stop_if_finished(LifecycleRunner.apply_events(state, events))

  # Events

  defp handle_message(:situ_launch, state), do: apply_event(state, :start)
  defp handle_message({:situ_stage, id, event}, state), do: handle_stage_message(event, id, state)
  defp handle_message({:situ_event, event}, state), do: apply_event(state, event)

  defp handle_message(:situ_stop, state),
    do: apply_event(state, {:stop, Lifecycle.default_catch_up_ms()})

  defp handle_message({:situ_stop, time}, state), do: apply_event(state, {:stop_at, time})
  defp handle_message(:situ_observe, state), do: {:noreply, Inspection.observe_totals(state)}

  defp handle_message(:situ_progress, state),
    do: {:noreply, LifecycleRunner.report_progress(state)}

  defp handle_message(:situ_moving, state), do: apply_event(state, :moving)

  defp handle_message({:situ_stop_part, path, opts}, %{life: %{phase: :running}} = state),
    do: accept_operation({:stop_part, path, opts}, nil, state)

  defp handle_message({:situ_handled, event, result, graph}, state),
    do:
      state
      |> LifecycleRunner.finish_handlers(event, result, graph)
      |> Termination.stop_if_finished()

  defp handle_message({:situ_watch, which, mark}, state) do
    # In this order: a stage that stops waiting is not idle before it has moved its messages.
    patient? = Stages.any_patient?(state)
    idle = StageProcesses.idle_stages(state)
    moved? = Stages.fingerprint(state, which) != mark
    seen = %{moved?: moved?, idle: if(moved?, do: MapSet.new(), else: idle), patient?: patient?}
    apply_event(state, {:watched, which, seen})
  end

  defp handle_message(:situ_reloaded, state), do: {:noreply, begin_reload(state)}

  defp handle_message({:situ_rebuilt, process, result}, state),
    do: finish_reload(process, result, state)

  defp handle_message({:situ_checkpoint, ref}, state),
    do: apply_dynamic(PendingCheckpoint.poll_progress(state, ref))

  defp handle_message({:situ_thaw, ref}, state),
    do: apply_dynamic(PendingCheckpoint.thaw_sources(state, ref))

  # A process that renews functions was killed. Normally it has already reported.
  defp handle_message({:EXIT, pid, _reason}, %{code: {_version, pid}} = state),
    do: finish_reload(pid, :error, state)

  defp handle_message({:EXIT, pid, reason}, state),
    do: state |> LifecycleRunner.handle_exit(pid, reason) |> Termination.stop_if_finished()

  defp handle_message({:situ_clock, _}, state) do
    for {id, _} <- state.stages, do: Stages.send_request(state, id, :clock)
    {:noreply, state}
  end

  defp handle_message({:DOWN, owner, :process, _, _}, %{owner: owner} = state),
    do: apply_event(state, {:stop, Lifecycle.default_catch_up_ms()})

  defp handle_message({:DOWN, ref, :process, _, _}, state) do
    {state, events} = PendingCheckpoint.thaw_sources(state, ref)
    {state, more} = Dynamic.Tap.handle_owner_down(state, ref)
    apply_dynamic({state, events ++ more})
  end

  defp handle_message(_other, state), do: {:noreply, state}

  # A stage that was already dropped sent this message before it ended.
  defp handle_stage_message(_event, id, %{stages: stages} = state)
       when not is_map_key(stages, id),
       do: {:noreply, state}

  defp handle_stage_message(:started, id, %{dynamic: %{taps: taps}} = state)
       when is_map_key(taps, id),
       do: {:noreply, Dynamic.Tap.connect_tap(state, id)}

  defp handle_stage_message(event, id, state)
       when event in [:up, :started, :source_stopped, :settled],
       do: apply_event(state, {event, id})

  defp handle_stage_message({:completed, time}, id, state),
    do: apply_event(state, {:completed, id, time})

  defp handle_stage_message({:unsubscribed, tag, _name, time}, id, state),
    do: apply_event(state, {:unsubscribed, id, tag, time})

  defp handle_stage_message({:failed, error, reached}, id, state),
    do: apply_event(state, {:failed, id, LifecycleRunner.explain_error(error, state), reached})

  defp handle_stage_message({:init_failed, error}, id, state),
    do: state |> LifecycleRunner.handle_init_failure(id, error) |> Termination.stop_if_finished()

  defp handle_stage_message({:skipped, error}, _id, state),
    do: {:noreply, LifecycleRunner.report_error(state, error)}

  defp handle_stage_message({:restarted, error}, id, state),
    do: apply_event(state, {:restarted, id, error})

  defp handle_stage_message({:description, text}, id, state),
    do: {:noreply, Inspection.put_description(state, id, text)}

  defp handle_stage_message({:tapped, tag}, _id, state),
    do: apply_dynamic(Dynamic.Tap.confirm_attached(state, tag))

  defp handle_stage_message({:lent, tag, how}, _id, %{dynamic: %{inputs: inputs}} = state)
       when is_map_key(inputs, tag),
       do: apply_dynamic(Dynamic.Input.request_attachment(state, tag, how))

  defp handle_stage_message({:lent, tag, how}, _id, state),
    do: apply_event(state, {:lent, tag, how})

  defp handle_stage_message({:answered, ref, answer, opts}, id, state),
    do: apply_dynamic(Dynamic.Input.handle_attach_reply(state, ref, id, answer, opts))

  defp handle_stage_message({:detached, input, opts}, id, state),
    do: apply_dynamic(Dynamic.Input.handle_detached(state, id, input, opts))

  defp handle_stage_message({:remembered, {:stopped, moment}, result}, id, state),
    do: {:noreply, Stages.put_stopped_snapshot(state, id, moment, result)}

  defp handle_stage_message({:remembered, ref, answer}, id, state),
    do: apply_dynamic(PendingCheckpoint.handle_snapshot(state, id, ref, answer))

  defp handle_stage_message({:replaced, ref, answer}, id, state),
    do: apply_dynamic(Dynamic.Replacement.handle_reply(state, id, ref, answer))

  defp handle_stage_message(:finalized, _id, state), do: {:noreply, state}

  defp handle_stage_message({:relocating, stage}, id, state),
    do:
      {:noreply, state |> StageProcesses.relocate_stage(id, stage) |> Stages.introduce_moved(id)}

  defp handle_stage_message(:ended, id, state),
    do: state |> LifecycleRunner.handle_stage_end(id) |> Termination.stop_if_finished()

  # A graph that is not planned yet is renewed when it is planned.
  defp begin_reload(%{life: %{phase: phase, step: step}} = state)
       when phase in [:starting, :running] and step != :handlers,
       do: Dynamic.Reload.begin(state)

  defp begin_reload(state), do: state

  defp finish_reload(process, result, state) do
    {state, requests} = Dynamic.Reload.finish(state, process, result)
    accept = &LifecycleRunner.accept_operation(&2, {:replace, &1}, {process, :renewed})
    requests |> Enum.reduce(state, accept) |> continue_plan()
  end

  # The plan waits for new functions.
  defp continue_plan(%{life: %{step: :handlers}, code: {_version, nil}} = state),
    do: apply_event(state, {:handled, :run, :ok})

  defp continue_plan(state), do: {:noreply, state}

  # Results

  defp apply_event(state, event),
    do: state |> LifecycleRunner.apply_event(event) |> Termination.stop_if_finished()

  defp reply_and_continue(answer, state) do
    case Termination.stop_if_finished(state) do
      {:noreply, state} -> {:reply, answer, state}
      {:stop, reason, state} -> {:stop, reason, answer, state}
    end
  end

  # A crash report names the pipeline but leaves out its graph, which would flood the log.
  @impl true
  def format_status(_reason, [_dictionary, state]) do
    summary = %{pipeline: state.settings.name, phase: state.life.phase, step: state.life.step}
    [data: [{~c"State", summary}]]
  end

  # The parent, a supervisor that is shutting down, ends the pipeline. This is a manual stop within the time that the
  # supervisor allows.
  @impl true
  def terminate(_reason, %{life: %{phase: :completed}}), do: :ok

  def terminate(_reason, %{life: %{phase: :building}} = state),
    do: Handlers.run_abandoned(state.handle, nil)

  def terminate(_reason, state),
    do:
      state
      |> LifecycleRunner.apply_event({:stop, Lifecycle.default_catch_up_ms()})
      |> run_until_finished()

  defp run_until_finished(%{view: %{outcome: result}} = state) when result != nil,
    do: Termination.publish_outcome(state)

  defp run_until_finished(state) do
    receive do
      {:"$gen_call", from, request} when request == :await or elem(request, 0) == :stop ->
        run_until_finished(%{state | waiters: [from | state.waiters]})

      {:"$gen_call", from, _} ->
        GenServer.reply(from, {:error, Errors.not_running()})
        run_until_finished(state)

      message ->
        case handle_info(message, state) do
          {:noreply, state} -> run_until_finished(state)
          {:stop, _, _} -> :ok
        end
    end
  end
end
