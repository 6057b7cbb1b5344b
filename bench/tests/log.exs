defmodule Situ.Bench.Log do
  # The log on real nats-servers, alternating with bare clients that do less and the same; with
  # one server, and with three whose leader is killed. Each writes to its own streams.
  alias Situ.Cluster.Log
  alias Situ.Cluster.Log.Entry

  @chunk 64 * 1024

  def tests do
    [
      {"log-nats", &one(max(50, round(2_000 * &1)))},
      {"log-nats-3", &three(max(50, round(500 * &1)))}
    ]
  end

  defp one(n) do
    root = Situ.Bench.folder!()
    server = server(root, "n1", Situ.Bench.free_port(), "")

    try do
      log = connect([server], 1)
      {{ours, _}, [bare, fenced]} = beside(log, [server.port], 1, n)

      # The server's own CPU time per chunk, without and with a conditional write.
      [plain, conditional] =
        for fence? <- [false, true] do
          socket = writer(server.port, if(fence?, do: "FENCED2", else: "BARE2"), 1)
          before = server_us(server.pid)
          publish(socket, fence?, 0, n)
          (server_us(server.pid) - before) / n
        end

      [
        {"log_nats", n * 1.0e9 / ours, "chunk/s"},
        {"log_bare", n * 1.0e9 / bare, "chunk/s"},
        {"log_ratio", bare / ours, "x"},
        {"log_ratio_fenced", fenced / ours, "x"},
        {"log_server_cpu", plain, "us/chunk"},
        {"log_server_fenced_cpu", conditional, "us/chunk"}
      ]
    after
      stop([server], root)
    end
  end

  # Both have one chunk in flight, and alternate so that other load on the machine affects both.
  defp beside(log, ports, replicas, n) do
    subject = {:stream, "b"}
    data = :crypto.strong_rand_bytes(@chunk)
    {:ok, first} = Log.append(log, subject, 0, %Entry{op: "0", data: data})
    plain = writer(hd(ports), "BARE", replicas)
    fenced = writer(hd(ports), "FENCED", replicas)
    publish(plain, false, 0, 1)
    last = publish(fenced, true, 0, 1)
    part = div(n, 10)

    {ours, _, seq, bare, conditional} =
      Enum.reduce(1..10, {0, last, first, 0, 0}, fn _, {ours, last, seq, bare, conditional} ->
        {a, seq} = timed(fn -> append(log, subject, seq, data, part) end)
        {b, _} = timed(fn -> publish(plain, false, nil, part) end)
        {c, last} = timed(fn -> publish(fenced, true, last, part) end)
        {ours + a, last, seq, bare + b, conditional + c}
      end)

    {{ours * n / (part * 10), seq}, for(t <- [bare, conditional], do: t * n / (part * 10))}
  end

  defp three(n) do
    root = Situ.Bench.folder!()
    ports = for _ <- 1..3, do: {Situ.Bench.free_port(), Situ.Bench.free_port()}
    routes = Enum.map_join(ports, ", ", fn {_, route} -> ~s("nats://127.0.0.1:#{route}") end)

    servers =
      for {{port, route}, i} <- Enum.with_index(ports) do
        cluster = ~s(cluster { name: "c", listen: "127.0.0.1:#{route}", routes: [#{routes}] })

        server(Path.join(root, "n#{i}"), "n#{i}", port, cluster)
      end

    try do
      log = connect(servers, 3)
      {{ours, _}, [bare, fenced]} = beside(log, for(s <- servers, do: s.port), 3, n)

      # The leader is killed in the middle. In the end every entry must exist once, and the
      # longest wait is the cost.
      subject = {:stream, "killed"}
      data = :crypto.strong_rand_bytes(@chunk)
      {:ok, []} = Log.read(log, subject, 1, 1)
      {:ok, _} = Log.append(log, subject, 0, %Entry{op: "k0", data: data})
      leader = leader(hd(servers).port, "SITU_S_killed")
      dead = Enum.find(servers, &(&1.name == leader))
      longest = killed(log, subject, data, n, dead)
      ^n = count(log, subject, 1, 0) - 1

      [
        {"log_nats_3", n * 1.0e9 / ours, "chunk/s"},
        {"log_bare_3", n * 1.0e9 / bare, "chunk/s"},
        {"log_ratio_3", bare / ours, "x"},
        {"log_ratio_3_fenced", fenced / ours, "x"},
        {"log_leader_killed", longest, "ms"}
      ]
    after
      stop(servers, root)
    end
  end

  defp killed(log, subject, data, n, dead) do
    {_, longest} =
      Enum.reduce(1..n, {1, 0}, fn i, {seq, longest} ->
        if i == div(n, 2), do: System.cmd("kill", ["-KILL", "#{dead.pid}"])
        {spent, seq} = timed(fn -> insist(log, subject, seq, %Entry{op: "k#{i}", data: data}) end)
        {seq, max(longest, spent)}
      end)

    longest / 1.0e6
  end

  # The same write again must be applied once.
  defp insist(log, subject, seq, entry) do
    case Log.append(log, subject, seq, entry) do
      {:ok, seq} ->
        seq

      {:error, _} ->
        Process.sleep(20)
        insist(log, subject, seq, entry)
    end
  end

  defp count(log, subject, from, n) do
    case Log.read(log, subject, from, 50) do
      {:ok, []} -> n
      {:ok, entries} -> count(log, subject, List.last(entries).seq + 1, n + length(entries))
      {:error, _} -> count(log, subject, from, n)
    end
  end

  defp connect(servers, replicas) do
    address = "nats://" <> Enum.map_join(servers, ",", &"127.0.0.1:#{&1.port}")
    {:ok, log} = patiently(fn -> Log.connect(address, replicas: replicas) end, 400)
    log
  end

  defp append(_log, _subject, seq, _data, 0), do: seq

  defp append(log, subject, seq, data, left) do
    {:ok, seq} = Log.append(log, subject, seq, %Entry{op: "#{seq}", data: data})
    append(log, subject, seq, data, left - 1)
  end

  # The bare client

  defp bare(port) do
    {:ok, socket} =
      :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false, nodelay: true])

    {:ok, _info} = :gen_tcp.recv(socket, 0, 10_000)

    inbox = inbox(socket)

    hello =
      ~s(CONNECT {"verbose":false,"headers":true,"no_responders":true}\r\nSUB #{inbox} 1\r\n)

    :ok = :gen_tcp.send(socket, hello)
    socket
  end

  defp inbox(socket), do: "_INBOX.bare#{:erlang.phash2(socket)}"

  # This client writes to its own stream.
  defp writer(port, stream, replicas) do
    socket = bare(port)

    config =
      ~s({"name":"#{stream}","subjects":["#{stream}"],"num_replicas":#{replicas},"storage":"file"})

    ask(socket, "$JS.API.STREAM.CREATE.#{stream}", config, ~r/"subjects":/)
    {socket, stream}
  end

  # With a condition, the client does the same as Situ's log.
  defp publish(_writer, _fence?, seq, 0), do: seq

  defp publish({socket, subject} = writer, fence?, seq, left) do
    data = Process.get(:chunk) || :crypto.strong_rand_bytes(@chunk)
    Process.put(:chunk, data)

    head =
      if fence?,
        do: "NATS/1.0\r\nNats-Expected-Last-Sequence: #{seq}\r\nSitu-Op: x\r\n\r\n",
        else: "NATS/1.0\r\nSitu-Op: x\r\n\r\n"

    sizes = "#{byte_size(head)} #{byte_size(head) + @chunk}"

    :ok =
      :gen_tcp.send(socket, [
        "HPUB ",
        subject,
        " ",
        inbox(socket),
        " ",
        sizes,
        "\r\n",
        head,
        data,
        "\r\n"
      ])

    [_, seq] = answered(socket, "", ~r/"seq":\s*(\d+)/)
    publish(writer, fence?, String.to_integer(seq), left - 1)
  end

  defp ask(socket, subject, body, answer) do
    :ok =
      :gen_tcp.send(socket, [
        "PUB #{subject} #{inbox(socket)} #{byte_size(body)}\r\n",
        body,
        "\r\n"
      ])

    answered(socket, "", answer)
  end

  defp answered(socket, got, answer) do
    {:ok, more} = :gen_tcp.recv(socket, 0, 30_000)
    got = got <> more
    Regex.run(answer, got) || answered(socket, got, answer)
  end

  # Servers

  defp server(root, name, port, settings) do
    File.mkdir_p!(root)
    config = Path.join(root, "server.conf")

    File.write!(config, """
    listen: "127.0.0.1:#{port}"
    server_name: "#{name}"
    jetstream { store_dir: "#{Path.join(root, "data")}" }
    #{settings}
    """)

    process =
      Port.open({:spawn_executable, path()}, [:binary, :stderr_to_stdout, args: ["-c", config]])

    {:os_pid, pid} = Port.info(process, :os_pid)
    %{name: name, port: port, pid: pid}
  end

  defp stop(servers, root) do
    for %{pid: pid} <- servers,
        do: System.cmd("kill", ["-KILL", "#{pid}"], stderr_to_stdout: true)

    File.rm_rf!(root)
  end

  # Any server can report the leader of a stream.
  defp leader(port, stream) do
    [_, name] = ask(bare(port), "$JS.API.STREAM.INFO.#{stream}", "", ~r/"leader":\s*"(n\d)"/)
    name
  end

  # In clock ticks, which are a hundredth of a second on Linux.
  defp server_us(pid) do
    [_, rest] = "/proc/#{pid}/stat" |> File.read!() |> String.split(") ", parts: 2)
    fields = String.split(rest)
    (String.to_integer(Enum.at(fields, 11)) + String.to_integer(Enum.at(fields, 12))) * 10_000
  end

  defp timed(fun) do
    started = System.monotonic_time(:nanosecond)
    result = fun.()
    {System.monotonic_time(:nanosecond) - started, result}
  end

  defp patiently(fun, 0), do: fun.()

  defp patiently(fun, left) do
    with {:error, _} <- fun.() do
      Process.sleep(50)
      patiently(fun, left - 1)
    end
  end

  defp path do
    fetched = Path.expand("../../apps/situ_link/priv/nats/nats-server", __DIR__)

    System.get_env("SITU_NATS_SERVER") || (File.exists?(fetched) && fetched) ||
      System.find_executable("nats-server") ||
      raise "there is no nats-server: bin/setup --for test fetches one"
  end
end
