defmodule Situ.CLI.ClusterDeployment do
  @moduledoc false
  # The verbs of `situ cluster` for deployments: deploy a pipeline, stop it, move its parts.
  alias Situ.{Cluster, Error}
  alias Situ.CLI.{ClusterNode, Option, Output, Setting, Verb}

  @deployment [kind: :text, doc: "the deployment's name"]

  @doc "Returns the verbs; `ask` calls a function on a node of the cluster."
  @spec deployment_verbs([Option.t()], ClusterNode.ask()) :: [Verb.t()]
  def deployment_verbs(common, ask) do
    [
      %Verb{
        words: ["cluster", "deploy"],
        summary: "run a pipeline on the cluster",
        arguments: [module: [kind: :text, doc: "the pipeline: a module that exists on the nodes"]],
        options: deploy_options() ++ common,
        examples: [
          "situ cluster deploy My.Hall --place Lips=compute,deterministic --node situ-9301@127.0.0.1",
          "situ cluster deploy My.Hall --set rooms=3 --publish Speech --node situ-9301@127.0.0.1"
        ],
        run: fn %{module: module}, opts -> deploy_pipeline(module, opts, ask) end
      },
      %Verb{
        words: ["cluster", "stop"],
        summary:
          "end a deployment: its sources close, and messages in flight are still processed",
        arguments: [deployment: @deployment],
        options: [
          Option.new(:forget, :flag, "remove it from all nodes immediately; its log is kept")
          | common
        ],
        examples: ["situ cluster stop Hall --node situ-9301@127.0.0.1"],
        run: fn %{deployment: name}, opts -> stop_deployment(name, opts, ask) end
      },
      %Verb{
        words: ["cluster", "move"],
        summary: "move a part to another node without losing messages",
        arguments: [
          deployment: @deployment,
          part: [kind: :text, doc: "the part"],
          to: [kind: :text, doc: "the node"]
        ],
        options: common,
        examples: ["situ cluster move Hall Lips situ-9302@127.0.0.1 --node situ-9301@127.0.0.1"],
        run: fn arguments, opts -> move_part(arguments, opts, ask) end
      },
      %Verb{
        words: ["cluster", "drain"],
        summary: "move all parts of a deployment away from a node",
        arguments: [deployment: @deployment, from: [kind: :text, doc: "the node"]],
        options: common,
        examples: ["situ cluster drain Hall situ-9302@127.0.0.1 --node situ-9301@127.0.0.1"],
        run: fn arguments, opts -> drain_node(arguments, opts, ask) end
      }
    ]
  end

  defp deploy_options do
    rule =
      "where a part runs: Path=LABEL or Path=near:DEVICE, followed by ,deterministic or ,only if needed"

    [
      Option.new(
        :name,
        :string,
        "the deployment's name (default: the last part of the module's name)"
      ),
      Option.new(:set, :string, "an option of the pipeline's build/2; VALUE is JSON or text",
        value: "NAME=VALUE",
        many?: true
      ),
      Option.new(:place, :string, rule, value: "RULE", many?: true),
      Option.new(:direct, :string, "a stream that bypasses the log between parts",
        value: "STREAM",
        many?: true
      ),
      Option.new(:publish, :string, "a stream kept in the log for external readers",
        value: "STREAM",
        many?: true
      ),
      Option.new(:retain, :span, "how much of each stream the log keeps (default: all)"),
      Option.new(:checkpoint, :span, "the interval between checkpoints", default: 1_000_000_000),
      Option.new(
        :lease,
        :span,
        "how long a node may be silent before another takes over its parts",
        default: 1_000_000_000
      ),
      Option.new(:balance, :span, "how often to check whether a part should move")
    ]
  end

  defp deploy_pipeline(module, opts, ask) do
    module = Module.concat([module])

    settings =
      Keyword.take(opts, [:name, :retain, :checkpoint, :lease, :balance, :direct, :publish])

    # Atoms from user input are safe here: there are few options, and a user who can deploy can run any code anyway.
    build =
      for {name, value} <- Setting.parse_settings(opts[:set]), do: {String.to_atom(name), value}

    settings =
      for({key, value} <- settings, value != nil, do: {key, value}) ++
        [place: Enum.map(opts[:place], &parse_rule/1), opts: build]

    deployment = Error.unwrap!(ask.(opts, Cluster, :deploy, [module, settings]))
    Output.puts("#{deployment.name} is running; see `situ cluster status` for its nodes")
    0
  end

  defp parse_rule(text) do
    with [path, rest] <- String.split(text, "=", parts: 2),
         [on | more] when more in [[], ["deterministic"], ["only"], ["deterministic", "only"]] <-
           String.split(rest, ",") do
      path = if path == "rest", do: :rest, else: path
      {path, [on: parse_target(on)] ++ Enum.map(more, &{String.to_existing_atom(&1), true})}
    else
      _ ->
        raise Error.new(:usage, "invalid placement rule: #{text}",
                fix: "write Path=LABEL or Path=LABEL,deterministic"
              )
    end
  end

  defp parse_target("near:" <> device), do: {:near, device}
  defp parse_target(label), do: label

  defp stop_deployment(name, opts, ask) do
    deployment = find_deployment(name, opts, ask)

    if opts[:forget] do
      Error.unwrap!(ask.(opts, Cluster, :forget, [deployment]))
      Output.puts("#{name} was removed; its log is kept (see `situ cluster prune`)")
    else
      :ok = ask.(opts, Cluster, :stop, [deployment])
      Output.puts("#{name} is ending; `situ cluster status` shows when all its parts are done")
    end

    0
  end

  defp move_part(%{deployment: name, part: part, to: to}, opts, ask) do
    to_node = String.to_atom(to)
    Error.unwrap!(ask.(opts, Cluster, :move, [find_deployment(name, opts, ask), part, to_node]))
    Output.puts("#{name}/#{part} is now running on #{to}")
    0
  end

  defp drain_node(%{deployment: name, from: from}, opts, ask) do
    ask.(opts, Cluster, :drain, [find_deployment(name, opts, ask), String.to_atom(from)])
    Output.puts("#{from} is handing over the parts of #{name}")
    0
  end

  @doc "Returns the deployment with this name, or raises an error that lists the existing deployments."
  @spec find_deployment(String.t(), keyword(), ClusterNode.ask()) :: Cluster.t()
  def find_deployment(name, opts, ask) do
    known = ask.(opts, Cluster.Agent, :info, []).deployments

    fix =
      if known == [],
        do: "nothing is deployed: see `situ cluster deploy`",
        else: "deployments: " <> Enum.map_join(known, ", ", & &1.name)

    Enum.find(known, &(&1.name == name)) ||
      raise Error.new(:not_found, "unknown deployment #{inspect(name)}", fix: fix)
  end
end
