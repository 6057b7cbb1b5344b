defmodule Situ.Pipeline.Taps do
  @moduledoc false
  # Taps of a running pipeline: a stage of its own for each, subscribed to an output or, inside a chain, to a probe.
  alias Situ.{Delivery, Error}
  alias Situ.Graph.{Edge, Vertex}
  alias Situ.Pipeline.{Crew, Launch, Life, Place}
  alias Situ.Stage.{Counters, Tally}

  @doc "Attaches; the caller gets its answer when the first message can come, or at once when it cannot be."
  @spec attach(Life.t(), term(), fun(), keyword(), GenServer.from()) ::
          {:ok | {:error, Error.t()}, Life.t()}
  def attach(%{phase: :running} = state, which, fun, opts, from) do
    with {:ok, {id, output}} <- Place.port(state, which),
         {:ok, stage, index} <- Place.stage(state, id) do
      {:ok, add(state, {id, output, stage, index}, fun, opts, from)}
    else
      {:error, error} -> {{:error, error}, state}
    end
  end

  def attach(state, _which, _fun, _opts, _from), do: {{:error, Launch.not_running()}, state}

  @doc "The source has taken the tap in."
  @spec opened(Life.t(), term()) :: Life.t()
  def opened(state, tag) do
    for {id, %{tag: ^tag, from: from}} <- state.taps,
        do: GenServer.reply(from, {:ok, %Situ.Pipeline.Tap{pipeline: self(), id: id}})

    state
  end

  @doc "Detaches; a tap that is gone is no error."
  @spec detach(Life.t(), pos_integer()) :: Life.t()
  def detach(state, id) do
    case state.taps do
      %{^id => tap} ->
        Process.demonitor(tap.monitor, [:flush])

        for stage <- [state.stages[tap.source]],
            stage && stage.pid,
            do: send(stage.pid, {:situ, {:untap, tap.tag}})

        if stage = state.stages[id], do: send(stage.pid, {:situ, :quit})
        forget(state, id, tap)

      _ ->
        state
    end
  end

  @doc "The process that attached a tap is gone."
  @spec owner_down(Life.t(), reference()) :: Life.t()
  def owner_down(state, monitor) do
    case Enum.find(state.taps, fn {_, tap} -> tap.monitor == monitor end) do
      {id, _} -> detach(state, id)
      nil -> state
    end
  end

  @doc "The outlet another process may subscribe to: `{pid, [output: name]}`."
  @spec subscription(Life.t(), term()) :: {:ok, {pid(), keyword()}} | {:error, Error.t()}
  def subscription(%{phase: :running} = state, which) do
    with {:ok, {id, output}} <- Place.port(state, which),
         {:ok, stage} <- Place.outlet(state, id),
         do: {:ok, {stage.pid, [output: output]}}
  end

  def subscription(_state, _which), do: {:error, Launch.not_running()}

  defp add(state, {from, output, source, index}, fun, opts, {owner, _} = caller) do
    id = state.graph.next_vertex
    tag = state.graph.next_edge
    name = unique(state.graph, opts[:name] || "Tap")

    vertex = %Vertex{
      id: id,
      module: Situ.Pipeline.Tap.Sink,
      path: name,
      opts: [fun: fun],
      inputs: [in: %{type: :any, optional: false}],
      on_error: :skip
    }

    policy = opts[:policy] || Delivery.max_queue(1_000)
    edge = %Edge{id: tag, from: {from, output}, to: {id, :in}, policy: policy, explicit: true}
    link = %{id: tag, from: source.id, output: output, to: id, input: :in, policy: policy}

    tap = %{
      tag: tag,
      source: source.id,
      output: output,
      index: index,
      from: caller,
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

    state = %{
      state
      | graph: graph,
        links: Map.put(state.links, tag, link),
        active: Map.put(state.active, tag, link),
        counters: Map.put(state.counters, tag, Counters.new()),
        order: state.order ++ [id],
        taps: Map.put(state.taps, id, tap)
    }

    Crew.spawn(state, id, [vertex], Tally.new(1))
  end

  @doc "The tap's stage is up and wired: let its messages come."
  @spec open(Life.t(), pos_integer()) :: Life.t()
  def open(state, id) do
    tap = Map.fetch!(state.taps, id)
    pid = state.stages[id].pid
    source = state.stages[tap.source]
    last = length(source.vertices) - 1
    index = if tap.index < last, do: tap.index

    wiring = %{
      tag: tap.tag,
      output: tap.output,
      index: index,
      pid: pid,
      counters: state.counters[tap.tag],
      policy: state.links[tap.tag].policy
    }

    send(source.pid, {:situ, {:tap, wiring}})
    send(pid, {:situ, :run})
    state
  end

  defp forget(state, id, tap) do
    name = state.graph.vertices[id].path

    graph = %{
      state.graph
      | vertices: Map.delete(state.graph.vertices, id),
        edges: Map.delete(state.graph.edges, tap.tag),
        paths: Map.delete(state.graph.paths, name)
    }

    {stage, stages} = Map.pop(state.stages, id)

    %{
      state
      | graph: graph,
        stages: stages,
        pids: if(stage, do: Map.delete(state.pids, stage.pid), else: state.pids),
        links: Map.delete(state.links, tap.tag),
        active: Map.delete(state.active, tap.tag),
        counters: Map.delete(state.counters, tap.tag),
        order: List.delete(state.order, id),
        pending: MapSet.delete(state.pending, id),
        taps: Map.delete(state.taps, id)
    }
  end

  defp unique(graph, name) do
    Enum.find(
      Stream.concat([name], Stream.map(Stream.iterate(2, &(&1 + 1)), &(name <> "#{&1}"))),
      fn name ->
        not Map.has_key?(graph.paths, name)
      end
    )
  end
end
