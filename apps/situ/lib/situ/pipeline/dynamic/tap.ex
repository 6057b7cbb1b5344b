defmodule Situ.Pipeline.Dynamic.Tap do
  @moduledoc false
  # Taps of a running pipeline. Each tap is a component in a separate stage that subscribes to an output or, inside a
  # chain, to a probe.
  alias Situ.{Delivery, Error}
  alias Situ.Graph.{Edge, Vertex}
  alias Situ.Lifecycle.{Errors, Operations}
  alias Situ.Pipeline.{StageProcesses, Stages, State}
  alias Situ.Ports.Counters

  @type events :: [Situ.Lifecycle.event()]

  @doc "Attaches a tap, which ends with `owner`. The operation `op` ends when messages can arrive, or with an error."
  @spec attach(State.t(), Operations.id(), map(), pid()) :: {State.t(), events()}
  def attach(state, op, %{stream: which, component: component, opts: opts}, owner) do
    with {:ok, {id, output}} <- State.fetch_port(state, which),
         {:ok, stage, index} <- State.fetch_stage(state, id) do
      add_tap(state, {id, output, stage, index}, component, opts, {op, owner})
    else
      {:error, error} -> {state, [{:finished, op, {:error, error}}]}
    end
  end

  @doc "Confirms a tap that its source has added as a subscriber."
  @spec confirm_attached(State.t(), term()) :: {State.t(), events()}
  def confirm_attached(state, tag) do
    case Enum.find(state.dynamic.taps, fn {_, tap} -> tap.tag == tag and tap.op != nil end) do
      {id, tap} ->
        {put_tap(state, id, %{tap | op: nil}), [{:finished, tap.op, {:ok, {self(), id}}}]}

      nil ->
        {state, []}
    end
  end

  @doc "Detaches a tap; does nothing if the tap no longer exists."
  @spec detach(State.t(), pos_integer()) :: {State.t(), events()}
  def detach(state, id) do
    case state.dynamic.taps do
      %{^id => tap} ->
        Process.demonitor(tap.monitor, [:flush])

        Stages.send_request(state, tap.source, {:untap, tap.tag})
        Stages.send_request(state, id, :quit)
        # A tap that was not attached yet is refused.
        refused = if tap.op, do: [{:finished, tap.op, {:error, Errors.not_running()}}], else: []
        {remove_from_graph(state, id, tap), [{:left, id} | refused]}

      _ ->
        {state, []}
    end
  end

  @doc "Detaches the tap whose owner process has ended."
  @spec handle_owner_down(State.t(), reference()) :: {State.t(), events()}
  def handle_owner_down(state, monitor) do
    case Enum.find(state.dynamic.taps, fn {_, tap} -> tap.monitor == monitor end) do
      {id, _} -> detach(state, id)
      nil -> {state, []}
    end
  end

  @doc "Fails the requests of callers that wait for a tap on a stage whose process has ended."
  @spec fail_pending(State.t(), pos_integer()) :: {State.t(), events()}
  def fail_pending(state, id) do
    Enum.reduce(state.dynamic.taps, {state, []}, fn {tap_id, tap}, {state, events} ->
      if tap.op != nil and id in [tap.source, tap_id] do
        path = hd(state.stages[tap.source].vertices).path
        refused = {:finished, tap.op, {:error, Errors.component_restarted(path)}}
        {state, more} = detach(put_tap(state, tap_id, %{tap | op: nil}), tap_id)
        {state, events ++ more ++ [refused]}
      else
        {state, events}
      end
    end)
  end

  @doc "Returns the output that another process may subscribe to, as `{pid, [output: name]}`."
  @spec fetch_subscription(State.t(), term()) :: {:ok, {pid(), keyword()}} | {:error, Error.t()}
  def fetch_subscription(state, which) do
    with {:ok, {id, output}} <- State.fetch_port(state, which),
         {:ok, stage} <- State.fetch_output_stage(state, id),
         do: {:ok, {stage.pid, subscription_options(stage, output)}}
  end

  defp subscription_options(%{shared?: true, id: id}, output), do: [output: output, stage: id]
  defp subscription_options(_stage, output), do: [output: output]

  defp add_tap(
         state,
         {from, output, source, index},
         {module, component},
         opts,
         {op, owner}
       ) do
    id = state.graph.next_vertex
    tag = state.graph.next_edge
    name = unique_name(state.graph, opts[:name] || "Tap")

    vertex = %Vertex{
      id: id,
      module: module,
      path: name,
      opts: component,
      inputs: [in: %{type: :any, optional: false}],
      on_error: :skip
    }

    policy = opts[:policy] || Delivery.max_queue(1_000)
    edge = %Edge{id: tag, from: {from, output}, to: {id, :in}, policy: policy, explicit: true}
    link = Stages.build_link(edge, source.id, id)

    tap = %{
      tag: tag,
      source: source.id,
      output: output,
      index: index,
      op: op,
      monitor: Process.monitor(owner)
    }

    graph = %{
      state.graph
      | vertices: Map.put(state.graph.vertices, id, vertex),
        edges: Map.put(state.graph.edges, tag, edge),
        paths: Map.put(state.graph.paths, name, id),
        next_vertex: id + 1,
        next_edge: tag + 1
    }

    stage = Stages.build_entry(id, [vertex])
    wires = state.wires

    state = %{
      state
      | graph: graph,
        stages: Map.put(state.stages, id, stage),
        wires: %{
          links: Map.put(wires.links, tag, link),
          counters: Map.put(wires.counters, tag, Counters.new())
        }
    }

    state = state |> put_tap(id, tap) |> StageProcesses.spawn_stages([id])
    {state, [{:joined, Stages.build_member(stage, tap?: true)}, {:linked, tag, link}]}
  end

  @doc "Connects a tap whose stage is started, so that it receives messages."
  @spec connect_tap(State.t(), pos_integer()) :: State.t()
  def connect_tap(state, id) do
    tap = Map.fetch!(state.dynamic.taps, id)
    pid = state.stages[id].pid
    last = length(state.stages[tap.source].vertices) - 1
    index = if tap.index < last, do: tap.index

    wiring = %{
      tag: tap.tag,
      output: tap.output,
      index: index,
      pid: pid,
      counters: state.wires.counters[tap.tag],
      policy: Stages.subscriber_policy(state.wires.links[tap.tag].policy, state.stages[id])
    }

    Stages.send_request(state, tap.source, {:tap, wiring})
    Stages.send_request(state, id, :run)
  end

  defp put_tap(state, id, tap),
    do: %{state | dynamic: update_taps(state.dynamic, &Map.put(&1, id, tap))}

  # Frees the tap's name. Everything else that belongs to its stage stays until the life cycle drops the stage.
  defp remove_from_graph(state, id, tap) do
    {vertex, vertices} = Map.pop(state.graph.vertices, id)

    graph = %{
      state.graph
      | vertices: vertices,
        edges: Map.delete(state.graph.edges, tap.tag),
        paths: Map.delete(state.graph.paths, vertex && vertex.path)
    }

    %{state | graph: graph, dynamic: update_taps(state.dynamic, &Map.delete(&1, id))}
  end

  @doc "Deletes the tap of a stage that is being dropped, if the stage belongs to a tap."
  @spec delete_tap(State.t(), pos_integer()) :: State.t()
  def delete_tap(%{dynamic: %{taps: taps} = dynamic} = state, id) do
    with %{^id => %{monitor: monitor}} <- taps, do: Process.demonitor(monitor, [:flush])
    %{state | dynamic: update_taps(dynamic, &Map.delete(&1, id))}
  end

  defp update_taps(dynamic, change), do: %{dynamic | taps: change.(dynamic.taps)}

  defp unique_name(graph, name) do
    Stream.iterate(2, &(&1 + 1))
    |> Stream.map(&(name <> Integer.to_string(&1)))
    |> then(&Stream.concat([name], &1))
    |> Enum.find(&(not Map.has_key?(graph.paths, &1)))
  end
end
