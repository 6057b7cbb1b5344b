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
  alias Situ.Application.{Directory, Results}
  alias Situ.Graph.Builder
  alias Situ.Lifecycle.Errors
  alias Situ.Pipeline.{Checkpointing, Dynamic, Handlers, Inspection, Performer, Stages, State}

  # These requests wait until a starting pipeline is running.
  @patient [:extend, :subscription, :replace, :tap, :stop_part, :clock, :attach, :detach] ++
             [:checkpoint]

  @impl true
  def init(_), do: :ignore

  # A start or a stop that fails halfway cannot be completed, so the pipeline ends with the error.
  @impl true
  def handle_call(request, from, state)
      when request in [:launch, :abandon] or (is_tuple(request) and elem(request, 0) == :stop),
      do: guard(state, fn -> answer(request, from, state) end)

  # Any other request that raises leaves the state unchanged, and the caller receives the error.
  def handle_call(request, from, state) do
    answer(request, from, state)
  catch
    kind, reason ->
      Logger.error(Exception.format(kind, reason, __STACKTRACE__))
      {:reply, {:error, Errors.request_failed(request, {kind, reason, __STACKTRACE__})}, state}
  end

  # No code sends casts; a stray one must not end the pipeline.
  @impl true
  def handle_cast(_message, state), do: {:noreply, state}

  @impl true
  def handle_info(message, state), do: guard(state, fn -> event(message, state) end)

  # A step that fails halfway leaves a state from which no orderly end is possible. The pipeline ends with an error
  # immediately, and its components release their resources.
  defp guard(state, step) do
    step.()
  catch
    kind, reason ->
      Logger.error(Exception.format(kind, reason, __STACKTRACE__))
      fallen(Errors.crashed({kind, reason, __STACKTRACE__}), state)
  end

  defp fallen(error, state) do
    life = %{state.life | phase: :completed, step: :over}
    over({:error, %{error | meta: %{errors: [error]}}}, %{state | life: life})
  end

  # Requests

  defp answer({:build, change}, _from, %{life: %{phase: :building}} = state) do
    {:reply, {:ok, Builder.run(state.handle, change)}, state}
  rescue
    error in Situ.Error -> {:reply, {:error, error}, state}
  end

  defp answer({:build, _change}, _from, state),
    do: {:reply, {:error, Builder.running()}, state}

  defp answer(:launch, from, %{life: %{phase: :building}} = state) do
    GenServer.reply(from, :ok)
    apply_event(%{state | graph: Builder.close(state.handle)}, :start)
  end

  defp answer(:launch, _from, state), do: {:reply, {:error, Builder.running()}, state}

  defp answer({:stop, catch_up}, from, state),
    do: apply_event(%{state | waiters: [from | state.waiters]}, {:stop, catch_up})

  defp answer(:abandon, _from, state) do
    {:stop, reason, state} = fallen(Errors.abandoned(), state)
    {:stop, reason, :ok, state}
  end

  defp answer(:await, from, state), do: {:noreply, %{state | waiters: [from | state.waiters]}}
  defp answer(:state, _from, state), do: {:reply, state.life.phase, state}

  defp answer(:clock, from, %{life: %{phase: :starting}, timing: nil} = state),
    do: {:noreply, later({:"$gen_call", from, :clock}, state)}

  defp answer(:clock, _from, %{timing: nil} = state), do: {:reply, Clock.real(), state}
  defp answer(:clock, _from, state), do: {:reply, state.timing.clock, state}

  # Serves pipelines inside this pipeline's components.
  defp answer(:timing, _from, state),
    do: {:reply, Map.take(state.timing, [:clock, :enforce, :replay_end]), state}

  defp answer(:mark, _from, state), do: {:reply, Stages.fingerprint(state, :all), state}

  defp answer(:quiet?, _from, state),
    do: {:reply, state.life.phase == :running and Stages.quiet?(state), state}

  defp answer(:info, _from, state) do
    snapshot = Inspection.snapshot(state)
    {:reply, snapshot, state |> Inspection.mark() |> Inspection.describe()}
  end

  defp answer({:trace, time}, _from, state), do: {:reply, Inspection.trace(state, time), state}

  # Returns the first error so far, for components that report to others why their stream ends.
  defp answer(:failure, _from, state), do: {:reply, {:ok, List.last(state.life.errors)}, state}

  defp answer(:progress, _from, state) do
    state = Inspection.advance_progress(state)
    {:reply, state.view.progress, state}
  end

  # These two requests make the pipeline look like a supervisor.
  defp answer(:which_children, _from, state), do: {:reply, Stages.children(state), state}

  defp answer(:count_children, _from, state) do
    children = Stages.children(state)
    active = Enum.count(children, fn {_, pid, _, _} -> is_pid(pid) end)
    n = length(children)
    {:reply, [specs: n, active: active, supervisors: 0, workers: n], state}
  end

  defp answer(request, from, %{life: %{phase: :starting}} = state)
       when is_tuple(request) and elem(request, 0) in @patient,
       do: {:noreply, later({:"$gen_call", from, request}, state)}

  defp answer(:extension, from, %{life: %{phase: :starting}} = state),
    do: {:noreply, later({:"$gen_call", from, :extension}, state)}

  defp answer({:untap, id}, _from, state) do
    {state, events} = Dynamic.Tap.detach(state, id)
    reply(:ok, Performer.apply_all(state, events))
  end

  defp answer(request, from, %{life: %{phase: :running}} = state),
    do: running(request, from, state)

  defp answer(_request, _from, state), do: {:reply, {:error, Errors.not_running()}, state}

  defp running({:tap, asked}, from, state), do: dynamic(Dynamic.Tap.attach(state, asked, from))

  defp running({:attach, asked}, from, state),
    do: dynamic(Dynamic.Input.attach(state, asked, from))

  defp running({:detach, asked}, from, state),
    do: dynamic(Dynamic.Input.detach(state, asked, from))

  defp running(:extension, _from, state) do
    {graph, state} = Dynamic.Extension.offer(state)
    {:reply, {:ok, {state.handle, graph}}, state}
  end

  defp running({:extend, graph}, from, state) do
    case Dynamic.Extension.take(state, graph) do
      {:ok, state, plan} -> apply_event(state, {:grow, make_ref(), plan, from})
      {:error, error} -> {:reply, {:error, error}, state}
    end
  end

  defp running({:replace, asked}, from, state),
    do: {:noreply, Dynamic.Replacement.ask(state, asked, from)}

  defp running({:checkpoint, timeout}, from, state),
    do: {:noreply, Checkpointing.ask(state, timeout, from)}

  defp running({:subscription, which}, _from, state),
    do: {:reply, Dynamic.Tap.subscription(state, which), state}

  defp running({:stop_part, path, opts}, from, state) do
    case stop_part(path, opts, from, state) do
      {:ok, event} -> apply_event(state, event)
      {:error, error} -> {:reply, {:error, error}, state}
    end
  end

  # Without pacing no message waits for the clock, so the clock cannot be controlled.
  defp running({:clock, _change}, _from, %{timing: %{enforce: false}} = state),
    do: {:reply, {:error, Errors.unpaced()}, state}

  defp running({:clock, :pause}, _from, state),
    do: {:reply, Clock.pause(state.timing.clock), state}

  defp running({:clock, :resume}, _from, state),
    do: {:reply, Clock.resume(state.timing.clock), state}

  defp running({:clock, {:set_speed, speed}}, _from, state),
    do: {:reply, Clock.set_speed(state.timing.clock, speed), state}

  defp running(_request, _from, state), do: {:reply, {:error, Errors.unknown_request()}, state}

  defp stop_part(path, %{catch_up: catch_up, forget?: forget?}, from, state) do
    with {:ok, %{ids: ids, forget: forget}} <- State.part(state, path, forget?),
         do:
           {:ok, {:stop_part, make_ref(), ids, %{catch_up: catch_up, from: from, forget: forget}}}
  end

  defp later(message, state), do: %{state | early: [message | state.early]}
  defp dynamic({state, events}), do: done(Performer.apply_all(state, events))

  # Events

  defp event(:situ_launch, state), do: apply_event(state, :start)
  defp event({:situ_stage, id, event}, state), do: stage(event, id, state)
  defp event({:situ_event, event}, state), do: apply_event(state, event)
  defp event(:situ_stop, state), do: apply_event(state, {:stop, Lifecycle.catch_up_ms()})
  defp event({:situ_stop, time}, state), do: apply_event(state, {:stop_at, time})
  defp event(:situ_observe, state), do: {:noreply, Inspection.observe(state)}
  defp event(:situ_progress, state), do: {:noreply, Performer.progress(state)}
  defp event(:situ_moving, state), do: apply_event(state, :moving)

  defp event({:situ_stop_part, path, opts}, %{life: %{phase: :running}} = state) do
    case stop_part(path, opts, nil, state) do
      {:ok, event} -> apply_event(state, event)
      _ -> {:noreply, state}
    end
  end

  defp event({:situ_handled, event, result, graph}, state),
    do: state |> Performer.handled(event, result, graph) |> done()

  defp event({:situ_watch, which, mark}, state) do
    moved? = Stages.fingerprint(state, which) != mark
    idle = if(moved?, do: MapSet.new(), else: Stages.idle(state))
    seen = %{moved?: moved?, idle: idle, patient?: Stages.patient?(state)}
    apply_event(state, {:watched, which, seen})
  end

  # The module that built the pipeline has a new version, so another process builds it again to obtain its functions.
  # No stage can use them before the graph is planned; until then the message is deferred.
  defp event(:situ_reloaded, %{life: %{step: step}} = state) when step in [:build, :handlers],
    do: {:noreply, later(:situ_reloaded, state)}

  defp event(:situ_reloaded, %{settings: %{origin: {_, _} = origin}} = state) do
    Handlers.rebuild(origin, state.handle)
    {:noreply, state}
  end

  defp event({:situ_rebuilt, graph}, %{life: %{phase: phase}} = state)
       when phase in [:starting, :running] do
    state = %{state | graph: Handlers.reload(state.graph, graph)}
    {:noreply, state |> Dynamic.Guarantee.reload(graph) |> Dynamic.Replacement.reload(graph)}
  end

  defp event({:situ_checkpoint, ref}, state), do: {:noreply, Checkpointing.look(state, ref)}
  defp event({:situ_thaw, ref}, state), do: {:noreply, Checkpointing.thaw(state, ref)}

  defp event({:situ_late, ref, timeout}, state),
    do: {:noreply, Dynamic.Replacement.late(state, ref, timeout)}

  defp event({:EXIT, pid, reason}, state), do: state |> Performer.exited(pid, reason) |> done()

  defp event({:situ_clock, _}, state) do
    for {id, _} <- state.stages, do: Stages.tell(state, id, :clock)
    {:noreply, state}
  end

  defp event({:DOWN, owner, :process, _, _}, %{owner: owner} = state),
    do: apply_event(state, {:stop, Lifecycle.catch_up_ms()})

  defp event({:DOWN, ref, :process, _, _}, state),
    do: dynamic(Dynamic.Tap.owner_down(Checkpointing.thaw(state, ref), ref))

  defp event(_other, state), do: {:noreply, state}

  # A stage that was already dropped sent this message before it ended.
  defp stage(_event, id, %{stages: stages} = state) when not is_map_key(stages, id),
    do: {:noreply, state}

  defp stage(:started, id, %{dynamic: %{taps: taps}} = state) when is_map_key(taps, id),
    do: {:noreply, Dynamic.Tap.open(state, id)}

  defp stage(event, id, state) when event in [:up, :started, :source_stopped, :settled],
    do: apply_event(state, {event, id})

  defp stage({:completed, time}, id, state), do: apply_event(state, {:completed, id, time})

  defp stage({:unsubscribed, tag, _name, time}, id, state),
    do: apply_event(state, {:unsubscribed, id, tag, time})

  defp stage({:failed, error, reached}, id, state),
    do: apply_event(state, {:failed, id, Performer.explained(error, state), reached})

  defp stage({:init_failed, error}, id, state),
    do: state |> Performer.interrupted(id) |> apply_event({:init_failed, id, error})

  defp stage({:skipped, error}, _id, state), do: {:noreply, Performer.noted(state, error)}
  defp stage({:restarted, error}, id, state), do: apply_event(state, {:restarted, id, error})

  defp stage({:description, text}, id, state),
    do: {:noreply, Inspection.described(state, id, text)}

  defp stage({:tapped, tag}, _id, state), do: {:noreply, Dynamic.Tap.opened(state, tag)}

  defp stage({:lent, tag, how}, _id, %{dynamic: %{inputs: inputs}} = state)
       when is_map_key(inputs, tag),
       do: dynamic(Dynamic.Input.lent(state, tag, how))

  defp stage({:lent, tag, how}, _id, state), do: apply_event(state, {:lent, tag, how})

  defp stage({:answered, ref, answer, opts}, id, state),
    do: dynamic(Dynamic.Input.answered(state, ref, id, answer, opts))

  defp stage({:detached, input, opts}, id, state),
    do: dynamic(Dynamic.Input.detached(state, id, input, opts))

  defp stage({:remembered, ref, answer}, id, state),
    do: {:noreply, Checkpointing.remembered(state, id, ref, answer)}

  defp stage({:replaced, ref, answer}, id, state),
    do: {:noreply, Dynamic.Replacement.answered(state, id, ref, answer)}

  defp stage(:finalized, _id, state), do: {:noreply, state}

  # Results

  defp apply_event(state, event), do: state |> Performer.apply(event) |> done()

  defp reply(answer, state) do
    case done(state) do
      {:noreply, state} -> {:reply, answer, state}
      {:stop, reason, state} -> {:stop, reason, answer, state}
    end
  end

  defp done(%{view: %{outcome: nil}} = state), do: {:noreply, state}
  defp done(state), do: over(state.view.outcome, state)

  defp over(result, state) do
    Directory.leave(state.settings)
    publish(state.settings, result)
    Enum.each(state.waiters, &GenServer.reply(&1, result))
    for {_, %{from: from}} when from != nil <- state.life.parts, do: GenServer.reply(from, :ok)
    Dynamic.cancel(state.dynamic, {:error, Errors.not_running()})
    Handlers.quit(state.handlers)
    state = %{state | waiters: [], dynamic: %Dynamic{}, life: %{state.life | parts: %{}}}

    case {result, state.settings.mode} do
      {{:error, %{code: :abandoned}}, _} -> {:stop, {:shutdown, :abandoned}, state}
      {{:error, error}, :linked} -> fall(error)
      {{:error, %{code: :crashed}}, _} -> {:stop, {:shutdown, :crashed}, state}
      _ -> {:stop, :normal, state}
    end
  end

  # The exit is abnormal, so that a supervisor restarts the pipeline. It uses a signal, because the error is already in
  # the log.
  defp fall(error) do
    Process.flag(:trap_exit, false)
    Process.exit(self(), {:pipeline_failed, error.code, error.what})
  end

  defp publish(%{mode: :run, reply: {caller, reply}}, result), do: send(caller, {reply, result})
  defp publish(_settings, result), do: Results.put(self(), result)

  # A crash report names the pipeline but leaves out its graph, which would flood the log.
  @impl true
  def format_status(_reason, [_dictionary, state]) do
    summary = %{pipeline: state.settings.name, phase: state.life.phase, step: state.life.step}
    [data: [{~c"State", summary}]]
  end

  # The parent, a supervisor that shuts down, ends the pipeline: stop as if by hand, within the time that it allows.
  @impl true
  def terminate(_reason, %{life: %{phase: :completed}}), do: :ok

  def terminate(_reason, %{life: %{phase: :building}} = state),
    do: Handlers.abandoned(state.handle, nil)

  def terminate(_reason, state),
    do: state |> Performer.apply({:stop, Lifecycle.catch_up_ms()}) |> shut()

  defp shut(%{view: %{outcome: result}} = state) when result != nil do
    Directory.leave(state.settings)
    Results.put(self(), result)
    Enum.each(state.waiters, &GenServer.reply(&1, result))
  end

  defp shut(state) do
    receive do
      {:"$gen_call", from, request} when request == :await or elem(request, 0) == :stop ->
        shut(%{state | waiters: [from | state.waiters]})

      {:"$gen_call", from, _} ->
        GenServer.reply(from, {:error, Errors.not_running()})
        shut(state)

      message ->
        case handle_info(message, state) do
          {:noreply, state} -> shut(state)
          {:stop, _, _} -> :ok
        end
    end
  end
end
