defmodule Situ.Lifecycle.State do
  @moduledoc false
  # The life-cycle state of a pipeline, and the actions that the current event has led to. Pure.
  #
  #   pending  the stages that have yet to complete this step
  #   awaited  the sources that have not reported their end
  #   parts    the parts that are being stopped, by reference: Lifecycle.PartialStop
  #   growths  the parts that are being added, by reference: Lifecycle.Addition
  #   operations  the log of the changes to the running pipeline: Lifecycle.Operations
  #   leaving  removed stages whose processes have ended: Lifecycle.Removal
  #   limits   `{restarts, ms}`: how often a stage may be restarted within `ms`; `stop_timeout` ms
  alias Situ.Lifecycle.{EndState, Links, Member, Operations}

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
            ending: %EndState{},
            parts: %{},
            growths: %{},
            operations: %Operations{},
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
          ending: EndState.t(),
          parts: %{Operations.id() => map()},
          growths: %{Operations.id() => map()},
          operations: Operations.t(),
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

  @doc """
  Asks these sources to stop at `time`. The new process of a restarted source is asked when it has started, since it has
  no clock before.
  """
  @spec stop_started_sources(t(), [id()], Situ.Time.t()) :: t()
  def stop_started_sources(state, ids, time),
    do: send_to_stages(state, Enum.reject(ids, &state.stages[&1].again?), {:stop, time})

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
  # A stage that was shut down for a restart is still expected to end.
  defp change_status(%{status: status} = member, :closed) when status in [:failed, :restarting],
    do: %{member | open?: false}

  defp change_status(member, :closed), do: %{member | status: :closed, open?: false}
  defp change_status(%{status: :running} = member, status), do: %{member | status: status}
  defp change_status(member, _status), do: member

  @doc "Records that the current step no longer waits for the stage."
  @spec clear_pending(t(), id()) :: t()
  def clear_pending(state, id), do: %{state | pending: MapSet.delete(state.pending, id)}

  @doc "Records that no part that is being stopped waits for the source: it has posted its last message, or has died."
  @spec mark_source_stopped(t(), id()) :: t()
  def mark_source_stopped(%{parts: parts} = state, _id) when parts == %{}, do: state

  def mark_source_stopped(%{parts: parts} = state, id) do
    parts = Map.new(parts, fn {ref, p} -> {ref, %{p | pending: MapSet.delete(p.pending, id)}} end)
    %{state | parts: parts}
  end

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
