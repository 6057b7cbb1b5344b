defmodule Situ.Lifecycle.Member do
  @moduledoc false
  # The life cycle's view of one stage.
  #
  #   status   :running, :failed (takes nothing any more), :restarting, :closed, :dead (its process is), :ended
  #            (stopped as a part of a
  #            pipeline that runs on)
  #   open?    whether its outputs have yet to close
  #   ends_at  the latest closing time among inputs that have closed; limit: nothing of it counts behind that time
  #   up?      whether its process has said so since it was spawned last; alive?: whether there is a process
  #   added?   whether it was added to the running pipeline
  #   unit     the composite that it restarts, or ends, together with
  #   again?   whether that process took the place of another, and its neighbours do not know it yet
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
  #   wish     somebody wants it to end: `{time | :now, by_hand?}`; begins as soon as it can
  #   final    the time up to which messages count
  #   by_hand  sources that lag behind the clock, and cycles that never rest, may go on for `catch_up` ms only
  #   enough?  those ms have passed
  #   drain    what was measured last of a cycle that is waited for: `{mark, polls}`
  #   latest   the latest end that a source has told; finite: the sources that have told one
  #   moves    how often something has moved that no counter shows
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
  # The state of a pipeline's life, and the actions that the event at hand has led to. Pure.
  #
  #   pending  the stages that owe an answer in this step
  #   awaited  the sources that have not told their end
  #   parts    what is being stopped alone, by reference: Lifecycle.PartialStop
  #   growths  what is being added, by reference: Lifecycle.Growth
  #   leaving  removed stages whose processes have ended: Lifecycle.Removal
  #   limits   `{restarts, ms}`: how often in how long a stage may be restarted; `stop_timeout` ms
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

  @doc "Adds an action; the server carries actions out in the order in which they were added."
  @spec act(t(), term()) :: t()
  def act(state, action), do: %{state | actions: [action | state.actions]}

  @spec tell(t(), [id()], term()) :: t()
  def tell(state, ids, request), do: Enum.reduce(ids, state, &act(&2, {:tell, &1, request}))

  @spec change(t(), id(), (Member.t() -> Member.t())) :: t()
  def change(state, id, fun),
    do: %{state | stages: Map.update!(state.stages, id, fun)}

  @spec mark(t(), Enumerable.t(), atom()) :: t()
  def mark(state, ids, status),
    do: Enum.reduce(ids, state, &change(&2, &1, fn m -> become(m, status) end))

  # Any member can become `:dead`, and any that is not dead `:ended`.
  defp become(member, :dead), do: %{member | status: :dead, open?: false}
  defp become(%{status: :dead} = member, _status), do: member
  defp become(member, :ended), do: %{member | status: :ended, open?: false}
  defp become(%{status: :failed} = member, :closed), do: %{member | open?: false}
  defp become(member, :closed), do: %{member | status: :closed, open?: false}
  defp become(%{status: :running} = member, status), do: %{member | status: status}
  defp become(member, _status), do: member

  @doc "The stage owes no answer any more."
  @spec answered(t(), id()) :: t()
  def answered(state, id), do: %{state | pending: MapSet.delete(state.pending, id)}

  @spec ending(t(), keyword()) :: t()
  def ending(state, changes), do: %{state | ending: struct!(state.ending, changes)}

  @doc "The pipeline is to end: at `time`, or now. The first wish counts."
  @spec wish(t(), Situ.Time.t() | :now, boolean()) :: t()
  def wish(%{ending: %{wish: nil}} = state, time, by_hand),
    do: ending(state, wish: {time, by_hand})

  def wish(state, _time, _by_hand), do: state

  @doc "An error that ends the pipeline."
  @spec error(t(), Situ.Error.t()) :: t()
  def error(state, error), do: act(%{state | errors: [error | state.errors]}, {:failed, error})

  @spec alive(t()) :: [id()]
  def alive(state), do: for({id, %{alive?: true}} <- state.stages, do: id)

  @doc "A fingerprint that stays the same while nothing happens."
  @spec mark_of(t()) :: term()
  def mark_of(state) do
    parts = for {_, part} <- state.parts, do: MapSet.size(part.pending)

    {state.step, MapSet.size(state.pending), map_size(state.links.active), parts,
     state.ending.moves}
  end
end
