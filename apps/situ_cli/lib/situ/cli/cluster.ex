defmodule Situ.CLI.Cluster do
  @moduledoc false
  # The verbs of `situ cluster`: the nodes of a cluster and the deployments that run on them.
  @behaviour Situ.CLI.Verb

  alias Situ.{Cluster, Error}
  alias Situ.Cluster.Identity
  alias Situ.CLI.{ClusterConnection, ClusterDeployment, ClusterLogOptions, ClusterNode}
  alias Situ.CLI.{Option, Output, Verb}

  @leave_ms 10_000

  @impl true
  def verbs do
    folder = ClusterConnection.folder_option()
    connection = ClusterConnection.options()

    [
      %Verb{
        words: ["cluster", "init"],
        summary:
          "create a cluster's cookie, certificates and NATS login, to be copied to every machine",
        options: [folder],
        examples: ["situ cluster init"],
        run: fn _, opts -> create_identity(opts) end
      },
      %Verb{
        words: ["cluster", "join"],
        summary: "run a node of a cluster until it is stopped",
        about: """
        NAME contains the port that the node listens on: situ-9301@10.0.0.1 listens on 10.0.0.1, port 9301. Nodes
        communicate over TLS if the folder of `situ cluster init` exists. A node that receives SIGTERM first hands its
        parts over to other nodes. If a node is killed, the others notice after a second and continue its parts from
        their last checkpoints. With --log nats://... it logs in with the files of that folder, over TLS.
        """,
        arguments: [name: [kind: :text, doc: "the node's name, with port and address"]],
        options: [
          Option.new(:log, :string, "the log that all nodes share: a folder, or nats://host:4222",
            value: "ADDRESS"
          ),
          Option.new(:label, :string, "a label that placement rules can use", many?: true),
          Option.new(:device, :string, "a device attached to this node (rules near:DEVICE)",
            many?: true
          ),
          Option.new(:studio, :integer, "show the cluster in a studio on this port of 127.0.0.1"),
          Option.new(:metrics, :integer, "serve /metrics and /health on this port of 127.0.0.1"),
          Option.new(:recordings, :path, "the folder of recordings that all nodes may open",
            value: "FOLDER"
          ),
          Option.new(:peer, :string, "another node to connect to first",
            value: "NODE",
            many?: true
          ),
          Option.new(:require, :path, "Elixir file with the pipelines", many?: true),
          folder
          | ClusterLogOptions.log_options()
        ],
        examples: ["situ cluster join situ-9301@127.0.0.1 --log /var/lib/situ/log --label camera"],
        run: fn %{name: name}, opts -> join_cluster(name, opts) end
      },
      %Verb{
        words: ["cluster", "status"],
        summary: "show nodes, deployments, and which node runs which part",
        options: connection,
        examples: ["situ cluster status --node situ-9301@127.0.0.1"],
        run: fn _, opts -> show_status(opts) end
      }
      | ClusterDeployment.deployment_verbs(connection, &ClusterConnection.call_node/4) ++
          ClusterNode.node_verbs(
            connection,
            &ClusterConnection.call_node/4,
            &ClusterConnection.identity_folder/1
          )
    ]
  end

  defp create_identity(opts) do
    folder = ClusterConnection.identity_folder(opts)
    Error.unwrap!(Identity.create(folder))

    Output.puts(
      "created #{folder}: copy it to every machine of the cluster, readable only by its owner"
    )

    Output.puts(
      "#{Path.join(folder, "nats-server")} is only for the machine of the NATS server: move it there"
    )

    0
  end

  defp join_cluster(name, opts) do
    log =
      opts[:log] ||
        raise Error.new(:usage, "the cluster's log is missing",
                fix: "give --log FOLDER or --log nats://host:4222"
              )

    for file <- opts[:require], do: Code.require_file(file)
    {:ok, _} = Application.ensure_all_started(:situ_cluster)
    ClusterConnection.start_distribution(name, opts)

    for peer <- opts[:peer], Node.connect(String.to_atom(peer)) != true do
      Output.warn("situ cluster: #{peer} is not responding; joining without it")
    end

    recordings = opts[:recordings] || if(File.dir?("recordings"), do: "recordings")

    settings = [
      log: log,
      log_options:
        ClusterLogOptions.connect_options(log, opts, ClusterConnection.identity_folder(opts)),
      labels: opts[:label],
      devices: opts[:device],
      recordings: recordings
    ]

    {:ok, agent} = settings |> Cluster.join() |> ensure_joined()
    Output.puts("#{name} is up")

    if opts[:studio],
      do:
        Output.puts(
          "the cluster is shown at #{ClusterNode.start_studio(opts[:studio], recordings)}cluster"
        )

    if opts[:metrics], do: start_metrics(opts[:metrics])

    # After this handler returns, Erlang's own handler shuts the VM down, so it blocks while the parts are drained.
    joined = self()
    trap = fn -> send(joined, :leave) && Process.sleep(:infinity) end
    {:ok, _} = System.trap_signal(:sigterm, trap)
    wait_for_end(name, Process.monitor(agent))
  end

  defp start_metrics(port) do
    server = Error.unwrap!(Situ.Metrics.Server.start_link(port: port))
    Output.puts("metrics are at http://127.0.0.1:#{Situ.Metrics.Server.port(server)}/metrics")
  end

  defp wait_for_end(name, monitor) do
    receive do
      {:DOWN, ^monitor, _, _, reason} ->
        Output.warn("situ cluster: the node ended: #{inspect(reason, limit: 8)}")
        1

      :leave ->
        Output.puts("#{name} is leaving; its parts continue on other nodes")
        drain_parts()
        0
    end
  end

  # Drains each part with a checkpoint if another node can take it. Service managers allow some seconds for a stop.
  defp drain_parts do
    %{members: members, deployments: deployments} = Cluster.Agent.info()

    if map_size(members) > 1 do
      task = Task.async(fn -> for d <- deployments, do: Cluster.drain(d, node()) end)
      Task.yield(task, @leave_ms) || Task.shutdown(task, :brutal_kill)
    end
  end

  defp ensure_joined({:error, %Error{} = error}), do: raise(error)
  defp ensure_joined(answer), do: answer

  defp show_status(opts) do
    info = ClusterConnection.call_node(opts, Cluster.Agent, :info, [])

    deployments =
      for d <- info.deployments,
          do: {d.name, ClusterConnection.call_node(opts, Cluster, :status, [d]).parts}

    if opts[:json] do
      Output.print_json(%{
        nodes: for({node, labels} <- info.members, do: %{name: node, labels: labels}),
        deployments:
          for(
            {name, parts} <- deployments,
            do: %{name: name, parts: for({p, i} <- parts, do: describe_part(p, i))}
          )
      })
    else
      for {node, labels} <- Enum.sort(info.members),
          do: Output.puts("#{node}  #{Enum.join(labels, ", ")}")

      if deployments == [], do: Output.puts("nothing is deployed")

      for {name, parts} <- deployments, {part, i} <- Enum.sort(parts) do
        r = describe_part(part, i)

        where = "#{name}/#{part}: #{r.phase} on #{r.node || "no node"}"
        Output.puts("#{where}, #{r.checkpoints} checkpoints, #{r.messages} messages out")
      end
    end

    0
  end

  defp describe_part(part, info) do
    streams = get_in(info, [:publisher, :streams]) || %{}

    %{
      part: part,
      phase: info.phase,
      node: info.node,
      checkpoints: get_in(info, [:checkpoints, :taken]) || 0,
      messages: streams |> Map.values() |> Enum.map(& &1.messages) |> Enum.sum()
    }
  end
end
