defmodule Situ.Pipeline.Lifecycle do
  @moduledoc false
  # The life of a pipeline as a pure state machine: `apply(state, event, now)` answers the next state and what is to be done.
  # The server turns messages into events and performs the actions; nothing here sends, reads a clock or knows a process.
  #
  #   building -> starting (handlers, up, sources) -> running -> stopping (settle, stop, close, quit) -> completed
  #
  # | event | who says so |
  # |---|---|
  # | `:start` | the graph is built |
  # | `{:handled, :run, :ok or {:error, error}}`, `{:handled, :completed}` | the handlers have returned |
  # | `{:planned, members, links}`, `{:plan_failed, error}` | the graph is cut into stages, or cannot be |
  # | `{:up, id}`, `{:started, id}`, `{:settled, id}`, `{:source_stopped, id}` | a stage has taken the step |
  # | `{:completed, id, time or :infinity}` | a source knows its end |
  # | `{:unsubscribed, id, tag, time}` | a stage took the closing mark of an input |
  # | `{:failed, id, error, reached}`, `{:init_failed, id, error}` | a stage fails |
  # | `{:exited, id, error, reached}` | a stage's process ended |
  # | `{:stop, catch_up}`, `{:stop_at, time}`, `{:stop_part, ref, ids, opts}` | somebody wants an end |
  # | `{:joined, member}`, `{:linked, tag, link}`, `{:unlinked, tag}`, `{:left, id}` | what changes while it runs |
  # | `{:measured, which, seen}`, `{:watched, which, seen}` | what was asked to be looked at |
  # | `:enough`, `{:part_enough, ref}`, `:drain`, `{:forgive, id}` | a time has passed |
  #
  # | action | what the server does |
  # |---|---|
  # | `{:handle, event}`, `{:handle, event, argument}` | calls the handlers of `Situ.Pipeline.on/3` |
  # | `:start_clock`, `:running`, `{:spawn, ids}`, `{:start, ids}`, `{:run, ids}`, `{:rewire, id, links}`, `{:kill, id}` | as they say |
  # | `{:tell, id, request}` | sends a stage a request |
  # | `{:cut, ids, time}`, `{:release, ids}` | later messages do not count in these stages; all do, but they end |
  # | `{:failed, error}`, `{:noted, error}`, `{:restarted, id, error}` | logs it and tells who listens |
  # | `{:reply, from, answer}` | answers a caller |
  # | `{:after, ms, event}`, `{:watch, ms, which}`, `{:measure, which}` | says it, or what it saw, later |
  # | `:finished` | publishes the result and ends |
  alias Situ.Pipeline.Lifecycle.{
    Failure,
    Links,
    Member,
    PartialStop,
    Shutdown,
    Stall,
    Startup,
    State
  }

  import Situ.Pipeline.Lifecycle.State

  @type event :: term()
  @type action :: term()

  @doc "The next state, and the actions in the order in which they are to be performed."
  @spec apply(State.t(), event(), Situ.Time.t()) :: {State.t(), [action()]}
  def apply(state, event, now) do
    state = state |> event(event, now) |> go_on(now)
    {%{state | actions: []}, Enum.reverse(state.actions)}
  end

  @doc "The wish of a caller to stop by hand, told how long sources may catch up."
  @spec catch_up_ms() :: pos_integer()
  def catch_up_ms, do: %Situ.Pipeline.Lifecycle.Ending{}.catch_up

  # Nothing happens to what is over, but that its last handlers return.
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

  defp event(state, {:joined, %Member{id: id} = member}, _now),
    do: %{state | stages: Map.put(state.stages, id, member)}

  defp event(state, {:linked, tag, link}, _now),
    do: %{state | links: Links.add(state.links, tag, link)}

  defp event(state, {:unlinked, tag}, _now) do
    state = %{state | links: Links.forget(state.links, tag)}
    if state.step == :close, do: Shutdown.close_free(state), else: state
  end

  defp event(state, {:left, id}, _now) do
    state = answered(%{state | stages: Map.delete(state.stages, id)}, id)
    %{state | awaited: MapSet.delete(state.awaited, id)}
  end

  defp event(state, :enough, now), do: Shutdown.enough(state, now)
  defp event(state, {:part_enough, ref}, _now), do: PartialStop.enough(state, ref)
  defp event(state, :drain, _now), do: act(state, {:measure, :drain})
  defp event(state, {:measured, :drain, seen}, _now), do: Shutdown.measured(state, seen)
  defp event(state, {:watched, which, seen}, _now), do: Stall.watched(state, which, seen)
  defp event(state, :moving, _now), do: ending(state, moves: state.ending.moves + 1)
  defp event(state, {:forgive, id}, _now), do: Failure.forgive(state, id)

  # The last words of a stage that is gone.
  defp event(%{stages: stages} = state, event, now)
       when is_tuple(event) and is_map_key(stages, elem(event, 1)),
       do: stage(event, state, now)

  defp event(state, _event, _now), do: state

  defp stage({:up, id}, state, _now), do: Startup.up(state, id)
  defp stage({:started, id}, state, _now), do: Startup.started(state, id)
  defp stage({:completed, id, time}, state, _now), do: completed(state, id, time)

  defp stage({:settled, id}, %{step: :settle} = state, _now), do: answered(state, id)

  defp stage({:source_stopped, id}, state, _now) do
    state = PartialStop.stopped(state, id)
    if state.step == :stop, do: answered(state, id), else: state
  end

  defp stage({:unsubscribed, id, tag, time}, state, _now),
    do: Shutdown.input_closed(state, id, tag, time)

  defp stage({:failed, id, error, reached}, state, _now),
    do: Failure.failed(state, id, error, reached)

  defp stage({:init_failed, id, error}, state, now),
    do: Failure.init_failed(state, id, error, now)

  defp stage({:exited, id, error, reached}, state, now) do
    ref = state.phase == :running && PartialStop.of(state, id)

    if ref && state.stages[id].status not in [:dead, :ended],
      do: PartialStop.died(state, ref, id, error, now),
      else: Failure.exited(state, id, error, reached, now)
  end

  defp stage(_event, state, _now), do: state

  defp keep(state, error), do: %{state | errors: [error | state.errors]}

  # What hangs in its start would keep the stop waiting.
  defp stop(%{phase: :starting, ending: %{wish: nil}} = state, {time, by_hand}) do
    state |> wish(time, by_hand) |> act({:watch, state.limits.stop_timeout, :all})
  end

  defp stop(%{phase: :running} = state, {time, by_hand}), do: wish(state, time, by_hand)
  defp stop(state, _wish), do: state

  # A source has told its end; those that have not decide how long the pipeline runs.
  defp completed(state, id, time) do
    if MapSet.member?(state.awaited, id),
      do: told(%{state | awaited: MapSet.delete(state.awaited, id)}, id, time),
      else: state
  end

  defp told(state, _id, :infinity), do: state

  defp told(state, id, time) do
    state = act(state, {:handle, :component_completed, {state.stages[id].path, time}})
    %{state | latest: max(state.latest || time, time), finite: MapSet.put(state.finite, id)}
  end

  # On to the next step, and the next, as long as nothing is waited for.
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
      %{ending: %{wish: {_, _} = wish}} = state -> Shutdown.begin(state, wish, now)
      state -> check_complete(state, now)
    end
  end

  defp next(%{step: :close} = state, _now), do: Shutdown.go_on(state)
  defp next(state, _now), do: state

  defp step_done(%{step: step} = state, _now) when step in [:up, :sources],
    do: Startup.go_on(state)

  defp step_done(%{step: :settle} = state, now), do: Shutdown.stop(state, now)
  defp step_done(%{step: :stop} = state, _now), do: Shutdown.close_free(state)
  defp step_done(%{step: :quit} = state, _now), do: Shutdown.complete(state)

  # With only infinite sources it runs until somebody stops it.
  defp check_complete(%{latest: time} = state, now) when is_integer(time) do
    if MapSet.size(state.awaited) == 0,
      do: Shutdown.begin(state, {time, false}, now),
      else: state
  end

  defp check_complete(state, _now), do: state
end
