defmodule Situ.Graph.StreamNames do
  @moduledoc false
  # The names of the streams of a graph. A stream has the name that `Situ.name/2` gave it, or else a name derived from
  # the path of its component.
  alias Situ.Graph.Vertex

  @doc "Returns the default name of an output's stream: the node's path, plus the output's name if there are several."
  @spec default_name(String.t(), atom(), keyword()) :: String.t()
  def default_name(path, _output, [_only]), do: path
  def default_name(path, output, _outputs), do: path <> "." <> Atom.to_string(output)

  @doc "Returns every stream's name with its vertex and output; an explicit name replaces the default name."
  @spec map_names(Situ.Graph.t()) :: %{String.t() => {pos_integer(), atom()}}
  def map_names(graph) do
    default =
      for {id, vertex} <- graph.vertices, {output, _} <- vertex.outputs, into: %{} do
        {default_name(vertex.path, output, vertex.outputs), {id, output}}
      end

    Map.merge(default, graph.stream_names)
  end

  @doc "Lists the names of all streams, or with `:named` only the explicit names, in the order of construction."
  @spec list_names(Situ.Graph.t(), :all | :named) :: [String.t()]
  def list_names(graph, which) do
    given = Map.new(graph.stream_names, fn {name, port} -> {port, name} end)

    for {id, %Vertex{} = vertex} <- Enum.sort(graph.vertices),
        {output, _} <- vertex.outputs,
        which == :all or vertex.named? or is_map_key(given, {id, output}) do
      given[{id, output}] || default_name(vertex.path, output, vertex.outputs)
    end
  end
end
