defmodule Situ.Lifecycle.Startup do
  @moduledoc false
  # Starts a pipeline. Pure.
  #
  #   handlers  the `:run` handlers are called; they may still add components
  #   up        every stage has a process with its component's initial state
  #   sources   stages know their neighbours and `handle_start/2` has run in each
  #   running   messages flow
  alias Situ.Lifecycle.{Links, PartialStop, Shutdown, State}
  import Situ.Lifecycle.State

  @doc "Begins the start, after `build/2` has built the graph, by calling the `:run` handlers."
  @spec begin(State.t()) :: State.t()
  def begin(state), do: add_action(%{state | phase: :starting, step: :handlers}, {:handle, :run})

  @doc "Spawns the stages of the planned graph."
  @spec spawn_planned(State.t(), %{State.id() => map()}, %{term() => Links.link()}) :: State.t()
  def spawn_planned(state, members, links) do
    ids = members |> Map.keys() |> Enum.sort()
    awaited = for {id, %{source?: true}} <- members, into: MapSet.new(), do: id

    state = %{
      state
      | step: :up,
        stages: members,
        links: Links.new(links),
        pending: MapSet.new(ids),
        awaited: awaited
    }

    # An empty pipeline has nothing that would ever end it.
    if ids == [] and state.mode == :run,
      do: Shutdown.complete_pipeline(add_action(state, :start_clock)),
      else: add_action(state, {:spawn, ids})
  end

  @doc """
  Handles a stage that has its initial state. A stage that was restarted is wired immediately. If another stage failed
  before the clock started, this one is about to quit and is not started.
  """
  @spec mark_up(State.t(), State.id()) :: State.t()
  def mark_up(state, id),
    do: state |> update_member(id, &%{&1 | up?: true}) |> start_when_ready(id)

  defp start_when_ready(%{step: :up} = state, id), do: clear_pending(state, id)
  defp start_when_ready(%{step: step} = state, _id) when step in [:quit, :over], do: state
  defp start_when_ready(state, id), do: add_action(state, {:start, [id]})

  @doc "Handles a stage in which `handle_start/2` has run; a restarted stage is connected to its neighbours."
  @spec mark_started(State.t(), State.id()) :: State.t()
  def mark_started(%{step: :sources} = state, id) do
    state = clear_pending(state, id)
    if state.stages[id].again?, do: introduce_to_neighbours(state, id), else: state
  end

  def mark_started(state, id) do
    state |> introduce_to_neighbours(id) |> add_action({:run, [id]}) |> repeat_stop(id)
  end

  # The previous process was asked in vain, or this one was not asked because it had not started.
  defp repeat_stop(state, id) do
    PartialStop.repeat_stop(state, id) ||
      case state do
        %{step: :settle} -> send_to_stages(state, [id], :settle)
        %{phase: :stopping, ending: %{final: time}} -> send_to_stages(state, [id], {:stop, time})
        _ -> state
      end
  end

  defp introduce_to_neighbours(state, id) do
    state = add_action(state, {:rewire, id, list_neighbours(state, id)})

    state =
      Enum.reduce(Links.list_incoming(state.links, id), state, &replay_closing_mark(&1, &2, id))

    state = Enum.reduce(Links.list_outgoing(state.links, id), state, &cut_again/2)
    update_member(state, id, &%{&1 | again?: false})
  end

  # The stream of an open stage is closing only where it was cut off for a part that is being stopped.
  defp cut_again({tag, %{from: from}}, state) do
    case state.links.closing do
      %{^tag => time} -> send_to_stages(state, [from], {:cut, tag, time})
      _open -> state
    end
  end

  # If the previous process received the closing mark, the new one needs it again. A live producer sends it, after the
  # messages that the previous process had not handled.
  defp replay_closing_mark({tag, link}, state, id) do
    time = state.links.closing[tag]
    producer = state.stages[link.from]

    cond do
      time == nil or producer.again? -> state
      not producer.alive? -> send_to_stages(state, [id], {:peer_gone, tag, time})
      producer.open? -> cut_again({tag, link}, state)
      true -> state
    end
  end

  defp list_neighbours(state, id),
    do: Links.list_incoming(state.links, id) ++ Links.list_outgoing(state.links, id)

  @doc "Advances to the next step. Nothing may be pending in the current step."
  @spec advance_step(State.t()) :: State.t()
  def advance_step(%{step: :up} = state) do
    ids = MapSet.new(alive_ids(state))

    %{state | step: :sources, pending: ids}
    |> add_action(:start_clock)
    |> add_action({:start, MapSet.to_list(ids)})
  end

  def advance_step(%{step: :sources} = state) do
    ids = alive_ids(state)
    add_action(%{state | phase: :running, step: :running}, {:run, ids}) |> add_action(:running)
  end
end
