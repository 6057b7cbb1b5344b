defmodule Situ.Cluster.Assembly do
  @moduledoc false
  # Builds a deployment's graph on this node: to plan it, or to run one part of it.
  alias Situ.Cluster.{Cut, Deployment, Plan}
  alias Situ.{Error, Graph, Pipeline}
  alias Situ.Graph.Builder

  @doc "The plan; nothing runs, and everything that `build/2` has opened is closed again."
  @spec plan(Deployment.t()) :: {:ok, Plan.t()} | {:error, Error.t()}
  def plan(%Deployment{module: module, opts: opts} = deployment) do
    {graph, _result} = Graph.build(&module.build(&1, opts))
    plan = Plan.new(graph, deployment)
    give_up(graph)
    plan
  rescue
    error in Error ->
      {:error, error}

    error ->
      what = "building #{inspect(module)} failed: #{Exception.message(error)}"
      {:error, Error.new(:build_failed, what)}
  end

  @doc "Starts a part; `links`: agent, publisher, memories."
  @spec start(Deployment.t(), Plan.t(), String.t(), map()) :: {:ok, pid()} | {:error, Error.t()}
  def start(%Deployment{module: module, opts: opts} = deployment, plan, part, links) do
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
      Builder.run(p, &{:ok, &1 |> Cut.part(plan, part, options) |> handlers(plan, part)})
    end

    settings =
      deployment.pipeline
      |> Keyword.put(:resume, links.memories)
      |> Keyword.put_new(:name, "#{deployment.name}/#{part}")

    Pipeline.start(build, pipeline: settings)
  end

  # Handlers close the recordings that `build/2` opened: one that this part does not write is abandoned. All others
  # run with the part that is not named by any rule.
  defp handlers(graph, plan, part) do
    writes? = Enum.any?(graph.vertices, fn {_, v} -> v.module == Situ.Store.Sink end)

    if writes? or part == Plan.main(plan) do
      graph
    else
      give_up(graph)
      %{graph | handlers: []}
    end
  end

  defp give_up(graph), do: for({:abandoned, fun} <- graph.handlers, do: fun.(nil))
end
