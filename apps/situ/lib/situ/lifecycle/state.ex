defmodule Situ.Lifecycle.Member do
  @moduledoc false
  # The life cycle's view of one stage.
  #
  #   status   :running, :failed (takes no more messages), :restarting, :closed, :dead (its process has ended), :ended
  #            (stopped as a part of a pipeline that keeps running)
  #   open?    whether its outputs have yet to close
  #   ends_at  the latest closing time among inputs that have closed
  #   limit    messages of the stage after this time do not count
  #   up?      whether its process has reported its initial state since the last spawn
  #   alive?   whether it has a process
  #   added?   whether it was added to the running pipeline
  #   unit     the composite that it restarts, or ends, together with
  #   again?   whether its process replaced an earlier one to which its neighbours still refer
  @enforce_keys [:id, :path]
  defstruct [
    :id,
    :path,
    :ends_at,
    :limit,
    :unit,
    source?: false,
    tap?: false,
    on_error: :stop,
    status: :running,
    open?: true,
    up?: false,
    alive?: true,
    added?: false,
    again?: false,
    restarts: 0
  ]

  @type t :: %__MODULE__{
          id: pos_integer(),
          path: String.t(),
          ends_at: Situ.Time.t() | nil,
          limit: Situ.Time.t() | nil,
          unit: {String.t(), :restart | :close} | nil,
          source?: boolean(),
          tap?: boolean(),
          on_error: :stop | :skip | :restart,
          status: :running | :failed | :restarting | :closed | :dead | :ended,
          open?: boolean(),
          up?: boolean(),
          alive?: boolean(),
          added?: boolean(),
          again?: boolean(),
          restarts: non_neg_integer()
        }
end

defmodule Situ.Lifecycle.Ending do
  @moduledoc false
  # When and how a pipeline ends.
  #
  #   wish     the requested end: `{time | :now, by_hand?}`; the pipeline begins to end as soon as it can
  #   final    the time up to which messages count
  #   by_hand  limits sources that lag behind the clock, and cycles that never rest, to `catch_up` ms
  #   enough?  whether these ms have passed
  #   drain    the last measurement of a cycle that has to come to rest: `{mark, polls}`
  #   latest   the latest end that a source has reported
  #   finite   the sources that have reported an end
  #   moves    how many movements occurred that the counters do not show
  defstruct [
    :wish,
    :final,
    :drain,
    :latest,
    finite: MapSet.new(),
    by_hand: false,
    enough?: false,
    catch_up: 1_000,
    moves: 0
  ]

  @type t :: %__MODULE__{
          wish: {Situ.Time.t() | :now, boolean()} | nil,
          final: Situ.Time.t() | nil,
          drain: {term(), non_neg_integer()} | nil,
          latest: Situ.Time.t() | nil,
          finite: MapSet.t(pos_integer()),
          by_hand: boolean(),
          enough?: boolean(),
          catch_up: non_neg_integer(),
          moves: non_neg_integer()
        }
end

defmodule Situ.Lifecycle.State do
  @moduledoc false
  # The life-cycle state of a pipeline, and the actions that the current event has led to. Pure.
  #
  #   pending  the stages that have yet to complete this step
  #   awaited  the sources that have not reported their end
  #   parts    the parts that are being stopped, by reference: Lifecycle.PartialStop
  #   growths  the parts that are being added, by reference: Lifecycle.Growth
  #   leaving  removed stages whose processes have ended: Lifecycle.Removal
  #   limits   `{restarts, ms}`: how often a stage may be restarted within `ms`; `stop_timeout` ms
  alias Situ.Lifecycle.{Ending, Links, Member}

  @type id :: pos_integer()
  @type phase :: :building | :starting | :running | :stopping | :completed
  @type step ::
          :build
          | :handlers
          | :up
          | :sources
          | :running
          | :settle
          | :stop
          | :close
          | :quit
          | :over

  defstruct phase: :building,
            step: :build,
            mode: :unlinked,
            stages: %{},
            links: %Links{},
            pending: MapSet.new(),
            awaited: MapSet.new(),
            ending: %Ending{},
            parts: %{},
            growths: %{},
            leaving: MapSet.new(),
            limits: %{restarts: {3, 5_000}, stop_timeout: 30_000},
            errors: [],
            closed: [],
            actions: []

  @type t :: %__MODULE__{
          phase: phase(),
          step: step(),
          mode: :run | :linked | :unlinked,
          stages: %{id() => Member.t()},
          links: Links.t(),
          pending: MapSet.t(id()),
          awaited: MapSet.t(id()),
          ending: Ending.t(),
          parts: %{(reference() | {:unit, String.t()}) => map()},
          growths: %{reference() => map()},
          leaving: MapSet.t(id()),
          limits: %{restarts: {non_neg_integer(), pos_integer()}, stop_timeout: pos_integer()},
          errors: [Situ.Error.t()],
          closed: [id()],
          actions: [Situ.Lifecycle.action()]
        }

  @doc "Adds an action; the server performs actions in the order in which they were added."
  @spec add_action(t(), term()) :: t()
  def add_action(state, action), do: %{state | actions: [action | state.actions]}

  @spec send_to_stages(t(), [id()], term()) :: t()
  def send_to_stages(state, ids, request),
    do: Enum.reduce(ids, state, &add_action(&2, {:tell, &1, request}))

  @spec update_member(t(), id(), (Member.t() -> Member.t())) :: t()
  def update_member(state, id, fun),
    do: %{state | stages: Map.update!(state.stages, id, fun)}

  @spec set_status(t(), Enumerable.t(), atom()) :: t()
  def set_status(state, ids, status),
    do: Enum.reduce(ids, state, &update_member(&2, &1, fn m -> change_status(m, status) end))

  # Any member can become `:dead`, and any that is not dead `:ended`.
  defp change_status(member, :dead), do: %{member | status: :dead, open?: false}
  defp change_status(%{status: :dead} = member, _status), do: member
  defp change_status(member, :ended), do: %{member | status: :ended, open?: false}
  defp change_status(%{status: :failed} = member, :closed), do: %{member | open?: false}
  defp change_status(member, :closed), do: %{member | status: :closed, open?: false}
  defp change_status(%{status: :running} = member, status), do: %{member | status: status}
  defp change_status(member, _status), do: member

  @doc "Records that the current step no longer waits for the stage."
  @spec clear_pending(t(), id()) :: t()
  def clear_pending(state, id), do: %{state | pending: MapSet.delete(state.pending, id)}

  @spec update_ending(t(), keyword()) :: t()
  def update_ending(state, changes), do: %{state | ending: struct!(state.ending, changes)}

  @doc "Requests the end of the pipeline at `time` or now; the first request counts."
  @spec request_end(t(), Situ.Time.t() | :now, boolean()) :: t()
  def request_end(%{ending: %{wish: nil}} = state, time, by_hand),
    do: update_ending(state, wish: {time, by_hand})

  def request_end(state, _time, _by_hand), do: state

  @doc "Adds an error that ends the pipeline."
  @spec add_error(t(), Situ.Error.t()) :: t()
  def add_error(state, error),
    do: add_action(%{state | errors: [error | state.errors]}, {:failed, error})

  @spec alive_ids(t()) :: [id()]
  def alive_ids(state), do: for({id, %{alive?: true}} <- state.stages, do: id)

  @doc "Returns a fingerprint that changes only when something happens."
  @spec progress_mark(t()) :: term()
  def progress_mark(state) do
    parts = for {_, part} <- state.parts, do: MapSet.size(part.pending)

    {state.step, MapSet.size(state.pending), map_size(state.links.active), parts,
     state.ending.moves}
  end
end
