defmodule Situ.Pipeline.Stages do
  @moduledoc false
  # Wires and measures the stages of a pipeline (StageProcesses spawns them). Carries out decisions of the life cycle.
  alias Situ.{Clock, Lifecycle, Stage}
  alias Situ.Application.Reaper
  alias Situ.Graph.{Edge, Plan, Vertex}
  alias Situ.Lifecycle.{Links, Member}
  alias Situ.Pipeline.{StageProcesses, State, StoppedSnapshot}
  alias Situ.Ports.{Counters, Output, ErrorCounters}

  @doc "Builds the links, counters and stage entries of a plan, and the members for the life cycle."
  @spec install_plan(State.t(), Plan.t()) :: {State.t(), %{pos_integer() => Member.t()}}
  def install_plan(state, plan) do
    Reaper.watch_pipeline(self())
    add_plan(state, plan, %{})
  end

  @doc """
  Adds the stages of a plan to the state. `lent` maps edges from outside the plan to the stages of their sources.
  """
  @spec add_plan(State.t(), Plan.t(), %{pos_integer() => pos_integer()}, keyword()) ::
          {State.t(), %{pos_integer() => Member.t()}}
  def add_plan(state, plan, lent, extra \\ []) do
    wires = state.wires
    links = build_links(plan, lent)
    counters = Map.new(plan.edges, &{&1.id, Counters.new()})
    inline = Map.new(plan.inline, &{elem(&1.from, 0), &1})
    entered = for id <- inline_heads(plan), edge = inline[id], do: {edge.id, Counters.new()}
    counters = Enum.into(entered, counters)

    stages =
      Map.new(plan.stages, fn %{id: id, vertices: [head | _] = vertices, group: group} ->
        tail = if edge = inline[head.id], do: counters[edge.id]
        {id, %{build_entry(id, vertices, tail) | group: group}}
      end)

    members = Map.new(stages, fn {id, stage} -> {id, build_member(stage, extra)} end)

    wires = %{
      links: Map.merge(wires.links, links),
      counters: Map.merge(wires.counters, counters)
    }

    {%{state | stages: Map.merge(state.stages, stages), wires: wires}, members}
  end

  # The edge from a component to the operators that share its process has counters like a queue.
  defp inline_heads(plan) do
    for %{vertices: [%{module: module, id: id}, _ | _]} <- plan.stages,
        module != :operator,
        do: id
  end

  defp build_links(plan, lent) do
    ends =
      for stage <- plan.stages, vertex <- stage.vertices, into: %{}, do: {vertex.id, stage.id}

    Map.new(plan.edges, fn %{from: {from, _}, to: {to, _}} = edge ->
      {edge.id, build_link(edge, lent[edge.id] || ends[from], ends[to])}
    end)
  end

  @doc "Returns a link: an edge with stages as its ends instead of vertices."
  @spec build_link(Edge.t(), pos_integer(), pos_integer()) :: map()
  def build_link(%Edge{from: {_, output}, to: {_, input}} = edge, from, to),
    do: %{id: edge.id, from: from, output: output, to: to, input: input, policy: edge.policy}

  @doc "Builds the entry of a stage without a process."
  @spec build_entry(pos_integer(), [Vertex.t(), ...], Counters.t() | nil) :: State.stage()
  def build_entry(id, vertices, tail \\ nil) do
    control = :atomics.new(2, signed: true)
    :atomics.put(control, 1, Stage.no_final_time())

    %{
      id: id,
      pid: nil,
      group: nil,
      shared?: false,
      left: nil,
      vertices: vertices,
      tally: ErrorCounters.new(length(vertices)),
      control: control,
      marks: new_marks(vertices),
      tail: tail,
      started: nil,
      memory: nil,
      stopped: %{}
    }
  end

  @doc "Keeps the snapshot that a stage has reported before or after its part was stopped."
  @spec put_stopped_snapshot(State.t(), pos_integer(), :before | :after, term()) :: State.t()
  def put_stopped_snapshot(state, id, moment, result) do
    stage = state.stages[id]
    stage = %{stage | stopped: Map.put(stage.stopped, moment, result)}
    %{state | stages: Map.put(state.stages, id, stage)}
  end

  @doc """
  Prepares stopped stages for a new start: afresh, or from the snapshots that they reported when they stopped. Returns
  an error if a stage has no snapshot.
  """
  @spec reset_stages(State.t(), [pos_integer()], :fresh | :checkpoint) ::
          {:ok, State.t()} | {:error, Situ.Error.t()}
  def reset_stages(state, ids, from) do
    entries =
      Enum.reduce_while(ids, {:ok, %{}}, fn id, {:ok, entries} ->
        case reset_entry(state.stages[id], from, state.life.stages[id].limit) do
          {:ok, entry} -> {:cont, {:ok, Map.put(entries, id, entry)}}
          {:error, error} -> {:halt, {:error, error}}
        end
      end)

    with {:ok, entries} <- entries do
      tags = for {tag, %{to: to}} <- state.wires.links, to in ids, do: tag
      counters = Enum.into(tags, state.wires.counters, &{&1, Counters.new()})
      wires = %{state.wires | counters: counters}
      {:ok, %{state | stages: Map.merge(state.stages, entries), wires: wires}}
    end
  end

  defp reset_entry(stage, :fresh, _limit),
    do:
      {:ok,
       %{
         build_entry(stage.id, stage.vertices, stage.tail)
         | tally: stage.tally,
           group: stage.group
       }}

  defp reset_entry(%{vertices: [head | _]} = stage, :checkpoint, limit) do
    with {:ok, memory} <- StoppedSnapshot.merge(stage.stopped, limit, head) do
      {:ok, entry} = reset_entry(stage, :fresh, limit)
      {:ok, %{entry | memory: memory, started: stage.started}}
    end
  end

  # Only a stage that can be spawned again has to record its progress.
  defp new_marks([%{on_error: :stop, unit: unit} | _])
       when unit == nil or elem(unit, 1) == :close,
       do: nil

  defp new_marks(vertices),
    do: vertices |> Enum.map(&length(&1.outputs)) |> Enum.sum() |> Output.new_marks()

  @doc "Builds the life cycle's record of a stage."
  @spec build_member(State.stage(), keyword()) :: Member.t()
  def build_member(%{id: id, vertices: [head | _]}, extra \\ []) do
    base = %Member{
      id: id,
      path: head.path,
      source?: Vertex.source?(head),
      on_error: head.on_error,
      unit: head.unit
    }

    struct!(base, extra)
  end

  @doc "Sends the stages their clock and neighbours, and starts them."
  @spec start_stages(State.t(), [pos_integer()]) :: State.t()
  def start_stages(state, ids) do
    links = Map.values(state.wires.links)
    into = Enum.group_by(links, & &1.to)
    out_of = Enum.group_by(links, & &1.from)

    now =
      if state.life.phase == :starting,
        do: state.timing.start_time,
        else: Clock.now(state.timing.clock)

    for id <- ids, reduce: state do
      state ->
        state = update_in(state.stages[id].started, &(&1 || now))
        ports = {Map.get(into, id, []), Map.get(out_of, id, [])}
        send_request(state, id, {:start, build_wiring(state, id, ports, now)})
    end
  end

  # A stage that is spawned again keeps its first start time, so that repeated messages have the same times.
  defp build_wiring(state, id, {into, out_of}, now) do
    counters = state.wires.counters

    inlets =
      for link <- into, is_map_key(state.life.links.active, link.id) do
        %{
          name: link.input,
          tag: link.id,
          producer: producer_address(state.stages[link.from], state.stages[id]),
          policy: link.policy,
          counters: counters[link.id]
        }
      end

    # Consumers that have taken the closing mark, or have ended, no longer subscribe.
    subs =
      out_of
      |> Enum.filter(&is_map_key(state.life.links.active, &1.id))
      |> Enum.sort_by(& &1.id)
      |> Enum.group_by(& &1.output, fn link ->
        consumer = state.stages[link.to]
        address = consumer_address(state.stages[id], consumer)
        {link.id, address, counters[link.id], subscriber_policy(link.policy, consumer)}
      end)

    state.timing
    |> Map.take([:clock, :enforce, :replay_start, :replay_end])
    |> Map.merge(%{
      start_time: state.stages[id].started,
      now: now,
      control: state.stages[id].control,
      inlets: inlets,
      subs: subs,
      sizes: state.settings.message_sizes
    })
  end

  # Stages that share a process send each other their messages without its mailbox.
  defp producer_address(%{pid: pid, id: from}, %{pid: pid, id: to, shared?: true}),
    do: {:local, from, to}

  defp producer_address(%{pid: pid}, _consumer), do: pid

  defp consumer_address(%{pid: pid, shared?: true}, %{pid: pid, id: to}), do: {:local, to}
  defp consumer_address(_producer, %{pid: pid}), do: pid

  @doc "Returns the policy for a subscriber: only a stage that is restarted can receive messages again."
  @spec subscriber_policy(Situ.Delivery.t(), State.stage()) :: Situ.Delivery.t()
  def subscriber_policy(policy, %{marks: nil}), do: %{policy | on_restart: :drop}
  def subscriber_policy(policy, _restarted), do: policy

  @doc "Informs the neighbours of a restarted stage about its new process."
  @spec rewire_stage(State.t(), pos_integer(), [{term(), map()}]) :: State.t()
  def rewire_stage(state, id, links) do
    pid = state.stages[id].pid

    for {tag, link} <- links, link.from != link.to do
      other = if link.from == id, do: link.to, else: link.from
      closing = if link.to == id, do: state.life.links.closing[tag]
      send_in_order(state, other, {:peer, tag, pid, closing})
      # A stage that is also starting sends its own request.
      asks? = not state.life.stages[link.to].again? and state.life.phase != :starting
      if link.from == id and asks?, do: send_in_order(state, other, {:ask, tag})
    end

    state
  end

  # A stage that has left a shared process may not have received all messages of the earlier process of its neighbour:
  # the shared process forwards them, and this request after them.
  defp send_in_order(state, id, request) do
    case state.stages do
      %{^id => %{left: shared}} when is_pid(shared) ->
        if Process.alive?(shared),
          do: send(shared, {:situ, {:to, id, {:forward, request}}}),
          else: send_request(state, id, request)

      _ ->
        send_request(state, id, request)
    end
  end

  @doc """
  Introduces a stage that has moved to its own process to producers that are just restarting: they may have been
  connected with the shared process, but will introduce themselves to the new one.
  """
  @spec introduce_moved(State.t(), pos_integer()) :: State.t()
  def introduce_moved(%{life: life} = state, id) do
    for {tag, %{from: from}} <- Links.list_incoming(life.links, id),
        life.stages[from].again?,
        reduce: state,
        do: (state -> send_request(state, from, {:peer, tag, state.stages[id].pid, nil}))
  end

  @doc """
  Sends a request to a stage. A dropped stage receives none; its waiting callers got a reply when it was dropped.
  """
  @spec send_request(State.t(), pos_integer(), term()) :: State.t()
  def send_request(state, id, request) do
    case state.stages do
      %{^id => %{pid: nil}} -> :ok
      %{^id => %{shared?: true, pid: pid}} -> send(pid, {:situ, {:to, id, request}})
      %{^id => %{pid: pid}} -> send(pid, {:situ, request})
      _has_been_dropped -> :ok
    end

    state
  end

  @doc "Deletes everything that belongs to a stage that the life cycle has dropped."
  @spec drop_stage(State.t(), pos_integer()) :: State.t()
  def drop_stage(state, id) do
    state = StageProcesses.remove_stage(state, id)
    tags = for {tag, link} <- state.wires.links, link.to == id or link.from == id, do: tag
    Enum.reduce(tags, %{state | stages: Map.delete(state.stages, id)}, &drop_link(&2, &1))
  end

  @doc "Deletes everything that belongs to a connection that the life cycle has dropped."
  @spec drop_link(State.t(), term()) :: State.t()
  def drop_link(%{wires: %{links: links, counters: counters}} = state, tag),
    do: %{state | wires: %{links: Map.delete(links, tag), counters: Map.delete(counters, tag)}}

  @doc "Makes these stages ignore messages later than `time`; a stage with an earlier limit keeps it."
  @spec limit_stages(State.t(), [pos_integer()], Situ.Time.t()) :: State.t()
  def limit_stages(state, ids, time) do
    for id <- ids,
        %{control: cell} <- [state.stages[id]],
        time < :atomics.get(cell, 1),
        do: :atomics.put(cell, 1, time)

    state
  end

  @doc "Lets these stages finish all their messages without waiting for demand or for the clock."
  @spec release_stages(State.t(), [pos_integer()]) :: State.t()
  def release_stages(state, ids),
    do:
      Enum.reduce(
        ids,
        limit_stages(state, ids, Stage.no_final_time() - 1),
        &send_request(&2, &1, :clock)
      )

  @doc "Returns the earliest time that the consumers of stage `id` have reached; its later messages may be lost."
  @spec reached_time(State.t(), pos_integer()) :: Situ.Time.t() | nil
  def reached_time(state, id) do
    times =
      for {tag, _} <- Links.list_outgoing(state.life.links, id),
          ref = state.wires.counters[tag],
          time = Counters.last_time(ref),
          time != 0,
          do: time

    Enum.min(times, fn -> nil end)
  end

  @doc "Returns whether no messages are in flight between the pipeline's processes."
  @spec no_messages_in_flight?(State.t()) :: boolean()
  def no_messages_in_flight?(state) do
    Enum.all?(state.life.links.active, fn {tag, _} ->
      {emitted, processed, dropped} = Counters.flow_counts(state.wires.counters[tag])
      emitted == processed + dropped
    end)
  end

  @doc "Returns a value that changes when any message moves, in the whole pipeline or in one part."
  @spec fingerprint(State.t(), :all | reference()) :: term()
  def fingerprint(state, :all) do
    flows = for {_, ref} <- state.wires.counters, do: Counters.flow_counts(ref)
    {Lifecycle.State.progress_mark(state.life), :erlang.phash2(flows)}
  end

  def fingerprint(state, part) do
    case state.life.parts do
      %{^part => %{ids: ids, pending: pending}} ->
        open = Enum.count(ids, &state.life.stages[&1].open?)
        links = for id <- ids, {tag, _} <- Links.list_incoming(state.life.links, id), do: tag

        {MapSet.size(pending), open,
         Enum.map(links, &Counters.flow_counts(state.wires.counters[&1]))}

      _ ->
        nil
    end
  end

  @doc "Returns whether a stage waits for the outside world or for the clock; such a wait has no limit."
  @spec any_patient?(State.t()) :: boolean()
  def any_patient?(state),
    do: Enum.any?(state.stages, fn {_, stage} -> Stage.patient?(stage.control) end)

  @doc "Measures whether the pipeline is quiet or busy, and its fingerprint, for the wait until a cycle has settled."
  @spec measure_drain(State.t()) :: map()
  def measure_drain(state) do
    if no_messages_in_flight?(state) do
      %{quiet?: true, mark: nil, busy?: false}
    else
      idle = StageProcesses.idle_stages(state)
      busy? = Enum.any?(state.life.pending, &(&1 not in idle))
      %{quiet?: false, mark: fingerprint(state, :all), busy?: busy?}
    end
  end
end
