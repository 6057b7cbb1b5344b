defmodule Situ.CLI.Cluster do
  @moduledoc "`situ cluster`: nodes of a cluster, and what runs on them."
  @behaviour Situ.CLI.Verb

  alias Situ.{Cluster, Error}
  alias Situ.Cluster.Identity
  alias Situ.CLI.{ClusterNode, Option, Output, Verb}

  @node Option.new(:node, :string, "a node of the cluster, as situ-9301@10.0.0.1", value: "NODE")
  @folder Option.new(
            :identity,
            :path,
            "the cluster's cookie and certificates (default: SITU_CLUSTER, ~/.config/situ/cluster)"
          )

  @impl true
  def verbs do
    [
      %Verb{
        words: ["cluster", "init"],
        summary: "make a cluster's cookie and certificates, to be copied to every machine",
        options: [@folder],
        examples: ["situ cluster init"],
        run: fn _, opts -> init(opts) end
      },
      %Verb{
        words: ["cluster", "join"],
        summary: "run a node of a cluster until it is stopped (Ctrl-C)",
        about: """
        NAME says the port that the node listens on: situ-9301@10.0.0.1 listens on 10.0.0.1, port 9301. Nodes talk by
        TLS when the folder of `situ cluster init` is there.
        """,
        arguments: [name: [kind: :text, doc: "the node's name, with port and address"]],
        options: [
          Option.new(:log, :string, "the log that all nodes share: a folder, or nats://host:4222",
            value: "ADDRESS"
          ),
          Option.new(:label, :string, "what rules of place may call it", many?: true),
          Option.new(:device, :string, "what is plugged in here (rules near:DEVICE)", many?: true),
          Option.new(:studio, :integer, "show the cluster in a studio on this port of 127.0.0.1"),
          Option.new(:recordings, :path, "the folder whose recordings all nodes may open",
            value: "FOLDER"
          ),
          Option.new(:peer, :string, "another node to begin with", value: "NODE", many?: true),
          Option.new(:require, :path, "Elixir file with the pipelines", many?: true),
          @folder
        ],
        examples: ["situ cluster join situ-9301@127.0.0.1 --log /var/lib/situ/log --label camera"],
        run: fn %{name: name}, opts -> join(name, opts) end
      },
      %Verb{
        words: ["cluster", "status"],
        summary: "show nodes, deployments, and which node runs which part",
        options: [@node, @folder],
        examples: ["situ cluster status --node situ-9301@127.0.0.1"],
        run: fn _, opts -> status(opts) end
      },
      %Verb{
        words: ["cluster", "deploy"],
        summary: "run a pipeline over the cluster",
        arguments: [module: [kind: :text, doc: "the pipeline, a module that the nodes have"]],
        options: [
          Option.new(
            :place,
            :string,
            "where a part runs: Path=LABEL or Path=near:DEVICE; then ,deterministic or ,only",
            value: "RULE",
            many?: true
          ),
          Option.new(:direct, :string, "a stream that bypasses the log between parts",
            value: "STREAM",
            many?: true
          ),
          Option.new(:publish, :string, "a stream kept in the log for readers outside",
            value: "STREAM",
            many?: true
          ),
          Option.new(:checkpoint, :span, "between checkpoints", default: 1_000_000_000),
          Option.new(:balance, :span, "how often to look whether a part should move"),
          @node,
          @folder
        ],
        examples: [
          "situ cluster deploy My.Hall --place Lips=compute,deterministic --node situ-9301@127.0.0.1"
        ],
        run: fn %{module: module}, opts -> deploy(module, opts) end
      },
      %Verb{
        words: ["cluster", "move"],
        summary: "move a part to another node, without losing a message",
        arguments: [
          deployment: [kind: :text, doc: "what was deployed"],
          part: [kind: :text, doc: "the part"],
          to: [kind: :text, doc: "the node"]
        ],
        options: [@node, @folder],
        examples: ["situ cluster move Hall Lips situ-9302@127.0.0.1 --node situ-9301@127.0.0.1"],
        run: &move/2
      },
      %Verb{
        words: ["cluster", "drain"],
        summary: "move all parts of a deployment away from a node",
        arguments: [
          deployment: [kind: :text, doc: "what was deployed"],
          from: [kind: :text, doc: "the node"]
        ],
        options: [@node, @folder],
        examples: ["situ cluster drain Hall situ-9302@127.0.0.1 --node situ-9301@127.0.0.1"],
        run: &drain/2
      }
      | ClusterNode.verbs([@node, @folder], &ask/4)
    ]
  end

  defp init(opts) do
    folder = folder(opts)
    Error.unwrap!(Identity.create(folder))

    Output.puts(
      "made #{folder}: copy it to every machine of the cluster, for its owner's eyes only"
    )

    0
  end

  defp join(name, opts) do
    log =
      opts[:log] ||
        raise Error.new(:usage, "the cluster's log is missing",
                fix: "give --log FOLDER or --log nats://host:4222"
              )

    for file <- opts[:require], do: Code.require_file(file)
    start(name, opts)

    for peer <- opts[:peer], Node.connect(String.to_atom(peer)) != true do
      Output.warn("situ cluster: #{peer} does not answer; it is not waited for")
    end

    recordings = opts[:recordings] || if(File.dir?("recordings"), do: "recordings")
    settings = [log: log, labels: opts[:label], devices: opts[:device], recordings: recordings]
    {:ok, agent} = settings |> Cluster.join() |> joined()
    Output.puts("#{name} is up")

    if opts[:studio],
      do:
        Output.puts(
          "the cluster is shown at #{ClusterNode.studio(opts[:studio], recordings)}cluster"
        )

    monitor = Process.monitor(agent)

    receive do
      {:DOWN, ^monitor, _, _, reason} ->
        Output.warn("situ cluster: the node ended: #{inspect(reason, limit: 8)}")
        1
    end
  end

  defp joined({:error, %Error{} = error}), do: raise(error)
  defp joined(answer), do: answer

  defp status(opts) do
    info = ask(opts, Cluster.Agent, :info, [])
    deployments = for d <- info.deployments, do: {d.name, ask(opts, Cluster, :status, [d]).parts}

    if opts[:json] do
      Output.json(%{
        nodes: for({node, labels} <- info.members, do: %{name: node, labels: labels}),
        deployments:
          for(
            {name, parts} <- deployments,
            do: %{name: name, parts: for({p, i} <- parts, do: row(p, i))}
          )
      })
    else
      for {node, labels} <- Enum.sort(info.members),
          do: Output.puts("#{node}  #{Enum.join(labels, ", ")}")

      for {name, parts} <- deployments, {part, i} <- Enum.sort(parts) do
        r = row(part, i)

        where = "#{name}/#{part}: #{r.phase} on #{r.node || "no node"}"
        Output.puts("#{where}, #{r.checkpoints} checkpoints, #{r.messages} messages out")
      end
    end

    0
  end

  defp row(part, info) do
    streams = get_in(info, [:publisher, :streams]) || %{}

    %{
      part: part,
      phase: info.phase,
      node: info.node,
      checkpoints: get_in(info, [:checkpoints, :taken]) || 0,
      messages: streams |> Map.values() |> Enum.map(& &1.messages) |> Enum.sum()
    }
  end

  defp deploy(module, opts) do
    module = Module.concat([module])
    place = Enum.map(opts[:place], &rule/1)
    streams = Keyword.take(opts, [:direct, :publish])
    settings = [place: place, checkpoint: opts[:checkpoint], balance: opts[:balance]] ++ streams
    deployment = Error.unwrap!(ask(opts, Cluster, :deploy, [module, settings]))
    Output.puts("#{deployment.name} runs; `situ cluster status` says where")
    0
  end

  defp rule(text) do
    with [path, rest] <- String.split(text, "=", parts: 2),
         [on | more] when more in [[], ["deterministic"], ["only"], ["deterministic", "only"]] <-
           String.split(rest, ",") do
      path = if path == "rest", do: :rest, else: path

      on =
        if String.starts_with?(on, "near:"),
          do: {:near, String.trim_leading(on, "near:")},
          else: on

      {path, [on: on] ++ Enum.map(more, &{String.to_existing_atom(&1), true})}
    else
      _ ->
        raise Error.new(:usage, "not a rule: #{text}",
                fix: "write Path=LABEL or Path=LABEL,deterministic"
              )
    end
  end

  defp move(%{deployment: name, part: part, to: to}, opts) do
    Error.unwrap!(ask(opts, Cluster, :move, [deployment(name, opts), part, String.to_atom(to)]))
    Output.puts("#{name}/#{part} runs on #{to}")
    0
  end

  defp drain(%{deployment: name, from: from}, opts) do
    ask(opts, Cluster, :drain, [deployment(name, opts), String.to_atom(from)])
    Output.puts("#{from} gives up the parts of #{name}")
    0
  end

  defp deployment(name, opts) do
    known = ask(opts, Cluster.Agent, :info, []).deployments

    Enum.find(known, &(&1.name == name)) ||
      raise Error.new(:not_found, "there is no deployment #{inspect(name)}",
              fix: "there are: " <> Enum.map_join(known, ", ", & &1.name)
            )
  end

  # Another VM that looks in, and is no member.
  defp ask(opts, module, function, args) do
    node =
      opts[:node] || raise Error.new(:usage, "which node?", fix: "give --node situ-9301@10.0.0.1")

    unless Node.alive?(), do: start("situ_cli_#{System.pid()}@127.0.0.1", opts)
    node = String.to_atom(node)

    unless :net_kernel.hidden_connect_node(node) == true do
      raise Error.new(:unreachable, "#{node} does not answer",
              why: "it does not run, or has another cookie or other certificates",
              fix: "check the name, and that both have the same folder of `situ cluster init`"
            )
    end

    try do
      :erpc.call(node, module, function, args, 120_000)
    catch
      :error, {:erpc, reason} ->
        raise Error.new(:unreachable, "#{node} is lost: #{inspect(reason)}")

      :exit, _ ->
        raise Error.new(:no_member, "#{node} is no member of a cluster",
                fix: "see `situ cluster join`"
              )
    end
  end

  # The node listens only on the host in its name.
  defp start(name, opts) do
    cookie = Error.unwrap!(Identity.cookie(folder(opts)))

    with [_, host] <- String.split(name, "@", parts: 2),
         {:ok, ip} <- :inet.getaddr(to_charlist(host), :inet) do
      Application.put_env(:kernel, :inet_dist_use_interface, ip)
    else
      _ ->
        raise Error.new(:usage, "not a node's name: #{name}",
                fix: "write it like situ-9301@10.0.0.1"
              )
    end

    case Node.start(String.to_atom(name), :longnames) do
      {:ok, _} ->
        Node.set_cookie(cookie)

      {:error, reason} ->
        raise Error.new(:no_distribution, "#{name} does not start: #{inspect(reason, limit: 20)}",
                fix: "check that its port is free"
              )
    end
  end

  defp folder(opts) do
    opts[:identity] || System.get_env("SITU_CLUSTER") ||
      Path.join(System.get_env("XDG_CONFIG_HOME") || Path.expand("~/.config"), "situ/cluster")
  end
end
