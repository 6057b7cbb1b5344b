defmodule Situ.Graph.Cycle do
  @moduledoc false
  # The shortest way from a component back to itself. Pure.
  #
  # That nothing on a cycle makes its messages later cannot be known before it runs: each has a component on it (light
  # operators take their input when they are made), and what times a component gives is its own affair. So the error
  # comes when the first message has come round, and this says by which way.
  alias Situ.{Error, Graph}

  @doc "The paths on it, the first again at the end; `nil` when there is no way back."
  @spec through(Graph.t(), pos_integer()) :: [String.t()] | nil
  def through(%Graph{} = graph, id) do
    next =
      Enum.group_by(graph.edges, fn {_, e} -> elem(e.from, 0) end, fn {_, e} -> elem(e.to, 0) end)

    with [_ | _] = ids <- search([[id]], id, next, MapSet.new()),
         do: Enum.map(ids, &graph.vertices[&1].path)
  end

  # Ways as lists, the last vertex first; the shorter ones come first.
  defp search([], _id, _next, _seen), do: nil

  defp search([[last | _] = way | ways], id, next, seen) do
    followers = next |> Map.get(last, []) |> Enum.sort()

    if id in followers do
      Enum.reverse([id | way])
    else
      fresh = followers |> Enum.uniq() |> Enum.reject(&MapSet.member?(seen, &1))
      search(ways ++ Enum.map(fresh, &[&1 | way]), id, next, Enum.into(fresh, seen))
    end
  end

  @doc "The error of a time that does not increase, with the cycle that brought it, if one did."
  @spec explain(Error.t(), Graph.t()) :: Error.t()
  def explain(%Error{code: :time_not_increasing, meta: %{component: path}} = error, graph) do
    with %{^path => id} <- graph.paths, [_ | _] = cycle <- through(graph, id) do
      why =
        "it lies on the cycle #{Enum.join(cycle, " -> ")}, on which nothing makes messages later"

      %{error | why: "#{error.why}; #{why}", meta: Map.put(error.meta, :cycle, cycle)}
    else
      _ -> error
    end
  end

  def explain(error, _graph), do: error
end
