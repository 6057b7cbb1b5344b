defmodule Situ.Pipeline.Inspection do
  @moduledoc false
  # Reports the state of a pipeline: report, snapshot and progress. Reads counters and sends no requests to components.
  alias Situ.Diagnostics.{Averages, Snapshot, Survey, Trace}
  alias Situ.Pipeline.{Report, State}
  alias Situ.Ports.{Counters, Tally}

  # The minimum interval between two observations, because each one costs some time.
  @least_ms 50

  defstruct [:averages, :described, :outcome, begun: 0, progress: 0.0, descriptions: %{}]

  @typedoc """
  `begun` and `described` are monotonic times, in native units and ms. `progress` never decreases. `outcome` is the
  final result.
  """
  @type t :: %__MODULE__{
          averages: Averages.t() | nil,
          described: integer() | nil,
          outcome: Situ.Pipeline.result() | nil,
          begun: integer(),
          progress: float(),
          descriptions: %{pos_integer() => String.t() | nil}
        }

  @spec result(State.t()) :: Situ.Pipeline.result()
  def result(state) do
    report = report(state)

    case report.errors do
      [] ->
        {:ok, report}

      [first | _] = errors ->
        meta = Map.merge(first.meta, %{errors: errors, report: report})
        {:error, %{first | meta: meta}}
    end
  end

  @doc "Asks components with `describe/1` for a description, at most five times a second; replies arrive later."
  @spec describe(State.t()) :: State.t()
  def describe(%{life: %{phase: :running}, view: %{described: described}} = state) do
    now = System.monotonic_time(:millisecond)

    if described == nil or now - described > 200 do
      for {id, %{vertices: [%{module: module} | _], pid: pid}} <- state.stages,
          state.life.stages[id].status == :running,
          module != :operator and function_exported?(module, :describe, 1),
          do: send(pid, {:situ, :describe})

      remember(state, described: now)
    else
      state
    end
  end

  def describe(state), do: state

  @doc "Stores a component's description of itself."
  @spec described(State.t(), pos_integer(), String.t() | nil) :: State.t()
  def described(state, id, text),
    do: remember(state, descriptions: Map.put(state.view.descriptions, id, text))

  @doc "Starts the averages, once the pipeline has a clock."
  @spec begin(State.t()) :: State.t()
  def begin(state) do
    averages = Averages.new(state.settings.averaging, state.timing.start_time)
    observe(remember(state, averages: averages))
  end

  defp remember(state, changes), do: %{state | view: struct!(state.view, changes)}

  @doc "Records the totals now and every half averaging span, so that averages never cover a much older span."
  @spec observe(State.t()) :: State.t()
  def observe(%{view: %{averages: %{span: span}}} = state) do
    Process.send_after(self(), :situ_observe, max(div(span, 2_000_000), @least_ms))
    mark(state)
  end

  @doc "Records the totals now."
  @spec mark(State.t()) :: State.t()
  def mark(%{view: %{averages: nil}} = state), do: state

  def mark(%{view: view} = state),
    do: remember(state, averages: Averages.mark(view.averages, now(state), totals(state)))

  defp totals(state),
    do: Map.new(state.wires.counters, fn {id, ref} -> {id, Counters.totals(ref)} end)

  @spec snapshot(State.t()) :: Snapshot.t()
  def snapshot(state) do
    state = advance_progress(state)
    time = now(state)
    totals = totals(state)

    averages = state.view.averages

    Survey.snapshot(%{
      name: state.settings.name,
      state: state.life.phase,
      time: time,
      start_time: start_time(state) || 0,
      progress: state.view.progress,
      graph: state.graph,
      taps: for({id, %{tap?: true}} <- state.life.stages, do: id),
      stages:
        Enum.map(state.stages, fn {id, stage} -> Map.put(stage, :state, shown(id, state)) end),
      counters: state.wires.counters,
      totals: totals,
      windows: if(averages, do: Averages.windows(averages, time, totals), else: %{}),
      descriptions: state.view.descriptions
    })
  end

  @doc "Returns where the message of an originating time is."
  @spec trace(State.t(), Situ.Time.t()) :: Trace.t()
  def trace(state, time) do
    Trace.new(time, now(state), %{
      links: state.wires.links,
      counters: state.wires.counters,
      stages: state.stages
    })
  end

  @spec advance_progress(State.t()) :: State.t()
  def advance_progress(%{life: %{phase: :completed}} = state), do: remember(state, progress: 1.0)

  def advance_progress(state),
    do: remember(state, progress: max(state.view.progress, min(estimate(state), 0.999)))

  defp estimate(%{timing: nil}), do: 0.0

  defp estimate(%{timing: %{replay_end: replay_end, start_time: start} = timing} = state)
       when is_integer(replay_end) and replay_end > start do
    reached = if timing.enforce, do: now(state), else: last_time(state)
    max((reached - start) / (replay_end - start), 0.0)
  end

  defp estimate(state) do
    all = map_size(state.life.stages)
    open = Enum.count(state.life.stages, fn {_, member} -> member.open? end)
    if all == 0, do: 0.0, else: 0.9 * (all - open) / all
  end

  defp last_time(state) do
    reached =
      for {_, ref} <- state.wires.counters, time = Counters.last_time(ref), time != 0, do: time

    if reached == [], do: state.timing.start_time, else: Enum.sum(reached) |> div(length(reached))
  end

  defp shown(id, state) do
    case state.life.stages do
      %{^id => %{status: :dead}} -> if(state.life.phase == :completed, do: :closed, else: :failed)
      %{^id => %{status: :ended}} -> :closed
      %{^id => %{status: :restarting}} -> :running
      %{^id => %{status: status}} -> status
      _ -> :running
    end
  end

  defp start_time(%{timing: nil}), do: nil
  defp start_time(state), do: state.timing.start_time

  @doc "Returns the report up to now."
  @spec report(State.t()) :: Report.t()
  def report(state) do
    skipped =
      for {_, stage} <- state.stages,
          {vertex, index} <- Enum.with_index(stage.vertices),
          %{skipped: n} when n > 0 <- [Tally.read(stage.tally, index)],
          into: %{},
          do: {vertex.path, n}

    duration = System.monotonic_time() - state.view.begun

    %Report{
      name: state.settings.name,
      result: state.result,
      start_time: start_time(state) || 0,
      final_time: state.life.ending.final,
      snapshot: snapshot(state),
      duration: System.convert_time_unit(duration, :native, :nanosecond),
      errors: Enum.reverse(state.life.errors),
      skipped: skipped,
      closed: closed(state)
    }
  end

  # All operators of a chain close together.
  defp closed(state) do
    for id <- Enum.reverse(state.life.closed),
        stage = state.stages[id],
        vertex <- stage.vertices,
        do: vertex.path
  end

  defp now(%{timing: nil}), do: 0
  defp now(state), do: State.now(state)
end
