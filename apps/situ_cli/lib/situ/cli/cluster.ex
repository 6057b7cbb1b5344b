defmodule Situ.CLI.Cluster do
  @moduledoc "`situ cluster`: nodes of a cluster, and what runs on them."
  @behaviour Situ.CLI.Verb

  alias Situ.{Cluster, Error}
  alias Situ.Cluster.Identity
  alias Situ.CLI.{ClusterDeployment, ClusterLog, ClusterNode, Option, Output, Verb}

  @node Option.new(:node, :string, "a node of the cluster, as situ-9301@10.0.0.1", value: "NODE")
  @folder Option.new(
            :identity,
            :path,
            "the cluster's cookie and certificates (default: SITU_CLUSTER, ~/.config/situ/cluster)"
          )

  @leave_ms 10_000

  @impl true
  def verbs do
    [
      %Verb{
        words: ["cluster", "init"],
        summary:
          "make a cluster's cookie, certificates and login for NATS, to be copied to every machine",
        options: [@folder],
        examples: ["situ cluster init"],
        run: fn _, opts -> init(opts) end
      },
      %Verb{
        words: ["cluster", "join"],
        summary: "run a node of a cluster until it is stopped",
        about: """
        NAME says the port that the node listens on: situ-9301@10.0.0.1 listens on 10.0.0.1, port 9301. Nodes talk by
        TLS when the folder of `situ cluster init` is there. A node that is told to end (SIGTERM) hands its parts over
        first; one that is killed is missed after a second, and its parts go on elsewhere from their last checkpoints.
        With --log nats://... it logs in by the files of that folder, over TLS.
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
          | ClusterLog.options()
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
      }
      | ClusterDeployment.verbs([@node, @folder], &ask/4) ++
          ClusterNode.verbs([@node, @folder], &ask/4, &folder/1)
    ]
  end

  defp init(opts) do
    folder = folder(opts)
    Error.unwrap!(Identity.create(folder))

    Output.puts(
      "made #{folder}: copy it to every machine of the cluster, for its owner's eyes only"
    )

    Output.puts(
      "#{Path.join(folder, "nats-server")} is for the machine of a NATS server alone: move it there"
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
    {:ok, _} = Application.ensure_all_started(:situ_remote)
    start(name, opts)

    for peer <- opts[:peer], Node.connect(String.to_atom(peer)) != true do
      Output.warn("situ cluster: #{peer} does not answer; it is not waited for")
    end

    recordings = opts[:recordings] || if(File.dir?("recordings"), do: "recordings")

    settings = [
      log: log,
      log_options: ClusterLog.connect_options(log, opts, folder(opts)),
      labels: opts[:label],
      devices: opts[:device],
      recordings: recordings
    ]

    {:ok, agent} = settings |> Cluster.join() |> joined()
    Output.puts("#{name} is up")

    if opts[:studio],
      do:
        Output.puts(
          "the cluster is shown at #{ClusterNode.studio(opts[:studio], recordings)}cluster"
        )

    # Behind this function Erlang's own begins to shut all down: it returns to nobody, and `leave/0` takes its time.
    joined = self()
    trap = fn -> send(joined, :leave) && Process.sleep(:infinity) end
    {:ok, _} = System.trap_signal(:sigterm, trap)
    wait(name, Process.monitor(agent))
  end

  defp wait(name, monitor) do
    receive do
      {:DOWN, ^monitor, _, _, reason} ->
        Output.warn("situ cluster: the node ended: #{inspect(reason, limit: 8)}")
        1

      :leave ->
        Output.puts("#{name} leaves; its parts go on elsewhere")
        leave()
        0
    end
  end

  # With a checkpoint of each part, where another node can take it; those who stop a service wait for some seconds.
  defp leave do
    %{members: members, deployments: deployments} = Cluster.Agent.info()

    if map_size(members) > 1 do
      task = Task.async(fn -> for d <- deployments, do: Cluster.drain(d, node()) end)
      Task.yield(task, @leave_ms) || Task.shutdown(task, :brutal_kill)
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

      if deployments == [], do: Output.puts("nothing is deployed")

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
