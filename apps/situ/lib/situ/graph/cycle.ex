defmodule Situ.Graph.Cycle do
  @moduledoc false
  # Finds the shortest path from a component back to itself. Pure.
  #
  # Before the pipeline runs, it is not known whether a component on a cycle delays its messages. A cycle always
  # contains a component, because a light operator needs its input stream when it is built, and a component chooses
  # its own times. The error therefore occurs when the first message has passed around the cycle, and this module
  # reports the cycle.
  alias Situ.{Error, Graph}

  @doc "Returns the component paths on the cycle, with the first repeated at the end; `nil` without a cycle."
  @spec find_cycle(Graph.t(), pos_integer()) :: [String.t()] | nil
  def find_cycle(%Graph{} = graph, id) do
    next =
      Enum.group_by(graph.edges, fn {_, e} -> elem(e.from, 0) end, fn {_, e} -> elem(e.to, 0) end)

    with [_ | _] = ids <- search_paths([[id]], id, next, MapSet.new()),
         do: Enum.map(ids, &graph.vertices[&1].path)
  end

  # Each path is a list of vertices with the last vertex first. Shorter paths are searched first.
  defp search_paths([], _id, _next, _seen), do: nil

  defp search_paths([[last | _] = way | ways], id, next, seen) do
    followers = next |> Map.get(last, []) |> Enum.sort()

    if id in followers do
      Enum.reverse([id | way])
    else
      fresh = followers |> Enum.uniq() |> Enum.reject(&MapSet.member?(seen, &1))
      search_paths(ways ++ Enum.map(fresh, &[&1 | way]), id, next, Enum.into(fresh, seen))
    end
  end

  @doc "Adds the cycle, if there is one, to an error about a time that does not increase."
  @spec explain_error(Error.t(), Graph.t()) :: Error.t()
  def explain_error(%Error{code: :time_not_increasing, meta: %{component: path}} = error, graph) do
    with %{^path => id} <- graph.paths, [_ | _] = cycle <- find_cycle(graph, id) do
      why =
        "it is on the cycle #{Enum.join(cycle, " -> ")}, and no component on it delays its messages"

      %{error | why: "#{error.why}; #{why}", meta: Map.put(error.meta, :cycle, cycle)}
    else
      _ -> error
    end
  end

  def explain_error(error, _graph), do: error
end
