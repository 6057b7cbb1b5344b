defmodule Situ.Studio.PipelineView.Waits do
  @moduledoc """
  Who waits in a pipeline for whom, and why: a producer waits because an input takes no more; that input's component is
  slow, or waits itself further on, or lacks messages at another input.

      iex> alias Situ.Diagnostics.{Edge, Node, Snapshot}
      iex> nodes = for {id, path} <- [{1, "Camera"}, {2, "Resize"}, {3, "Detect"}], do: %Node{id: id, path: path}
      iex> edge = fn id, from, to ->
      ...>   %Edge{id: id, from: from, to: to, to_input: :in, kind: :process, throttled: true, queue: 16, policy: "all"}
      ...> end
      iex> snapshot = %Snapshot{nodes: nodes, edges: [edge.(1, 1, 2), edge.(2, 2, 3)]}
      iex> sample = %{at: 0, edges: %{1 => %{"busy" => 3.0}, 2 => %{"busy" => 97.0}}, nodes: %{}}
      iex> for wait <- Situ.Studio.PipelineView.Waits.of(snapshot, sample), do: {wait.who, wait.input, wait.why}
      [
        {"Camera", "Resize", "Resize waits itself: Detect is the one that is slow"},
        {"Resize", "Detect", "Detect is busy 97.0 % of the time"}
      ]
  """
  alias Situ.Diagnostics.Snapshot
  alias Situ.Studio.PipelineView.{Fold, Stats}

  @type t :: %{
          edge: pos_integer(),
          who: String.t(),
          input: String.t(),
          queue: non_neg_integer(),
          why: String.t()
        }

  # A component that is busy for less than this much of its time is not what is slow.
  @busy 50.0
  # One that is busy for so much of it has no time for more.
  @full 90.0

  @doc "Each wait that there is now, in the order of the connections."
  @spec of(Snapshot.t(), Stats.sample()) :: [t()]
  def of(%Snapshot{} = snapshot, sample) do
    paths = Map.new(snapshot.nodes, &{&1.id, &1.path})
    waiting = Enum.filter(snapshot.edges, &waits?(&1, snapshot, sample))
    by_from = Enum.group_by(waiting, & &1.from)

    for edge <- waiting do
      %{
        edge: edge.id,
        who: paths[edge.from],
        input: input(edge, paths, snapshot),
        queue: edge.queue,
        why: why(edge, by_from, paths, snapshot, sample)
      }
    end
  end

  # A source that is asked for messages has none left over: it waits where the input has some and has no time for more.
  defp waits?(%{throttled: true}, _snapshot, _sample), do: true

  defp waits?(edge, snapshot, sample),
    do: edge.queue > 0 and not Fold.lossy?(edge) and busy(edge.to, snapshot, sample) >= @full

  # Its name says more where there are several.
  defp input(edge, paths, snapshot) do
    if Enum.count(snapshot.edges, &(&1.to == edge.to)) > 1,
      do: "#{paths[edge.to]} (input #{edge.to_input})",
      else: paths[edge.to]
  end

  defp why(edge, by_from, paths, snapshot, sample) do
    case root(edge, by_from, [edge.to]) do
      ^edge -> own(edge, paths, snapshot, sample)
      last -> "#{paths[edge.to]} waits itself: #{paths[last.to]} is the one that is slow"
    end
  end

  # Down the connections that wait, to one whose component does not; a circle ends where it closes.
  defp root(edge, by_from, seen) do
    case Enum.reject(Map.get(by_from, edge.to, []), &(&1.to in seen)) do
      [next | _] -> root(next, by_from, [next.to | seen])
      [] -> edge
    end
  end

  defp own(edge, paths, snapshot, sample) do
    busy = busy(edge.to, snapshot, sample)
    path = paths[edge.to]

    case Enum.filter(snapshot.edges, &(&1.to == edge.to and &1.id != edge.id and &1.queue == 0)) do
      [%{to_input: empty, from: from} | _] when busy < @busy ->
        "#{path} has too little at its input #{empty}, from #{paths[from]}"

      _ ->
        "#{path} is busy #{Float.round(busy / 1, 1)} % of the time#{handling(edge, sample)}"
    end
  end

  defp busy(node, snapshot, sample) do
    for(e <- snapshot.edges, e.to == node, do: number(sample.edges[e.id]["busy"]))
    |> Enum.max(fn -> 0.0 end)
  end

  defp handling(edge, sample) do
    case number(sample.edges[edge.id]["handling"]) do
      ms when ms > 0 -> ", #{Stats.format("handling", ms)} a message"
      _ -> ""
    end
  end

  defp number(x) when is_number(x), do: x
  defp number(_), do: 0.0
end
