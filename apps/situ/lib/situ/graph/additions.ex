defmodule Situ.Graph.Additions do
  @moduledoc false
  # Adds parts to a graph that is already running, and removes them again. Pure.
  alias Situ.{Error, Graph}

  @doc "Skips the next `n` ids of each kind, so that another graph can use them."
  @spec reserve_ids(Graph.t(), pos_integer()) :: Graph.t()
  def reserve_ids(%Graph{} = graph, n) do
    %{
      graph
      | next_vertex: graph.next_vertex + n,
        next_edge: graph.next_edge + n,
        next_source: graph.next_source + n
    }
  end

  @doc "Returns whether `built` has components or connections that `graph` does not have."
  @spec has_additions?(Graph.t(), Graph.t()) :: boolean()
  def has_additions?(built, graph) do
    added = extract_additions(built, graph)
    added.vertices != %{} or added.edges != %{}
  end

  @doc """
  Returns the additions in `built`, which was built on a copy of `offered`. Only these additions are merged, so parts
  that are removed from the running graph in the meantime do not return.
  """
  @spec extract_additions(Graph.t(), Graph.t()) :: Graph.t()
  def extract_additions(%Graph{} = built, %Graph{} = offered) do
    fresh = &Map.drop(Map.fetch!(built, &1), Map.keys(Map.fetch!(offered, &1)))

    %Graph{
      vertices: fresh.(:vertices),
      edges: fresh.(:edges),
      paths: fresh.(:paths),
      scopes: fresh.(:scopes),
      stream_names: fresh.(:stream_names),
      handlers: Enum.drop(built.handlers, length(offered.handlers))
    }
  end

  @doc "Merges the additions into `graph`; returns the graph and the ids of the new vertices."
  @spec merge_additions(Graph.t(), Graph.t()) ::
          {:ok, Graph.t(), MapSet.t(pos_integer())} | {:error, Error.t()}
  def merge_additions(%Graph{} = graph, %Graph{} = added) do
    ids = MapSet.new(Map.keys(added.vertices))
    edges = Map.values(added.edges)
    names = Map.keys(added.paths) ++ Map.keys(added.scopes)

    with :ok <- check_names_free(names, graph),
         :ok <- check_scopes_exist(added, graph),
         :ok <- check_edges(edges, ids, graph) do
      {:ok,
       %{
         graph
         | vertices: Map.merge(graph.vertices, added.vertices),
           edges: Map.merge(graph.edges, added.edges),
           connected: Map.merge(graph.connected, Map.new(edges, &{&1.to, &1.id})),
           paths: Map.merge(graph.paths, added.paths),
           scopes: Map.merge(graph.scopes, added.scopes),
           stream_names: Map.merge(added.stream_names, graph.stream_names),
           handlers: graph.handlers ++ added.handlers
       }, ids}
    end
  end

  defp check_names_free(names, graph) do
    case Enum.find(names, &(is_map_key(graph.paths, &1) or is_map_key(graph.scopes, &1))) do
      nil ->
        :ok

      name ->
        {:error,
         Error.new(:duplicate_name, "there is already a component named #{inspect(name)}",
           why: "it was added at the same time",
           fix: "choose a different name:"
         )}
    end
  end

  defp check_scopes_exist(added, graph) do
    lost = fn {_, %{scope: scope}} ->
      scope && not (is_map_key(graph.scopes, scope) or is_map_key(added.scopes, scope)) && scope
    end

    case Enum.find_value(added.vertices, lost) do
      nil -> :ok
      scope -> {:error, Error.new(:not_running, "the composite #{scope} has been removed")}
    end
  end

  # Running components accept no new connections to their inputs, and new components may subscribe only to components
  # that still exist.
  defp check_edges(edges, ids, graph) do
    Enum.find_value(edges, :ok, fn %{from: {from, _}, to: {to, input}} ->
      cond do
        not MapSet.member?(ids, to) ->
          {:error, fixed_inputs_error(graph, to, input)}

        not MapSet.member?(ids, from) and not is_map_key(graph.vertices, from) ->
          {:error,
           Error.new(:not_running, "the component that this stream comes from has been removed")}

        true ->
          nil
      end
    end)
  end

  defp fixed_inputs_error(graph, id, input) do
    path = if vertex = graph.vertices[id], do: vertex.path, else: "the component"

    Error.new(
      :fixed_inputs,
      "#{path}.#{input} cannot be connected: the component is already running",
      why: "the inputs of a component are fixed when it starts",
      fix:
        "connect only inputs of new components; for a join over a map of streams use Situ.add_input/4",
      meta: %{component: path}
    )
  end

  @doc "Removes these vertices with their connections and names, and the composites that are empty afterward."
  @spec remove_vertices(Graph.t(), MapSet.t(pos_integer())) :: Graph.t()
  def remove_vertices(%Graph{} = graph, ids) do
    removed? = &MapSet.member?(ids, &1)

    edges =
      reject_entries(graph.edges, fn {_, e} ->
        removed?.(elem(e.from, 0)) or removed?.(elem(e.to, 0))
      end)

    vertices = Map.drop(graph.vertices, MapSet.to_list(ids))

    %{
      graph
      | vertices: vertices,
        edges: edges,
        connected: reject_entries(graph.connected, fn {_, id} -> not is_map_key(edges, id) end),
        paths: reject_entries(graph.paths, fn {_, id} -> removed?.(id) end),
        stream_names: reject_entries(graph.stream_names, fn {_, {id, _}} -> removed?.(id) end),
        scopes:
          reject_entries(graph.scopes, fn {path, _} -> scope_emptied?(graph, vertices, path) end),
        numbers: %{}
    }
  end

  defp scope_emptied?(before, vertices, path),
    do: scope_occupied?(before.vertices, path) and not scope_occupied?(vertices, path)

  defp scope_occupied?(vertices, path),
    do: Enum.any?(vertices, fn {_, v} -> String.starts_with?(v.path, path <> ".") end)

  defp reject_entries(map, fun), do: map |> Enum.reject(fun) |> Map.new()
end
