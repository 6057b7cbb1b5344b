defmodule Situ.Diagnostics do
  @moduledoc """
  Inspects a running pipeline from outside, as a `Situ.Diagnostics.Snapshot` or as a table for people.

  The numbers come from shared counters and from the VM's process table. Components are not queried, so stuck
  components are visible, too.

      iex> {:ok, report} = Situ.Pipeline.run(fn p -> Situ.from_enumerable(p, [1], every: 1, name: "Numbers") end)
      iex> [node] = report.snapshot.nodes
      iex> {node.path, node.kind, node.state}
      {"Numbers", :source, :closed}
  """
  alias Situ.Graph
  alias Situ.Diagnostics.{Snapshot, Table, Trace, Window}

  @doc """
  Returns the Diagnostics stream of the pipeline being built, which emits a snapshot every `interval:` ns (default 100
  ms). Repeated calls return the same stream. The pipeline setting `diagnostics: true` adds it as well, so that tools
  find it under the name "Diagnostics".
  """
  @spec stream(Graph.Handle.t(), keyword()) :: Situ.Stream.t()
  def stream(%Situ.Graph.Handle{} = p, opts \\ []) do
    root = %{p | scope: nil}

    case Graph.Builder.update_graph(root, &{Map.get(&1.paths, "Diagnostics"), &1}) do
      nil ->
        opts = [name: "Diagnostics"] ++ opts

        root
        |> Graph.Builder.update_graph(
          &Graph.add_component(&1, root, Situ.Diagnostics.Source, opts)
        )
        |> Situ.Node.output(:out)

      id ->
        %Situ.Stream{pipeline: p, node: id, output: :out, name: "Diagnostics", type: Snapshot}
    end
  end

  @doc """
  Formats a snapshot as a compact table for IEx, with means over the last averaging span. Formats a trace
  (`Situ.trace/2`) as the current position of the message and a line for each connection.
  """
  @spec format(Snapshot.t() | Trace.t()) :: String.t()
  def format(%Trace{} = trace), do: Trace.format(trace)
  def format(snapshot), do: Table.format(snapshot)

  @doc "Returns `part` as a percentage of `total`, or 0.0 if `total` is zero."
  @spec percent(number(), number()) :: float()
  defdelegate percent(part, total), to: Window

  @doc "Converts a count of the window to a rate per second."
  @spec rate(number(), Window.t()) :: float()
  defdelegate rate(n, window), to: Window

  @doc """
  Summarizes a snapshot, or only the connections for which `which?` returns true. Returns the number of each kind of
  element, the traffic of the connections (in total and in the window), and the ids of the connections whose producer
  is waiting. Connections within a process have no queue and are not counted.

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
