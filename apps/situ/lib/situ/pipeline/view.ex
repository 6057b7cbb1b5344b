defmodule Situ.Pipeline.View do
  @moduledoc false
  # What there is to see of a pipeline: report, snapshot, progress. Reads counters; asks no component.
  alias Situ.Clock
  alias Situ.Diagnostics.{Averages, Snapshot, Survey}
  alias Situ.Pipeline.{Life, Report}
  alias Situ.Stage.{Counters, Tally}

  # However short the averaging span: looking costs something.
  @least_ms 50

  @spec result(Life.t()) :: Situ.Pipeline.result()
  def result(%{errors: []} = state), do: {:ok, report(state)}

  def result(%{errors: [first | _] = errors} = state) do
    meta = Map.merge(first.meta, %{errors: errors, report: report(state)})
    {:error, %{first | meta: meta}}
  end

  @doc "Asks components that describe themselves for a line, at most five times a second; answers come when they come."
  @spec describe(Life.t()) :: Life.t()
  def describe(%{phase: :running} = state) do
    now = System.monotonic_time(:millisecond)

    if state.described == nil or now - state.described > 200 do
      for {_, %{state: :running, vertices: [%{module: module} | _], pid: pid}} <- state.stages,
          module != :operator and function_exported?(module, :describe, 1),
          do: send(pid, {:situ, :describe})

      %{state | described: now}
    else
      state
    end
  end

  def describe(state), do: state

  @doc "Remembers the totals now, and again in half an averaging span: what means are taken over is never much older."
  @spec observe(Life.t()) :: Life.t()
  def observe(%{averages: %{span: span}} = state) do
    Process.send_after(self(), :situ_observe, max(div(span, 2_000_000), @least_ms))
    mark(state)
  end

  @doc "Remembers the totals now."
  @spec mark(Life.t()) :: Life.t()
  def mark(%{averages: nil} = state), do: state
  def mark(%{clock: nil} = state), do: state

  def mark(state),
    do: %{state | averages: Averages.mark(state.averages, now(state), totals(state))}

  defp totals(state), do: Map.new(state.counters, fn {id, ref} -> {id, Counters.totals(ref)} end)

  @spec snapshot(Life.t()) :: Snapshot.t()
  def snapshot(state) do
    state = advance_progress(state)
    time = now(state)
    totals = totals(state)

    Survey.snapshot(%{
      name: state.settings.name,
      state: state.phase,
      time: time,
      start_time: state.start_time || 0,
      progress: state.progress,
      graph: state.graph,
      stages:
        Enum.map(state.stages, fn {_, stage} -> %{stage | state: shown(stage.state, state)} end),
      counters: state.counters,
      totals: totals,
      windows: if(state.averages, do: Averages.windows(state.averages, time, totals), else: %{}),
      descriptions: state.descriptions
    })
  end

  @spec advance_progress(Life.t()) :: Life.t()
  def advance_progress(%{phase: :completed} = state), do: state

  def advance_progress(state),
    do: %{state | progress: max(state.progress, min(estimate(state), 0.999))}

  defp estimate(%{clock: nil}), do: 0.0

  defp estimate(%{replay_end: replay_end, start_time: start} = state)
       when is_integer(replay_end) and replay_end > start do
    reached = if state.enforce, do: now(state), else: last_time(state)
    max((reached - start) / (replay_end - start), 0.0)
  end

  defp estimate(state) do
    all = Enum.count(state.stages)
    if all == 0, do: 0.0, else: 0.9 * (all - length(state.order)) / all
  end

  defp last_time(state) do
    reached = for {_, ref} <- state.counters, time = Counters.last_time(ref), time != 0, do: time
    if reached == [], do: state.start_time, else: Enum.sum(reached) |> div(length(reached))
  end

  defp shown(:dead, %{phase: :completed}), do: :closed
  defp shown(:dead, _state), do: :failed
  defp shown(:ended, _state), do: :closed
  defp shown(other, _state), do: other

  @doc "The report up to now."
  @spec report(Life.t()) :: Report.t()
  def report(state) do
    skipped =
      for {_, stage} <- state.stages,
          {vertex, index} <- Enum.with_index(stage.vertices),
          %{skipped: n} when n > 0 <- [Tally.read(stage.tally, index)],
          into: %{},
          do: {vertex.path, n}

    %Report{
      name: state.settings.name,
      result: state.result,
      start_time: state.start_time,
      final_time: state.final,
      snapshot: snapshot(state),
      duration:
        System.convert_time_unit(System.monotonic_time() - state.begun, :native, :nanosecond),
      errors: state.errors,
      skipped: skipped,
      closed: Enum.reverse(state.closed)
    }
  end

  defp now(%{clock: nil}), do: 0
  defp now(state), do: Clock.now(state.clock)
end
