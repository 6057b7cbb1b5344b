defmodule Situ.Studio.PipelineView.Waits do
  @moduledoc false
  # Finds the waiting producers of a pipeline and the causes. A producer waits if an input accepts
  # no more messages. The component of this input is slow, waits for a component further
  # downstream, or lacks messages at another input.
  alias Situ.Diagnostics.Snapshot
  alias Situ.Studio.PipelineView.{FoldedGraph, Stats}

  @type t :: %{
          edge: pos_integer(),
          who: String.t(),
          input: String.t(),
          queue: non_neg_integer(),
          why: String.t()
        }

  # A component that is busy for less than this percentage of its time is not the bottleneck.
  @busy 50.0
  # A component that is busy for this percentage of its time cannot take more messages.
  @full 90.0

  @doc """
  Lists the current waits in the order of the connections.

      iex> alias Situ.Diagnostics.{Edge, Node, Snapshot}
      iex> nodes = for {id, path} <- [{1, "Camera"}, {2, "Resize"}, {3, "Detect"}], do: %Node{id: id, path: path}
      iex> edge = fn id, from, to ->
      ...>   %Edge{id: id, from: from, to: to, to_input: :in, kind: :process, throttled: true, queue: 16, policy: "all"}
      ...> end
      iex> snapshot = %Snapshot{nodes: nodes, edges: [edge.(1, 1, 2), edge.(2, 2, 3)]}
      iex> sample = %{at: 0, edges: %{1 => %{"busy" => 3.0}, 2 => %{"busy" => 97.0}}, nodes: %{}}
      iex> for wait <- Situ.Studio.PipelineView.Waits.list_waits(snapshot, sample), do: {wait.who, wait.input, wait.why}
      [
        {"Camera", "Resize", "Resize is itself waiting because Detect is slow"},
        {"Resize", "Detect", "Detect is busy 97.0 % of the time"}
      ]
  """
  @spec list_waits(Snapshot.t(), Stats.sample()) :: [t()]
  def list_waits(%Snapshot{} = snapshot, sample) do
    paths = Map.new(snapshot.nodes, &{&1.id, &1.path})
    waiting = Enum.filter(snapshot.edges, &edge_waits?(&1, snapshot, sample))
    by_from = Enum.group_by(waiting, & &1.from)

    for edge <- waiting do
      %{
        edge: edge.id,
        who: paths[edge.from],
        input: input_label(edge, paths, snapshot),
        queue: edge.queue,
        why: explain_wait(edge, by_from, paths, snapshot, sample)
      }
    end
  end

  # A source that produces on demand has no messages left over. It counts as waiting if its consumer has queued messages
  # and cannot take more.
  defp edge_waits?(%{throttled: true}, _snapshot, _sample), do: true

  defp edge_waits?(edge, snapshot, sample),
    do:
      edge.queue > 0 and not FoldedGraph.lossy?(edge) and
        busy_percent(edge.to, snapshot, sample) >= @full

  # Includes the input's name if the component has several.
  defp input_label(edge, paths, snapshot) do
    if Enum.count(snapshot.edges, &(&1.to == edge.to)) > 1,
      do: "#{paths[edge.to]} (input #{edge.to_input})",
      else: paths[edge.to]
  end

  defp explain_wait(edge, by_from, paths, snapshot, sample) do
    case find_bottleneck(edge, by_from, [edge.to]) do
      ^edge -> explain_slow(edge, paths, snapshot, sample)
      last -> "#{paths[edge.to]} is itself waiting because #{paths[last.to]} is slow"
    end
  end

  # Follows waiting connections downstream to a component that does not wait. Stops where the connections form a cycle.
  defp find_bottleneck(edge, by_from, seen) do
    case Enum.reject(Map.get(by_from, edge.to, []), &(&1.to in seen)) do
      [next | _] -> find_bottleneck(next, by_from, [next.to | seen])
      [] -> edge
    end
  end

  defp explain_slow(edge, paths, snapshot, sample) do
    busy = busy_percent(edge.to, snapshot, sample)
    path = paths[edge.to]

    case Enum.filter(snapshot.edges, &(&1.to == edge.to and &1.id != edge.id and &1.queue == 0)) do
      [%{to_input: empty, from: from} | _] when busy < @busy ->
        "#{path} lacks messages at its input #{empty}, from #{paths[from]}"

      _ ->
        "#{path} is busy #{Float.round(busy / 1, 1)} % of the time#{handling_text(edge, sample)}"
    end
  end

  defp busy_percent(node, snapshot, sample) do
    for(e <- snapshot.edges, e.to == node, do: number_or_zero(sample.edges[e.id]["busy"]))
    |> Enum.max(fn -> 0.0 end)
  end

  defp handling_text(edge, sample) do
    case number_or_zero(sample.edges[edge.id]["handling"]) do
      ms when ms > 0 -> ", #{Stats.format_value("handling", ms)} per message"
      _ -> ""
    end
  end

  defp number_or_zero(x) when is_number(x), do: x
  defp number_or_zero(_), do: 0.0
end
