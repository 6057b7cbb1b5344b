defmodule Situ.Build.Cycles do
  @moduledoc false
  # Finds groups of modules that use each other in a cycle.
  alias Situ.Build.Beam

  @doc """
  Returns the strongly connected groups of more than one node, each sorted, with the largest group first. Uses of nodes
  that are not keys of the map, and uses of a node by itself, are ignored.

      iex> Situ.Build.Cycles.find_cycles(%{a: [:b], b: [:c], c: [:a], d: [:a]})
      [[:a, :b, :c]]
      iex> Situ.Build.Cycles.find_cycles(%{a: [:b], b: [:c], c: []})
      []
  """
  @spec find_cycles(%{optional(node) => Enumerable.t()}) :: [[node, ...]] when node: term()
  def find_cycles(uses) do
    graph = :digraph.new()
    for {node, _} <- uses, do: :digraph.add_vertex(graph, node)

    for {node, used} <- uses,
        to <- used,
        to != node,
        is_map_key(uses, to),
        do: :digraph.add_edge(graph, node, to)

    groups = for group <- :digraph_utils.strong_components(graph), length(group) > 1, do: group
    :digraph.delete(graph)
    groups |> Enum.map(&Enum.sort/1) |> Enum.sort_by(&{-length(&1), &1})
  end

  @doc "Finds the cycles of calls between these modules."
  @spec find_in_modules([Beam.t()]) :: [[module(), ...]]
  def find_in_modules(beams), do: beams |> Map.new(&{&1.module, &1.calls}) |> find_cycles()

  @doc """
  Finds the cycles between the files of one Rust crate, whose sources are in `src`. A file uses the modules that it
  names after `crate::`. `lib.rs` is ignored because it declares all other modules.
  """
  @spec find_in_crate(Path.t()) :: [[String.t(), ...]]
  def find_in_crate(src) do
    files = src |> Path.join("**/*.rs") |> Path.wildcard()
    modules = for file <- files, module = rust_module(file, src), module != "", do: {module, file}
    names = MapSet.new(modules, &elem(&1, 0))

    modules
    |> Map.new(fn {module, file} -> {module, file |> File.read!() |> rust_uses(names)} end)
    |> find_cycles()
  end

  defp rust_module(file, src) do
    file
    |> Path.relative_to(src)
    |> Path.rootname()
    |> String.split("/")
    |> Enum.reject(&(&1 in ["mod", "lib", "main"]))
    |> Enum.join("::")
  end

  # `use crate::a::b::Type` uses the longest module name in that path. Tests and comments are ignored.
  defp rust_uses(text, names) do
    code = text |> String.split("#[cfg(test)]") |> hd() |> String.replace(~r{//.*}, "")

    for [_, path] <- Regex.scan(~r/\bcrate::((?:[a-z_0-9]+::)*[A-Za-z_0-9]+)/, code),
        module = longest_module(String.split(path, "::"), names),
        uniq: true,
        do: module
  end

  defp longest_module([], _names), do: nil

  defp longest_module(parts, names) do
    path = Enum.join(parts, "::")
    if path in names, do: path, else: parts |> Enum.drop(-1) |> longest_module(names)
  end
end
