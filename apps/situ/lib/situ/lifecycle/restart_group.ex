defmodule Situ.Lifecycle.RestartGroup do
  @moduledoc false
  # A composite with its own `on_error:`, so that the failure or death of a stage in it does not end the pipeline.
  # Either the whole composite restarts, or it ends and the rest keeps running. Pure.
  alias Situ.Error
  alias Situ.Lifecycle.{Failure, Operations, PartialStop, State}
  import Situ.Lifecycle.State

  # A stage that has not ended by itself after this many ms is killed.
  @overdue_ms 5_000

  @doc """
  Returns the composite of a stage that fails while the pipeline is running, and whether it restarts or closes; `nil` if
  the failure concerns the whole pipeline.
  """
  @spec find_unit(State.t(), State.id()) :: {String.t(), :restart | :close} | nil
  def find_unit(%{phase: :running} = state, id) do
    member = state.stages[id]
    if member.open? and PartialStop.find_ref(state, id) == nil, do: member.unit
  end

  def find_unit(_state, _id), do: nil

  @doc "Handles the failure of a stage; with `alive?: false` its process has ended, too."
  @spec handle_failure(State.t(), State.id(), Error.t(), boolean(), Situ.Time.t()) :: State.t()
  def handle_failure(state, id, error, alive?, now) do
    {path, how} = state.stages[id].unit

    state =
      state
      |> update_member(id, &%{&1 | alive?: alive?, up?: false})
      |> add_action({:noted, error})

    if how == :restart,
      do: restart_unit(state, path, error),
      else: close_unit(state, id, path, alive?, now)
  end

  # The sources of the composite end at their current position.
  defp close_unit(state, id, path, alive?, now) do
    state = set_status(state, [id], :failed)
    ids = for member <- open_members(state, path), member.alive?, do: member.id
    state = if alive?, do: state, else: Failure.close_dead_stage(state, id, now)
    scope = %{what: {:close, path}, reads: [:graph], writes: [{:path, path} | ids]}
    state = Operations.add_running(state, {:unit, path}, scope, now)
    opts = %{catch_up: 0, from: {:operation, {:unit, path}}}
    add_action(state, {:event, {:stop_part, {:unit, path}, ids, opts}})
  end

  defp open_members(state, path),
    do: for({_, %{unit: {^path, _}, open?: true} = member} <- state.stages, do: member)

  defp restart_unit(state, path, error) do
    members = open_members(state, path)

    if Enum.any?(members, &(&1.status == :restarting)) do
      respawn_when_ended(state, path)
    else
      leader = members |> Enum.map(& &1.id) |> Enum.min()

      case Failure.count_restart(state, leader) do
        {:ok, state} -> state |> end_members(members) |> respawn_when_ended(path)
        {:error, state} -> fail_too_often(state, leader, path, error)
      end
    end
  end

  defp end_members(state, members) do
    Enum.reduce(members, state, fn member, state ->
      state = update_member(state, member.id, &%{&1 | status: :restarting})

      if member.alive?,
        do:
          state
          |> add_action({:shutdown, member.id})
          |> add_action({:after, @overdue_ms, {:overdue, member.id}}),
        else: state
    end)
  end

  @doc "Handles the end of a stage that had to end for a restart."
  @spec handle_exit(State.t(), State.id(), Situ.Time.t()) :: State.t()
  def handle_exit(state, id, now) do
    {path, _} = state.stages[id].unit
    state = update_member(state, id, &%{&1 | alive?: false, up?: false})

    if state.phase == :running,
      do: respawn_when_ended(state, path),
      else: state |> Failure.close_dead_stage(id, now) |> close_ended(path, now)
  end

  # The pipeline ends, so stages that have ended for the restart do not start again.
  defp close_ended(state, path, now) do
    for %{id: id, status: :restarting, alive?: false} <- open_members(state, path),
        reduce: state,
        do: (state -> Failure.close_dead_stage(state, id, now))
  end

  # Spawns all stages together once the last process has ended.
  defp respawn_when_ended(state, path) do
    members = open_members(state, path)

    if Enum.any?(members, & &1.alive?) do
      state
    else
      ids = members |> Enum.map(& &1.id) |> Enum.sort()
      fresh = &%{&1 | status: :running, alive?: true, again?: true}

      ids
      |> Enum.reduce(state, fn id, state -> update_member(state, id, fresh) end)
      |> add_action({:spawn, ids})
    end
  end

  @doc "Kills a stage that should have ended by now."
  @spec kill_overdue(State.t(), State.id()) :: State.t()
  def kill_overdue(state, id) do
    case state.stages do
      %{^id => %{status: :restarting, alive?: true}} -> add_action(state, {:kill, id})
      _ -> state
    end
  end

  defp fail_too_often(state, leader, path, error) do
    state
    |> add_error(Failure.restart_limit_error(%{state.stages[leader] | path: path}, state, error))
    |> request_end(:now, true)
  end
end
