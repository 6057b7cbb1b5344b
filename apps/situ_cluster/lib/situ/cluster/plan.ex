defmodule Situ.Cluster.Plan do
  @moduledoc false
  # Splits a graph into parts: the components of each part, and the streams between parts. Pure. Every node builds the
  # same graph and therefore computes the same plan.
  alias Situ.Cluster.Deployment
  alias Situ.{Delivery, Error, Graph, Options}

  @enforce_keys [:parts, :streams]
  defstruct [:parts, :streams]

  @typedoc """
  `parts`: the ids and the rule of each part, by name. `streams`: each stream that leaves its part, by name, with the
  vertex and output it comes from, its part, and the parts that read it. A `direct` stream bypasses the log, because
  all of its readers may lose messages or because it was declared direct; `policies` contains the policies of the
  readers that may lose messages.
  """
  @type part :: %{name: String.t(), ids: MapSet.t(pos_integer()), rule: Deployment.rule()}
  @type stream :: %{
          name: String.t(),
          from: {pos_integer(), atom()},
          part: String.t(),
          readers: [String.t()],
          direct: boolean(),
          policies: %{String.t() => Situ.Delivery.t()}
        }
  @type t :: %__MODULE__{parts: %{String.t() => part()}, streams: %{String.t() => stream()}}

  @rest "rest"
  @sources " sources"

  @spec new(Graph.t(), Deployment.t()) :: {:ok, t()} | {:error, Error.t()}
  def new(%Graph{} = graph, %Deployment{} = deployment) do
    names = for {path, _} <- deployment.rules, path != :rest, do: path

    with :ok <- check_known(names, graph),
         {:ok, published} <- resolve_ports(deployment.publish, graph),
         {:ok, direct} <- resolve_ports(deployment.direct, graph) do
      part_of =
        Map.new(graph.vertices, fn {id, vertex} -> {id, owning_part(vertex.path, names)} end)

      with :ok <- check_not_empty(names, part_of),
           part_of = split_sources(graph, part_of),
           streams = build_streams(graph, part_of, published, direct),
           plan = %__MODULE__{parts: build_parts(part_of, deployment), streams: streams},
           :ok <- check_direct(deployment, plan),
           :ok <- check_repeatable(plan),
           do: {:ok, plan}
    end
  end

  defp check_direct(deployment, plan) do
    case Enum.find(deployment.direct, &(not match?(%{^&1 => %{readers: [_ | _]}}, plan.streams))) do
      nil ->
        :ok

      name ->
        {:error,
         Error.new(:not_crossing, "#{inspect(name)} is not read by any other part",
           why: "direct: lists streams between parts that bypass the log",
           fix: "remove it from direct:, or place its source or a reader in another part"
         )}
    end
  end

  # A restarted part receives other messages of a direct stream than before, or none.
  defp check_repeatable(plan) do
    conflicts =
      for {name, %{direct: true, readers: readers}} <- plan.streams,
          part <- readers,
          plan.parts[part].rule.deterministic,
          Enum.any?(outgoing_streams(plan, part), &(not &1.direct)),
          do: {name, part}

    case conflicts do
      [] ->
        :ok

      [{name, part} | _] ->
        {:error,
         Error.new(
           :not_deterministic,
           "part #{part} is declared deterministic: true, but is not deterministic",
           why:
             "it reads #{name}, which may lose messages and is not in the log, so a restarted part would produce" <>
               " different outputs",
           fix:
             "declare it deterministic: false, add the stream to publish:, or read it with a lossless policy"
         )}
    end
  end

  # If a part waits, through other parts, for its own outputs, its sources become a separate part. A pipeline ends only
  # when all of its sources have ended, and an inlet that returns the pipeline's own outputs counts as a source.
  defp split_sources(graph, part_of) do
    successors = edges_between(graph, part_of)

    Map.new(part_of, fn {id, part} ->
      separate? =
        graph.vertices[id].inputs == [] and reaches_part?(successors, part, part, MapSet.new())

      {id, if(separate?, do: part <> @sources, else: part)}
    end)
  end

  defp edges_between(graph, part_of) do
    pairs =
      for {_, %{from: {from, _}, to: {to, _}}} <- graph.edges,
          part_of[from] != part_of[to],
          do: {part_of[from], part_of[to]}

    pairs |> Enum.uniq() |> Enum.group_by(&elem(&1, 0), &elem(&1, 1))
  end

  defp reaches_part?(successors, from, target, seen) do
    Enum.any?(Map.get(successors, from, []), fn part ->
      part == target or
        (part not in seen and reaches_part?(successors, part, target, MapSet.put(seen, from)))
    end)
  end

  # Returns the longest of `names` that is the path or contains it.
  defp owning_part(path, names) do
    names
    |> Enum.filter(&(path == &1 or String.starts_with?(path, &1 <> ".")))
    |> Enum.max_by(&String.length/1, fn -> @rest end)
  end

  defp check_known(names, graph) do
    paths = Map.keys(graph.paths) ++ Map.keys(graph.scopes)

    case Enum.find(names, &(&1 not in paths)) do
      nil ->
        :ok

      name ->
        near = Options.nearest_name(name, paths)
        hint = if near, do: "did you mean #{inspect(near)}? ", else: ""

        {:error,
         Error.new(:unknown_component, "the pipeline has no component #{inspect(name)} to place",
           fix: hint <> "Its components are: " <> Enum.join(Enum.sort(paths), ", ")
         )}
    end
  end

  defp check_not_empty(names, part_of) do
    parts = Map.values(part_of)

    case Enum.find(names, &(&1 not in parts)) do
      nil ->
        :ok

      name ->
        {:error,
         Error.new(:empty_part, "#{inspect(name)} contains no component that could be placed",
           why: "a component belongs to a composite if the stream it is built on does",
           fix:
             "build it on the streams that the function of the composite receives (Situ.composite/3)"
         )}
    end
  end

  defp resolve_ports(names, graph) do
    ports = Graph.StreamNames.map_names(graph)

    case Enum.find(names, &(not is_map_key(ports, &1))) do
      nil -> {:ok, Enum.map(names, &ports[&1])}
      name -> {:error, Graph.unknown_stream(name, Map.keys(ports))}
    end
  end

  defp build_parts(part_of, deployment) do
    rules = Map.new(deployment.rules, fn {path, rule} -> {part_name(path), rule} end)
    default = %{on: [], only: false, deterministic: false}

    part_of
    |> Enum.group_by(&elem(&1, 1), &elem(&1, 0))
    |> Map.new(fn {name, ids} ->
      rule = Map.get(rules, String.replace_suffix(name, @sources, ""), default)
      {name, %{name: name, ids: MapSet.new(ids), rule: rule}}
    end)
  end

  defp part_name(:rest), do: @rest
  defp part_name(path), do: path

  defp build_streams(graph, part_of, published, direct) do
    cross_edges =
      for {_, %{from: {from, output}, to: {to, _}} = edge} <- graph.edges,
          part_of[from] != part_of[to] do
        {{from, output}, {part_of[to], edge.policy}}
      end

    readers = Enum.group_by(cross_edges, &elem(&1, 0), &elem(&1, 1))

    for port <- Enum.uniq(Map.keys(readers) ++ published), into: %{} do
      {id, output} = port
      vertex = graph.vertices[id]
      name = Graph.StreamNames.default_name(vertex.path, output, vertex.outputs)
      edges = Map.get(readers, port, [])
      lossy? = edges != [] and Enum.all?(edges, fn {_, policy} -> Delivery.lossy?(policy) end)
      direct? = port not in published and (lossy? or port in direct)

      {name,
       %{
         name: name,
         from: port,
         part: part_of[id],
         readers: edges |> Enum.map(&elem(&1, 0)) |> Enum.uniq() |> Enum.sort(),
         direct: direct?,
         policies: if(direct?, do: lossy_policies(edges), else: %{})
       }}
    end
  end

  # Returns the policy with the largest queue of each part. A part with any lossless edge has none.
  defp lossy_policies(edges) do
    for {part, all} <- Enum.group_by(edges, &elem(&1, 0), &elem(&1, 1)),
        Enum.all?(all, &Delivery.lossy?/1),
        into: %{},
        do: {part, widest_policy(all)}
  end

  defp widest_policy([policy]), do: policy
  # Atoms are larger than numbers, so `:infinity` is the maximum.
  defp widest_policy(all),
    do: Delivery.max_queue(bounded_size(Enum.max(Enum.map(all, & &1.max_queue))))

  defp bounded_size(:infinity), do: 1_000
  defp bounded_size(n), do: n

  @doc "Returns the streams that leave a part."
  @spec outgoing_streams(t(), String.t()) :: [stream()]
  def outgoing_streams(plan, part),
    do: plan.streams |> Map.values() |> Enum.filter(&(&1.part == part)) |> Enum.sort_by(& &1.name)

  @doc "Returns the streams that a part reads from others."
  @spec incoming_streams(t(), String.t()) :: [stream()]
  def incoming_streams(plan, part),
    do: for({_, stream} <- plan.streams, part in stream.readers, do: stream)

  @doc "Returns the part of the components that no rule names or, without one, the first part."
  @spec main_part(t()) :: String.t()
  def main_part(%__MODULE__{parts: parts}) when is_map_key(parts, @rest), do: @rest
  def main_part(%__MODULE__{parts: parts}), do: parts |> Map.keys() |> Enum.min()
end
