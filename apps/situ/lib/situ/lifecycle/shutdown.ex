defmodule Situ.Lifecycle.Shutdown do
  @moduledoc false
  # Ends a pipeline. Pure.
  #
  #   settle   after a stop by hand, every source first handles the messages that were already posted to it
  #   stop     sources stop at the final time
  #   close    outputs close, upstream first; a cycle is cut once it has come to rest
  #   quit     stages end
  #   over     everything is final
  alias Situ.Lifecycle.{Closing, Links, State}
  import Situ.Lifecycle.State

  # A cycle counts as at rest after this many polls without movement, even if messages still seem to be in flight.
  @still 100

  @doc "Ends a running pipeline, either now (`{:now, by_hand?}`) or at an originating time."
  @spec begin(State.t(), {Situ.Time.t() | :now, boolean()}, Situ.Time.t()) :: State.t()
  def begin(state, {:now, by_hand}, now) do
    state = ending(%{state | phase: :stopping}, by_hand: by_hand)

    if state.ending.catch_up == 0 or state.errors != [],
      do: stop(watch(state), now),
      else: settle(watch(state))
  end

  def begin(state, {time, by_hand}, _now),
    do: %{state | phase: :stopping} |> ending(by_hand: by_hand) |> watch() |> stop(time)

  defp watch(state), do: act(state, {:watch, state.limits.stop_timeout, :all})

  defp settle(state) do
    sources = running_sources(state)

    %{state | step: :settle, pending: MapSet.new(sources)}
    |> tell(sources, :settle)
    |> act({:after, state.ending.catch_up, :enough})
  end

  @doc "Stops the sources at `time`, or at the latest end that a source has reported, whichever is later."
  @spec stop(State.t(), Situ.Time.t()) :: State.t()
  def stop(state, time) do
    final = max(time, state.ending.latest || time)
    sources = running_sources(state)
    # Sources that belong to a part being stopped were asked before.
    asked = for {_, part} <- state.parts, id <- part.pending, do: id

    state = ending(state, final: final)
    state = if state.ending.by_hand and state.step != :settle, do: catch_up(state), else: state
    state = %{state | step: :stop, pending: MapSet.new(sources ++ asked)}
    {whole, cut} = Enum.split_with(Map.keys(state.stages), whole(state))
    state = act(state, {:cut, cut, final})
    # Stages that wait for demand must not delay a stop by hand.
    state = if state.ending.by_hand, do: act(state, {:release, whole}), else: state
    state = tell(state, sources, {:stop, final})
    if state.ending.enough?, do: tell(state, sources, :stop_now), else: state
  end

  @doc "Turns the end of a pipeline into a stop by hand, which no longer waits for message times or for demand."
  @spec hurry(State.t()) :: State.t()
  def hurry(%{ending: %{by_hand: true}} = state), do: state

  # This counts as a move, which restarts the timeout of everything that was waiting.
  def hurry(state) do
    state
    |> ending(by_hand: true, moves: state.ending.moves + 1)
    |> catch_up()
    |> act({:release, alive(state)})
  end

  defp catch_up(state), do: act(state, {:after, state.ending.catch_up, :enough})

  defp running_sources(state) do
    alone = for {_, part} <- state.parts, id <- part.ids, into: MapSet.new(), do: id

    for {id, %{source?: true, status: :running}} <- state.stages,
        not MapSet.member?(alone, id),
        do: id
  end

  # Messages later than the end have run ahead and do not count. If every source upstream has emitted all its messages,
  # nothing has run ahead, and messages that operators made later than their inputs (`merge`, by the clock) belong to
  # the result.
  defp whole(state) do
    whole = Links.whole(state.stages, Map.values(state.links.topology), state.ending.finite)
    &MapSet.member?(whole, &1)
  end

  @doc """
  Ends the catch-up time after a stop by hand: sources that are still late end at their current position.
  """
  @spec enough(State.t(), Situ.Time.t()) :: State.t()
  def enough(%{ending: %{by_hand: false}} = state, _now), do: state
  def enough(%{step: :settle} = state, now), do: state |> ending(enough?: true) |> stop(now)

  def enough(%{step: :stop} = state, _now),
    do: state |> ending(enough?: true) |> tell(MapSet.to_list(state.pending), :stop_now)

  def enough(state, _now), do: ending(state, enough?: true)

  @doc "Closes the stages without active inputs after the sources have stopped; the rest close as their inputs close."
  @spec close_free(State.t()) :: State.t()
  def close_free(state) do
    open = for {id, %{open?: true}} <- state.stages, do: id
    state = %{state | step: :close, pending: MapSet.new(open)}
    close(state, open |> Enum.filter(&Links.free?(state.links, &1)) |> Enum.sort())
  end

  @doc """
  Closes the outputs of these stages, each at the closing time of its inputs. A source, or a stage cut out of a cycle,
  closes at the end.
  """
  @spec close(State.t(), [State.id()]) :: State.t()
  def close(state, ids), do: Enum.reduce(ids, state, &close_one/2)

  defp close_one(id, state) do
    time = closing_time(state.stages[id], state)
    state = state |> abandon([id]) |> act({:tell, id, {:finalize, time}})
    state = %{state | links: Links.close(state.links, id, time), closed: [id | state.closed]}
    state = if state.step == :close, do: answered(state, id), else: state
    mark(state, [id], :closed)
  end

  defp closing_time(member, state) do
    time = own_time(member, state)
    if member.limit, do: min(member.limit, time), else: time
  end

  defp own_time(%{source?: false, ends_at: time, id: id}, state) when is_integer(time) do
    if Links.free?(state.links, id), do: time, else: state.ending.final || time
  end

  defp own_time(member, state), do: state.ending.final || member.ends_at || member.limit || 0

  @doc "Handles a closed input of `id`; a stage whose inputs are all closed closes, too."
  @spec input_closed(State.t(), State.id(), term(), Situ.Time.t()) :: State.t()
  def input_closed(%{links: %{active: active}} = state, _id, tag, _time)
      when not is_map_key(active, tag),
      do: state

  def input_closed(state, id, tag, time) do
    state = %{state | links: Links.drop(state.links, tag)}
    state = change(state, id, &%{&1 | ends_at: max(&1.ends_at || time, time)})
    member = state.stages[id]

    if member.open? and Links.free?(state.links, id) and
         (not member.source? or state.step == :close),
       do: close(state, [id]),
       else: state
  end

  @doc "Advances when no stage closes by itself: ends the pipeline, waits, or checks whether a cycle has come to rest."
  @spec go_on(State.t()) :: State.t()
  def go_on(%{step: :close} = state) do
    open? = MapSet.size(state.pending) > 0

    cond do
      not open? and state.links.active == %{} -> quit(state)
      not open? or state.links.closing != %{} -> state
      state.ending.drain == nil -> state |> ending(drain: {nil, 0}) |> act({:measure, :drain})
      true -> state
    end
  end

  @doc """
  Handles the measurement of an open cycle: whether no messages are in flight in it, a mark of its counters, and whether
  any stage is busy.
  """
  @spec measured(State.t(), %{quiet?: boolean(), mark: term(), busy?: boolean()}) :: State.t()
  def measured(%{step: :close, ending: %{drain: {mark, polls}}} = state, seen) do
    polls = if seen.mark == mark and not seen.busy?, do: polls + 1, else: 0
    open = MapSet.to_list(state.pending)

    cond do
      open == [] or state.links.closing != %{} ->
        ending(state, drain: nil)

      seen.quiet? or polls > @still or (state.ending.by_hand and state.ending.enough?) ->
        ids = Closing.break(Enum.sort(open), Map.values(state.links.active))
        state |> ending(drain: nil) |> close(ids)

      true ->
        state |> ending(drain: {seen.mark, polls}) |> act({:after, pause(polls), :drain})
    end
  end

  def measured(state, _seen), do: ending(state, drain: nil)

  defp pause(polls) when polls < 5, do: 1
  defp pause(_polls), do: 10

  @doc "Ends the stages after everything has closed, or if nothing has begun."
  @spec quit(State.t()) :: State.t()
  def quit(state) do
    alive = alive(state)
    state = if state.phase == :stopping, do: state, else: watch(state)
    state = abandon(state, alive)
    tell(%{state | phase: :stopping, step: :quit, pending: MapSet.new(alive)}, alive, :quit)
  end

  # Subscribers outside the pipeline are given the reason for its end.
  defp abandon(state, ids) do
    if error = List.last(state.errors), do: tell(state, ids, {:abandon, error}), else: state
  end

  @doc "Completes the pipeline and calls the last handlers."
  @spec complete(State.t()) :: State.t()
  def complete(state), do: act(%{state | phase: :completed, step: :over}, {:handle, :completed})
end
