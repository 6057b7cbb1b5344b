defmodule Situ.Cluster.Overview do
  @moduledoc false
  # Describes the current state of a cluster for display: nodes, parts with their streams and
  # readers, and the links and recordings of every node. The result is plain data.
  #
  #     {:ok, _} = Situ.Cluster.join(log: "/var/lib/situ/log")
  #     Situ.Cluster.overview().nodes
  alias Situ.Cluster.{Agent, Recordings, Runner, NodeMetrics}

  # A node may be suspended, so a reply is not awaited for longer.
  @answer_ms 2_000

  defstruct time: 0, own_node: nil, nodes: [], parts: [], links: [], recordings: []

  @typedoc """
  `time`: ns since 1970. `readers` of a stream: the parts that read it, each with the number of messages it is
  `behind`.
  """
  @type t :: %__MODULE__{
          time: Situ.Time.t(),
          own_node: node(),
          nodes: [map()],
          parts: [part()],
          links: [map()],
          recordings: [Recordings.entry()]
        }
  @type part :: %{
          deployment: String.t(),
          part: String.t(),
          phase: :running | :done | :failed | :standby,
          node: node() | nil,
          epoch: pos_integer() | nil,
          checkpoints: non_neg_integer(),
          error: String.t() | nil,
          pipeline: pid() | nil,
          streams: [map()]
        }

  @spec now() :: t()
  def now do
    info = Agent.info()
    nodes = Map.keys(info.members)

    %__MODULE__{
      time: Situ.Time.now(),
      own_node: node(),
      nodes: describe_nodes(info.members),
      parts: Enum.flat_map(Enum.sort_by(info.deployments, & &1.name), &list_parts(&1, nodes)),
      links: Enum.flat_map(nodes, &list_links/1),
      recordings: Recordings.list_all(Enum.sort(nodes))
    }
  end

  defp describe_nodes(members) do
    vitals = NodeMetrics.recent_vitals()
    trips = get_in(vitals, [node(), :trips]) || %{}

    for {node, labels} <- Enum.sort(members) do
      vitals
      |> Map.get(node, %{busy: nil, cores: nil, machine: nil, memory: nil, devices: []})
      |> Map.take([:busy, :cores, :machine, :memory, :devices])
      |> Map.merge(%{node: node, labels: labels, trip: trips[node]})
    end
  end

  @doc "Returns the parts of one deployment, each with the node that runs it and the state which that node reports."
  @spec list_parts(Situ.Cluster.Deployment.t(), [node()]) :: [part()]
  def list_parts(deployment, nodes) do
    infos =
      for node <- nodes, {part, runner} <- list_runners(node, deployment.name) do
        {part, node, runner_info(runner)}
      end

    for {part, entries} <- infos |> Enum.group_by(&elem(&1, 0)) |> Enum.sort() do
      {_, node, info} =
        Enum.find(entries, {part, nil, %{}}, fn {_, _, i} ->
          i[:phase] in [:running, :done, :failed]
        end)

      describe_part(deployment.name, part, node, info)
    end
  end

  defp describe_part(deployment, part, node, info) do
    %{
      deployment: deployment,
      part: part,
      phase: info[:phase] || :standby,
      node: node,
      epoch: info[:epoch],
      checkpoints: get_in(info, [:checkpoints, :taken]) || 0,
      error: info[:error] && Exception.message(info[:error]),
      pipeline: info[:pipeline],
      streams: describe_streams(info[:publisher])
    }
  end

  defp describe_streams(nil), do: []

  defp describe_streams(%{streams: streams, readers: readers}) do
    for {name, stream} <- Enum.sort(streams) do
      stream_readers =
        for %{stream: ^name} = r <- readers,
            do: %{node: r.node, part: r.part, behind: max(stream.messages - r.last, 0)}

      stream
      |> Map.take([:messages, :time, :closed])
      |> Map.merge(%{name: name, readers: stream_readers})
    end
  end

  @doc """
  Returns the pipeline that currently runs a part of a deployment, on any node, or `nil` if no node runs it, for
  example while the part is being moved.
  """
  @spec find_pipeline(String.t(), String.t()) :: pid() | nil
  def find_pipeline(deployment, part) do
    with %{node: node} <- find_route({deployment, part}),
         %{^part => runner} <- list_runners(node, deployment),
         %{pipeline: pid} <- runner_info(runner),
         do: pid,
         else: (_ -> nil)
  end

  defp find_route(part) do
    Agent.info().routes[part]
  catch
    :exit, _ -> nil
  end

  defp list_runners(node, name) do
    Agent.list_runners({Agent, node}, name, @answer_ms)
  catch
    :exit, _ -> %{}
  end

  defp runner_info(runner) do
    Runner.part_info(runner, @answer_ms)
  catch
    :exit, _ -> %{}
  end

  defp list_links(node) do
    for link <- :erpc.call(node, Situ.Link, :links, [], 5_000), do: Map.put(link, :node, node)
  catch
    _, _ -> []
  end
end
