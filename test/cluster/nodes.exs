Code.require_file("../../apps/situ_types/test/support/free_port.ex", __DIR__)

# Starts, kills, stops and queries nodes, which are OS processes.
defmodule Nodes do
  def start(log, name, labels, peers, net) do
    ip = Net.ip(net, name)
    node = :"#{name}-#{Situ.Test.FreePort.find_tcp()}@#{ip}"
    tuple = "{" <> String.replace(ip, ".", ",") <> "}"
    ebin = System.get_env("SITU_EBIN") |> String.split()

    erl =
      Enum.map_join(ebin, " ", &"-pa #{&1}") <>
        " -start_epmd false -epmd_module Elixir.Situ.Cluster.Epmd +sbwt none" <>
        " -kernel inet_dist_use_interface #{tuple} prevent_overlapping_partitions false logger_level error"

    args =
      ["--name", "#{node}", "--cookie", "#{Node.get_cookie()}", "--erl", erl] ++
        ["-r", "sums.exs", "node.exs", log, labels] ++
        Enum.map(peers, &to_string/1)

    [program | args] = Net.within(net, name, [System.find_executable("elixir") | args])

    port =
      Port.open({:spawn_executable, program}, [
        :binary,
        :exit_status,
        :stderr_to_stdout,
        args: args
      ])

    {:os_pid, _shell} = Port.info(port, :os_pid)
    wait_up(port, node, "")
    true = Node.connect(node)
    %{name: name, node: node, port: port, pid: :erpc.call(node, :os, :getpid, []) |> to_string()}
  end

  defp wait_up(port, node, said) do
    receive do
      {^port, {:data, text}} ->
        unless said <> text =~ ~r/^up$/m, do: wait_up(port, node, said <> text)

      {^port, {:exit_status, status}} ->
        raise "#{node} ended with #{status}: #{said}"
    after
      120_000 -> raise "#{node} did not start: #{said}"
    end
  end

  @doc "Returns a nats-server on this machine, or `nil` if there is none."
  def nats(work, net, port \\ Situ.Test.FreePort.find_tcp()) do
    if path = nats_path() do
      args = ["-a", Net.ip(net, :here), "-p", "#{port}", "-js", "-sd", Path.join(work, "nats")]

      process =
        Port.open({:spawn_executable, path}, [
          :binary,
          :exit_status,
          :stderr_to_stdout,
          args: args
        ])

      {:os_pid, pid} = Port.info(process, :os_pid)

      %{
        address: "nats://#{Net.ip(net, :here)}:#{port}",
        port: port,
        pid: "#{pid}",
        process: process
      }
    end
  end

  defp nats_path do
    fetched = Path.expand("../../apps/situ_link/priv/nats/nats-server", __DIR__)

    System.get_env("SITU_NATS_SERVER") || (File.exists?(fetched) && fetched) ||
      System.find_executable("nats-server")
  end

  def signal(%{pid: pid}, signal),
    do: System.cmd("kill", ["-#{signal}", pid], stderr_to_stdout: true)

  def kill(nodes, name) do
    signal(nodes[name], "KILL")
    port = nodes[name].port

    receive do
      {^port, {:exit_status, _}} -> :ok
    after
      60_000 -> raise "#{name} did not end"
    end

    Map.delete(nodes, name)
  end

  def call(nodes, fun, args) do
    node = nodes |> Map.values() |> hd() |> Map.fetch!(:node)
    :erpc.call(node, Situ.Cluster, fun, args, 300_000)
  end
end
