defmodule Situ.Lifecycle.Addition do
  @moduledoc false
  # Adds components to a running pipeline, or starts a stopped part again, by taking their stages through the steps of a
  # start. No message moves before all of them are connected: running streams add the new stages as subscribers without
  # demand, at a message boundary. Pure.
  #
  #   ended  the earlier processes of a stopped part have ended, and its consumers have taken its closing marks
  #   reset  the server has prepared its stages
  #   up     every new stage has its initial state
  #   start  `handle_start/2` has run in each
  #   lend   the streams that they consume have added them as subscribers
  alias Situ.Error
  alias Situ.Lifecycle.{Errors, Failure, Links, Member, State}
  import Situ.Lifecycle.State

  @type plan :: %{
          required(:members) => %{State.id() => Member.t()},
          required(:links) => %{term() => Links.link()},
          required(:lent) => [term()],
          optional(:again?) => boolean()
        }

  @doc """
  Begins the addition; replies to `from` when messages flow or when adding fails. `plan.lent` holds the links from
  streams that are already running.
  """
  @spec begin(State.t(), reference(), plan(), term()) :: State.t()
  def begin(state, ref, plan, from) do
    ids = Map.keys(plan.members)
    sources = for {id, %{source?: true}} <- plan.members, do: id

    links =
      Enum.reduce(plan.links, state.links, fn {tag, link}, all -> Links.add(all, tag, link) end)

    growth = %{
      ids: ids,
      step: :up,
      pending: MapSet.new(ids),
      lent: plan.lent,
      from: from,
      again?: Map.get(plan, :again?, false)
    }

    %{
      state
      | stages: Map.merge(state.stages, plan.members),
        links: links,
        awaited: Enum.into(sources, state.awaited),
        growths: Map.put(state.growths, ref, growth)
    }
    |> add_action({:spawn, ids})
    |> advance_growth(ref)
  end

  @doc "Starts a stopped part again as soon as it has ended completely; `how` is passed to the server."
  @spec begin_again(State.t(), reference(), [State.id()], term(), term()) :: State.t()
  def begin_again(state, ref, ids, how, from) do
    waiting = MapSet.new(ids)

    growth = %{ids: ids, step: :ended, pending: waiting, lent: [], from: from, again?: true}
    growth = Map.put(growth, :how, how)
    advance_stopped(%{state | growths: Map.put(state.growths, ref, growth)})
  end

  @doc "Advances the parts that wait for their own end."
  @spec advance_stopped(State.t()) :: State.t()
  def advance_stopped(%{growths: growths} = state) when growths == %{}, do: state

  def advance_stopped(state) do
    for {ref, %{step: :ended} = growth} <- state.growths,
        Enum.all?(growth.ids, &completely_ended?(state, &1, growth.ids)),
        reduce: state do
      state ->
        state
        |> enter_step(ref, growth, :reset, [ref])
        |> add_action({:reset, ref, growth.ids, growth.how})
    end
  end

  defp completely_ended?(state, id, ids) do
    not state.stages[id].alive? and
      Enum.all?(Links.list_outgoing(state.links, id), fn {_, link} -> link.to in ids end)
  end

  @doc "Handles the server's reply: it has prepared the stages, or the part cannot be started as requested."
  @spec handle_reset(State.t(), reference(), :ok | {:error, Error.t()}) :: State.t()
  def handle_reset(state, ref, result) do
    case {Map.pop(state.growths, ref), result} do
      {{%{step: :reset} = growth, growths}, {:error, error}} ->
        add_action(%{state | growths: growths}, {:reply, growth.from, {:error, error}})

      {{%{step: :reset} = growth, growths}, :ok} ->
        %{state | growths: growths}
        |> forget_end(growth.ids)
        |> begin(ref, plan_again(state, growth.ids), growth.from)

      _ ->
        state
    end
  end

  # Connections to consumers outside ended with the streams; these consumers have seen the end.
  defp plan_again(state, ids) do
    links = for {tag, %{to: to} = link} <- state.links.topology, to in ids, do: {tag, link}
    lent = for {tag, %{from: from}} <- links, from not in ids, do: tag
    members = Map.new(ids, &{&1, Member.restart(state.stages[&1])})
    %{members: members, links: Map.new(links), lent: lent, again?: true}
  end

  defp forget_end(state, ids) do
    finite = MapSet.difference(state.ending.finite, MapSet.new(ids))
    update_ending(%{state | closed: state.closed -- ids}, finite: finite)
  end

  @spec reject_request(State.t(), term()) :: State.t()
  def reject_request(state, from),
    do: add_action(state, {:reply, from, {:error, Errors.not_running()}})

  @doc "Returns the reference of the addition that a stage belongs to, unless its earlier process has yet to end."
  @spec find_ref(State.t(), State.id()) :: reference() | nil
  def find_ref(state, id) do
    Enum.find_value(state.growths, fn {ref, growth} ->
      growth.step not in [:ended, :reset] and id in growth.ids && ref
    end)
  end

  @doc "Applies an event of a stage that is being added."
  @spec handle_event(State.t(), reference(), tuple(), Situ.Time.t()) :: State.t()
  def handle_event(state, ref, {step, id}, _now) when step in [:up, :started],
    do:
      state
      |> update_member(id, &%{&1 | up?: true})
      |> remove_pending(ref, id)
      |> advance_growth(ref)

  # The stage's process is still alive and ends with the others.
  def handle_event(state, ref, {:failed, _id, error, _reached}, _now),
    do: fail_growth(state, ref, error)

  def handle_event(state, ref, {:init_failed, id, error}, now),
    do: state |> Failure.close_dead_stage(id, now) |> fail_growth(ref, error)

  def handle_event(state, ref, {:exited, id, error, _reached}, now),
    do: state |> Failure.close_dead_stage(id, now) |> fail_growth(ref, error)

  @doc "Handles a running stream that has added a new subscriber, or that has ended."
  @spec handle_lent_stream(State.t(), term(), {:open, term()} | {:closed, Situ.Time.t()}) ::
          State.t()
  def handle_lent_stream(state, tag, how) do
    case Enum.find(state.growths, fn {_, g} -> tag in g.lent end) do
      {ref, _growth} ->
        to = state.links.topology[tag].to

        state =
          case how do
            {:closed, time} -> close_lent_link(state, tag, to, time)
            {:open, _last} -> state
          end

        state |> remove_pending(ref, tag) |> advance_growth(ref)

      nil ->
        state
    end
  end

  # The mark is recorded, because a consumer that restarts needs it again.
  defp close_lent_link(state, tag, to, time) do
    state = send_to_stages(state, [to], {:peer_gone, tag, time})
    %{state | links: Links.close_link(state.links, tag, time)}
  end

  @doc "Handles the end of a stage's process: parts that are being added stop waiting for its stream."
  @spec handle_lender_exit(State.t(), State.id()) :: State.t()
  def handle_lender_exit(%{growths: growths} = state, _id) when growths == %{}, do: state

  def handle_lender_exit(state, id) do
    tags =
      for {_, %{step: :lend, pending: pending}} <- state.growths,
          tag <- pending,
          %{from: ^id} <- [state.links.topology[tag]],
          do: tag

    # A stage that was restarted connects to its neighbours by itself.
    Enum.reduce(tags, state, fn tag, state ->
      if state.stages[id].alive?,
        do: handle_lent_stream(state, tag, {:open, nil}),
        else: report_closed_stream(state, tag)
    end)
  end

  defp lend_stream(tag, state) do
    %{from: from} = state.links.topology[tag]

    if state.stages[from].alive?,
      do: add_action(state, {:lend, tag}),
      else: report_closed_stream(state, tag)
  end

  defp report_closed_stream(state, tag) do
    %{from: from} = state.links.topology[tag]
    member = state.stages[from]
    time = Map.get(state.links.closing, tag, member.ends_at || member.limit || 0)
    handle_lent_stream(state, tag, {:closed, time})
  end

  defp remove_pending(state, ref, what) do
    update = &%{&1 | pending: MapSet.delete(&1.pending, what)}
    %{state | growths: Map.update!(state.growths, ref, update)}
  end

  defp advance_growth(state, ref) do
    case state.growths do
      %{^ref => %{pending: pending} = growth} ->
        if MapSet.size(pending) == 0, do: finish_step(state, ref, growth), else: state

      _ ->
        state
    end
  end

  defp finish_step(state, ref, %{step: :up} = growth),
    do:
      state
      |> enter_step(ref, growth, :start, growth.ids)
      |> add_action({:start, growth.ids})
      |> advance_growth(ref)

  defp finish_step(state, ref, %{step: :start} = growth) do
    state = enter_step(state, ref, growth, :lend, growth.lent)
    growth.lent |> Enum.reduce(state, &lend_stream/2) |> advance_growth(ref)
  end

  defp finish_step(state, ref, %{step: :lend} = growth) do
    %{state | growths: Map.delete(state.growths, ref)}
    |> add_action({:run, growth.ids})
    |> add_action({:reply, growth.from, :ok})
  end

  defp enter_step(state, ref, growth, step, pending) do
    growth = %{growth | step: step, pending: MapSet.new(pending)}
    %{state | growths: Map.put(state.growths, ref, growth)}
  end

  # Removes the other stages of the addition, too; the pipeline keeps running.
  defp fail_growth(state, ref, error) do
    {growth, growths} = Map.pop(state.growths, ref)

    %{state | growths: growths}
    |> add_action({:reply, growth.from, {:error, error}})
    |> remove_growth(growth)
  end

  @doc "Removes all stages that are still being added, because the pipeline is ending."
  @spec abandon_all(State.t()) :: State.t()
  def abandon_all(%{growths: growths} = state) when growths == %{}, do: state

  def abandon_all(state) do
    Enum.reduce(state.growths, %{state | growths: %{}}, fn {_ref, growth}, state ->
      state
      |> add_action({:reply, growth.from, {:error, Errors.not_running()}})
      |> remove_growth(growth)
    end)
  end

  # The stages of a part that has yet to end are not affected.
  defp remove_growth(state, %{step: step}) when step in [:ended, :reset], do: state

  defp remove_growth(state, growth) do
    tags =
      for id <- growth.ids,
          {tag, _} <-
            Links.list_incoming(state.links, id) ++ Links.list_outgoing(state.links, id),
          do: tag

    # A restored source may hold messages for a consumer of the part, which would keep it from ending.
    started? = growth.step in [:start, :lend]

    untold =
      for tag <- tags,
          started? or tag in growth.lent,
          link = state.links.topology[tag],
          do: {link.from, tag}

    state =
      Enum.reduce(untold, state, fn {from, tag}, state ->
        send_to_stages(state, [from], {:untap, tag})
      end)

    alive = Enum.filter(growth.ids, &state.stages[&1].alive?)
    forget = if growth.again?, do: &Links.deactivate_link/2, else: &Links.forget_link/2
    links = Enum.reduce(tags, state.links, &forget.(&2, &1))
    awaited = MapSet.difference(state.awaited, MapSet.new(growth.ids))

    %{state | links: links, awaited: awaited}
    |> send_to_stages(alive, :quit)
    |> set_status(growth.ids, :dead)
    |> forget_added(growth)
    |> fail_listeners(tags)
  end

  # A part that could not be started again stays stopped.
  defp forget_added(state, %{again?: true}), do: state
  defp forget_added(state, growth), do: add_action(state, {:forget, growth.ids})

  # Other parts that are being added may have been waiting to subscribe to this one.
  defp fail_listeners(state, tags) do
    refs = for {ref, %{lent: lent}} <- state.growths, Enum.any?(lent, &(&1 in tags)), do: ref

    Enum.reduce(refs, state, fn ref, state ->
      if is_map_key(state.growths, ref),
        do: fail_growth(state, ref, Errors.source_removed()),
        else: state
    end)
  end
end
