defmodule Situ.Lifecycle.PartialStop do
  @moduledoc false
  # Stops a composite or a single component while the rest of its pipeline keeps running. Its stages take the same steps
  # as at the end of a pipeline: their inputs from outside close and their sources stop at the time of the stop, their
  # outputs close in order, and they quit. Pure.
  #
  # A composite is only a name. As a separate pipeline it would need its own server, clock and
  # connectors, and killing its processes would skip their flush. Light operators are therefore
  # not chained across the border of a composite, which costs one hop: 0.15 us of CPU under load.
  alias Situ.Error
  alias Situ.Lifecycle.{Closing, Failure, Links, Shutdown, State}
  import Situ.Lifecycle.State

  @typedoc """
  A part that is being stopped. `ids` are its stages, and `pending` are its sources that have yet to stop. `error` is
  the first error during the stop. `forget` holds the stages to remove with it, including stages that ended before.
  With `checkpoint?`, its
  stages report snapshots with which they can start again.
  """
  @type t :: %{
          ids: MapSet.t(State.id()),
          pending: MapSet.t(State.id()),
          final: Situ.Time.t(),
          from: GenServer.from() | nil,
          forget: [State.id()],
          checkpoint?: boolean(),
          error: Error.t() | nil
        }

  @doc "Begins the stop; replies to `opts.from` when the whole part has closed."
  @spec begin(State.t(), reference(), [State.id()], map(), Situ.Time.t()) :: State.t()
  def begin(state, ref, ids, %{catch_up: catch_up, from: from} = opts, final) do
    ids = for id <- ids, is_map_key(state.stages, id), into: MapSet.new(), do: id
    state = state |> abandon_restart(ids, final) |> cut_stages(ids, final, opts)
    sources = for id <- ids, %{source?: true, alive?: true} <- [state.stages[id]], do: id

    state =
      for id <- ids,
          {tag, link} <- Links.list_incoming(state.links, id),
          not MapSet.member?(ids, link.from),
          reduce: state,
          do: (state -> close_link(state, tag, link, final))

    state =
      Enum.reduce(ids, state, fn id, state ->
        update_member(state, id, &limit_member(&1, final))
      end)

    state = if opts[:checkpoint?], do: request_snapshots(state, ids), else: state
    state = stop_started_sources(state, sources, final)

    forget = Map.get(opts, :forget, [])

    part = %{
      ids: ids,
      pending: MapSet.new(sources),
      final: final,
      from: from,
      forget: forget,
      checkpoint?: Map.get(opts, :checkpoint?, false),
      error: nil
    }

    %{
      state
      | parts: Map.put(state.parts, ref, part),
        awaited: MapSet.difference(state.awaited, ids)
    }
    |> add_action({:after, catch_up, {:part_enough, ref}})
    |> add_action({:watch, state.limits.stop_timeout, ref})
  end

  # A stage that is just restarting may miss the request or the messages; the producer is asked when it has started.
  defp close_link(state, tag, link, time) do
    again? = state.stages[link.from].again? or state.stages[link.to].again?
    state = if again?, do: state, else: send_to_stages(state, [link.from], {:cut, tag, time})
    %{state | links: Links.close_link(state.links, tag, time)}
  end

  # For a checkpoint, messages that sources post before they handle the request count: their state includes them.
  defp cut_stages(state, _ids, _final, %{checkpoint?: true}), do: state

  defp cut_stages(state, ids, final, _opts),
    do: add_action(state, {:cut, MapSet.to_list(ids), final})

  # Stages that were to restart with their composite no longer do; running stages end as they were asked to.
  defp abandon_restart(state, ids, time) do
    for id <- ids, %{status: :restarting, alive?: false} <- [state.stages[id]], reduce: state do
      state -> Failure.close_dead_stage(state, id, time)
    end
  end

  # A source that is asked to stop forgets its later timers and messages, so its position is the one before the stop.
  # Every stage reports its final state when it closes; a stage that has closed already does so now.
  defp request_snapshots(state, ids) do
    sources = for id <- ids, %{source?: true, again?: false} <- [state.stages[id]], do: id
    closed = for id <- ids, not state.stages[id].open?, do: id

    state
    |> request_source_snapshot(sources)
    |> send_to_stages(closed, {:remember, {:stopped, :after}})
  end

  defp request_source_snapshot(state, sources),
    do: send_to_stages(state, sources, {:remember, {:stopped, :before}})

  defp limit_member(member, time), do: %{member | limit: min(member.limit || time, time)}

  @doc "Returns the reference of the part that a stage is being stopped with."
  @spec find_ref(State.t(), State.id()) :: reference() | nil
  def find_ref(%{parts: parts}, _id) when parts == %{}, do: nil

  def find_ref(state, id),
    do: Enum.find_value(state.parts, fn {ref, part} -> id in part.ids && ref end)

  @doc "Repeats the requests to a source that has started again while its part is being stopped."
  @spec repeat_stop(State.t(), State.id()) :: State.t() | nil
  def repeat_stop(state, id) do
    with %{} = part <-
           Enum.find_value(state.parts, fn {_, part} -> id in part.pending && part end) do
      state = if part.checkpoint?, do: request_source_snapshot(state, [id]), else: state
      send_to_stages(state, [id], {:stop, part.final})
    end
  end

  @doc "Handles the death of a stage during the stop of its part; the other stages continue without it."
  @spec handle_stage_death(State.t(), reference(), State.id(), Error.t(), Situ.Time.t()) ::
          State.t()
  def handle_stage_death(state, ref, id, error, now) do
    state = state |> Failure.close_dead_stage(id, now) |> add_action({:noted, error})
    part = state.parts[ref]
    %{state | parts: %{state.parts | ref => %{part | error: part.error || error}}}
  end

  @doc "Ends sources that have not caught up with the clock at their current position."
  @spec stop_sources_now(State.t(), reference()) :: State.t()
  def stop_sources_now(state, ref) do
    case state.parts do
      %{^ref => part} -> send_to_stages(state, MapSet.to_list(part.pending), :stop_now)
      _ -> state
    end
  end

  @doc "Advances every part that no longer waits for anything."
  @spec advance_parts(State.t()) :: State.t()
  def advance_parts(%{parts: parts} = state) when parts == %{}, do: state

  def advance_parts(state) do
    Enum.reduce(Map.keys(state.parts), state, &advance_part/2)
  end

  defp advance_part(ref, state) do
    part = state.parts[ref]

    if MapSet.size(part.pending) > 0 do
      state
    else
      order = for id <- Enum.sort(part.ids), state.stages[id].open?, do: id
      active = for id <- part.ids, {_, link} <- Links.list_incoming(state.links, id), do: link

      case Closing.next_to_close(order, active) do
        {how, ids} when how in [:close, :break] ->
          advance_part(ref, Shutdown.close_stages(state, ids))

        :wait ->
          state

        :done ->
          quit_part(state, ref, part)
      end
    end
  end

  defp quit_part(state, ref, part) do
    ids = MapSet.to_list(part.ids)
    alive = Enum.filter(ids, &state.stages[&1].alive?)
    answer = if part.error, do: {:error, part.error}, else: :ok
    state = state |> send_to_stages(alive, :quit) |> add_action({:reply, part.from, answer})
    state = set_status(%{state | parts: Map.delete(state.parts, ref)}, ids, :ended)
    state = if part.forget == [], do: state, else: add_action(state, {:forget, part.forget})
    had? = Enum.any?(ids, &state.stages[&1].source?)
    left? = Enum.any?(state.stages, fn {_, m} -> m.source? and m.status == :running end)
    if had? and not left?, do: request_end(state, :now, true), else: state
  end
end
