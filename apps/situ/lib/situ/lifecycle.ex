defmodule Situ.Lifecycle do
  @moduledoc false
  # The life cycle of a pipeline as a pure state machine: `apply(state, event, now)` returns the next state and the
  # actions. The server turns messages into events and performs the actions. Nothing here sends messages, reads a clock
  # or knows a process.
  # See docs/adr/0017-the-life-cycle-is-a-pure-state-machine.md.
  #
  #   building -> starting (handlers, up, sources) -> running -> stopping (settle, stop, close, quit) -> completed
  # | event | meaning |
  # |---|---|
  # | `:start` | the graph is built |
  # | `{:handled, :run, :ok or {:error, error}}`, `{:handled, :completed}` | the handlers have returned |
  # | `{:planned, members, links}`, `{:plan_failed, error}` | the graph was cut into stages, or planning failed |
  # | `{:up, id}`, `{:started, id}`, `{:settled, id}`, `{:source_stopped, id}` | a stage has taken the step |
  # | `{:completed, id, time or :infinity}` | a source knows its end, and holds its last messages until `:heard` |
  # | `{:unsubscribed, id, tag, time}` | a stage took the closing mark of an input |
  # | `{:failed, id, error, reached}`, `{:init_failed, id, error}` | a stage fails |
  # | `{:restarted, id, error}` | a component raised and restarted within its process |
  # | `{:exited, id, error, reached}` | a stage's process ended |
  # | `{:stop, catch_up}`, `{:stop_at, time}`, `{:stop_part, ref, ids, opts}` | the pipeline, or a part, is to stop |
  # | `{:accept, request, scope, from}` | a change to the running pipeline is requested: Lifecycle.Operations |
  # | `{:finished, id, reply}`, `{:answered, id, reply, writes}`, `{:expired, id, error}` | an operation has ended,
  # continues after a reply, or its caller waits no longer |
  # | `{:grow, ref, plan, from}`, `{:lent, tag, how}` | components are being added to the running pipeline |
  # | `{:start_part, ref, ids, how, from}`, `{:reset, ref, result}` | a stopped part is to start again |
  # | `{:joined, member}`, `{:linked, tag, link}`, `{:unlinked, tag}`, `{:left, id}` | the running graph changed |
  # | `{:measured, which, measurement}`, `{:watched, which, measurement}` | the results of `:measure` and `:watch` |
  # | `:enough`, `{:part_enough, ref}`, `:drain`, `{:forgive, id}`, `{:overdue, id}` | a timer has expired |
  # | action | the server ... |
  # |---|---|
  # | `{:handle, event}`, `{:handle, event, argument}` | calls the handlers of `Situ.Pipeline.on/3` |
  # | `:start_clock`, `:running`, `{:spawn, ids}`, `{:start, ids}`, `{:run, ids}` | performs the step of that name |
  # | `{:rewire, id, links}`, `{:shutdown, id}`, `{:kill, id}` | reconnects, shuts down or kills the stage |
  # | `{:tell, id, request}`, `{:lend, tag}` | sends a stage a request; asks a stage to add a subscriber |
  # | `{:reset, ref, ids, how}` | prepares stopped stages for a new start, then sends the event `:reset` |
  # | `{:forget, ids}` | takes removed stages out of the graph, which frees their names |
  # | `{:drop, id}`, `{:unwire, tag}` | drops a stage, or a connection, that the life cycle has deleted |
  # | `{:cut, ids, time}`, `{:release, ids}` | makes these stages ignore later messages, or lets them finish all
  # messages and end |
  # | `{:failed, error}`, `{:noted, error}`, `{:restarted, id, error}` | logs the error and calls the handlers |
  # | `{:perform, id, request, from}` | performs an operation, and sends the event `:finished` when it has ended |
  # | `{:reply, from, reply}` | replies to a caller, or ends the operation with this id |
  # | `{:after, ms, event}`, `{:watch, ms, which}`, `{:measure, which}` | sends the event, or its measurement, later |
  # | `{:event, event}` | applies the event after the actions before it |
  # | `:finished` | publishes the result and ends |
  alias Situ.Lifecycle.{
    Failure,
    Addition,
    Links,
    Member,
    Operations,
    PartialStop,
    Removal,
    Shutdown,
    StuckStages,
    Startup,
    State,
    RestartGroup
  }

  import Situ.Lifecycle.State

  @type event :: term()
  @type action :: term()

  @doc "Applies an event; returns the next state, and the actions in the order in which to perform them."
  @spec apply_event(State.t(), event(), Situ.Time.t()) :: {State.t(), [action()]}
  def apply_event(state, event, now) do
    state = state |> handle_event(event, now) |> advance_steps(now) |> confirm_end_time(event)
    state = state |> Addition.advance_stopped() |> Removal.drop_unconsumed()

    state =
      if state.phase in [:stopping, :completed],
        do: Operations.refuse_waiting(state, now),
        else: state

    {%{state | actions: []}, Enum.reverse(state.actions)}
  end

  # A source holds its last messages until its end is known. If it was the last source to end, the other stages begin
  # to ignore later messages now, before the held messages can cause any.
  defp confirm_end_time(state, {:completed, id, time}) when is_integer(time) do
    if match?(%{^id => %{alive?: true}}, state.stages),
      do: send_to_stages(state, [id], :heard),
      else: state
  end

  defp confirm_end_time(state, _event), do: state

  @doc "Returns the default time, in ms, for which sources may catch up after a manual stop."
  @spec default_catch_up_ms() :: pos_integer()
  def default_catch_up_ms, do: %Situ.Lifecycle.EndState{}.catch_up

  defp handle_event(%{phase: phase} = state, {:grow, _ref, _plan, from}, _now)
       when phase != :running,
       do: Addition.reject_request(state, from)

  defp handle_event(%{phase: phase} = state, {:start_part, _ref, _ids, _how, from}, _now)
       when phase != :running,
       do: Addition.reject_request(state, from)

  defp handle_event(state, {:accept, request, scope, from}, now),
    do: Operations.accept(state, request, scope, from, now)

  defp handle_event(state, {:finished, id, answer}, now),
    do: Operations.finish(state, id, answer, now)

  defp handle_event(state, {:answered, id, answer, writes}, _now),
    do: Operations.answer(state, id, answer, writes)

  defp handle_event(state, {:expired, id, error}, now),
    do: Operations.expire(state, id, error, now)

  defp handle_event(state, {:left, id}, _now), do: Removal.mark_leaving(state, id)

  # For a completed pipeline, only the results of its last handlers still matter.
  defp handle_event(%{phase: :completed} = state, {:handled, :completed}, _now),
    do: add_action(state, :finished)

  defp handle_event(%{phase: :completed} = state, {:handler_failed, error}, _now),
    do: record_error(state, error)

  defp handle_event(%{phase: :completed} = state, _event, _now), do: state

  defp handle_event(%{phase: :building} = state, :start, _now), do: Startup.begin(state)

  defp handle_event(%{phase: :building} = state, {stop, _}, _now) when stop in [:stop, :stop_at],
    do: state |> add_action(:abandoned) |> Shutdown.complete_pipeline()

  defp handle_event(%{phase: :building} = state, _event, _now), do: state

  defp handle_event(%{step: :handlers} = state, {:handled, :run, :ok}, _now),
    do: add_action(state, :plan)

  defp handle_event(%{step: :handlers} = state, {:handled, :run, {:error, error}}, _now),
    do: state |> add_error(error) |> Shutdown.complete_pipeline()

  defp handle_event(%{step: :handlers} = state, {:planned, members, links}, _now),
    do: Startup.spawn_planned(state, members, links)

  defp handle_event(state, {:plan_failed, error}, _now),
    do: state |> add_error(error) |> Shutdown.complete_pipeline()

  defp handle_event(state, {:handler_failed, error}, _now), do: record_error(state, error)

  defp handle_event(state, {:stop, catch_up}, _now),
    do: state |> update_ending(catch_up: catch_up) |> request_stop({:now, true})

  defp handle_event(state, {:stop_at, time}, _now), do: request_stop(state, {time, false})

  defp handle_event(%{phase: :running} = state, {:stop_part, ref, ids, opts}, now),
    do: PartialStop.begin(state, ref, ids, opts, now)

  defp handle_event(state, {:stop_part, _ref, _ids, %{from: from}}, _now),
    do: Addition.reject_request(state, from)

  defp handle_event(state, {:grow, ref, plan, from}, _now),
    do: Addition.begin(state, ref, plan, from)

  defp handle_event(state, {:start_part, ref, ids, how, from}, _now),
    do: Addition.begin_again(state, ref, ids, how, from)

  defp handle_event(state, {:reset, ref, result}, _now),
    do: Addition.handle_reset(state, ref, result)

  defp handle_event(state, {:lent, tag, how}, _now),
    do: Addition.handle_lent_stream(state, tag, how)

  defp handle_event(state, {:joined, %Member{id: id} = member}, _now),
    do: %{state | stages: Map.put(state.stages, id, member)}

  defp handle_event(state, {:linked, tag, link}, _now),
    do: %{state | links: Links.add(state.links, tag, link)}

  defp handle_event(state, {:unlinked, tag}, _now) do
    state = add_action(%{state | links: Links.forget_link(state.links, tag)}, {:unwire, tag})
    if state.step == :close, do: Shutdown.close_unfed_stages(state), else: state
  end

  defp handle_event(state, :enough, now), do: Shutdown.end_catch_up(state, now)

  defp handle_event(state, {:part_enough, ref}, _now),
    do: PartialStop.stop_sources_now(state, ref)

  defp handle_event(state, :drain, _now), do: add_action(state, {:measure, :drain})

  defp handle_event(state, {:measured, :drain, measurement}, _now),
    do: Shutdown.handle_drain_measurement(state, measurement)

  defp handle_event(state, {:watched, which, measurement}, _now),
    do: StuckStages.kill_stuck_stages(state, which, measurement)

  defp handle_event(state, :moving, _now), do: update_ending(state, moves: state.ending.moves + 1)
  defp handle_event(state, {:overdue, id}, _now), do: RestartGroup.kill_overdue(state, id)
  defp handle_event(state, {:forgive, id}, _now), do: Failure.forgive_restart(state, id)

  # An event of a stage that was already dropped matches only the last clause.
  defp handle_event(%{stages: stages} = state, event, now)
       when is_tuple(event) and is_map_key(stages, elem(event, 1)),
       do: handle_stage_event(event, state, now)

  defp handle_event(state, _event, _now), do: state

  # For a stage that was given up, only the end of its process still matters.
  defp handle_stage_event(event, state, _now)
       when elem(event, 0) != :exited and
              :erlang.map_get(:status, :erlang.map_get(elem(event, 1), state.stages)) == :dead,
       do: state

  # A part that is being added goes through the startup steps by itself; if it fails, the rest continues without it.
  defp handle_stage_event(event, %{growths: growths} = state, now)
       when growths != %{} and elem(event, 0) in [:up, :started, :init_failed, :failed, :exited] do
    case Addition.find_ref(state, elem(event, 1)) do
      nil -> apply_stage_event(event, state, now)
      ref -> Addition.handle_event(state, ref, event, now)
    end
  end

  defp handle_stage_event(event, state, now), do: apply_stage_event(event, state, now)

  defp apply_stage_event({:up, id}, state, _now), do: Startup.mark_up(state, id)
  defp apply_stage_event({:started, id}, state, _now), do: Startup.mark_started(state, id)

  defp apply_stage_event({:completed, id, time}, state, _now),
    do: complete_source(state, id, time)

  defp apply_stage_event({:settled, id}, %{step: :settle} = state, _now),
    do: clear_pending(state, id)

  defp apply_stage_event({:source_stopped, id}, state, _now) do
    state = mark_source_stopped(state, id)
    if state.step == :stop, do: clear_pending(state, id), else: state
  end

  defp apply_stage_event({:unsubscribed, id, tag, time}, state, _now),
    do: Shutdown.handle_closed_input(state, id, tag, time)

  defp apply_stage_event({:failed, id, error, reached}, state, now) do
    if RestartGroup.find_unit(state, id),
      do: RestartGroup.handle_failure(state, id, error, true, now),
      else: Failure.handle_stage_failure(state, id, error, reached)
  end

  defp apply_stage_event({:restarted, id, error}, state, _now),
    do: Failure.handle_component_restart(state, id, error)

  defp apply_stage_event({:init_failed, id, error}, state, now),
    do: Failure.handle_init_failure(state, id, error, now)

  defp apply_stage_event({:exited, id, _error, _reached} = event, state, now),
    do: event |> handle_process_exit(state, now) |> Addition.handle_lender_exit(id)

  defp apply_stage_event(_event, state, _now), do: state

  defp handle_process_exit({:exited, id, error, reached}, state, now) do
    cond do
      state.stages[id].status == :restarting ->
        if PartialStop.find_ref(state, id),
          do: Failure.close_dead_stage(state, id, now),
          else: RestartGroup.handle_exit(state, id, now)

      fails_with_unit?(state.stages[id]) and RestartGroup.find_unit(state, id) ->
        RestartGroup.handle_failure(state, id, error, false, now)

      true ->
        handle_unexpected_exit(state, id, error, reached, now)
    end
  end

  # A component with its own `on_error:` is restarted alone.
  defp fails_with_unit?(member), do: member.on_error == :stop

  defp handle_unexpected_exit(state, id, error, reached, now) do
    ref = state.phase == :running && PartialStop.find_ref(state, id)

    if ref && state.stages[id].status not in [:dead, :ended],
      do: PartialStop.handle_stage_death(state, ref, id, error, now),
      else: Failure.handle_stage_exit(state, id, error, reached, now)
  end

  defp record_error(state, error), do: %{state | errors: [error | state.errors]}

  # A component that hangs while it starts would block the stop, so the check for stuck stages starts now.
  defp request_stop(%{phase: :starting, ending: %{wish: nil}} = state, {time, by_hand}) do
    state |> request_end(time, by_hand) |> add_action({:watch, state.limits.stop_timeout, :all})
  end

  defp request_stop(%{phase: :running} = state, {time, by_hand}),
    do: request_end(state, time, by_hand)

  defp request_stop(%{phase: :stopping} = state, {_time, true}), do: Shutdown.stop_by_hand(state)
  defp request_stop(state, _wish), do: state

  # A source has announced its end; the remaining sources decide how long the pipeline runs.
  defp complete_source(state, id, time) do
    if MapSet.member?(state.awaited, id),
      do: record_end_time(%{state | awaited: MapSet.delete(state.awaited, id)}, id, time),
      else: state
  end

  defp record_end_time(state, _id, :infinity), do: state

  defp record_end_time(state, id, time) do
    state = add_action(state, {:handle, :component_completed, {state.stages[id].path, time}})
    ending = state.ending
    # The end of an added source must not end the components that were running before.
    latest = if state.stages[id].added?, do: ending.latest, else: max(ending.latest || time, time)
    update_ending(state, latest: latest, finite: MapSet.put(ending.finite, id))
  end

  # Advances step by step until a step has to wait for something.
  defp advance_steps(state, now) do
    case advance_once(state, now) do
      %{step: step} = next when step != state.step -> advance_steps(next, now)
      next -> next
    end
  end

  defp advance_once(%{step: :up, errors: [_ | _]} = state, _now), do: Shutdown.quit_stages(state)

  defp advance_once(%{step: step, pending: pending} = state, now)
       when step in [:up, :sources, :settle, :stop, :quit] do
    if MapSet.size(pending) == 0, do: finish_step(state, now), else: state
  end

  defp advance_once(%{step: :running} = state, now) do
    case PartialStop.advance_parts(state) do
      %{ending: %{wish: {_, _} = wish}} = state ->
        state |> Addition.abandon_all() |> Shutdown.begin(wish, now)

      state ->
        check_complete(state, now)
    end
  end

  defp advance_once(%{step: :close} = state, _now), do: Shutdown.advance_close(state)
  defp advance_once(state, _now), do: state

  defp finish_step(%{step: step} = state, _now) when step in [:up, :sources],
    do: Startup.advance_step(state)

  defp finish_step(%{step: :settle} = state, now), do: Shutdown.stop_sources(state, now)
  defp finish_step(%{step: :stop} = state, _now), do: Shutdown.close_unfed_stages(state)
  defp finish_step(%{step: :quit} = state, _now), do: Shutdown.complete_pipeline(state)

  # With only infinite sources, the pipeline runs until it is stopped.
  defp check_complete(%{ending: %{latest: time}} = state, now) when is_integer(time) do
    if MapSet.size(state.awaited) == 0,
      do: state |> Addition.abandon_all() |> Shutdown.begin({time, false}, now),
      else: state
  end

  defp check_complete(state, _now), do: state
end
