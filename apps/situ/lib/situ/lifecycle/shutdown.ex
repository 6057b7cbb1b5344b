defmodule Situ.Lifecycle.Shutdown do
  @moduledoc false
  # Ends a pipeline. Pure.
  #
  #   settle   after a manual stop, every source first handles the messages that were already posted to it
  #   stop     sources stop at the final time
  #   close    outputs close, upstream first; a cycle is cut once it has settled
  #   quit     stages end
  #   over     everything is final
  alias Situ.Lifecycle.{Closing, Links, State}
  import Situ.Lifecycle.State

  # A cycle counts as settled after this many polls without movement, even if messages still seem to be in flight.
  @still 100

  @doc "Ends a running pipeline, either now (`{:now, by_hand?}`) or at an originating time."
  @spec begin(State.t(), {Situ.Time.t() | :now, boolean()}, Situ.Time.t()) :: State.t()
  def begin(state, {:now, by_hand}, now) do
    state = update_ending(%{state | phase: :stopping}, by_hand: by_hand)

    if state.ending.catch_up == 0 or state.errors != [],
      do: stop_sources(start_watchdog(state), now),
      else: settle_sources(start_watchdog(state))
  end

  def begin(state, {time, by_hand}, _now),
    do:
      %{state | phase: :stopping}
      |> update_ending(by_hand: by_hand)
      |> start_watchdog()
      |> stop_sources(time)

  defp start_watchdog(state), do: add_action(state, {:watch, state.limits.stop_timeout, :all})

  defp settle_sources(state) do
    sources = running_sources(state)

    %{state | step: :settle, pending: MapSet.new(sources)}
    |> send_to_stages(sources, :settle)
    |> add_action({:after, state.ending.catch_up, :enough})
  end

  @doc "Stops the sources at `time`, or at the latest end that a source has reported, whichever is later."
  @spec stop_sources(State.t(), Situ.Time.t()) :: State.t()
  def stop_sources(state, time) do
    final = max(time, state.ending.latest || time)
    sources = running_sources(state)
    # Sources that belong to a part being stopped were already asked to stop.
    already_stopping = for {_, part} <- state.parts, id <- part.pending, do: id

    state = update_ending(state, final: final)

    state =
      if state.ending.by_hand and state.step != :settle,
        do: schedule_catch_up_end(state),
        else: state

    state = %{state | step: :stop, pending: MapSet.new(sources ++ already_stopping)}
    {complete, cut} = Enum.split_with(Map.keys(state.stages), complete_stage_filter(state))
    state = add_action(state, {:cut, cut, final})
    # Stages that wait for demand must not delay a manual stop.
    state = if state.ending.by_hand, do: add_action(state, {:release, complete}), else: state
    state = stop_started_sources(state, sources, final)
    if state.ending.enough?, do: send_to_stages(state, sources, :stop_now), else: state
  end

  @doc "Turns the end of a pipeline into a manual stop, which no longer waits for message times or for demand."
  @spec stop_by_hand(State.t()) :: State.t()
  def stop_by_hand(%{ending: %{by_hand: true}} = state), do: state

  # This counts as movement, which restarts the timeout of everything that was waiting.
  def stop_by_hand(state) do
    state
    |> update_ending(by_hand: true, moves: state.ending.moves + 1)
    |> schedule_catch_up_end()
    |> add_action({:release, alive_ids(state)})
  end

  defp schedule_catch_up_end(state),
    do: add_action(state, {:after, state.ending.catch_up, :enough})

  defp running_sources(state) do
    alone = for {_, part} <- state.parts, id <- part.ids, into: MapSet.new(), do: id

    for {id, %{source?: true, status: :running}} <- state.stages,
        not MapSet.member?(alone, id),
        do: id
  end

  # Messages later than the end have run ahead and do not count. If every source upstream has emitted all its messages,
  # nothing has run ahead, and messages that operators made later than their inputs (`merge`, by the clock) belong to
  # the result. Cutting only at the sources would not be reproducible: a fusion whose primary ran
  # ahead would emit more in one run than in the next. Components need not declare that they post
  # late.
  defp complete_stage_filter(state) do
    complete =
      Links.complete_stages(state.stages, Map.values(state.links.topology), state.ending.finite)

    &MapSet.member?(complete, &1)
  end

  @doc """
  Ends the catch-up time after a manual stop: sources that are still late end at their current position.
  """
  @spec end_catch_up(State.t(), Situ.Time.t()) :: State.t()
  def end_catch_up(%{ending: %{by_hand: false}} = state, _now), do: state

  def end_catch_up(%{step: :settle} = state, now),
    do: state |> update_ending(enough?: true) |> stop_sources(now)

  def end_catch_up(%{step: :stop} = state, _now),
    do:
      state
      |> update_ending(enough?: true)
      |> send_to_stages(MapSet.to_list(state.pending), :stop_now)

  def end_catch_up(state, _now), do: update_ending(state, enough?: true)

  @doc "Closes the stages without active inputs after the sources have stopped; the rest close as their inputs close."
  @spec close_unfed_stages(State.t()) :: State.t()
  def close_unfed_stages(state) do
    open = for {id, %{open?: true}} <- state.stages, do: id
    state = %{state | step: :close, pending: MapSet.new(open)}
    close_stages(state, open |> Enum.filter(&Links.no_inputs?(state.links, &1)) |> Enum.sort())
  end

  @doc """
  Closes the outputs of these stages, each at the closing time of its inputs. A source, or a stage cut out of a cycle,
  closes at the end.
  """
  @spec close_stages(State.t(), [State.id()]) :: State.t()
  def close_stages(state, ids), do: Enum.reduce(ids, state, &close_stage/2)

  defp close_stage(id, state) do
    time = closing_time(state.stages[id], state)
    state = state |> abandon_subscribers([id]) |> request_snapshot(id)
    state = add_action(state, {:tell, id, {:finalize, time}})

    state = %{
      state
      | links: Links.close_outputs(state.links, id, time),
        closed: [id | state.closed]
    }

    state = if state.step == :close, do: clear_pending(state, id), else: state
    set_status(state, [id], :closed)
  end

  # A part that is stopped with a checkpoint keeps the final states of its stages.
  defp request_snapshot(state, id) do
    if Enum.any?(state.parts, fn {_ref, part} -> part.checkpoint? and id in part.ids end),
      do: send_to_stages(state, [id], {:remember, {:stopped, :after}}),
      else: state
  end

  defp closing_time(member, state) do
    time = unlimited_closing_time(member, state)
    if member.limit, do: min(member.limit, time), else: time
  end

  defp unlimited_closing_time(%{source?: false, ends_at: time, id: id}, state)
       when is_integer(time) do
    if Links.no_inputs?(state.links, id), do: time, else: state.ending.final || time
  end

  defp unlimited_closing_time(member, state),
    do: state.ending.final || member.ends_at || member.limit || 0

  @doc "Handles a closed input of `id`; a stage whose inputs are all closed closes, too."
  @spec handle_closed_input(State.t(), State.id(), term(), Situ.Time.t()) :: State.t()
  def handle_closed_input(%{links: %{active: active}} = state, _id, tag, _time)
      when not is_map_key(active, tag),
      do: state

  def handle_closed_input(state, id, tag, time) do
    state = unwire_restarting(state, state.links.active[tag].from, tag)
    links = state.links |> Links.close_link(tag, time) |> Links.deactivate_link(tag)
    state = %{state | links: links}
    state = update_member(state, id, &%{&1 | ends_at: max(&1.ends_at || time, time)})
    member = state.stages[id]

    if member.open? and Links.no_inputs?(state.links, id) and
         (not member.source? or state.step == :close),
       do: close_stages(state, [id]),
       else: state
  end

  # A producer that is just restarting may have been wired with this connection.
  defp unwire_restarting(state, from, tag) do
    if state.stages[from].again?, do: send_to_stages(state, [from], {:untap, tag}), else: state
  end

  @doc "Advances when no stage closes by itself: ends the pipeline, waits, or checks whether a cycle has settled."
  @spec advance_close(State.t()) :: State.t()
  def advance_close(%{step: :close} = state) do
    open? = MapSet.size(state.pending) > 0

    cond do
      not open? and state.links.active == %{} ->
        quit_stages(state)

      not open? or state.links.closing != %{} or restarting?(state) ->
        state

      state.ending.drain == nil ->
        state |> update_ending(drain: {nil, 0}) |> add_action({:measure, :drain})

      true ->
        state
    end
  end

  @doc """
  Handles the measurement of an open cycle: whether no messages are in flight in it, a mark of its counters, and whether
  any stage is busy.
  """
  @spec handle_drain_measurement(State.t(), %{quiet?: boolean(), mark: term(), busy?: boolean()}) ::
          State.t()
  def handle_drain_measurement(%{step: :close, ending: %{drain: {mark, polls}}} = state, seen) do
    polls = if seen.mark == mark and not seen.busy?, do: polls + 1, else: 0
    open = MapSet.to_list(state.pending)

    cond do
      open == [] or state.links.closing != %{} or restarting?(state) ->
        update_ending(state, drain: nil)

      seen.quiet? or polls > @still or (state.ending.by_hand and state.ending.enough?) ->
        ids = Closing.break_cycle(Enum.sort(open), Map.values(state.links.active))
        state |> update_ending(drain: nil) |> close_stages(ids)

      true ->
        state
        |> update_ending(drain: {seen.mark, polls})
        |> add_action({:after, poll_interval(polls), :drain})
    end
  end

  def handle_drain_measurement(state, _seen), do: update_ending(state, drain: nil)

  defp restarting?(state), do: Enum.any?(state.pending, &state.stages[&1].again?)

  defp poll_interval(polls) when polls < 5, do: 1
  defp poll_interval(_polls), do: 10

  @doc "Ends the stages after everything has closed, or if nothing has begun."
  @spec quit_stages(State.t()) :: State.t()
  def quit_stages(state) do
    alive = alive_ids(state)
    state = if state.phase == :stopping, do: state, else: start_watchdog(state)
    state = abandon_subscribers(state, alive)

    send_to_stages(
      %{state | phase: :stopping, step: :quit, pending: MapSet.new(alive)},
      alive,
      :quit
    )
  end

  # Subscribers outside the pipeline are given the reason for its end.
  defp abandon_subscribers(state, ids) do
    if error = List.last(state.errors),
      do: send_to_stages(state, ids, {:abandon, error}),
      else: state
  end

  @doc "Completes the pipeline and calls the last handlers."
  @spec complete_pipeline(State.t()) :: State.t()
  def complete_pipeline(state),
    do: add_action(%{state | phase: :completed, step: :over}, {:handle, :completed})
end
