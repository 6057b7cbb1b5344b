defmodule Situ.Pipeline.Dynamic do
  @moduledoc false
  # Performs the operations of the life cycle's log (Lifecycle.Operations) on a running pipeline. The functions return
  # events: `{:finished, id, reply}` when an operation has been applied or refused, now or later.
  #
  #   taps        by the id of their stage: Dynamic.Tap
  #   inputs      inputs being added or removed: Dynamic.Input
  #   checkpoint  the current checkpoint: PendingCheckpoint
  #   replaces    the current replacement of each stage: Dynamic.Replacement
  alias Situ.{Clock, Graph}
  alias Situ.Lifecycle.{Errors, Operations}
  alias Situ.Pipeline.{PendingCheckpoint, State}
  alias Situ.Pipeline.Dynamic.{Extension, Input, Replacement, Tap}

  defstruct taps: %{}, inputs: %{}, replaces: %{}, checkpoint: nil

  @type t :: %__MODULE__{
          taps: %{pos_integer() => map()},
          inputs: %{term() => map()},
          replaces: %{pos_integer() => map()},
          checkpoint: map() | nil
        }
  @type events :: [Situ.Lifecycle.event()]

  @doc "Returns the keys of the running pipeline that a request reads and writes."
  @spec scope(State.t(), tuple()) :: Operations.scope()
  def scope(_state, {:clock, :pause}), do: new_scope({:pause, nil}, [], [:graph, :clock])
  def scope(_state, {:clock, {change, _value}}), do: new_scope({change, nil}, [], [:clock])
  def scope(_state, {:clock, change}), do: new_scope({change, nil}, [], [:clock])

  def scope(_state, {:checkpoint, _timeout}),
    do: new_scope({:checkpoint, nil}, [], [:graph, :checkpoint])

  def scope(state, {:extend, graph}) do
    names = Map.keys(graph.paths) ++ Map.keys(graph.scopes)
    sources = Enum.uniq(for {_, %{from: {id, _}}} <- graph.edges, do: id)
    reads = Enum.flat_map(sources, &(stage_keys(state, &1) ++ path_keys(state, &1)))
    writes = names |> Enum.flat_map(&outer_paths/1) |> Enum.uniq()
    new_scope({:extend, Enum.min(names, fn -> nil end)}, [:graph | reads], writes)
  end

  def scope(state, {kind, path, how}) when kind in [:stop_part, :start_part] do
    kind = if match?(%{forget?: true}, how), do: :remove, else: kind
    new_scope({kind, path}, [:graph], [{:path, path} | State.list_inside(state, path)])
  end

  def scope(state, {:replace, %{node: node}}) do
    ids = with {:ok, %{id: id}} <- State.fetch_vertex(state, node), do: [id], else: (_ -> [])
    component_scope(state, {:replace, subject(node)}, [], ids)
  end

  def scope(state, {:tap, %{stream: stream}}),
    do: component_scope(state, {:tap, subject(stream)}, port_ids(state, stream), [])

  def scope(state, {:attach, %{taker: taker, stream: stream}}) do
    sources = port_ids(state, stream)
    component_scope(state, {:attach, subject(taker)}, sources, port_ids(state, taker))
  end

  def scope(state, {:detach, %{taker: taker}}),
    do: component_scope(state, {:detach, subject(taker)}, [], port_ids(state, taker))

  defp new_scope(what, reads, writes), do: %{what: what, reads: reads, writes: writes}

  # An operation on a component waits until the component has been added.
  defp component_scope(state, what, sources, changed) do
    paths = Enum.flat_map(sources ++ changed, &path_keys(state, &1))
    reads = Enum.flat_map(sources, &stage_keys(state, &1))
    new_scope(what, [:graph | paths ++ reads], Enum.flat_map(changed, &stage_keys(state, &1)))
  end

  defp port_ids(state, which),
    do: with({:ok, {id, _output}} <- State.fetch_port(state, which), do: [id], else: (_ -> []))

  defp path_keys(state, id),
    do: for(%{path: path} <- [state.graph.vertices[id]], do: {:path, path})

  defp stage_keys(state, id) do
    case State.fetch_stage(state, id) do
      {:ok, stage, _index} -> [stage.id]
      {:error, _error} -> []
    end
  end

  # A composite is changed by everything that is added inside it.
  defp outer_paths(path) do
    path
    |> String.split(".")
    |> Enum.scan(&(&2 <> "." <> &1))
    |> Enum.map(&{:path, &1})
  end

  defp subject(%Situ.Node{path: path}), do: path
  defp subject(name) when is_binary(name), do: name
  defp subject(_port), do: nil

  @doc "Begins an operation that no longer waits for others."
  @spec perform(State.t(), Operations.id(), tuple(), GenServer.from() | nil) ::
          {State.t(), events()}
  def perform(state, id, request, from) do
    cond do
      from != nil and not caller_alive?(from) ->
        refuse(state, id, Errors.caller_ended())

      member = find_restarting(state, id, request) ->
        refuse(state, id, Errors.component_restarted(member.path))

      true ->
        begin_operation(state, id, request, from)
    end
  end

  # The new process of a stage has no clock and no connections before it has started.
  defp find_restarting(state, id, {kind, _}) when kind in [:tap, :attach, :detach, :replace] do
    %{reads: reads, writes: writes} = state.life.operations.open[id]
    members = for key <- reads ++ writes, %{^key => member} <- [state.life.stages], do: member
    Enum.find(members, & &1.again?)
  end

  defp find_restarting(_state, _id, _request), do: nil

  defp caller_alive?({pid, _tag}), do: node(pid) != node() or Process.alive?(pid)

  defp begin_operation(state, id, {:extend, %Graph{} = graph}, _from) do
    case Extension.add_components(state, graph) do
      {:ok, state, plan} -> {state, [{:grow, id, plan, {:operation, id}}]}
      {:error, error} -> refuse(state, id, error)
    end
  end

  defp begin_operation(state, id, {:stop_part, path, %{forget?: forget?} = how}, _from) do
    case State.fetch_part(state, path, forget?) do
      {:ok, %{ids: ids, forget: forget}} ->
        opts = Map.merge(how, %{from: {:operation, id}, forget: forget})
        {state, [{:stop_part, id, ids, opts}]}

      {:error, error} ->
        refuse(state, id, error)
    end
  end

  defp begin_operation(state, id, {:start_part, path, how}, _from) do
    case State.fetch_stopped_part(state, path) do
      {:ok, ids} -> {state, [{:start_part, id, ids, how, {:operation, id}}]}
      {:error, error} -> refuse(state, id, error)
    end
  end

  defp begin_operation(state, id, {:tap, request}, {owner, _tag}),
    do: Tap.attach(state, id, request, owner)

  defp begin_operation(state, id, {:attach, request}, _from),
    do: Input.attach(state, id, request)

  defp begin_operation(state, id, {:detach, request}, _from),
    do: Input.detach(state, id, request)

  defp begin_operation(state, id, {:replace, request}, _from),
    do: Replacement.replace(state, id, request)

  defp begin_operation(state, id, {:checkpoint, timeout}, {pid, _tag}),
    do: PendingCheckpoint.begin(state, id, timeout, pid)

  # Without pacing no message waits for the clock, so the clock cannot be controlled.
  defp begin_operation(%{timing: %{enforce: false}} = state, id, {:clock, _change}, _from),
    do: refuse(state, id, Errors.not_paced())

  defp begin_operation(%{timing: %{clock: clock}} = state, id, {:clock, change}, _from),
    do: {state, [{:finished, id, change_clock(clock, change)}]}

  defp change_clock(clock, :pause), do: Clock.pause(clock)
  defp change_clock(clock, :resume), do: Clock.resume(clock)
  defp change_clock(clock, {:set_speed, speed}), do: Clock.set_speed(clock, speed)

  defp refuse(state, id, error), do: {state, [{:finished, id, {:error, error}}]}
end
