defmodule Situ.Bench.Log do
  # The log on real nats-servers, in turns with a bare client that does the same or less; one server, and three of which
  # the leader is killed.
  alias Situ.Remote.Log
  alias Situ.Remote.Log.Entry

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
      {{ours, _}, [bare, fenced]} = beside(log, server.port, n)

      # The server's own CPU time for a chunk: without and with the condition of a write.
      [plain, conditional] =
        for fence? <- [false, true] do
          socket = bare(server.port)
          {before, _} = {server_us(server.pid), publish(socket, fence?, 0, 1)}
          publish(socket, fence?, nil, n)
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

  # One chunk under way, as both must; in turns, so that all meet the same neighbours.
  defp beside(log, port, n) do
    subject = {:stream, "b#{System.unique_integer([:positive])}"}
    data = :crypto.strong_rand_bytes(@chunk)
    {:ok, first} = Log.append(log, subject, 0, %Entry{op: "0", data: data})
    {plain, fenced} = {bare(port), bare(port)}
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
      {leader, _} = leader(hd(servers).port)
      {{ours, _}, [bare, _]} = beside(log, port(servers, leader), n)

      # The leader dies in the middle: every entry is there in the end, once, and the longest wait is what it cost.
      subject = {:stream, "killed"}
      data = :crypto.strong_rand_bytes(@chunk)
      dead = Enum.find(servers, &(&1.name == leader))
      longest = killed(log, subject, data, n, dead)
      ^n = count(log, subject, 1, 0)

      [
        {"log_nats_3", n * 1.0e9 / ours, "chunk/s"},
        {"log_bare_3", n * 1.0e9 / bare, "chunk/s"},
        {"log_ratio_3", bare / ours, "x"},
        {"log_leader_killed", longest, "ms"}
      ]
    after
      stop(servers, root)
    end
  end

  defp killed(log, subject, data, n, dead) do
    {_, longest} =
      Enum.reduce(1..n, {0, 0}, fn i, {seq, longest} ->
        if i == div(n, 2), do: System.cmd("kill", ["-KILL", "#{dead.pid}"])
        {spent, seq} = timed(fn -> insist(log, subject, seq, %Entry{op: "k#{i}", data: data}) end)
        {seq, max(longest, spent)}
      end)

    longest / 1.0e6
  end

  # The same write again: it happens once.
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

  # Into the same stream of the server, on a subject of its own; with a condition it is the same as ours.
  defp publish(_socket, _fence?, seq, 0), do: seq

  defp publish(socket, fence?, seq, left) do
    data = Process.get(:chunk) || :crypto.strong_rand_bytes(@chunk)
    Process.put(:chunk, data)

    subject = if fence?, do: "situ.s.fenced#{:erlang.phash2(socket)}", else: "situ.s.bare"

    head =
      if fence? and seq != nil,
        do: "NATS/1.0\r\nNats-Expected-Last-Subject-Sequence: #{seq}\r\n\r\n",
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

    publish(socket, fence?, answered(socket, ""), left - 1)
  end

  defp answered(socket, got) do
    {:ok, more} = :gen_tcp.recv(socket, 0, 30_000)
    got = got <> more

    case Regex.run(~r/"seq":\s*(\d+)/, got) do
      [_, seq] -> String.to_integer(seq)
      nil -> answered(socket, got)
    end
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

  # Who leads the stream: asked of any server.
  defp leader(port) do
    socket = bare(port)
    :ok = :gen_tcp.send(socket, "PUB $JS.API.STREAM.INFO.SITU #{inbox(socket)} 0\r\n\r\n")
    told(socket, "")
  end

  defp told(socket, got) do
    {:ok, more} = :gen_tcp.recv(socket, 0, 10_000)
    got = got <> more

    case Regex.run(~r/"leader":\s*"(n\d)"/, got) do
      [_, name] -> {name, socket}
      nil -> told(socket, got)
    end
  end

  defp port(servers, name), do: Enum.find(servers, &(&1.name == name)).port

  # In clock ticks of a hundredth of a second, as Linux has them.
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
    fetched = Path.expand("../../apps/situ_remote/priv/nats/nats-server", __DIR__)

    System.get_env("SITU_NATS_SERVER") || (File.exists?(fetched) && fetched) ||
      System.find_executable("nats-server") ||
      raise "there is no nats-server: bin/setup --for test fetches one"
  end
end
