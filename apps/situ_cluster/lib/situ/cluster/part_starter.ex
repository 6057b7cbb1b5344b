defmodule Situ.Cluster.PartStarter do
  @moduledoc false
  # Builds a deployment's graph on this node: to plan it, or to run one part of it.
  alias Situ.Cluster.{PartGraph, Deployment, Plan}
  alias Situ.{Error, Graph, Pipeline}
  alias Situ.Graph.Builder

  @doc "Builds the plan of a deployment. Nothing is run, and everything that `build/2` opened is closed again."
  @spec build_plan(Deployment.t()) :: {:ok, Plan.t()} | {:error, Error.t()}
  def build_plan(%Deployment{module: module, opts: opts} = deployment) do
    {graph, _result} = Graph.build(&module.build(&1, opts))
    plan = Plan.new(graph, deployment)
    abandon_graph(graph)
    plan
  rescue
    error in Error ->
      {:error, error}

    error ->
      what = "building #{inspect(module)} failed: #{Exception.message(error)}"
      {:error, Error.new(:build_failed, what)}
  end

  @doc "Starts a part. `links` contains the agent, the publisher and the component states to resume from."
  @spec start_part(Deployment.t(), Plan.t(), String.t(), map()) ::
          {:ok, pid()} | {:error, Error.t()}
  def start_part(%Deployment{module: module, opts: opts} = deployment, plan, part, links) do
    options = %{
      inlet:
        &[
          agent: links.agent,
          part: {deployment.name, &1.part},
          stream: &1.name,
          direct: &1.direct,
          reader: part
        ],
      outlet: &[publisher: links.publisher, stream: &1.name]
    }

    build = fn p ->
      module.build(p, opts)

      Builder.update_graph(
        p,
        &{:ok,
         &1 |> PartGraph.build_part_graph(plan, part, options) |> keep_handlers(&1, plan, part)}
      )
    end

    settings =
      deployment.pipeline
      |> Keyword.put(:resume, links.memories)
      |> Keyword.put_new(:name, "#{deployment.name}/#{part}")

    Pipeline.start(build, pipeline: settings)
  end

  # Handlers close the recordings and links that `build/2` has opened. The handlers of a resource run with the
  # components that use it. A resource that only other parts use is closed here; otherwise each part would leave an
  # empty recording. All other handlers run with the main part and with parts that record.
  defp keep_handlers(graph, full_graph, plan, part) do
    main? = part == Plan.main_part(plan)
    records? = Enum.any?(graph.vertices, fn {_, v} -> v.module == Situ.Store.Sink end)

    {handlers, others} =
      Enum.split_with(graph.handlers, fn {_event, fun} ->
        case graph.resources do
          %{^fun => resource} ->
            uses_resource?(graph, resource) or
              (main? and not uses_resource?(full_graph, resource))

          _ ->
            main? or records?
        end
      end)

    abandon_graph(%{graph | handlers: others})
    %{graph | handlers: handlers}
  end

  defp uses_resource?(graph, resource),
    do: Enum.any?(graph.vertices, fn {_, vertex} -> option_uses?(vertex.opts, resource) end)

  # The options of operators are not always a keyword list.
  defp option_uses?([{_name, value} | rest], resource),
    do: value == resource or in_tuple?(value, resource) or option_uses?(rest, resource)

  defp option_uses?(_other, _resource), do: false

  defp in_tuple?(value, resource), do: is_tuple(value) and resource in Tuple.to_list(value)

  defp abandon_graph(graph), do: for({:abandoned, fun} <- graph.handlers, do: fun.(nil))
end
