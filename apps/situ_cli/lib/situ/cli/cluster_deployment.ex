defmodule Situ.CLI.ClusterDeployment do
  @moduledoc false
  # The verbs of `situ cluster` for what runs on a cluster: deploy a pipeline, stop it, move its parts.
  alias Situ.{Cluster, Error}
  alias Situ.CLI.{ClusterNode, Option, Output, Setting, Verb}

  @deployment [kind: :text, doc: "what was deployed"]

  @doc "`ask` calls a function on a node of the cluster."
  @spec verbs([Option.t()], ClusterNode.ask()) :: [Verb.t()]
  def verbs(common, ask) do
    [
      %Verb{
        words: ["cluster", "deploy"],
        summary: "run a pipeline over the cluster",
        arguments: [module: [kind: :text, doc: "the pipeline, a module that the nodes have"]],
        options: deploy_options() ++ common,
        examples: [
          "situ cluster deploy My.Hall --place Lips=compute,deterministic --node situ-9301@127.0.0.1",
          "situ cluster deploy My.Hall --set rooms=3 --publish Speech --node situ-9301@127.0.0.1"
        ],
        run: fn %{module: module}, opts -> deploy(module, opts, ask) end
      },
      %Verb{
        words: ["cluster", "stop"],
        summary: "end a deployment: its sources close, and what is under way goes through",
        arguments: [deployment: @deployment],
        options: [
          Option.new(:forget, :flag, "take it away at once, on all nodes; its log stays") | common
        ],
        examples: ["situ cluster stop Hall --node situ-9301@127.0.0.1"],
        run: fn %{deployment: name}, opts -> stop(name, opts, ask) end
      },
      %Verb{
        words: ["cluster", "move"],
        summary: "move a part to another node, without losing a message",
        arguments: [
          deployment: @deployment,
          part: [kind: :text, doc: "the part"],
          to: [kind: :text, doc: "the node"]
        ],
        options: common,
        examples: ["situ cluster move Hall Lips situ-9302@127.0.0.1 --node situ-9301@127.0.0.1"],
        run: fn arguments, opts -> move(arguments, opts, ask) end
      },
      %Verb{
        words: ["cluster", "drain"],
        summary: "move all parts of a deployment away from a node",
        arguments: [deployment: @deployment, from: [kind: :text, doc: "the node"]],
        options: common,
        examples: ["situ cluster drain Hall situ-9302@127.0.0.1 --node situ-9301@127.0.0.1"],
        run: fn arguments, opts -> drain(arguments, opts, ask) end
      }
    ]
  end

  defp deploy_options do
    rule = "where a part runs: Path=LABEL or Path=near:DEVICE; then ,deterministic or ,only"

    [
      Option.new(:name, :string, "the deployment's name (default: the module's last name)"),
      Option.new(:set, :string, "an option of the pipeline's build/2; VALUE is JSON, or text",
        value: "NAME=VALUE",
        many?: true
      ),
      Option.new(:place, :string, rule, value: "RULE", many?: true),
      Option.new(:direct, :string, "a stream that bypasses the log between parts",
        value: "STREAM",
        many?: true
      ),
      Option.new(:publish, :string, "a stream kept in the log for readers outside",
        value: "STREAM",
        many?: true
      ),
      Option.new(:retain, :span, "how much of each stream the log keeps (default: all)"),
      Option.new(:checkpoint, :span, "between checkpoints", default: 1_000_000_000),
      Option.new(:lease, :span, "without a sign of life of a node: another takes its parts over",
        default: 1_000_000_000
      ),
      Option.new(:balance, :span, "how often to look whether a part should move")
    ]
  end

  defp deploy(module, opts, ask) do
    module = Module.concat([module])
    taken = Keyword.take(opts, [:name, :retain, :checkpoint, :lease, :balance, :direct, :publish])
    # A pipeline's options are few, and whoever deploys may run code there anyway.
    build = for {name, value} <- Setting.read(opts[:set]), do: {String.to_atom(name), value}

    settings =
      for({key, value} <- taken, value != nil, do: {key, value}) ++
        [place: Enum.map(opts[:place], &rule/1), opts: build]

    deployment = Error.unwrap!(ask.(opts, Cluster, :deploy, [module, settings]))
    Output.puts("#{deployment.name} runs; `situ cluster status` says where")
    0
  end

  defp rule(text) do
    with [path, rest] <- String.split(text, "=", parts: 2),
         [on | more] when more in [[], ["deterministic"], ["only"], ["deterministic", "only"]] <-
           String.split(rest, ",") do
      path = if path == "rest", do: :rest, else: path
      {path, [on: on(on)] ++ Enum.map(more, &{String.to_existing_atom(&1), true})}
    else
      _ ->
        raise Error.new(:usage, "not a rule: #{text}",
                fix: "write Path=LABEL or Path=LABEL,deterministic"
              )
    end
  end

  defp on("near:" <> device), do: {:near, device}
  defp on(label), do: label

  defp stop(name, opts, ask) do
    deployment = find(name, opts, ask)

    if opts[:forget] do
      Error.unwrap!(ask.(opts, Cluster, :forget, [deployment]))
      Output.puts("#{name} is taken away; its log stays (see `situ cluster prune`)")
    else
      :ok = ask.(opts, Cluster, :stop, [deployment])
      Output.puts("#{name} ends; `situ cluster status` says when all its parts are done")
    end

    0
  end

  defp move(%{deployment: name, part: part, to: to}, opts, ask) do
    to_node = String.to_atom(to)
    Error.unwrap!(ask.(opts, Cluster, :move, [find(name, opts, ask), part, to_node]))
    Output.puts("#{name}/#{part} runs on #{to}")
    0
  end

  defp drain(%{deployment: name, from: from}, opts, ask) do
    ask.(opts, Cluster, :drain, [find(name, opts, ask), String.to_atom(from)])
    Output.puts("#{from} gives up the parts of #{name}")
    0
  end

  @doc "The deployment of a name, or an error that says which there are."
  @spec find(String.t(), keyword(), ClusterNode.ask()) :: Cluster.t()
  def find(name, opts, ask) do
    known = ask.(opts, Cluster.Agent, :info, []).deployments

    fix =
      if known == [],
        do: "nothing is deployed: see `situ cluster deploy`",
        else: "there are: " <> Enum.map_join(known, ", ", & &1.name)

    Enum.find(known, &(&1.name == name)) ||
      raise Error.new(:not_found, "there is no deployment #{inspect(name)}", fix: fix)
  end
end
