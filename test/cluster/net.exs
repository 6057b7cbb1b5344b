# A test network: each node has a namespace, and a bridge joins them, so that links can be cut and
# slowed down. Without root or `ip netns`, all nodes use the loopback device, and the test reports
# this.
defmodule Net do
  @subnet "10.213.#{rem(System.os_time(:second), 200) + 20}"
  @hosts %{here: 1, a: 2, b: 3, c: 4}

  def open(work) do
    id = "st#{System.pid()}"
    made = Path.join(work, "net")

    with :ok <- ip(["link", "add", bridge(id), "type", "bridge"], made, bridge(id)),
         :ok <- ip(["addr", "add", "#{@subnet}.1/24", "dev", bridge(id)]),
         :ok <- ip(["link", "set", bridge(id), "up"]),
         :ok <- all(~w(a b c), &join(id, &1, made)) do
      unless delays?(id),
        do:
          IO.puts("NOT RUN: delay and loss by netem, which this kernel lacks; thin links by tbf")

      id
    else
      {:error, why} ->
        close(id)

        IO.puts(
          "NOT RUN: cuts and thin links, since there are no network namespaces (#{String.trim(why)})"
        )

        nil
    end
  end

  defp join(id, name, made) do
    with :ok <- ip(["netns", "add", space(id, name)], made, space(id, name)),
         :ok <-
           ip([
             "link",
             "add",
             link(id, name),
             "type",
             "veth",
             "peer",
             "name",
             "eth0",
             "netns",
             space(id, name)
           ]),
         :ok <- ip(["link", "set", link(id, name), "master", bridge(id), "up"]),
         :ok <- inside(id, name, ["addr", "add", "#{ip(id, name)}/24", "dev", "eth0"]),
         :ok <- inside(id, name, ["link", "set", "eth0", "up"]),
         do: inside(id, name, ["link", "set", "lo", "up"])
  end

  defp all(names, fun), do: Enum.find_value(names, :ok, &with(:ok <- fun.(&1), do: nil))

  def close(nil), do: :ok

  def close(id) do
    for name <- ~w(a b c),
        do: System.cmd("ip", ["netns", "del", space(id, name)], stderr_to_stdout: true)

    System.cmd("ip", ["link", "del", bridge(id)], stderr_to_stdout: true)
    :ok
  end

  def ip(nil, _name), do: "127.0.0.1"
  def ip(_id, name), do: "#{@subnet}.#{@hosts[:"#{name}"]}"

  def within(nil, _name, command), do: command

  def within(id, name, command),
    do: [System.find_executable("ip"), "netns", "exec", space(id, name) | command]

  def troubles(nil), do: []
  def troubles(_id), do: [:cut, :thin]

  @doc "Drops all packets in both directions without an error."
  def cut(id, name), do: :ok = ip(["link", "set", link(id, name), "nomaster"])

  @doc "Sets a delay of 100 ms and a loss of one packet in fifty, or a rate of a megabit per second."
  def thin(id, name) do
    :ok =
      if delays?(id),
        do:
          tc([
            "qdisc",
            "replace",
            "dev",
            link(id, name),
            "root",
            "netem",
            "delay",
            "100ms",
            "loss",
            "2%"
          ]),
        else:
          tc([
            "qdisc",
            "replace",
            "dev",
            link(id, name),
            "root",
            "tbf",
            "rate",
            "1mbit",
            "burst",
            "16kbit",
            "latency",
            "300ms"
          ])
  end

  def heal(id, name) do
    :ok = ip(["link", "set", link(id, name), "master", bridge(id)])
    _ = tc(["qdisc", "del", "dev", link(id, name), "root"])
    :ok
  end

  defp delays?(id) do
    with nil <- Process.get({:netem, id}) do
      able? = tc(["qdisc", "add", "dev", bridge(id), "root", "netem", "delay", "1ms"]) == :ok
      if able?, do: tc(["qdisc", "del", "dev", bridge(id), "root"])
      Process.put({:netem, id}, able?)
      able?
    end
  end

  defp bridge(id), do: id
  defp link(id, name), do: "#{id}#{name}"
  defp space(id, name), do: "#{id}-#{name}"

  defp inside(id, name, args), do: run(["ip", "-n", space(id, name) | args])

  # Records each object before it is created, so that `run` can remove it even if this script
  # dies.
  defp ip(args, file, what) do
    File.write!(file, what <> "\n", [:append])
    run(["ip" | args])
  end

  defp ip(args), do: run(["ip" | args])
  defp tc(args), do: run(["tc" | args])

  defp run([program | args]) do
    case System.find_executable(program) && System.cmd(program, args, stderr_to_stdout: true) do
      nil -> {:error, "there is no #{program}"}
      {_, 0} -> :ok
      {said, _} -> {:error, said}
    end
  end
end
