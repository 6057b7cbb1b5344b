defmodule Situ.Pipeline.Life do
  @moduledoc false
  # The life cycle as functions over the server's state: each takes an event and does the next step. Sends requests to
  # stages, never waits for them. Crew spawns stages, Ending closes and ends them in order, Death is for those that
  # end before their time, Watch for those that do not end, Notice tells others.
  alias Situ.{Clock, Telemetry}
  alias Situ.Graph.{Plan, Vertex}
  alias Situ.Diagnostics.Averages
  alias Situ.Pipeline.{Crew, Death, Ending, Inputs, Launch, Notice, Part, Taps, View, Watch}

  @catch_up_ms 1_000

  defstruct [
    :settings,
    :handle,
    :result,
    :owner,
    :clock,
    :latest_finite,
    :final,
    :begun,
    :plan,
    :drain_until,
    :stop_wish,
    :averages,
    graph: %Situ.Graph{},
    phase: :starting,
    step: :up,
    enforce: false,
    start_time: nil,
    replay_start: :unbounded,
    replay_end: :infinity,
    stages: %{},
    pids: %{},
    links: %{},
    counters: %{},
    pending: MapSet.new(),
    completable: MapSet.new(),
    finite: MapSet.new(),
    active: %{},
    order: [],
    closed: [],
    errors: [],
    progress: 0.0,
    waiters: [],
    replacing: %{},
    taps: %{},
    inputs: %{},
    parts: %{},
    moves: 0,
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

  @spec launch(t()) :: t()
  def launch(state) do
    case Plan.compile(state.graph) do
      {:ok, plan} -> begin(%{state | plan: plan})
      {:error, error} -> state |> Notice.failed(error) |> Ending.complete()
    end
  end

  defp begin(%{plan: %{stages: []}, settings: %{mode: :run}} = state),
    do: Ending.complete(timed(state))

  defp begin(%{plan: %{stages: []}} = state), do: state |> Crew.spawn_all() |> start_sources()
  defp begin(state), do: Crew.spawn_all(state)

  defp start_sources(state) do
    state = timed(state)
    Clock.listen(state.clock)

    state =
      View.observe(%{state | averages: Averages.new(state.settings.averaging, state.start_time)})

    case Notice.notify(state, :run, state.start_time) do
      {:ok, state} ->
        for {id, stage} <- state.stages,
            do: send(stage.pid, {:situ, {:start, Launch.wiring(id, state)}})

        next_step(%{state | step: :sources, pending: Crew.ids(state)})

      {:error, error} ->
        state |> Notice.failed(error) |> Ending.quit()
    end
  end

  defp timed(state) do
    timing = Launch.timing(state.settings, state.graph.proposals)

    Telemetry.execute([:situ, :pipeline, :start], %{system_time: :os.system_time()}, %{
      pipeline: state.settings.name
    })

    struct!(state, timing)
  end

  @spec event(t(), pos_integer(), term()) :: t()
  def event(%{phase: :completed} = state, _id, _event), do: state

  # The last words of a tap that is gone.
  def event(%{stages: stages} = state, id, _event) when not is_map_key(stages, id), do: state
  def event(state, id, :up), do: state |> up(id) |> next_step()
  def event(state, id, :started), do: state |> started(id) |> next_step()

  def event(state, id, :source_stopped),
    do: state |> Part.stopped(id) |> ready(id, :stop) |> next_step()

  def event(state, _id, :finalized), do: state

  def event(state, id, {:init_failed, error}) do
    state = Notice.failed(Death.dead(state, id), error)
    if state.step == :up, do: Ending.quit(state), else: Ending.begin(state, now(state))
  end

  def event(state, id, {:completed, time}), do: completed(state, id, time)

  def event(state, _id, {:unsubscribed, tag, _, _}),
    do: next_step(%{state | active: Map.delete(state.active, tag)})

  def event(state, id, {:failed, error}), do: Death.failed(state, id, error)
  def event(state, _id, {:skipped, error}), do: Notice.noted(state, error)

  def event(state, id, {:description, text}),
    do: %{state | descriptions: Map.put(state.descriptions, id, text)}

  def event(state, _id, {:tapped, tag}), do: Taps.opened(state, tag)
  def event(state, _id, {:lent, tag, how}), do: Inputs.lent(state, tag, how)

  def event(state, id, {:answered, ref, answer, opts}),
    do: next_step(Inputs.answered(state, ref, id, answer, opts))

  def event(state, id, {:detached, input, opts}),
    do: next_step(Inputs.detached(state, id, input, opts))

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

  @doc "Goes on when nothing is waited for any more."
  @spec next_step(t()) :: t()
  def next_step(%{step: step, pending: pending} = state)
      when step in [:up, :sources, :stop, :quit] do
    if MapSet.size(pending) == 0, do: step_done(state), else: state
  end

  def next_step(%{step: :finalize} = state), do: Ending.finalize(state)
  def next_step(state), do: Part.next(state)

  defp step_done(%{step: :up} = state), do: start_sources(state)

  defp step_done(%{step: :sources, early: early} = state) do
    for {_, stage} <- state.stages, do: send(stage.pid, {:situ, :run})
    state = %{state | phase: :running, step: :running, early: []}
    for message <- Enum.reverse(early), do: send(self(), message)

    cond do
      state.errors != [] -> Ending.begin(state, now(state))
      state.stop_wish != nil -> Ending.begin(state, time(state.stop_wish, state))
      true -> check_complete(state)
    end
  end

  defp step_done(%{step: :stop} = state), do: Ending.finalize(%{state | step: :finalize})
  defp step_done(%{step: :quit} = state), do: Ending.complete(state)

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
    {_, state} = Notice.notify(state, :component_completed, {path, time})
    finite = MapSet.put(state.finite, id)
    %{state | latest_finite: max(state.latest_finite || time, time), finite: finite}
  end

  @doc "Sources have been stopped for good: those that are left decide how long the pipeline runs; without any it ends."
  @spec without(t()) :: t()
  def without(state) do
    if Enum.any?(state.stages, fn {_, s} ->
         s.state == :running and Vertex.source?(hd(s.vertices))
       end),
       do: check_complete(state),
       else: stop(state)
  end

  defp check_complete(%{phase: :running, latest_finite: time} = state) when is_integer(time) do
    if MapSet.size(state.completable) == 0, do: Ending.begin(state, time), else: state
  end

  defp check_complete(state), do: state

  @spec stop(t()) :: t()
  def stop(%{phase: :building} = state) do
    Notice.abandoned(state.handle, nil)
    Ending.complete(%{state | plan: %Plan{}})
  end

  def stop(%{phase: :running} = state), do: Ending.begin(%{state | by_hand: true}, now(state))

  # What hangs in its start would keep the stop waiting.
  def stop(%{phase: :starting, stop_wish: nil} = state) do
    Watch.begin(state)
    %{state | stop_wish: :now, by_hand: true}
  end

  def stop(state), do: state

  @doc "The same at an originating time: sources go on up to it, and take the time they need."
  @spec stop(t(), Situ.Time.t()) :: t()
  def stop(%{phase: :running} = state, time), do: Ending.begin(state, time)

  def stop(%{phase: :starting, stop_wish: nil} = state, time) do
    Watch.begin(state)
    %{state | stop_wish: time}
  end

  def stop(state, _time), do: state

  defp time(:now, state), do: now(state)
  defp time(time, _state), do: time

  @doc "The clock; wall time before there is one."
  @spec now(t()) :: Situ.Time.t()
  def now(%{clock: nil}), do: :os.system_time()

  def now(state), do: Clock.now(state.clock)
end
