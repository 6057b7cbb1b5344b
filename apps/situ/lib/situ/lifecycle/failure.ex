defmodule Situ.Lifecycle.Failure do
  @moduledoc false
  # Handles stages that fail or whose processes end early: the stage restarts or the pipeline ends. Pure.
  # The streams of a failed stage end at the time of the failure, and stages downstream emit nothing about later times.
  # A group without the failed stage's part, or with a default instead, would be made up.
  alias Situ.Error
  alias Situ.Lifecycle.{Links, Member, State}
  import Situ.Lifecycle.State

  @doc """
  Handles a stage that reports a failure and takes no more messages. `reached` is the time up to which its streams are
  complete, or `nil` if unknown.
  """
  @spec failed(State.t(), State.id(), Error.t(), Situ.Time.t() | nil) :: State.t()
  def failed(state, id, error, reached) do
    state = state |> mark([id], :failed) |> error(error) |> limit(id, reached)
    end_soon(%{state | awaited: MapSet.delete(state.awaited, id)})
  end

  @doc "Handles a component whose `init/1` failed."
  @spec init_failed(State.t(), State.id(), Error.t(), Situ.Time.t()) :: State.t()
  def init_failed(state, id, error, now),
    do: state |> gone(id, now) |> error(error) |> end_soon()

  defp end_soon(%{phase: phase} = state) when phase in [:starting, :running],
    do: state |> abandon() |> wish(:now, true)

  defp end_soon(state), do: state |> abandon() |> ending(by_hand: true)

  # External subscribers are notified immediately, so that an idle one cannot keep a failed pipeline from ending.
  defp abandon(state), do: tell(state, alive(state), {:abandon, List.last(state.errors)})

  @doc "Handles the end of a stage's process for `reason`, an error, which may be part of a shutdown."
  @spec exited(State.t(), State.id(), Error.t(), Situ.Time.t() | nil, Situ.Time.t()) :: State.t()
  def exited(state, id, reason, reached, now) do
    state = change(state, id, &%{&1 | alive?: false, up?: false})
    member = state.stages[id]

    cond do
      member.status in [:dead, :ended] ->
        answered(state, id)

      state.step == :quit ->
        answered(mark(state, [id], :dead), id)

      member.on_error != :stop and not member.open? ->
        state |> act({:noted, reason}) |> gone(id, now)

      member.on_error != :stop and restartable?(state) ->
        restart(state, member, reason, reached, now)

      true ->
        state |> limit(id, reached) |> gone(id, now) |> error(reason) |> end_soon()
    end
  end

  defp restartable?(%{phase: phase}), do: phase in [:starting, :running]

  defp restart(state, member, reason, reached, now) do
    case count(state, member.id) do
      {:ok, state} ->
        state = state |> act({:restarted, member.id, reason}) |> act({:spawn, [member.id]})
        state = change(state, member.id, &%{&1 | alive?: true, again?: true})
        # The other stages wait for it, because it has yet to take the step that they have taken.
        if state.step in [:up, :sources],
          do: %{state | pending: MapSet.put(state.pending, member.id)},
          else: state

      {:error, state} ->
        state
        |> limit(member.id, reached)
        |> gone(member.id, now)
        |> error(too_often(state.stages[member.id], state, reason))
        |> end_soon()
    end
  end

  @doc "Handles a component that raised and restarted in its process; too many restarts fail the stage."
  @spec restarted(State.t(), State.id(), Error.t()) :: State.t()
  def restarted(state, id, error) do
    state = act(state, {:noted, error})

    if restartable?(state) and state.stages[id].status == :running do
      case count(state, id) do
        {:ok, state} ->
          state

        {:error, state} ->
          tell(state, [id], {:fail, too_often(raised(state, id, error), state, error)})
      end
    else
      state
    end
  end

  # Within a chain, the error names the operator that raised.
  defp raised(state, id, error) do
    member = state.stages[id]
    %{member | path: error.meta[:component] || member.path}
  end

  @doc "Counts a restart; returns `:error` for too many within `max_seconds`, as a supervisor counts them."
  @spec count(State.t(), State.id()) :: {:ok | :error, State.t()}
  def count(state, id) do
    {most, ms} = state.limits.restarts
    state = change(state, id, &%{&1 | restarts: &1.restarts + 1})

    if state.stages[id].restarts > most,
      do: {:error, state},
      else: {:ok, act(state, {:after, ms, {:forgive, id}})}
  end

  @doc "Stops counting a restart that is older than `max_seconds`."
  @spec forgive(State.t(), State.id()) :: State.t()
  def forgive(state, id) do
    if is_map_key(state.stages, id),
      do: change(state, id, &%{&1 | restarts: max(&1.restarts - 1, 0)}),
      else: state
  end

  @doc "Marks a stage as dead and closes its links, so that its neighbours treat it as closed."
  @spec gone(State.t(), State.id(), Situ.Time.t()) :: State.t()
  def gone(state, id, now) do
    time = with nil <- state.stages[id].limit, do: now

    state =
      Enum.reduce(Links.out_of(state.links, id), state, fn {tag, link}, state ->
        if link.to == id, do: state, else: tell(state, [link.to], {:peer_gone, tag, time})
      end)

    state =
      Enum.reduce(Links.into(state.links, id), state, fn {tag, link}, state ->
        state =
          if link.from == id, do: state, else: tell(state, [link.from], {:peer_gone, tag, time})

        %{state | links: Links.drop(state.links, tag)}
      end)

    state = %{state | links: Links.close(state.links, id, time)}
    state = %{state | awaited: MapSet.delete(state.awaited, id)}
    state |> mark([id], :dead) |> change(id, &%{&1 | alive?: false}) |> answered(id)
  end

  # Limits the stage and everything downstream of it: messages later than the failure do not count.
  defp limit(state, _id, nil), do: state

  defp limit(state, id, reached) do
    ids = [id | MapSet.to_list(MapSet.delete(Links.downstream(state.links, id), id))]

    ids
    |> Enum.reduce(state, fn id, state -> change(state, id, &bound(&1, reached)) end)
    |> act({:cut, ids, reached})
    |> tell(ids, {:limit, reached})
  end

  defp bound(member, reached), do: %{member | limit: min(member.limit || reached, reached)}

  @doc "Builds the error of a component or composite that was restarted too often."
  @spec too_often(Member.t(), State.t(), Error.t()) :: Error.t()
  def too_often(%Member{path: path} = member, state, reason) do
    {most, ms} = state.limits.restarts

    Error.new(
      :restarted_too_often,
      "#{path} was restarted #{member.restarts - 1} times in #{ms} ms and failed again: #{reason.what}",
      why: "a component, or a composite, may be restarted #{most} times in #{ms} ms",
      fix: "fix the cause of the failure, or raise max_restarts: in the pipeline's settings",
      meta: Map.merge(reason.meta, %{component: path, last: reason})
    )
  end
end
