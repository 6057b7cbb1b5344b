# The driver of the cluster test. See the comment in `run`.
defmodule Driver do
  @replay [replay: [interval: {0, 3_600_000_000_000}, speed: 1.0]]
  @fast [replay: [interval: {0, 3_600_000_000_000}, speed: :max]]

  def main([work, seconds]) do
    {:ok, _} = Application.ensure_all_started(:situ)
    Process.flag(:trap_exit, true)
    Process.put(:log, Path.join(work, "log"))
    Process.put(:work, work)
    remember(System.pid())
    Process.put(:net, Net.open(work))

    try do
      results = scenarios(work, start(%{}, ~w(a b c)), random_till(seconds))
      bad = Enum.reject(results, &elem(&1, 1))
      for {name, ok} <- results, do: IO.puts("#{if ok, do: "ok    ", else: "FAILED"} #{name}")
      IO.puts("#{length(results) - length(bad)} passed, #{length(bad)} failed")
      if bad != [], do: System.halt(1)
    after
      for pid <- Process.get(:pids, []),
          pid != System.pid(),
          do: System.cmd("kill", ["-KILL", pid], stderr_to_stdout: true)

      Net.close(Process.get(:net))
    end
  end

  # "25" means seconds, "100x" a number of faults.
  defp random_till(text) do
    case Integer.parse(text) do
      {n, "x"} -> {:times, n}
      {n, ""} -> {:seconds, n}
    end
  end

  defp start(nodes, names) do
    Enum.reduce(names, nodes, fn name, nodes ->
      peers = for {_, n} <- nodes, do: n.node
      node = Nodes.start(Process.get(:log), name, name, peers, Process.get(:net))
      remember(node.pid)
      Map.put(nodes, name, node)
    end)
  end

  # If this driver dies, `run` ends the processes in this file.
  defp remember(pid) do
    Process.put(:pids, [pid | Process.get(:pids, [])])
    File.write!(Path.join(Process.get(:work), "pids"), pid <> "\n", [:append])
  end

  # Runs one deployment with a fault in the middle.
  defp one(nodes, name, count, trouble, opts \\ []) do
    opts =
      Keyword.merge(
        [
          name: name,
          opts: [count: count],
          place: [
            {"Left", on: ["a", "b", "c"], deterministic: true},
            {"Sum", on: ["b", "c", "a"], deterministic: true},
            {"Dice", on: ["c", "b", "a"]}
          ],
          publish: ["Smooth.Window", "Result"],
          checkpoint: 150_000_000,
          lease: 600_000_000,
          pipeline: @replay
        ],
        opts
      )

    deployment = deploy(nodes, opts)
    nodes = trouble.(deployment, nodes)
    answer = Nodes.call(nodes, :await, [deployment, 240_000])
    {answer, deployment, nodes}
  end

  # As the error states, undelivered messages are repeated, and nothing is done twice.
  defp deploy(nodes, opts, tries \\ 10) do
    case Nodes.call(nodes, :deploy, [Sums, opts]) do
      {:ok, deployment} -> deployment
      {:error, %{code: :log_away}} when tries > 1 -> deploy(nodes, opts, tries - 1)
      {:error, error} -> raise error
    end
  end

  defp same?({:ok, deployment, nodes}, count) do
    {:ok, smooth} = Nodes.call(nodes, :read, [deployment, "Smooth.Window"])
    {:ok, result} = Nodes.call(nodes, :read, [deployment, "Result"])
    expected = expected(count)
    smooth? = for(m <- smooth, do: {m.data, m.originating_time}) == expected
    # The random numbers differ between runs, but each value must follow from the previous one.
    sums = for m <- result, do: m.data

    chain? =
      sums
      |> Enum.reduce_while(0, fn {_, d, s}, sum ->
        if s == sum + d, do: {:cont, s}, else: {:halt, nil}
      end)

    data? = for(m <- result, do: {elem(m.data, 0), m.originating_time}) == expected
    numbered? = for(m <- result, do: m.sequence_id) == Enum.to_list(1..length(result)//1)

    unless smooth? and chain? && data? and numbered? do
      IO.inspect(
        smooth: {smooth?, length(smooth), length(expected)},
        chain: chain? != nil,
        result: {data?, length(result)},
        numbered: numbered?
      )
    end

    smooth? and chain? != nil and data? and numbered?
  end

  defp same?({{:error, error}, deployment, nodes}, _count) do
    IO.puts("  " <> Exception.message(error))

    for {part, info} <- Nodes.call(nodes, :status, [deployment]).parts do
      seen = Map.take(info, [:node, :phase, :epoch, :checkpoints, :publisher, :error])
      IO.inspect({part, seen}, limit: 50)
    end

    false
  end

  defp expected(count) do
    with nil <- Process.get({:expected, count}) do
      me = self()

      build = fn p ->
        p |> Sums.build(count: count) |> Situ.each(&send(me, {:m, {&1, &2.originating_time}}))
      end

      {:ok, _} = Situ.Pipeline.run(build, pipeline: @fast)
      list = heard([])
      Process.put({:expected, count}, list)
      list
    end
  end

  defp heard(list) do
    receive do
      {:m, m} -> heard([m | list])
    after
      0 -> Enum.reverse(list)
    end
  end

  defp wait(ms), do: receive(do: (:never -> :ok), after: (ms -> :ok))

  # Returns the node that runs a part, and waits until there is one.
  defp owner(nodes, deployment, part) do
    case Nodes.call(nodes, :status, [deployment]).parts do
      %{^part => %{node: node}} when node != nil ->
        Enum.find_value(nodes, fn {name, n} -> if n.node == node, do: name end)

      _ ->
        wait(20)
        owner(nodes, deployment, part)
    end
  end

  # Waits until a stream has this number of messages.
  defp until(nodes, deployment, stream, n) do
    {:ok, messages} = Nodes.call(nodes, :read, [deployment, stream])

    if length(messages) < n,
      do:
        (
          wait(20)
          until(nodes, deployment, stream, n)
        ),
      else: :ok
  end

  defp scenarios(work, nodes, random) do
    plain = one(nodes, "plain", 1_000, fn _, nodes -> nodes end)
    r1 = {"three nodes give what one gives", same?(plain, 1_000)}
    nodes = elem(plain, 2)

    lost =
      one(nodes, "lost", 2_000, fn d, nodes ->
        until(nodes, d, "Smooth.Window", 300)
        Nodes.kill(nodes, owner(nodes, d, "Sum"))
      end)

    r2 = {"the node of a deterministic part is killed", same?(lost, 2_000)}
    nodes = refill(elem(lost, 2))

    dice =
      one(nodes, "dice", 2_000, fn d, nodes ->
        until(nodes, d, "Result", 300)
        Nodes.kill(nodes, owner(nodes, d, "Dice"))
      end)

    r3 = {"the node of a part that throws dice is killed", same?(dice, 2_000)}
    nodes = refill(elem(dice, 2))
    # The other nodes have received it by then.
    at_once =
      one(nodes, "at once", 1_000, fn _, nodes -> Nodes.kill(nodes, hd(Map.keys(nodes))) end)

    r0 = {"the node that deployed is killed at once", same?(at_once, 1_000)}
    nodes = refill(elem(at_once, 2))
    {r4, nodes} = zombie(nodes)
    {r5, nodes} = moved(nodes)
    {r6, nodes} = upgraded(nodes)
    for {name, _} <- nodes, do: Nodes.kill(nodes, name)
    {rs, nodes} = nats(work)
    nodes = if nodes == %{}, do: start(%{}, ~w(a b c)), else: nodes
    {random, nodes} = random(nodes, random, System.monotonic_time(:second), 1, [])
    for {name, _} <- nodes, do: Nodes.kill(nodes, name)
    [r1, r2, r3, r0, r4, r5] ++ r6 ++ rs ++ random
  end

  defp refill(nodes), do: start(nodes, ~w(a b c) -- Map.keys(nodes))

  # A node pauses for longer than its lease, and then continues as if nothing had happened.
  defp zombie(nodes) do
    frozen = fn d, nodes ->
      until(nodes, d, "Result", 200)
      name = owner(nodes, d, "Dice")
      stopped = nodes[name]
      Nodes.signal(stopped, "STOP")
      others = Map.delete(nodes, name)
      {:ok, seen} = Nodes.call(others, :read, [d, "Result"])
      until(others, d, "Result", length(seen) + 50)
      Nodes.signal(stopped, "CONT")
      Process.put(:frozen, {name, stopped})
      others
    end

    result = {_, _, others} = one(nodes, "zombie", 2_500, frozen)
    ok? = same?(result, 2_500)
    {name, stopped} = Process.get(:frozen)

    {{"a node that was cut off is refused when it comes back", ok?},
     Map.put(others, name, stopped)}
  end

  defp moved(nodes) do
    result =
      one(nodes, "moved", 2_000, fn d, nodes ->
        until(nodes, d, "Smooth.Window", 200)
        from = owner(nodes, d, "Sum")
        to = hd(Map.keys(nodes) -- [from])
        :ok = Nodes.call(nodes, :move, [d, "Sum", nodes[to].node])
        Process.put(:moved, owner(nodes, d, "Sum") == to)
        :ok = Nodes.call(nodes, :drain, [d, nodes["c"].node])
        nodes
      end)

    {{"parts are moved while they run", same?(result, 2_000) and Process.get(:moved)}, nodes}
  end

  # All nodes load new code while they are running: Dice reports a new version, and its values
  # still form a chain.
  defp upgraded(nodes) do
    Code.put_compiler_option(:ignore_module_conflict, true)

    source =
      "sums.exs" |> File.read!() |> String.replace("def version, do: 1", "def version, do: 2")

    dice = source |> Code.compile_string() |> List.keyfind(Dice, 0)

    result =
      one(nodes, "upgraded", 3_000, fn d, nodes ->
        until(nodes, d, "Result", 200)
        Process.put(:upgraded, Nodes.call(nodes, :upgrade, [[dice]]))
        nodes
      end)

    took? = match?({:ok, [_, _, _]}, Process.get(:upgraded))
    versions = for {_, n} <- nodes, do: :erpc.call(n.node, Dice, :version, [])
    info = Nodes.call(nodes, :info, [elem(result, 1)])

    {[
       {"new code is taken up by all nodes while they run", same?(result, 3_000) and took?},
       {"and it is what runs", versions == [2, 2, 2]},
       {"a deployment is one pipeline to look at", info.pipeline == "upgraded"}
     ], nodes}
  end

  # The same over NATS: a node is killed, and then the server, which restarts with its stored
  # data. The last nodes continue to the random part.
  defp nats(work) do
    if server = Nodes.nats(work, Process.get(:net)) do
      remember(server.pid)
      Process.put(:log, server.address)
      nodes = start(%{}, ~w(a b c))

      {answer, deployment, nodes} =
        one(nodes, "nats", 2_500, fn d, nodes ->
          until(nodes, d, "Result", 200)
          nodes = Nodes.kill(nodes, owner(nodes, d, "Dice"))
          until(nodes, d, "Result", 600)
          Nodes.signal(server, "KILL")
          wait(500)
          server = Nodes.nats(work, Process.get(:net), server.port)
          remember(server.pid)
          nodes
        end)

      ok? = same?({answer, deployment, nodes}, 2_500)
      {[{"over NATS: a node is killed, then the server", ok?}], refill(nodes)}
    else
      IO.puts(
        "NOT RUN: the log over NATS, since there is no nats-server (bin/setup --for test fetches one)"
      )

      {[], %{}}
    end
  end

  # Random faults, for the given time or number.
  defp random(nodes, how, since, i, results) do
    if enough?(how, since, i) do
      {Enum.reverse(results), nodes}
    else
      victim = Enum.random(Map.keys(nodes))
      trouble = Enum.random([:kill, :stop, :pause, :parted] ++ Net.troubles(Process.get(:net)))
      count = 600 + :rand.uniform(600)
      ms = :rand.uniform(count)
      {happened, result} = {trouble, troubled(nodes, i, count, ms, victim, trouble)}
      ok? = same?(result, count)
      nodes = nodes_again(elem(result, 2))
      name = "random #{i}: #{happened} of #{victim} after #{ms} ms"
      if match?({:times, _}, how), do: IO.puts("#{if ok?, do: "ok", else: "FAILED"} #{name}")
      random(nodes, how, since, i + 1, [{name, ok?} | results])
    end
  end

  defp enough?({:seconds, n}, since, _i), do: System.monotonic_time(:second) - since >= n
  defp enough?({:times, n}, _since, i), do: i > n

  defp troubled(nodes, i, count, ms, victim, trouble) do
    # On a shared machine, all processes may pause for half a second.
    lease = [lease: 1_500_000_000]

    one(
      nodes,
      "random#{i}",
      count,
      fn _d, nodes ->
        wait(ms)
        trouble(trouble, nodes, victim)
      end,
      lease
    )
  end

  # A stopped node is not queried. It is back before or when the deployment has ended
  # (`nodes_again/1`).
  defp trouble(:kill, nodes, victim), do: Nodes.kill(nodes, victim)

  # For longer than its lease, or shorter.
  defp trouble(stop, nodes, victim) when stop in [:stop, :pause] do
    Nodes.signal(nodes[victim], "STOP")
    ms = if stop == :stop, do: 3_500, else: 50 + :rand.uniform(250)
    later(ms, fn -> Nodes.signal(nodes[victim], "CONT") end)
    away(nodes, victim)
  end

  # The nodes lose the connection to each other, but not to the log.
  defp trouble(:parted, nodes, victim) do
    for {name, other} <- nodes, name != victim do
      :erpc.call(nodes[victim].node, :erlang, :disconnect_node, [other.node])
    end

    nodes
  end

  defp trouble(:cut, nodes, victim) do
    net = Process.get(:net)
    Net.cut(net, victim)
    later(3_500, fn -> Net.heal(net, victim) end)
    away(nodes, victim)
  end

  defp trouble(:thin, nodes, victim) do
    net = Process.get(:net)
    Net.thin(net, victim)
    later(3_500, fn -> Net.heal(net, victim) end)
    nodes
  end

  defp later(ms, fun) do
    task =
      Task.async(fn ->
        wait(ms)
        fun.()
      end)

    Process.put(:healing, [task | Process.get(:healing, [])])
  end

  defp away(nodes, victim) do
    Process.put(:away, {victim, nodes[victim]})
    Map.delete(nodes, victim)
  end

  defp nodes_again(nodes) do
    Task.await_many(Process.get(:healing, []), 60_000)
    Process.put(:healing, [])

    nodes =
      case Process.delete(:away) do
        {name, node} -> back(nodes, name, node)
        nil -> nodes
      end

    refill(nodes)
  end

  # Waits until it is connected to all others again, or was ended and restarted.
  defp back(nodes, name, node) do
    for {_, other} <- nodes, do: :erpc.call(other.node, Node, :connect, [node.node])
    members = fn -> Enum.map(nodes, fn {_, n} -> :erpc.call(n.node, Node, :list, []) end) end

    if Node.connect(node.node) == true and Enum.all?(members.(), &(node.node in &1)),
      do: Map.put(nodes, name, node),
      else: Nodes.kill(Map.put(nodes, name, node), name)
  end
end

Driver.main(System.argv())
