defmodule Situ.Pipeline.Revise do
  @moduledoc false
  # What the server remembers of a component after it was replaced.
  alias Situ.Pipeline.Life

  @spec replaced(Life.t(), pos_integer(), tuple()) :: Life.t()
  def replaced(state, id, {:replace, index, module, opts}) do
    stage = Map.fetch!(state.stages, id)
    vertices = List.update_at(stage.vertices, index, &%{&1 | module: module, opts: opts})
    vertex = Enum.at(vertices, index)
    graph = %{state.graph | vertices: Map.put(state.graph.vertices, vertex.id, vertex)}
    %{state | graph: graph, stages: Map.put(state.stages, id, %{stage | vertices: vertices})}
  end
end
