defmodule Situ.Graph.Composite do
  @moduledoc false
  # Groups the components that a function adds under one name. `Situ.composite/4` documents it.
  alias Situ.{Argument, Graph, Node, Stream}
  alias Situ.Graph.{Builder, Handle}

  def build(%Handle{} = p, name, fun, opts) when is_binary(name) and is_function(fun, 1) do
    scope = Builder.update_graph(p, &Graph.open_scope(&1, p.scope, name, opts))
    p |> Map.put(:scope, scope) |> fun.() |> restore_scope(p.scope)
  end

  def build(%Stream{} = stream, name, fun, opts) when is_binary(name) and is_function(fun, 1),
    do: build(stream.pipeline, name, fn p -> fun.(%{stream | pipeline: p}) end, opts)

  def build(other, _name, _fun, _opts) do
    takes = "a stream, or a pipeline that is being built"
    example = ~s|Situ.composite(stream, "Mouth", fn stream -> stream end)|
    Argument.raise_invalid!(other, takes, example)
  end

  # Streams and nodes that a composite returns are used outside of it, so their handles are given the outer scope again.
  defp restore_scope(%Stream{} = s, scope), do: %{s | pipeline: %{s.pipeline | scope: scope}}
  defp restore_scope(%Node{} = n, scope), do: %{n | pipeline: %{n.pipeline | scope: scope}}
  defp restore_scope(%_{} = struct, _scope), do: struct

  defp restore_scope(%{} = map, scope),
    do: Map.new(map, fn {k, v} -> {k, restore_scope(v, scope)} end)

  defp restore_scope([head | tail], scope),
    do: [restore_scope(head, scope) | restore_scope(tail, scope)]

  defp restore_scope(tuple, scope) when is_tuple(tuple),
    do: tuple |> Tuple.to_list() |> Enum.map(&restore_scope(&1, scope)) |> List.to_tuple()

  defp restore_scope(other, _scope), do: other
end
