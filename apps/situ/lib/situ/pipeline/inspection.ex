defmodule Situ.Pipeline.Inspection do
  @moduledoc false
  # Reports the state of a pipeline: report, snapshot and progress. Reads counters and sends no requests to components.
  alias Situ.Runtime
  alias Situ.Diagnostics.{Averages, Snapshot, SnapshotBuilder, Trace}
  alias Situ.Lifecycle.Operations
  alias Situ.Pipeline.{Report, Stages, State}
  alias Situ.Ports.{Counters, ErrorCounters}

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

  @spec build_result(State.t()) :: Situ.Pipeline.result()
  def build_result(state) do
    report = build_report(state)

    case report.errors do
      [] ->
        {:ok, report}

      [first | _] = errors ->
        meta = Map.merge(first.meta, %{errors: errors, report: report})
        {:error, %{first | meta: meta}}
    end
  end

  @doc "Asks components for their descriptions, at most five times a second; replies arrive later."
  @spec request_descriptions(State.t()) :: State.t()
  def request_descriptions(%{life: %{phase: :running}, view: %{described: described}} = state) do
    now = div(Runtime.monotonic_time(), 1_000_000)

    if described == nil or now - described > 200 do
      for {id, %{vertices: [%{module: module} | _]}} <- state.stages,
          state.life.stages[id].status == :running,
          module != :operator and function_exported?(module, :describe, 1),
          do: Stages.send_request(state, id, :describe)

      update_view(state, described: now)
    else
      state
    end
  end

  def request_descriptions(state), do: state

  @doc "Stores a component's description of itself."
  @spec put_description(State.t(), pos_integer(), String.t() | nil) :: State.t()
  def put_description(state, id, text),
    do: update_view(state, descriptions: Map.put(state.view.descriptions, id, text))

  @doc "Starts the averages, once the pipeline has a clock."
  @spec start_averaging(State.t()) :: State.t()
  def start_averaging(state) do
    averages = Averages.new(state.settings.averaging, state.timing.start_time)
    observe_totals(update_view(state, averages: averages))
  end

  defp update_view(state, changes), do: %{state | view: struct!(state.view, changes)}

  @doc "Records the totals now and every half averaging span, so that averages never cover a much older span."
  @spec observe_totals(State.t()) :: State.t()
  def observe_totals(%{view: %{averages: %{span: span}}} = state) do
    Runtime.send_after(:situ_observe, max(div(span, 2_000_000), @least_ms), :background)
    mark_totals(state)
  end

  @doc "Records the totals now."
  @spec mark_totals(State.t()) :: State.t()
  def mark_totals(%{view: %{averages: nil}} = state), do: state

  def mark_totals(%{view: view} = state),
    do:
      update_view(state,
        averages: Averages.add_mark(view.averages, clock_time(state), counter_totals(state))
      )

  defp counter_totals(state),
    do: Map.new(state.wires.counters, fn {id, ref} -> {id, Counters.read_totals(ref)} end)

  @spec build_snapshot(State.t()) :: Snapshot.t()
  def build_snapshot(state) do
    state = advance_progress(state)
    time = clock_time(state)
    totals = counter_totals(state)

    averages = state.view.averages

    SnapshotBuilder.take_snapshot(%{
      name: state.settings.name,
      state: state.life.phase,
      time: time,
      start_time: start_time(state) || 0,
      progress: state.view.progress,
      graph: state.graph,
      taps: for({id, %{tap?: true}} <- state.life.stages, do: id),
      stages:
        Enum.map(state.stages, fn {id, stage} ->
          Map.put(stage, :state, display_status(id, state))
        end),
      counters: state.wires.counters,
      totals: totals,
      windows: if(averages, do: Averages.build_windows(averages, time, totals), else: %{}),
      descriptions: state.view.descriptions
    })
  end

  @doc "Returns the operations that have changed the pipeline, the newest first."
  @spec list_changes(State.t()) :: [map()]
  def list_changes(state) do
    for %{what: {change, subject}} = operation <- Operations.list(state.life.operations) do
      operation
      |> Map.take([:id, :by, :state, :accepted, :ended])
      |> Map.merge(%{change: change, subject: subject})
    end
  end

  @doc "Returns where the message of an originating time is."
  @spec trace_message(State.t(), Situ.Time.t()) :: Trace.t()
  def trace_message(state, time) do
    Trace.new(time, clock_time(state), %{
      links: state.wires.links,
      counters: state.wires.counters,
      stages: state.stages
    })
  end

  @spec advance_progress(State.t()) :: State.t()
  def advance_progress(%{life: %{phase: :completed}} = state),
    do: update_view(state, progress: 1.0)

  def advance_progress(state),
    do:
      update_view(state, progress: max(state.view.progress, min(estimate_progress(state), 0.999)))

  defp estimate_progress(%{timing: nil}), do: 0.0

  defp estimate_progress(%{timing: %{replay_end: replay_end, start_time: start} = timing} = state)
       when is_integer(replay_end) and replay_end > start do
    reached = if timing.enforce, do: clock_time(state), else: last_time(state)
    max((reached - start) / (replay_end - start), 0.0)
  end

  defp estimate_progress(state) do
    all = map_size(state.life.stages)
    open = Enum.count(state.life.stages, fn {_, member} -> member.open? end)
    if all == 0, do: 0.0, else: 0.9 * (all - open) / all
  end

  defp last_time(state) do
    reached =
      for {_, ref} <- state.wires.counters, time = Counters.last_time(ref), time != 0, do: time

    if reached == [], do: state.timing.start_time, else: Enum.sum(reached) |> div(length(reached))
  end

  defp display_status(id, state) do
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
  @spec build_report(State.t()) :: Report.t()
  def build_report(state) do
    skipped =
      for {_, stage} <- state.stages,
          {vertex, index} <- Enum.with_index(stage.vertices),
          %{skipped: n} when n > 0 <- [ErrorCounters.read_counts(stage.tally, index)],
          into: %{},
          do: {vertex.path, n}

    duration = System.monotonic_time() - state.view.begun

    %Report{
      name: state.settings.name,
      result: state.result,
      start_time: start_time(state) || 0,
      final_time: state.life.ending.final,
      snapshot: build_snapshot(state),
      duration: System.convert_time_unit(duration, :native, :nanosecond),
      errors: Enum.reverse(state.life.errors),
      skipped: skipped,
      closed: closed_paths(state)
    }
  end

  # The operators of a chain close at the same time.
  defp closed_paths(state) do
    for id <- Enum.reverse(state.life.closed),
        stage = state.stages[id],
        vertex <- stage.vertices,
        do: vertex.path
  end

  defp clock_time(%{timing: nil}), do: 0
  defp clock_time(state), do: State.now(state)
end
