defmodule Situ.Lifecycle.Unit do
  @moduledoc false
  # A composite with its own `on_error:`, so that the failure or death of one of its stages does not end the pipeline.
  # Either the whole composite restarts, or it ends and the rest keeps running. Pure.
  alias Situ.Error
  alias Situ.Lifecycle.{Failure, PartialStop, State}
  import Situ.Lifecycle.State

  # A stage that has not ended by itself after this many ms is killed.
  @overdue_ms 5_000

  @doc """
  Returns the composite of a stage that fails while the pipeline is running, and whether it restarts or closes; `nil` if
  the failure concerns the whole pipeline.
  """
  @spec of(State.t(), State.id()) :: {String.t(), :restart | :close} | nil
  def of(%{phase: :running} = state, id) do
    member = state.stages[id]
    if member.open? and PartialStop.of(state, id) == nil, do: member.unit
  end

  def of(_state, _id), do: nil

  @doc "Handles the failure of a stage; with `alive?: false` its process has ended, too."
  @spec failed(State.t(), State.id(), Error.t(), boolean(), Situ.Time.t()) :: State.t()
  def failed(state, id, error, alive?, now) do
    {path, how} = state.stages[id].unit
    state = state |> change(id, &%{&1 | alive?: alive?, up?: false}) |> act({:noted, error})
    if how == :restart, do: restart(state, path, error), else: close(state, id, path, alive?, now)
  end

  # The sources of the composite end at their current position.
  defp close(state, id, path, alive?, now) do
    state = mark(state, [id], :failed)
    ids = for member <- members(state, path), member.alive?, do: member.id
    state = if alive?, do: state, else: Failure.gone(state, id, now)
    opts = %{catch_up: 0, from: nil}
    act(state, {:event, {:stop_part, {:unit, path}, ids, opts}})
  end

  defp members(state, path),
    do: for({_, %{unit: {^path, _}, open?: true} = member} <- state.stages, do: member)

  defp restart(state, path, error) do
    members = members(state, path)

    if Enum.any?(members, &(&1.status == :restarting)) do
      respawn(state, path)
    else
      leader = members |> Enum.map(& &1.id) |> Enum.min()

      case Failure.count(state, leader) do
        {:ok, state} -> state |> end_all(members) |> respawn(path)
        {:error, state} -> too_often(state, leader, path, error)
      end
    end
  end

  defp end_all(state, members) do
    Enum.reduce(members, state, fn member, state ->
      state = change(state, member.id, &%{&1 | status: :restarting})

      if member.alive?,
        do:
          state
          |> act({:shutdown, member.id})
          |> act({:after, @overdue_ms, {:overdue, member.id}}),
        else: state
    end)
  end

  @doc "Handles the end of a stage that had to end for a restart."
  @spec exited(State.t(), State.id(), Situ.Time.t()) :: State.t()
  def exited(state, id, now) do
    {path, _} = state.stages[id].unit
    state = change(state, id, &%{&1 | alive?: false, up?: false})
    if state.phase == :running, do: respawn(state, path), else: Failure.gone(state, id, now)
  end

  # Spawns all stages together once the last process has ended.
  defp respawn(state, path) do
    members = members(state, path)

    if Enum.any?(members, & &1.alive?) do
      state
    else
      ids = members |> Enum.map(& &1.id) |> Enum.sort()
      fresh = &%{&1 | status: :running, alive?: true, again?: true}

      ids
      |> Enum.reduce(state, fn id, state -> change(state, id, fresh) end)
      |> act({:spawn, ids})
    end
  end

  @doc "Kills a stage that should have ended by now."
  @spec overdue(State.t(), State.id()) :: State.t()
  def overdue(state, id) do
    case state.stages do
      %{^id => %{status: :restarting, alive?: true}} -> act(state, {:kill, id})
      _ -> state
    end
  end

  defp too_often(state, leader, path, error) do
    state
    |> error(Failure.too_often(%{state.stages[leader] | path: path}, state, error))
    |> wish(:now, true)
  end
end
