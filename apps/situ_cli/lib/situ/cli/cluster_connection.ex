defmodule Situ.CLI.ClusterConnection do
  @moduledoc false
  # Connects the command line to the nodes of a cluster, with the cookie and the certificates of the cluster's folder.
  # The script bin/situ gives the VM the same flags as a node (`rel/overlays/bin/cluster-flags`).
  alias Situ.Cluster.Identity
  alias Situ.CLI.Option
  alias Situ.Error

  @doc "Returns the options of all verbs that use a cluster: a node of it, and its folder."
  @spec options() :: [Option.t()]
  def options, do: [node_option(), folder_option()]

  defp node_option,
    do: Option.new(:node, :string, "a node of the cluster, as situ-9301@10.0.0.1", value: "NODE")

  @doc "Returns the option for the cluster's folder."
  @spec folder_option() :: Option.t()
  def folder_option do
    Option.new(
      :identity,
      :path,
      "the cluster's cookie and certificates (default: SITU_CLUSTER, ~/.config/situ/cluster)"
    )
  end

  @doc "Calls a function on the node of the options, from a VM that is not a member of the cluster."
  @spec call_node(keyword(), module(), atom(), list()) :: term()
  def call_node(opts, module, function, args) do
    name =
      opts[:node] ||
        raise Error.new(:usage, "no node given", fix: "give --node situ-9301@10.0.0.1")

    node = String.to_atom(name)
    unless Node.alive?(), do: start_distribution(new_name(), opts)
    unless connect_node(node), do: raise(unreachable_error(node))

    try do
      :erpc.call(node, module, function, args, 120_000)
    catch
      :error, {:erpc, reason} ->
        raise Error.new(:unreachable, "lost the connection to #{node}: #{inspect(reason)}")

      :exit, _ ->
        raise Error.new(:no_member, "#{node} is not a member of a cluster",
                fix: "see `situ cluster join`"
              )
    end
  end

  # Command lines on two machines may have the same process id.
  defp new_name, do: "situ_cli_#{System.pid()}_#{:rand.uniform(1_000_000)}@127.0.0.1"

  # Members of the cluster do not see this node, and do not tell each other about it.
  defp connect_node(node), do: :net_kernel.hidden_connect_node(node) == true

  defp unreachable_error(node) do
    Error.new(:unreachable, "#{node} is not responding",
      why: "it is not running, or uses a different cookie or different certificates",
      fix: "check the name, and that both nodes use the same folder of `situ cluster init`"
    )
  end

  @doc """
  Connects to all members of the cluster that have all of these labels, and returns those that respond. Asks another
  connected node if the node of the options was lost.
  """
  @spec connect_members(keyword(), labels :: [String.t()]) :: [node()]
  def connect_members(opts, labels) do
    members = call_any(Node.list(:hidden)) || call_node(opts, Situ.Cluster.Agent, :info, [])
    for {node, own} <- members.members, labels -- own == [], connect_node(node), do: node
  end

  defp call_any(nodes) do
    Enum.find_value(nodes, fn node ->
      try do
        :erpc.call(node, Situ.Cluster.Agent, :info, [], 5_000)
      catch
        _, _ -> nil
      end
    end)
  end

  @doc "Starts this VM's distribution under a name. The node listens only on the host in its name."
  @spec start_distribution(String.t(), keyword()) :: true
  def start_distribution(name, opts) do
    cookie = Error.unwrap!(Identity.read_cookie(identity_folder(opts)))

    with [_, host] <- String.split(name, "@", parts: 2),
         {:ok, ip} <- :inet.getaddr(to_charlist(host), :inet) do
      Application.put_env(:kernel, :inet_dist_use_interface, ip)
    else
      _ ->
        raise Error.new(:usage, "invalid node name: #{name}",
                fix: "write it like situ-9301@10.0.0.1"
              )
    end

    case Node.start(String.to_atom(name), :longnames) do
      {:ok, _} ->
        Node.set_cookie(cookie)

      {:error, reason} ->
        raise Error.new(
                :no_distribution,
                "cannot start node #{name}: #{inspect(reason, limit: 20)}",
                fix: "check that its port is free"
              )
    end
  end

  @doc "Returns the cluster's folder."
  @spec identity_folder(keyword()) :: Path.t()
  def identity_folder(opts) do
    opts[:identity] || System.get_env("SITU_CLUSTER") ||
      Path.join(System.get_env("XDG_CONFIG_HOME") || Path.expand("~/.config"), "situ/cluster")
  end
end
