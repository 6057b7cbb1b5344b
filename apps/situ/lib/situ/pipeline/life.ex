defmodule Situ.Pipeline.Life do
  @moduledoc false
  # The life cycle as functions over the server's state: each takes an event and does the next step. Sends requests to
  # stages, never waits for them.
  alias Situ.{Clock, Error, Stage, Telemetry}
  alias Situ.Graph.{Builder, Plan, Vertex}
  alias Situ.Pipeline.{Finalizer, Launch, Taps, View}
  alias Situ.Stage.{Counters, Tally}
  require Logger

  @drain_ms 1_000
  @catch_up_ms 1_000

  defstruct [
    :settings,
    :handle,
    :result,
    :owner,
    :clock,
    :control,
    :latest_finite,
    :final,
    :begun,
    :plan,
    :drain_until,
    :stop_wish,
    graph: %Situ.Graph{},
    phase: :starting,
    step: :up,
    enforce: false,
    start_time: nil,
    replay_end: :infinity,
    stages: %{},
    pids: %{},
    links: %{},
    counters: %{},
    pending: MapSet.new(),
    completable: MapSet.new(),
    active: %{},
    order: [],
    closed: [],
    errors: [],
    progress: 0.0,
    waiters: [],
    replacing: %{},
    taps: %{},
    early: [],
    described: nil,
    by_hand: false,
    catch_up: @catch_up_ms,
    descriptions: %{}
  ]

  @type t :: %__MODULE__{}

  @spec new(Situ.Pipeline.Settings.t()) :: t()
  def new(settings) do
    graph = %Situ.Graph{default_policy: settings.default_policy, replay: settings.interval}
    %__MODULE__{settings: settings, graph: graph, begun: System.monotonic_time()}
  end

  @doc "How long sources may catch up with the clock when a pipeline is stopped by hand, ms."
  @spec catch_up_ms() :: pos_integer()
  def catch_up_ms, do: @catch_up_ms

  # Starting

  @spec launch(t()) :: t()
  def launch(state) do
    case Plan.compile(state.graph) do
      {:ok, plan} -> spawn_stages(%{state | plan: plan})
      {:error, error} -> state |> failed(error) |> complete()
    end
  end

  defp spawn_stages(%{plan: %{stages: []}, settings: %{mode: :run}} = state),
    do: complete(timed(state))

  defp spawn_stages(%{plan: plan} = state) do
    Situ.Pipeline.Reaper.watch(self())
    control = :atomics.new(1, signed: true)
    :atomics.put(control, 1, Stage.never())
    links = Launch.links(plan)

    state = %{
      state
      | control: control,
        links: links,
        active: links,
        counters: Launch.counters(plan.edges ++ tails(plan)),
        order: Enum.map(plan.stages, & &1.id),
        pending: MapSet.new(plan.stages, & &1.id),
        completable:
          for(
            %{id: id, vertices: [head | _]} <- plan.stages,
            Vertex.source?(head),
            into: MapSet.new(),
            do: id
          )
    }

    state =
      Enum.reduce(
        plan.stages,
        state,
        &spawn_stage(&2, &1.id, &1.vertices, Tally.new(length(&1.vertices)))
      )

    if plan.stages == [], do: start_sources(state), else: state
  end

  @doc false
  def spawn_stage(state, id, vertices, tally) do
    pid =
      Stage.spawn_link(%{
        id: id,
        server: self(),
        handle: state.handle,
        vertices: vertices,
        tally: tally,
        tail_counters: tail_counters(state, vertices)
      })

    stage = %{id: id, pid: pid, vertices: vertices, tally: tally, state: :running}
    %{state | stages: Map.put(state.stages, id, stage), pids: Map.put(state.pids, pid, id)}
  end

  defp tails(plan) do
    heads =
      for %{vertices: [%{module: module, id: id}, _ | _]} <- plan.stages,
          module != :operator,
          do: id

    Enum.filter(plan.inline, &(elem(&1.from, 0) in heads))
  end

  # The edge from a component into the operators that share its process is counted like a queue.
  defp tail_counters(state, [%{id: id}, %{id: next} | _]) do
    case Enum.find(state.plan.inline, &(elem(&1.from, 0) == id and elem(&1.to, 0) == next)) do
      nil -> nil
      edge -> state.counters[edge.id]
    end
  end

  defp tail_counters(_state, _vertices), do: nil

  defp start_sources(state) do
    state = timed(state)
    Clock.listen(state.clock)

    case notify(state, :run, state.start_time) do
      {:ok, state} ->
        for {id, stage} <- state.stages,
            do: send(stage.pid, {:situ, {:start, Launch.wiring(id, state)}})

        next_step(%{state | step: :sources, pending: ids(state)})

      {:error, error} ->
        state |> failed(error) |> quit()
    end
  end

  defp timed(state) do
    timing = Launch.timing(state.settings, state.graph.proposals)

    Telemetry.execute([:situ, :pipeline, :start], %{system_time: :os.system_time()}, %{
      pipeline: state.settings.name
    })

    struct!(state, timing)
  end

  # Events of stages

  @spec event(t(), pos_integer(), term()) :: t()
  def event(%{phase: :completed} = state, _id, _event), do: state

  # The last words of a tap that is gone.
  def event(%{stages: stages} = state, id, _event) when not is_map_key(stages, id), do: state
  def event(state, id, :up), do: state |> up(id) |> next_step()
  def event(state, id, :started), do: state |> started(id) |> next_step()
  def event(state, id, :source_stopped), do: next_step(ready(state, id, :stop))
  def event(state, _id, :finalized), do: state

  def event(state, id, {:init_failed, error}) do
    state = failed(dead(state, id), error)
    if state.step == :up, do: quit(state), else: begin_stop(state, now(state))
  end

  def event(state, id, {:completed, time}), do: completed(state, id, time)

  def event(state, _id, {:unsubscribed, tag, _, _}),
    do: next_step(%{state | active: Map.delete(state.active, tag)})

  def event(state, id, {:failed, error}), do: stage_failed(state, id, error)
  def event(state, _id, {:skipped, error}), do: noted(state, error)

  def event(state, id, {:description, text}),
    do: %{state | descriptions: Map.put(state.descriptions, id, text)}

  def event(state, _id, {:tapped, tag}), do: Taps.opened(state, tag)

  def event(state, id, {:replaced, answer}) do
    {{from, request}, replacing} = Map.pop(state.replacing, id)
    GenServer.reply(from, answer)
    state = %{state | replacing: replacing}
    if answer == :ok, do: Situ.Pipeline.Revise.replaced(state, id, request), else: state
  end

  defp up(%{step: :up} = state, id), do: ready(state, id, :up)

  # A stage that was restarted: wire it, tell its neighbours.
  defp up(state, id) do
    send(state.stages[id].pid, {:situ, {:start, Launch.wiring(id, state)}})
    state
  end

  defp started(%{step: :sources} = state, id), do: ready(state, id, :sources)

  defp started(%{taps: taps} = state, id) when is_map_key(taps, id), do: Taps.open(state, id)

  defp started(state, id) do
    pid = state.stages[id].pid

    for {tag, link} <- state.active, link.from == id or link.to == id do
      other = if link.from == id, do: link.to, else: link.from
      send(state.stages[other].pid, {:situ, {:peer, tag, pid}})
      if link.from == id, do: send(state.stages[other].pid, {:situ, {:ask, tag}})
    end

    send(pid, {:situ, :run})
    if state.phase == :stopping, do: send(pid, {:situ, {:stop, state.final}})
    state
  end

  defp ready(%{step: step} = state, id, step),
    do: %{state | pending: MapSet.delete(state.pending, id)}

  defp ready(state, _id, _step), do: state

  defp next_step(%{step: step, pending: pending} = state)
       when step in [:up, :sources, :stop, :quit] do
    if MapSet.size(pending) == 0, do: step_done(state), else: state
  end

  defp next_step(%{step: :finalize} = state), do: finalize(state)
  defp next_step(state), do: state

  defp step_done(%{step: :up} = state), do: start_sources(state)

  defp step_done(%{step: :sources, early: early} = state) do
    for {_, stage} <- state.stages, do: send(stage.pid, {:situ, :run})
    state = %{state | phase: :running, step: :running, early: []}
    for message <- Enum.reverse(early), do: send(self(), message)

    cond do
      state.stop_wish || state.errors != [] -> begin_stop(state, now(state))
      true -> check_complete(state)
    end
  end

  defp step_done(%{step: :stop} = state), do: finalize(%{state | step: :finalize})
  defp step_done(%{step: :quit} = state), do: complete(state)

  # Completion

  defp completed(state, id, time) do
    if MapSet.member?(state.completable, id) do
      state = %{state | completable: MapSet.delete(state.completable, id)}
      state |> latest(id, time) |> check_complete()
    else
      state
    end
  end

  defp latest(state, _id, :infinity), do: state

  defp latest(state, id, time) do
    path = hd(state.stages[id].vertices).path
    {_, state} = notify(state, :component_completed, {path, time})
    %{state | latest_finite: max(state.latest_finite || time, time)}
  end

  defp check_complete(%{phase: :running, latest_finite: time} = state) when is_integer(time) do
    if MapSet.size(state.completable) == 0, do: begin_stop(state, time), else: state
  end

  defp check_complete(state), do: state

  # Stopping

  @spec stop(t()) :: t()
  def stop(%{phase: :building} = state), do: complete(%{state | plan: %Plan{}})
  def stop(%{phase: :running} = state), do: begin_stop(%{state | by_hand: true}, now(state))
  def stop(%{phase: :starting} = state), do: %{state | stop_wish: true, by_hand: true}
  def stop(state), do: state

  defp begin_stop(%{phase: :running} = state, time) do
    final = max(time, state.latest_finite || time)
    :atomics.put(state.control, 1, final)

    sources =
      for {id, %{state: :running, vertices: [head | _]}} <- state.stages,
          Vertex.source?(head),
          do: id

    for id <- sources, do: send(state.stages[id].pid, {:situ, {:stop, final}})
    watch_progress(state)
    if state.by_hand, do: Process.send_after(self(), :situ_enough, state.catch_up)

    next_step(%{state | phase: :stopping, step: :stop, final: final, pending: MapSet.new(sources)})
  end

  defp begin_stop(state, _time), do: %{state | stop_wish: true}

  # Stopped by hand, sources that lag behind the clock may catch up to it, but not for ever: they end where they are.
  # After completion they do go on to the end: that is what makes a replay the same each time.
  @spec enough(t()) :: t()
  def enough(%{step: :stop, by_hand: true} = state) do
    for id <- state.pending, do: send(state.stages[id].pid, {:situ, :stop_now})
    state
  end

  def enough(state), do: state

  defp finalize(state) do
    case Finalizer.next(state.order, Map.values(state.active)) do
      {:close, ids} -> finalize(close(state, ids))
      :wait -> state
      :done -> quit(state)
      {:break, ids} -> break(state, ids)
    end
  end

  # Before a cycle is cut, what circulates in it gets the time to come to rest.
  defp break(state, ids) do
    now = System.monotonic_time(:millisecond)
    until = state.drain_until || now + @drain_ms

    if quiet?(state) or now > until do
      finalize(close(%{state | drain_until: nil}, ids))
    else
      Process.send_after(self(), :situ_recheck, 1)
      %{state | drain_until: until}
    end
  end

  @spec recheck(t()) :: t()
  def recheck(%{step: :finalize} = state), do: finalize(state)
  def recheck(state), do: state

  defp close(state, ids) do
    for id <- ids, do: send(state.stages[id].pid, {:situ, {:finalize, state.final}})
    paths = for id <- ids, vertex <- state.stages[id].vertices, do: vertex.path
    gone = for id <- ids, %{state: :dead} <- [state.stages[id]], do: id

    state = %{state | order: state.order -- ids, closed: Enum.reverse(paths) ++ state.closed}
    active = state.active |> Enum.reject(fn {_, link} -> link.to in gone end) |> Map.new()
    %{mark(state, ids, :closed) | active: active}
  end

  defp quiet?(state) do
    state.active
    |> Map.keys()
    |> Enum.all?(fn id ->
      {emitted, processed, dropped} = Counters.flow(state.counters[id])
      emitted == processed + dropped
    end)
  end

  defp quit(state) do
    alive = for {id, stage} <- state.stages, stage.state != :dead, do: id
    for id <- alive, do: send(state.stages[id].pid, {:situ, :quit})
    if state.phase != :stopping, do: watch_progress(state)
    next_step(%{state | phase: :stopping, step: :quit, pending: MapSet.new(alive)})
  end

  defp complete(state) do
    state = %{state | phase: :completed, progress: 1.0, start_time: state.start_time || 0}
    {_, state} = notify(state, :completed, View.report(state))
    duration = System.monotonic_time() - state.begun

    Telemetry.execute([:situ, :pipeline, :stop], %{duration: duration}, %{
      pipeline: state.settings.name,
      errors: length(state.errors)
    })

    state
  end

  # No counter moved for the whole stop timeout: what still owes an answer is stuck.
  defp watch_progress(state),
    do: Process.send_after(self(), {:situ_stuck, fingerprint(state)}, state.settings.stop_timeout)

  @spec stuck(t(), term()) :: t()
  def stuck(%{phase: :stopping} = state, mark) do
    if fingerprint(state) == mark, do: kill(state), else: watch_again(state)
  end

  def stuck(state, _mark), do: state

  defp watch_again(state) do
    watch_progress(state)
    state
  end

  defp kill(state) do
    late = late(state)
    names = Enum.map_join(late, ", ", fn stage -> hd(stage.vertices).path end)
    for stage <- late, do: Process.exit(stage.pid, :kill)

    error =
      Error.new(
        :stuck,
        "#{names} did not end within #{state.settings.stop_timeout} ms and was killed",
        why: "it neither took a message nor answered the stop",
        fix:
          "look for a loop or a call that never returns; raise stop_timeout: when it is just slow",
        meta: %{component: names}
      )

    state =
      if Enum.all?(late, &is_map_key(state.taps, &1.id)), do: state, else: failed(state, error)

    watch_progress(state)
    state
  end

  # Those that are in the middle of something; only if there are none, those that still owe an answer.
  defp late(state) do
    alive = for {_, stage} <- state.stages, stage.state != :dead, do: stage
    with [] <- Enum.reject(alive, &idle?/1), do: Enum.filter(alive, &owes?(&1, state))
  end

  defp owes?(stage, state) do
    MapSet.member?(state.pending, stage.id) or
      (state.step == :finalize and
         Enum.any?(state.active, fn {_, link} -> link.to == stage.id end))
  end

  defp idle?(stage) do
    case Process.info(stage.pid, [:message_queue_len, :current_function]) do
      [message_queue_len: 0, current_function: {:gen_server, _, _}] -> true
      nil -> true
      _ -> false
    end
  end

  defp fingerprint(state) do
    flows = for {_, ref} <- state.counters, do: Counters.flow(ref)
    {state.step, MapSet.size(state.pending), map_size(state.active), :erlang.phash2(flows)}
  end

  # Deaths and errors

  @spec exited(t(), pid(), term()) :: t()
  def exited(state, pid, reason) do
    case Map.pop(state.pids, pid) do
      {nil, _} -> state
      {id, pids} -> died(%{state | pids: pids}, id, state.stages[id], reason)
    end
  end

  defp died(state, _id, %{state: :dead}, _reason), do: next_step(state)

  defp died(%{step: :quit} = state, id, _stage, _reason) do
    next_step(%{mark(state, [id], :dead) | pending: MapSet.delete(state.pending, id)})
  end

  defp died(
         %{phase: :running} = state,
         id,
         %{vertices: [%{on_error: policy} | _]} = stage,
         reason
       )
       when policy in [:skip, :restart] do
    Tally.restarted(stage.tally, 0)
    state = noted(state, killed(stage, reason))
    spawn_stage(state, id, stage.vertices, stage.tally)
  end

  defp died(state, id, stage, reason) do
    state = failed(dead(state, id), killed(stage, reason))
    stop_after_death(state)
  end

  defp stop_after_death(%{step: :up} = state), do: quit(state)

  defp stop_after_death(%{phase: :running} = state),
    do: begin_stop(%{state | by_hand: true}, now(state))

  defp stop_after_death(state), do: next_step(state)

  # Its neighbours take it as closed.
  defp dead(state, id) do
    time = if state.clock, do: now(state), else: 0

    for {tag, link} <- state.active, link.from == id or link.to == id, link.from != link.to do
      other = if link.from == id, do: link.to, else: link.from
      send(state.stages[other].pid, {:situ, {:peer_gone, tag, time}})
    end

    active = state.active |> Enum.reject(fn {_, link} -> link.to == id end) |> Map.new()

    %{
      mark(state, [id], :dead)
      | active: active,
        order: List.delete(state.order, id),
        pending: MapSet.delete(state.pending, id),
        completable: MapSet.delete(state.completable, id)
    }
  end

  defp killed(stage, reason) do
    path = hd(stage.vertices).path

    Error.new(:component_killed, "#{path} was killed: #{inspect(reason, limit: 8)}",
      meta: %{component: path, reason: reason}
    )
  end

  defp stage_failed(state, id, error) do
    state = failed(mark(state, [id], :failed), error)
    state = %{state | completable: MapSet.delete(state.completable, id)}

    if state.phase == :running,
      do: begin_stop(%{state | by_hand: true}, now(state)),
      else: %{state | by_hand: true}
  end

  defp failed(state, error) do
    Logger.error(Exception.message(error))
    state = noted(state, error)
    %{state | errors: state.errors ++ [error]}
  end

  defp noted(state, error) do
    Telemetry.execute(
      [:situ, :component, :error],
      %{originating_time: error.meta[:originating_time]},
      %{
        pipeline: state.settings.name,
        component: error.meta[:component],
        error: error
      }
    )

    {_, state} = notify(state, :error, error)
    state
  end

  # Handlers run here; one that raises is an error of the pipeline. A handler may add others of its kind: they run too.
  defp notify(state, event, argument) do
    {:ok, call_handlers(state, event, argument, 0)}
  rescue
    error ->
      error =
        Error.new(
          :handler_failed,
          "the #{inspect(event)} handler failed: #{Exception.message(error)}",
          meta: %{exception: error, reason: error, stacktrace: __STACKTRACE__}
        )

      if event == :run,
        do: {:error, error},
        else: {:ok, %{state | errors: state.errors ++ [error]}}
  end

  defp call_handlers(%{graph: %{handlers: handlers}} = state, event, argument, done) do
    case Enum.drop(handlers, done) do
      [] ->
        state

      fresh ->
        {_, handlers} =
          Builder.lend(state.handle, state.graph, fn ->
            for({^event, fun} <- fresh, do: fun.(argument))
          end)

        state = %{state | graph: %{state.graph | handlers: handlers}}
        call_handlers(state, event, argument, done + length(fresh))
    end
  end

  defp mark(state, ids, how) do
    stages =
      Enum.reduce(ids, state.stages, fn id, stages ->
        Map.update!(
          stages,
          id,
          &%{&1 | state: if(&1.state == :running or how == :dead, do: how, else: &1.state)}
        )
      end)

    %{state | stages: stages}
  end

  defp now(%{clock: nil}), do: :os.system_time()
  defp now(state), do: Clock.now(state.clock)
  defp ids(state), do: state.stages |> Map.keys() |> MapSet.new()
end
