defmodule Situ.Lifecycle.Failure do
  @moduledoc false
  # Handles stages that fail or whose processes end early: the stage restarts or the pipeline ends. Pure.
  # The streams of a failed stage end at the time of the failure, and stages downstream emit nothing about later
  # times. Otherwise they would emit groups that lack the failed stage's part, or that contain a default in its place.
  alias Situ.Error
  alias Situ.Lifecycle.{Links, Member, State}
  import Situ.Lifecycle.State

  @doc """
  Handles a stage that reports a failure and takes no more messages. `reached` is the time up to which its streams are
  complete, or `nil` if unknown.
  """
  @spec handle_stage_failure(State.t(), State.id(), Error.t(), Situ.Time.t() | nil) :: State.t()
  def handle_stage_failure(state, id, error, reached) do
    state =
      state |> set_status([id], :failed) |> add_error(error) |> limit_downstream(id, reached)

    end_soon(%{state | awaited: MapSet.delete(state.awaited, id)})
  end

  @doc "Handles a component whose `init/1` failed."
  @spec handle_init_failure(State.t(), State.id(), Error.t(), Situ.Time.t()) :: State.t()
  def handle_init_failure(state, id, error, now),
    do: state |> close_dead_stage(id, now) |> add_error(error) |> end_soon()

  defp end_soon(%{phase: phase} = state) when phase in [:starting, :running],
    do: state |> abandon_subscribers() |> request_end(:now, true)

  defp end_soon(state), do: state |> abandon_subscribers() |> update_ending(by_hand: true)

  # External subscribers are notified immediately, so that an idle one cannot keep a failed pipeline from ending.
  defp abandon_subscribers(state),
    do: send_to_stages(state, alive_ids(state), {:abandon, List.last(state.errors)})

  @doc "Handles the end of a stage's process for `reason`, an error, which may be part of a shutdown."
  @spec handle_stage_exit(State.t(), State.id(), Error.t(), Situ.Time.t() | nil, Situ.Time.t()) ::
          State.t()
  def handle_stage_exit(state, id, reason, reached, now) do
    state = update_member(state, id, &%{&1 | alive?: false, up?: false})
    member = state.stages[id]

    cond do
      member.status in [:dead, :ended] ->
        state |> clear_pending(id) |> repeat_closing_marks(id)

      state.step == :quit ->
        clear_pending(set_status(state, [id], :dead), id)

      member.on_error != :stop and restart_allowed?(state, member) ->
        restart_stage(state, member, reason, reached, now)

      member.on_error != :stop and not member.open? ->
        state |> add_action({:noted, reason}) |> close_dead_stage(id, now)

      true ->
        state
        |> limit_downstream(id, reached)
        |> close_dead_stage(id, now)
        |> add_error(reason)
        |> end_soon()
    end
  end

  # A consumer that was restarted in the meantime may wait for the mark of this process.
  defp repeat_closing_marks(state, id) do
    Enum.reduce(Links.list_outgoing(state.links, id), state, fn {tag, link}, state ->
      case state.links.closing do
        %{^tag => time} -> send_to_stages(state, [link.to], {:peer_gone, tag, time})
        _open -> state
      end
    end)
  end

  # While the pipeline drains, messages may still wait in a stage whose inputs have closed. A stage that was stuck, or
  # part of a pipeline that has failed, ends.
  defp restart_allowed?(%{phase: :stopping} = state, member) do
    unsent? = Links.list_outgoing(state.links, member.id) != []
    state.errors == [] and not member.tap? and (member.open? or unsent?)
  end

  defp restart_allowed?(%{phase: phase}, member),
    do: phase in [:starting, :running] and member.open?

  defp restart_stage(state, member, reason, reached, now) do
    case count_restart(state, member.id) do
      {:ok, state} ->
        state =
          state
          |> add_action({:restarted, member.id, reason})
          |> add_action({:spawn, [member.id]})

        state |> reopen_stage(member) |> await_restart(member)

      {:error, state} ->
        state
        |> limit_downstream(member.id, reached)
        |> close_dead_stage(member.id, now)
        |> add_error(restart_limit_error(state.stages[member.id], state, reason))
        |> end_soon()
    end
  end

  defp reopen_stage(state, %{id: id, open?: open?}) do
    status = &if(&1 == :closed, do: :running, else: &1)
    links = Links.reopen_inputs(state.links, id)
    # A closing output of an open stage was cut off for a part that is being stopped.
    links = if open?, do: links, else: Links.reopen_outputs(links, id)

    %{state | links: links, closed: List.delete(state.closed, id)}
    |> update_member(
      id,
      &%{&1 | alive?: true, again?: true, open?: true, status: status.(&1.status)}
    )
  end

  # The other stages wait until it has completed the step that they have already completed. A source stops again.
  defp await_restart(%{step: :close} = state, %{source?: true, id: id}),
    do: %{state | step: :stop, pending: MapSet.new([id])}

  defp await_restart(%{step: step} = state, %{source?: source?, id: id})
       when step in [:up, :sources, :close] or (source? and step in [:settle, :stop]),
       do: %{state | pending: MapSet.put(state.pending, id)}

  defp await_restart(state, _member), do: state

  @doc "Handles a component that raised and restarted in its process; too many restarts fail the stage."
  @spec handle_component_restart(State.t(), State.id(), Error.t()) :: State.t()
  def handle_component_restart(state, id, error) do
    state = add_action(state, {:noted, error})

    if state.phase in [:starting, :running] and state.stages[id].status == :running do
      case count_restart(state, id) do
        {:ok, state} ->
          state

        {:error, state} ->
          send_to_stages(
            state,
            [id],
            {:fail, restart_limit_error(put_component_path(state, id, error), state, error)}
          )
      end
    else
      state
    end
  end

  # Within a chain, the error names the operator that raised.
  defp put_component_path(state, id, error) do
    member = state.stages[id]
    %{member | path: error.meta[:component] || member.path}
  end

  @doc "Counts a restart; returns `:error` if there were too many within `max_seconds`, by the rule of supervisors."
  @spec count_restart(State.t(), State.id()) :: {:ok | :error, State.t()}
  def count_restart(state, id) do
    {most, ms} = state.limits.restarts
    state = update_member(state, id, &%{&1 | restarts: &1.restarts + 1})

    if state.stages[id].restarts > most,
      do: {:error, state},
      else: {:ok, add_action(state, {:after, ms, {:forgive, id}})}
  end

  @doc "Stops counting a restart that is older than `max_seconds`."
  @spec forgive_restart(State.t(), State.id()) :: State.t()
  def forgive_restart(state, id) do
    if is_map_key(state.stages, id),
      do: update_member(state, id, &%{&1 | restarts: max(&1.restarts - 1, 0)}),
      else: state
  end

  @doc "Marks a stage as dead and closes its links, so that its neighbours treat it as closed."
  @spec close_dead_stage(State.t(), State.id(), Situ.Time.t()) :: State.t()
  def close_dead_stage(state, id, now) do
    time = with nil <- state.stages[id].limit, do: now

    state =
      Enum.reduce(Links.list_outgoing(state.links, id), state, fn {tag, link}, state ->
        if link.to == id,
          do: state,
          else: send_to_stages(state, [link.to], {:peer_gone, tag, time})
      end)

    state =
      Enum.reduce(Links.list_incoming(state.links, id), state, fn {tag, link}, state ->
        state =
          if link.from == id,
            do: state,
            else: send_to_stages(state, [link.from], {:peer_gone, tag, time})

        %{state | links: Links.deactivate_link(state.links, tag)}
      end)

    state = %{state | links: Links.close_outputs(state.links, id, time)}
    state = %{state | awaited: MapSet.delete(state.awaited, id)}

    state
    |> set_status([id], :dead)
    |> update_member(id, &%{&1 | alive?: false, again?: false})
    |> clear_pending(id)
    |> mark_source_stopped(id)
  end

  # Limits the stage and everything downstream of it: messages later than the failure do not count.
  defp limit_downstream(state, _id, nil), do: state

  defp limit_downstream(state, id, reached) do
    ids = [id | MapSet.to_list(MapSet.delete(Links.downstream_ids(state.links, id), id))]

    ids
    |> Enum.reduce(state, fn id, state -> update_member(state, id, &limit_member(&1, reached)) end)
    |> add_action({:cut, ids, reached})
    |> send_to_stages(ids, {:limit, reached})
  end

  defp limit_member(member, reached), do: %{member | limit: min(member.limit || reached, reached)}

  @doc "Builds the error of a component or composite that was restarted too often."
  @spec restart_limit_error(Member.t(), State.t(), Error.t()) :: Error.t()
  def restart_limit_error(%Member{path: path} = member, state, reason) do
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
