defmodule Situ.Diagnostics do
  @moduledoc """
  What a running pipeline looks like from outside: `Situ.Diagnostics.Snapshot`, and a table of it for people.

  Numbers come from shared counters and from the VM's process table; no component is asked, so a stuck one is seen.

      iex> {:ok, report} = Situ.Pipeline.run(fn p -> Situ.source(p, Situ.Pipeline.Empty, []) end)
      iex> [node] = report.snapshot.nodes
      iex> {node.path, node.kind, node.state}
      {"Empty", :source, :closed}
  """
  alias Situ.Diagnostics.{Edge, Node, Process, Snapshot}
  alias Situ.{Delivery, Graph, Type}
  alias Situ.Graph.Vertex
  alias Situ.Stage.{Counters, Tally}

  @doc """
  The Diagnostics stream of the pipeline being built: a snapshot every `interval:` ns (default 100 ms). Asked for twice it is the
  same stream; `diagnostics: true` among the pipeline's settings adds it too, for tools to find under the name "Diagnostics".
  """
  @spec stream(Situ.Pipeline.t(), keyword()) :: Situ.Stream.t()
  def stream(%Situ.Pipeline{} = p, opts \\ []) do
    root = %{p | scope: nil}

    case Graph.Builder.run(root, &{Map.get(&1.paths, "Diagnostics"), &1}) do
      nil ->
        Situ.source(root, Situ.Diagnostics.Source, opts, name: "Diagnostics")

      id ->
        %Situ.Stream{pipeline: p, node: id, output: :out, name: "Diagnostics", type: Snapshot}
    end
  end

  @doc false
  # Every stream's name and where it comes from; an explicit name replaces the default one.
  @spec stream_names(Graph.t()) :: %{String.t() => {pos_integer(), atom()}}
  def stream_names(graph) do
    default =
      for {id, vertex} <- graph.vertices,
          types = vertex.outputs,
          {output, _} <- types,
          into: %{} do
        {Graph.stream_name(vertex.path, output, types), {id, output}}
      end

    Map.merge(default, graph.stream_names)
  end

  @doc false
  # `view` is what the server knows: graph, plan, pids, counters, tallies and which stages have closed.
  @spec snapshot(map()) :: Snapshot.t()
  def snapshot(view) do
    place = places(view.stages)

    %Snapshot{
      pipeline: view.name,
      state: view.state,
      time: view.time,
      start_time: view.start_time,
      progress: view.progress,
      scopes: view.graph.scopes |> Map.keys() |> Enum.sort_by(&{String.length(&1), &1}),
      nodes:
        view.graph.vertices
        |> Map.values()
        |> Enum.sort_by(& &1.id)
        |> Enum.map(&node(&1, view, place)),
      edges:
        view.graph.edges
        |> Map.values()
        |> Enum.sort_by(& &1.id)
        |> Enum.map(&edge(&1, view, place)),
      processes: view.stages |> Enum.sort_by(& &1.id) |> Enum.map(&process/1)
    }
  end

  @doc """
  The snapshot as a compact table, for iex.
  """
  @spec format(Snapshot.t()) :: String.t()
  def format(%Snapshot{} = snapshot) do
    paths = Map.new(snapshot.nodes, &{&1.id, &1.path})
    head = "#{snapshot.pipeline}  #{snapshot.state}  #{percent(snapshot.progress)}"

    rows =
      for edge <- snapshot.edges, edge.kind == :process do
        [
          "#{paths[edge.from]} -> #{paths[edge.to]}",
          edge.policy,
          "#{edge.processed}",
          "#{edge.queue}#{if edge.throttled, do: "!", else: ""}",
          "#{edge.dropped}",
          Situ.Time.format_duration(edge.latency_mean),
          Situ.Time.format_duration(edge.latency_p99)
        ]
      end

    processes =
      for process <- snapshot.processes do
        [
          Enum.join(process.nodes, " | "),
          process.status,
          "#{process.mailbox}",
          "#{div(process.memory, 1024)} KiB",
          process.busy_in
        ]
      end

    Enum.join(
      [
        head,
        table([~w(edge policy done queue dropped mean p99) | rows]),
        table([~w(process status mailbox memory in) | processes])
      ],
      "\n\n"
    )
  end

  @doc false
  # The live table of Situ.inspect/2: printed again every `ms` until the pipeline has ended.
  @spec watch(Situ.Pipeline.target(), pos_integer(), pos_integer() | :infinity) :: :ok
  def watch(_p, _ms, 0), do: :ok

  def watch(p, ms, times) do
    if Situ.Pipeline.state(p) == :completed do
      IO.puts("the pipeline has ended")
    else
      IO.puts([IO.ANSI.clear(), IO.ANSI.home(), format(Situ.Pipeline.info(p))])
      # A person reads it: this is the one place where waiting is the purpose.
      Elixir.Process.sleep(ms)
      watch(p, ms, if(times == :infinity, do: :infinity, else: times - 1))
    end
  end

  defp percent(progress), do: "#{round(progress * 100)} %"

  defp table(rows) do
    widths =
      rows |> Enum.zip_with(fn column -> column |> Enum.map(&String.length/1) |> Enum.max() end)

    Enum.map_join(rows, "\n", fn row ->
      row
      |> Enum.zip(widths)
      |> Enum.map_join("  ", fn {cell, w} -> String.pad_trailing(cell, w) end)
    end)
  end

  defp places(stages) do
    for stage <- stages, {vertex, index} <- Enum.with_index(stage.vertices), into: %{} do
      {vertex.id, {stage, index}}
    end
  end

  defp node(%Vertex{} = vertex, view, place) do
    {stage, index} = Map.get(place, vertex.id, {nil, 0})
    tally = if stage, do: Tally.read(stage.tally, index), else: %{}

    struct!(
      %Node{
        id: vertex.id,
        path: vertex.path,
        scope: vertex.scope,
        module: if(vertex.module == :operator, do: "Operator", else: inspect(vertex.module)),
        kind: kind(vertex),
        state: node_state(stage),
        process: stage && stage.id,
        description: stage && Map.get(view.descriptions, stage.id),
        inputs: Enum.map(vertex.inputs, &port(&1, nil)),
        outputs: Enum.map(vertex.outputs, &port(&1, stream_name(view.graph, vertex, elem(&1, 0))))
      },
      tally
    )
  end

  defp node_state(nil), do: :running
  defp node_state(stage), do: stage.state

  defp kind(%Vertex{module: Situ.Pipeline.Tap.Sink}), do: :tap
  defp kind(%Vertex{module: :operator}), do: :operator
  defp kind(vertex), do: if(Vertex.source?(vertex), do: :source, else: :component)

  defp port({name, port}, stream),
    do: %{name: Atom.to_string(name), type: Type.to_string(port.type), stream: stream}

  defp stream_name(graph, vertex, output) do
    case Enum.find(graph.stream_names, fn {_, port} -> port == {vertex.id, output} end) do
      {name, _} -> name
      nil -> Graph.stream_name(vertex.path, output, vertex.outputs)
    end
  end

  defp edge(edge, view, place) do
    {from, output} = edge.from
    {to, input} = edge.to

    base = %Edge{
      id: edge.id,
      from: from,
      from_output: Atom.to_string(output),
      to: to,
      to_input: Atom.to_string(input),
      policy: Delivery.name(edge.policy)
    }

    case Map.fetch(view.counters, edge.id) do
      {:ok, counters} -> struct!(base, Counters.read(counters))
      :error -> inline(base, view, place, from)
    end
  end

  # Inside a chain there is no queue: what entered the chain is what there is to tell.
  defp inline(base, view, place, from) do
    with {stage, _} <- Map.get(place, from, nil),
         %{id: entry} <-
           Enum.find(Map.values(view.graph.edges), &(elem(&1.to, 0) == hd(stage.vertices).id)),
         %{^entry => counters} <- view.counters do
      read = Counters.read(counters)

      struct!(
        base,
        Map.merge(read, %{
          kind: :inline,
          emitted: read.processed,
          queue: 0,
          dropped: 0,
          throttled: false
        })
      )
    else
      _ -> %{base | kind: :inline}
    end
  end

  defp process(stage) do
    paths = Enum.map(stage.vertices, & &1.path)
    keys = [:memory, :message_queue_len, :reductions, :status, :current_function]

    case stage.pid && Elixir.Process.info(stage.pid, keys) do
      nil ->
        %Process{number: stage.id, nodes: paths, status: "ended"}

      info ->
        {module, function, arity} = info[:current_function] || {:none, :none, 0}

        %Process{
          number: stage.id,
          nodes: paths,
          memory: info[:memory],
          mailbox: info[:message_queue_len],
          reductions: info[:reductions],
          status: Atom.to_string(info[:status]),
          busy_in: Exception.format_mfa(module, function, arity)
        }
    end
  end
end
