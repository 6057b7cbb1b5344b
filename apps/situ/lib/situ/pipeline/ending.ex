defmodule Situ.Pipeline.Ending do
  @moduledoc false
  # How a pipeline ends: sources stop, outputs close in order (Finalizer), stages quit, the result is published.
  alias Situ.Graph.Vertex
  alias Situ.Pipeline.{Crew, Finalizer, Life, Notice, Part, Upstream, View, Watch}
  alias Situ.Stage.Counters
  alias Situ.Telemetry

  @drain_ms 1_000

  @doc "Sources are asked to stop at `time`; everything else follows."
  @spec begin(Life.t(), Situ.Time.t()) :: Life.t()
  def begin(%{phase: :running} = state, time) do
    final = max(time, state.latest_finite || time)
    cut(state, final)

    sources =
      for {id, %{state: :running, vertices: [head | _]}} <- state.stages,
          Vertex.source?(head) and Part.of(state, id) == nil,
          do: id

    # Those that are being stopped alone have been asked already.
    asked = for {_, part} <- state.parts, id <- part.pending, do: id

    for id <- sources, do: send(state.stages[id].pid, {:situ, {:stop, final}})
    Watch.begin(state)
    if state.by_hand, do: Process.send_after(self(), :situ_enough, state.catch_up)

    Life.next_step(%{
      state
      | phase: :stopping,
        step: :stop,
        final: final,
        pending: MapSet.new(sources ++ asked)
    })
  end

  def begin(state, time), do: %{state | stop_wish: time}

  # What is later than the end does not count: it has run ahead. Where every source upstream has given all it has, nothing has,
  # and what operators made later than their inputs (`merge`, by the clock) belongs to the result.
  defp cut(state, final) do
    whole = Upstream.whole(state.stages, Map.values(state.links), state.finite)

    for {id, stage} <- state.stages,
        not MapSet.member?(whole, id),
        do: :atomics.put(stage.control, 1, final)
  end

  # Stopped by hand, sources that lag behind the clock may catch up to it, but not for ever: they end where they are.
  # After completion they do go on to the end: that is what makes a replay the same each time.
  @spec enough(Life.t()) :: Life.t()
  def enough(%{step: :stop, by_hand: true} = state) do
    for id <- state.pending, do: send(state.stages[id].pid, {:situ, :stop_now})
    state
  end

  def enough(state), do: state

  @doc "Closes what may be closed now."
  @spec finalize(Life.t()) :: Life.t()
  def finalize(state) do
    case Finalizer.next(state.order, Map.values(state.active)) do
      {:close, ids} -> finalize(close(state, ids, state.final))
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
      finalize(close(%{state | drain_until: nil}, ids, state.final))
    else
      Process.send_after(self(), :situ_recheck, 1)
      %{state | drain_until: until}
    end
  end

  @spec recheck(Life.t()) :: Life.t()
  def recheck(%{step: :finalize} = state), do: finalize(state)
  def recheck(state), do: state

  @doc "The outputs of these stages close at `time`; nothing is waited for."
  @spec close(Life.t(), [pos_integer()], Situ.Time.t()) :: Life.t()
  def close(state, ids, time) do
    for id <- ids, do: send(state.stages[id].pid, {:situ, {:finalize, time}})
    paths = for id <- ids, vertex <- state.stages[id].vertices, do: vertex.path
    gone = for id <- ids, %{state: :dead} <- [state.stages[id]], do: id

    state = %{state | order: state.order -- ids, closed: Enum.reverse(paths) ++ state.closed}
    active = state.active |> Enum.reject(fn {_, link} -> link.to in gone end) |> Map.new()
    %{Crew.mark(state, ids, :closed) | active: active}
  end

  @doc "Whether no message is on its way between its processes."
  @spec quiet?(Life.t()) :: boolean()
  def quiet?(state) do
    state.active
    |> Map.keys()
    |> Enum.all?(fn id ->
      {emitted, processed, dropped} = Counters.flow(state.counters[id])
      emitted == processed + dropped
    end)
  end

  @doc "Everything is closed: stages end."
  @spec quit(Life.t()) :: Life.t()
  def quit(state) do
    alive =
      for {id, stage} <- state.stages,
          stage.state != :dead and is_map_key(state.pids, stage.pid),
          do: id

    for id <- alive, do: send(state.stages[id].pid, {:situ, :quit})
    if state.phase != :stopping, do: Watch.begin(state)
    Life.next_step(%{state | phase: :stopping, step: :quit, pending: MapSet.new(alive)})
  end

  @doc "All is final."
  @spec complete(Life.t()) :: Life.t()
  def complete(state) do
    state = %{state | phase: :completed, progress: 1.0, start_time: state.start_time || 0}
    {_, state} = Notice.notify(state, :completed, View.report(state))
    duration = System.monotonic_time() - state.begun

    Telemetry.execute([:situ, :pipeline, :stop], %{duration: duration}, %{
      pipeline: state.settings.name,
      errors: length(state.errors)
    })

    state
  end
end
