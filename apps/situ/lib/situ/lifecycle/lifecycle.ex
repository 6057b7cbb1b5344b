defmodule Situ.Lifecycle do
  @moduledoc false
  # The life cycle of a pipeline as a pure state machine: `apply(state, event, now)` returns the next state and the
  # actions. The server turns messages into events and performs the actions. Nothing here sends messages, reads a clock
  # or knows a process.
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
  # | `{:grow, ref, plan, from}`, `{:lent, tag, how}` | components are being added to the running pipeline |
  # | `{:joined, member}`, `{:linked, tag, link}`, `{:unlinked, tag}`, `{:left, id}` | the running graph changed |
  # | `{:measured, which, seen}`, `{:watched, which, seen}` | the results of `:measure` and `:watch` |
  # | `:enough`, `{:part_enough, ref}`, `:drain`, `{:forgive, id}`, `{:overdue, id}` | a timer has expired |
  # | action | the server ... |
  # |---|---|
  # | `{:handle, event}`, `{:handle, event, argument}` | calls the handlers of `Situ.Pipeline.on/3` |
  # | `:start_clock`, `:running`, `{:spawn, ids}`, `{:start, ids}`, `{:run, ids}` | performs the step of that name |
  # | `{:rewire, id, links}`, `{:shutdown, id}`, `{:kill, id}` | reconnects, shuts down or kills the stage |
  # | `{:tell, id, request}`, `{:lend, tag}` | sends a stage a request; asks a stage to add a subscriber |
  # | `{:forget, ids}` | takes removed stages out of the graph, which frees their names |
  # | `{:drop, id}`, `{:unwire, tag}` | drops a stage, or a connection, that the life cycle has deleted |
  # | `{:cut, ids, time}`, `{:release, ids}` | makes these stages ignore later messages, or lets them finish all
  # messages and end |
  # | `{:failed, error}`, `{:noted, error}`, `{:restarted, id, error}` | logs the error and calls the handlers |
  # | `{:reply, from, answer}` | replies to a caller |
  # | `{:after, ms, event}`, `{:watch, ms, which}`, `{:measure, which}` | sends the event, or its measurement, later |
  # | `{:event, event}` | applies the event after the actions before it |
  # | `:finished` | publishes the result and ends |
  alias Situ.Lifecycle.{
    Failure,
    Growth,
    Links,
    Member,
    PartialStop,
    Removal,
    Shutdown,
    Stall,
    Startup,
    State,
    Unit
  }

  import Situ.Lifecycle.State

  @type event :: term()
  @type action :: term()

  @doc "Applies an event; returns the next state, and the actions in the order in which to perform them."
  @spec apply(State.t(), event(), Situ.Time.t()) :: {State.t(), [action()]}
  def apply(state, event, now) do
    state = state |> event(event, now) |> go_on(now) |> heard(event)
    state = Removal.drop_left(state)
    {%{state | actions: []}, Enum.reverse(state.actions)}
  end

  # A source holds its last messages until its end is known. If it was the last source to end, the others start to
  # ignore later messages now, before these messages can lead to any.
  defp heard(state, {:completed, id, time}) when is_integer(time) do
    if match?(%{^id => %{alive?: true}}, state.stages),
      do: tell(state, [id], :heard),
      else: state
  end

  defp heard(state, _event), do: state

  @doc "Returns the default time, in ms, for which sources may catch up after a stop by hand."
  @spec catch_up_ms() :: pos_integer()
  def catch_up_ms, do: %Situ.Lifecycle.Ending{}.catch_up

  defp event(%{phase: phase} = state, {:grow, _ref, _plan, from}, _now) when phase != :running,
    do: Growth.refuse(state, from)

  defp event(state, {:left, id}, _now), do: Removal.leave(state, id)

  # Only the results of its last handlers still matter to a completed pipeline.
  defp event(%{phase: :completed} = state, {:handled, :completed}, _now),
    do: act(state, :finished)

  defp event(%{phase: :completed} = state, {:handler_failed, error}, _now), do: keep(state, error)
  defp event(%{phase: :completed} = state, _event, _now), do: state

  defp event(%{phase: :building} = state, :start, _now), do: Startup.begin(state)

  defp event(%{phase: :building} = state, {stop, _}, _now) when stop in [:stop, :stop_at],
    do: state |> act(:abandoned) |> Shutdown.complete()

  defp event(%{phase: :building} = state, _event, _now), do: state

  defp event(%{step: :handlers} = state, {:handled, :run, :ok}, _now), do: act(state, :plan)

  defp event(%{step: :handlers} = state, {:handled, :run, {:error, error}}, _now),
    do: state |> error(error) |> Shutdown.complete()

  defp event(%{step: :handlers} = state, {:planned, members, links}, _now),
    do: Startup.planned(state, members, links)

  defp event(state, {:plan_failed, error}, _now), do: state |> error(error) |> Shutdown.complete()
  defp event(state, {:handler_failed, error}, _now), do: keep(state, error)

  defp event(state, {:stop, catch_up}, _now),
    do: state |> ending(catch_up: catch_up) |> stop({:now, true})

  defp event(state, {:stop_at, time}, _now), do: stop(state, {time, false})

  defp event(%{phase: :running} = state, {:stop_part, ref, ids, opts}, now),
    do: PartialStop.begin(state, ref, ids, opts, now)

  defp event(state, {:grow, ref, plan, from}, _now),
    do: Growth.begin(state, ref, plan, from)

  defp event(state, {:lent, tag, how}, _now), do: Growth.lent(state, tag, how)

  defp event(state, {:joined, %Member{id: id} = member}, _now),
    do: %{state | stages: Map.put(state.stages, id, member)}

  defp event(state, {:linked, tag, link}, _now),
    do: %{state | links: Links.add(state.links, tag, link)}

  defp event(state, {:unlinked, tag}, _now) do
    state = act(%{state | links: Links.forget(state.links, tag)}, {:unwire, tag})
    if state.step == :close, do: Shutdown.close_free(state), else: state
  end

  defp event(state, :enough, now), do: Shutdown.enough(state, now)
  defp event(state, {:part_enough, ref}, _now), do: PartialStop.enough(state, ref)
  defp event(state, :drain, _now), do: act(state, {:measure, :drain})
  defp event(state, {:measured, :drain, seen}, _now), do: Shutdown.measured(state, seen)
  defp event(state, {:watched, which, seen}, _now), do: Stall.watched(state, which, seen)
  defp event(state, :moving, _now), do: ending(state, moves: state.ending.moves + 1)
  defp event(state, {:overdue, id}, _now), do: Unit.overdue(state, id)
  defp event(state, {:forgive, id}, _now), do: Failure.forgive(state, id)

  # An event of a stage that was already dropped matches only the last clause.
  defp event(%{stages: stages} = state, event, now)
       when is_tuple(event) and is_map_key(stages, elem(event, 1)),
       do: stage(event, state, now)

  defp event(state, _event, _now), do: state

  # For a stage that was given up, only the end of its process still matters.
  defp stage(event, state, _now)
       when elem(event, 0) != :exited and
              :erlang.map_get(:status, :erlang.map_get(elem(event, 1), state.stages)) == :dead,
       do: state

  # A part that is being added takes the steps of a start by itself; if it fails, the rest continues without it.
  defp stage(event, %{growths: growths} = state, now)
       when growths != %{} and elem(event, 0) in [:up, :started, :init_failed, :failed, :exited] do
    case Growth.of(state, elem(event, 1)) do
      nil -> known(event, state, now)
      ref -> Growth.event(state, ref, event, now)
    end
  end

  defp stage(event, state, now), do: known(event, state, now)

  defp known({:up, id}, state, _now), do: Startup.up(state, id)
  defp known({:started, id}, state, _now), do: Startup.started(state, id)
  defp known({:completed, id, time}, state, _now), do: completed(state, id, time)

  defp known({:settled, id}, %{step: :settle} = state, _now), do: answered(state, id)

  defp known({:source_stopped, id}, state, _now) do
    state = PartialStop.stopped(state, id)
    if state.step == :stop, do: answered(state, id), else: state
  end

  defp known({:unsubscribed, id, tag, time}, state, _now),
    do: Shutdown.input_closed(state, id, tag, time)

  defp known({:failed, id, error, reached}, state, now) do
    if Unit.of(state, id),
      do: Unit.failed(state, id, error, true, now),
      else: Failure.failed(state, id, error, reached)
  end

  defp known({:restarted, id, error}, state, _now), do: Failure.restarted(state, id, error)

  defp known({:init_failed, id, error}, state, now),
    do: Failure.init_failed(state, id, error, now)

  defp known({:exited, id, _error, _reached} = event, state, now),
    do: event |> ended(state, now) |> Growth.lender_ended(id)

  defp known(_event, state, _now), do: state

  defp ended({:exited, id, error, reached}, state, now) do
    cond do
      state.stages[id].status == :restarting ->
        Unit.exited(state, id, now)

      dies_for_itself?(state.stages[id]) and Unit.of(state, id) ->
        Unit.failed(state, id, error, false, now)

      true ->
        exited(state, id, error, reached, now)
    end
  end

  # A component with its own `on_error:` is restarted alone.
  defp dies_for_itself?(member), do: member.on_error == :stop

  defp exited(state, id, error, reached, now) do
    ref = state.phase == :running && PartialStop.of(state, id)

    if ref && state.stages[id].status not in [:dead, :ended],
      do: PartialStop.died(state, ref, id, error, now),
      else: Failure.exited(state, id, error, reached, now)
  end

  defp keep(state, error), do: %{state | errors: [error | state.errors]}

  # A component that hangs while it starts would block the stop, so the watchdog starts now.
  defp stop(%{phase: :starting, ending: %{wish: nil}} = state, {time, by_hand}) do
    state |> wish(time, by_hand) |> act({:watch, state.limits.stop_timeout, :all})
  end

  defp stop(%{phase: :running} = state, {time, by_hand}), do: wish(state, time, by_hand)
  defp stop(%{phase: :stopping} = state, {_time, true}), do: Shutdown.hurry(state)
  defp stop(state, _wish), do: state

  # A source has announced its end; the remaining sources decide how long the pipeline runs.
  defp completed(state, id, time) do
    if MapSet.member?(state.awaited, id),
      do: told(%{state | awaited: MapSet.delete(state.awaited, id)}, id, time),
      else: state
  end

  defp told(state, _id, :infinity), do: state

  defp told(state, id, time) do
    state = act(state, {:handle, :component_completed, {state.stages[id].path, time}})
    ending = state.ending
    # The end of an added source must not end the components that were running before.
    latest = if state.stages[id].added?, do: ending.latest, else: max(ending.latest || time, time)
    ending(state, latest: latest, finite: MapSet.put(ending.finite, id))
  end

  # Advances step by step until a step has to wait for something.
  defp go_on(state, now) do
    case next(state, now) do
      %{step: step} = next when step != state.step -> go_on(next, now)
      next -> next
    end
  end

  defp next(%{step: :up, errors: [_ | _]} = state, _now), do: Shutdown.quit(state)

  defp next(%{step: step, pending: pending} = state, now)
       when step in [:up, :sources, :settle, :stop, :quit] do
    if MapSet.size(pending) == 0, do: step_done(state, now), else: state
  end

  defp next(%{step: :running} = state, now) do
    case PartialStop.go_on(state) do
      %{ending: %{wish: {_, _} = wish}} = state ->
        state |> Growth.abandon() |> Shutdown.begin(wish, now)

      state ->
        check_complete(state, now)
    end
  end

  defp next(%{step: :close} = state, _now), do: Shutdown.go_on(state)
  defp next(state, _now), do: state

  defp step_done(%{step: step} = state, _now) when step in [:up, :sources],
    do: Startup.go_on(state)

  defp step_done(%{step: :settle} = state, now), do: Shutdown.stop(state, now)
  defp step_done(%{step: :stop} = state, _now), do: Shutdown.close_free(state)
  defp step_done(%{step: :quit} = state, _now), do: Shutdown.complete(state)

  # With only infinite sources, the pipeline runs until it is stopped.
  defp check_complete(%{ending: %{latest: time}} = state, now) when is_integer(time) do
    if MapSet.size(state.awaited) == 0,
      do: state |> Growth.abandon() |> Shutdown.begin({time, false}, now),
      else: state
  end

  defp check_complete(state, _now), do: state
end
