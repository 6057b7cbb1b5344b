defmodule Situ.Cluster.Plan do
  @moduledoc false
  # A graph cut into parts: which components each has, which streams cross from one to another. Pure; every node comes
  # to the same plan, since each builds the same graph.
  alias Situ.Cluster.Deployment
  alias Situ.{Error, Graph, Options}

  @enforce_keys [:parts, :streams]
  defstruct [:parts, :streams]

  @typedoc """
  `parts`: name to ids and rule. `streams`: each stream that leaves its part, by name, with the vertex and output it
  comes from, its part, and the parts that read it.
  """
  @type part :: %{name: String.t(), ids: MapSet.t(pos_integer()), rule: Deployment.rule()}
  @type stream :: %{
          name: String.t(),
          from: {pos_integer(), atom()},
          part: String.t(),
          readers: [String.t()]
        }
  @type t :: %__MODULE__{parts: %{String.t() => part()}, streams: %{String.t() => stream()}}

  @rest "rest"
  @sources " sources"

  @spec new(Graph.t(), Deployment.t()) :: {:ok, t()} | {:error, Error.t()}
  def new(%Graph{} = graph, %Deployment{} = deployment) do
    names = for {path, _} <- deployment.rules, path != :rest, do: path

    with :ok <- known(names, graph), {:ok, published} <- published(deployment.publish, graph) do
      of = Map.new(graph.vertices, fn {id, vertex} -> {id, owner(vertex.path, names)} end)

      with :ok <- inhabited(names, of) do
        of = apart(graph, of)
        streams = streams(graph, of, published)
        {:ok, %__MODULE__{parts: parts(of, deployment), streams: streams}}
      end
    end
  end

  # Sources of a part that waits, through others, for what it puts out itself are a part of their own: a pipeline ends
  # when all its sources have ended, and so does not end before what comes back to it.
  defp apart(graph, of) do
    next = edges_between(graph, of)

    Map.new(of, fn {id, part} ->
      alone? = graph.vertices[id].inputs == [] and reaches?(next, part, part, MapSet.new())
      {id, if(alone?, do: part <> @sources, else: part)}
    end)
  end

  defp edges_between(graph, of) do
    pairs =
      for {_, %{from: {from, _}, to: {to, _}}} <- graph.edges,
          of[from] != of[to],
          do: {of[from], of[to]}

    pairs |> Enum.uniq() |> Enum.group_by(&elem(&1, 0), &elem(&1, 1))
  end

  defp reaches?(next, from, goal, seen) do
    Enum.any?(Map.get(next, from, []), fn part ->
      part == goal or (part not in seen and reaches?(next, part, goal, MapSet.put(seen, from)))
    end)
  end

  # The longest path that it is, or is below of.
  defp owner(path, names) do
    names
    |> Enum.filter(&(path == &1 or String.starts_with?(path, &1 <> ".")))
    |> Enum.max_by(&String.length/1, fn -> @rest end)
  end

  defp known(names, graph) do
    paths = Map.keys(graph.paths) ++ Map.keys(graph.scopes)

    case Enum.find(names, &(&1 not in paths)) do
      nil ->
        :ok

      name ->
        near = Options.nearest(name, paths)
        hint = if near, do: "did you mean #{inspect(near)}? ", else: ""

        {:error,
         Error.new(:unknown_component, "the pipeline has no component #{inspect(name)} to place",
           fix: hint <> "It has: " <> Enum.join(Enum.sort(paths), ", ")
         )}
    end
  end

  defp inhabited(names, of) do
    parts = Map.values(of)

    case Enum.find(names, &(&1 not in parts)) do
      nil ->
        :ok

      name ->
        {:error,
         Error.new(:empty_part, "#{inspect(name)} holds no component that could be placed",
           why: "a component belongs to a composite when the stream it is made from does",
           fix:
             "build it on the streams that the composite's function is given (Situ.composite/3)"
         )}
    end
  end

  defp published(names, graph) do
    known = Graph.stream_names(graph)

    case Enum.find(names, &(not is_map_key(known, &1))) do
      nil -> {:ok, Enum.map(names, &known[&1])}
      name -> {:error, Graph.unknown_stream(name, Map.keys(known))}
    end
  end

  defp parts(of, deployment) do
    rules = Map.new(deployment.rules, fn {path, rule} -> {name(path), rule} end)
    default = %{on: [], only: false, deterministic: false}

    of
    |> Enum.group_by(&elem(&1, 1), &elem(&1, 0))
    |> Map.new(fn {name, ids} ->
      rule = Map.get(rules, String.replace_suffix(name, @sources, ""), default)
      {name, %{name: name, ids: MapSet.new(ids), rule: rule}}
    end)
  end

  defp name(:rest), do: @rest
  defp name(path), do: path

  defp streams(graph, of, published) do
    crossing =
      for {_, %{from: {from, output}, to: {to, _}}} <- graph.edges, of[from] != of[to] do
        {{from, output}, of[to]}
      end

    readers = Enum.group_by(crossing, &elem(&1, 0), &elem(&1, 1))

    for port <- Enum.uniq(Map.keys(readers) ++ published), into: %{} do
      {id, output} = port
      vertex = graph.vertices[id]
      name = Graph.stream_name(vertex.path, output, vertex.outputs)
      readers = readers |> Map.get(port, []) |> Enum.uniq() |> Enum.sort()
      {name, %{name: name, from: port, part: of[id], readers: readers}}
    end
  end

  @doc "The streams that leave a part."
  @spec outlets(t(), String.t()) :: [stream()]
  def outlets(plan, part),
    do: plan.streams |> Map.values() |> Enum.filter(&(&1.part == part)) |> Enum.sort_by(& &1.name)

  @doc "The streams that come into a part from others."
  @spec inlets(t(), String.t()) :: [stream()]
  def inlets(plan, part), do: for({_, stream} <- plan.streams, part in stream.readers, do: stream)

  @doc "The part with what no rule names; without one, the first."
  @spec main(t()) :: String.t()
  def main(%__MODULE__{parts: parts}) when is_map_key(parts, @rest), do: @rest
  def main(%__MODULE__{parts: parts}), do: parts |> Map.keys() |> Enum.min()
end
