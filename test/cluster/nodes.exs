# Nodes as OS processes: started, killed, stopped, asked.
defmodule Nodes do
  def start(work, name, labels, peers) do
    node = :"#{name}-#{free_port()}@127.0.0.1"
    ebin = System.get_env("SITU_EBIN") |> String.split()

    erl =
      Enum.map_join(ebin, " ", &"-pa #{&1}") <>
        " -start_epmd false -epmd_module Elixir.Situ.Cluster.Epmd +sbwt none" <>
        " -kernel inet_dist_use_interface {127,0,0,1} prevent_overlapping_partitions false logger_level error"

    args =
      ["--name", "#{node}", "--cookie", "#{Node.get_cookie()}", "--erl", erl] ++
        ["-r", "sums.exs", "node.exs", Path.join(work, "log"), labels] ++
        Enum.map(peers, &to_string/1)

    port =
      Port.open({:spawn_executable, System.find_executable("elixir")}, [
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
    :erpc.call(node, Situ.Cluster, fun, args, 120_000)
  end

  def free_port do
    {:ok, socket} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(socket)
    :gen_tcp.close(socket)
    port
  end
end
