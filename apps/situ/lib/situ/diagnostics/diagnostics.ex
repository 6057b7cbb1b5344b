defmodule Situ.Diagnostics do
  @moduledoc """
  A running pipeline seen from outside: `Situ.Diagnostics.Snapshot`, and a table of it for people.

  Numbers come from shared counters and from the VM's process table; no component is asked, so a stuck one is seen.

      iex> {:ok, report} = Situ.Pipeline.run(fn p -> Situ.source(p, Situ.Component.Empty) end)
      iex> [node] = report.snapshot.nodes
      iex> {node.path, node.kind, node.state}
      {"Empty", :source, :closed}
  """
  alias Situ.Graph
  alias Situ.Diagnostics.{Snapshot, Window}

  @doc """
  The Diagnostics stream of the pipeline being built: a snapshot every `interval:` ns (default 100 ms). Asked for
  twice it is the same stream; `diagnostics: true` among the pipeline's settings adds it too, for tools to find under
  the name "Diagnostics".
  """
  @spec stream(Graph.Handle.t(), keyword()) :: Situ.Stream.t()
  def stream(%Situ.Graph.Handle{} = p, opts \\ []) do
    root = %{p | scope: nil}

    case Graph.Builder.run(root, &{Map.get(&1.paths, "Diagnostics"), &1}) do
      nil ->
        opts = [name: "Diagnostics"] ++ opts

        root
        |> Graph.Builder.run(&Graph.add(&1, root, Situ.Diagnostics.Source, opts))
        |> Situ.Node.output(:out)

      id ->
        %Situ.Stream{pipeline: p, node: id, output: :out, name: "Diagnostics", type: Snapshot}
    end
  end

  @doc "The snapshot as a compact table, for iex; means are of the last averaging span."
  @spec format(Snapshot.t()) :: String.t()
  defdelegate format(snapshot), to: Situ.Diagnostics.Table

  @doc "`part` in percent of `whole`; 0.0 of nothing."
  @spec percent(number(), number()) :: float()
  defdelegate percent(part, whole), to: Window

  @doc "A window's count as so many per second."
  @spec rate(number(), Window.t()) :: float()
  defdelegate rate(n, window), to: Window

  @doc """
  A snapshot, or the connections of it for which `which?` is true, in a few numbers: how many of everything there are,
  what went over the connections (in all and in the window), and the ids of those whose producer waits. Connections
  inside a process have no queue and do not count.

      iex> {:ok, report} = Situ.Pipeline.run(fn p ->
      ...>   p |> Situ.from_enumerable(0..9, every: 1) |> Situ.each(& &1, policy: Situ.Delivery.max_queue(100))
      ...> end)
      iex> summary = Situ.Diagnostics.summary(report.snapshot)
      iex> {summary.nodes, summary.edges, summary.emitted, summary.processed_percent, summary.throttled}
      {2, 1, 10, 100.0, []}
      iex> Situ.Diagnostics.summary(report.snapshot, &(&1.policy == "latest")).edges
      0
  """
  @spec summary(Snapshot.t(), (Situ.Diagnostics.Edge.t() -> boolean())) :: map()
  def summary(%Snapshot{} = snapshot, which? \\ fn _ -> true end) do
    edges = Enum.filter(snapshot.edges, &(&1.kind == :process and which?.(&1)))
    total = fn of -> edges |> Enum.map(of) |> Enum.sum() end
    emitted = total.(& &1.emitted)
    recent = total.(& &1.window.emitted)

    %{
      nodes: length(snapshot.nodes),
      sources: Enum.count(snapshot.nodes, &(&1.kind == :source)),
      composites: length(snapshot.scopes),
      inputs: snapshot.nodes |> Enum.map(&length(&1.inputs)) |> Enum.sum(),
      outputs: snapshot.nodes |> Enum.map(&length(&1.outputs)) |> Enum.sum(),
      processes: length(snapshot.processes),
      edges: length(edges),
      queued: total.(& &1.queue),
      queued_mean: total.(&(&1.window.queue || 0.0)),
      emitted: emitted,
      processed: total.(& &1.processed),
      processed_percent: percent(total.(& &1.processed), emitted),
      dropped: total.(& &1.dropped),
      dropped_percent: percent(total.(& &1.dropped), emitted),
      window_emitted: recent,
      window_processed: total.(& &1.window.processed),
      window_processed_percent: percent(total.(& &1.window.processed), recent),
      window_dropped: total.(& &1.window.dropped),
      window_dropped_percent: percent(total.(& &1.window.dropped), recent),
      throttled: for(%{throttled: true, id: id} <- edges, do: id)
    }
  end
end
