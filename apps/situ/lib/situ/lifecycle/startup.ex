defmodule Situ.Lifecycle.Startup do
  @moduledoc false
  # Starts a pipeline. Pure.
  #
  #   handlers  the `:run` handlers are called; they may still add components
  #   up        every stage has a process with its component's initial state
  #   sources   stages know their neighbours and `handle_start/2` has run in each
  #   running   messages flow
  alias Situ.Lifecycle.{Links, Shutdown, State}
  import Situ.Lifecycle.State

  @doc "Begins the start, after `build/2` has built the graph, by calling the `:run` handlers."
  @spec begin(State.t()) :: State.t()
  def begin(state), do: act(%{state | phase: :starting, step: :handlers}, {:handle, :run})

  @doc "Spawns the stages of the planned graph."
  @spec planned(State.t(), %{State.id() => map()}, %{term() => Links.link()}) :: State.t()
  def planned(state, members, links) do
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
      do: Shutdown.complete(act(state, :start_clock)),
      else: act(state, {:spawn, ids})
  end

  @doc """
  Handles a stage that has its initial state. A stage that was restarted is wired immediately. If another stage failed
  before the clock started, this one is about to quit and is not started.
  """
  @spec up(State.t(), State.id()) :: State.t()
  def up(state, id), do: state |> change(id, &%{&1 | up?: true}) |> wire(id)

  defp wire(%{step: :up} = state, id), do: answered(state, id)
  defp wire(%{step: step} = state, _id) when step in [:quit, :over], do: state
  defp wire(state, id), do: act(state, {:start, [id]})

  @doc "Handles a stage in which `handle_start/2` has run; a restarted stage is connected to its neighbours."
  @spec started(State.t(), State.id()) :: State.t()
  def started(%{step: :sources} = state, id) do
    state = answered(state, id)
    if state.stages[id].again?, do: known(state, id), else: state
  end

  def started(state, id) do
    state = state |> known(id) |> act({:run, [id]})

    if state.ending.final != nil and state.phase == :stopping,
      do: tell(state, [id], {:stop, state.ending.final}),
      else: state
  end

  defp known(state, id) do
    state = act(state, {:rewire, id, neighbours(state, id)})
    state = Enum.reduce(Links.into(state.links, id), state, &closed(&1, &2, id))
    change(state, id, &%{&1 | again?: false})
  end

  # The previous process received the closing mark, so the new one needs it again.
  defp closed({tag, _link}, state, id) do
    case state.links.closing do
      %{^tag => time} -> tell(state, [id], {:peer_gone, tag, time})
      _ -> state
    end
  end

  defp neighbours(state, id),
    do: Links.into(state.links, id) ++ Links.out_of(state.links, id)

  @doc "Advances to the next step; nothing is pending in the current one."
  @spec go_on(State.t()) :: State.t()
  def go_on(%{step: :up} = state) do
    ids = MapSet.new(alive(state))

    %{state | step: :sources, pending: ids}
    |> act(:start_clock)
    |> act({:start, MapSet.to_list(ids)})
  end

  def go_on(%{step: :sources} = state) do
    ids = alive(state)
    act(%{state | phase: :running, step: :running}, {:run, ids}) |> act(:running)
  end
end
