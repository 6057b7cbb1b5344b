defmodule Situ.Bench.Cluster do
  # Clusters and their log: an edge between two nodes (each a virtual machine of its own, whose CPU time is counted),
  # the log on a real nats-server beside a bare client in turns, checkpoints, and a link with very many streams.
  alias Situ.{Message, Pipeline, Remote}
  alias Situ.Remote.{Connection, Log, Server}
  alias Situ.Remote.Log.Entry
  alias Situ.Store.Writer

  @chunk 64 * 1024

  def tests do
    [
      {"cluster-edge", &edge("cluster_edge", "numbers", max(2_000, round(400_000 * &1)))},
      {"cluster-edge-1mb", &edge("cluster_edge_1mb", "pictures", max(20, round(300 * &1)))},
      {"log-nats", &log(max(50, round(2_000 * &1)))},
      {"checkpoints", &checkpoints(max(5, round(100 * &1)))},
      {"link-10000-streams", &many_streams(max(100, round(10_000 * &1)))}
    ]
  end

  # Two nodes

  @pipe """
  defmodule Situ.Bench.ClusterPipe do
    use Situ.Pipeline

    @impl true
    def build(p, opts) do
      n = opts[:count]
      data = if opts[:kind] == "pictures", do: :binary.copy(<<7>>, 1024 * 1024)
      made = Situ.sequence(p, 1, &(&1 + 1), count: n, every: 1_000, name: "Made")
      made = if data, do: Situ.map(made, fn _ -> data end, name: "Picture"), else: made
      made |> Situ.composite("Far", fn far -> Situ.count(far) |> Situ.filter(&(&1 == n)) end)
    end
  end
  """

  defp edge(metric, kind, n) do
    root = folder()
    code = for {module, beam} <- Code.compile_string(@pipe), do: {module, beam}
    nodes = for name <- ["left", "right"], do: node(name, code)

    try do
      [left, right] = nodes
      true = call(left, Node, :connect, [right.name])

      for {node, label} <- [{left, "left"}, {right, "right"}] do
        {:ok, _} = call(node, Application, :ensure_all_started, [:situ_remote])

        {:ok, _} =
          call(node, Situ.Cluster, :join, [[log: Path.join(root, "log"), labels: [label]]])
      end

      # A deployment of a few messages says what starting and ending cost.
      deployed(nodes, kind, 5)
      {least_wall, least_cpu} = deployed(nodes, kind, 5)
      {wall, cpu} = deployed(nodes, kind, n)
      rate = n * 1.0e9 / max(wall - least_wall, 1)
      used = max(cpu - least_cpu, 0) * 1_000 / n

      if kind == "pictures",
        do: [{metric, rate * 1.048576, "MB/s"}, {metric <> "_cpu", used, "us/msg"}],
        else: [{metric, rate, "msg/s"}, {metric <> "_cpu", used, "us/msg"}]
    after
      for %{pid: pid} <- nodes, do: System.cmd("kill", ["-KILL", pid], stderr_to_stdout: true)
      File.rm_rf!(root)
    end
  end

  # Wall ns, and CPU ms of both nodes.
  defp deployed([left, _] = nodes, kind, n) do
    {before, started} = {cpu_ms(nodes), System.monotonic_time(:nanosecond)}

    {:ok, deployment} =
      call(left, Situ.Cluster, :deploy, [
        Situ.Bench.ClusterPipe,
        [
          name: "bench#{System.unique_integer([:positive])}",
          opts: [count: n, kind: kind],
          place: [
            {"Far", on: "right", deterministic: true},
            {:rest, on: "left", deterministic: true}
          ],
          pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
        ]
      ])

    :ok = call(left, Situ.Cluster, :await, [deployment, 600_000])
    {System.monotonic_time(:nanosecond) - started, cpu_ms(nodes) - before}
  end

  defp cpu_ms(nodes) do
    nodes |> Enum.map(&elem(call(&1, :erlang, :statistics, [:runtime]), 0)) |> Enum.sum()
  end

  defp node(name, code) do
    paths = Enum.flat_map(:code.get_path(), &[~c"-pa", &1])

    flags =
      ~w(-setcookie bench -start_epmd false -epmd_module Elixir.Situ.Cluster.Epmd +sbwt very_short +zdbbl 32768)

    kernel = ~w(-kernel inet_dist_use_interface {127,0,0,1} -kernel logger_level error)

    {:ok, peer, node} =
      :peer.start(%{
        name: to_charlist("#{name}-#{free_port()}"),
        host: ~c"127.0.0.1",
        longnames: true,
        connection: :standard_io,
        args: paths ++ Enum.map(flags ++ kernel, &to_charlist/1),
        wait_boot: 120_000
      })

    {:ok, _} = :peer.call(peer, :application, :ensure_all_started, [:elixir], 60_000)
    started = %{peer: peer, name: node, pid: :peer.call(peer, :os, :getpid, []) |> to_string()}

    for {module, beam} <- code,
        do: {:module, _} = call(started, :code, :load_binary, [module, ~c"bench", beam])

    started
  end

  defp call(node, module, function, args),
    do: :peer.call(node.peer, module, function, args, 660_000)

  # The log beside a bare client: one chunk under way, as both must.

  defp log(n) do
    case nats() do
      nil -> raise "there is no nats-server: bin/setup --for test fetches one"
      path -> log(n, path)
    end
  end

  defp log(n, path) do
    root = folder()
    port = free_port()
    args = ["-a", "127.0.0.1", "-p", "#{port}", "-js", "-sd", root]
    process = Port.open({:spawn_executable, path}, [:binary, :stderr_to_stdout, args: args])
    {:os_pid, pid} = Port.info(process, :os_pid)

    try do
      {:ok, log} = patiently(fn -> Log.connect("nats://127.0.0.1:#{port}") end, 200)
      data = :crypto.strong_rand_bytes(@chunk)
      subject = {:stream, "b#{System.unique_integer([:positive])}"}
      {:ok, first} = Log.append(log, subject, 0, %Entry{op: "0", data: data})
      socket = bare(port)

      # In turns, so that both meet the same neighbours.
      {ours, theirs, _} =
        Enum.reduce(1..10, {0, 0, first}, fn _, {ours, theirs, seq} ->
          {spent, seq} = timed(fn -> append(log, subject, seq, data, div(n, 10)) end)
          {other, _} = timed(fn -> publish(socket, data, div(n, 10)) end)
          {ours + spent, theirs + other, seq}
        end)

      rate = &(div(n, 10) * 10 * 1.0e9 / &1)

      # The server's own CPU time, for chunks of a byte and of 64 KB.
      [small, large] =
        for bytes <- ["x", data] do
          before = server_us(pid)
          publish(socket, bytes, n)
          (server_us(pid) - before) / n
        end

      [
        {"log_nats", rate.(ours), "chunk/s"},
        {"log_bare", rate.(theirs), "chunk/s"},
        {"log_ratio", theirs / ours, "x"},
        {"log_server_small_cpu", small, "us/chunk"},
        {"log_server_64k_cpu", large, "us/chunk"}
      ]
    after
      System.cmd("kill", ["-KILL", "#{pid}"], stderr_to_stdout: true)
      File.rm_rf!(root)
    end
  end

  # In clock ticks of a hundredth of a second, as Linux has them.
  defp server_us(pid) do
    [_, rest] = "/proc/#{pid}/stat" |> File.read!() |> String.split(") ", parts: 2)
    fields = String.split(rest)
    (String.to_integer(Enum.at(fields, 11)) + String.to_integer(Enum.at(fields, 12))) * 10_000
  end

  defp append(_log, _subject, seq, _data, 0), do: seq

  defp append(log, subject, seq, data, left) do
    {:ok, seq} = Log.append(log, subject, seq, %Entry{op: "#{seq}", data: data})
    append(log, subject, seq, data, left - 1)
  end

  defp bare(port) do
    {:ok, socket} =
      :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false, nodelay: true])

    {:ok, _info} = :gen_tcp.recv(socket, 0, 10_000)
    :ok = :gen_tcp.send(socket, "CONNECT {\"verbose\":false}\r\nSUB _INBOX.bare 1\r\n")
    socket
  end

  # Into the same stream of the server, on a subject of its own.
  defp publish(socket, data, n) do
    head = "PUB situ.s.bare _INBOX.bare #{byte_size(data)}\r\n"

    for _ <- 1..n do
      :ok = :gen_tcp.send(socket, [head, data, "\r\n"])
      answered(socket, "")
    end
  end

  defp answered(socket, got) do
    {:ok, more} = :gen_tcp.recv(socket, 0, 30_000)
    got = got <> more
    unless got =~ "\"seq\"", do: answered(socket, got)
  end

  defp timed(fun) do
    started = System.monotonic_time(:nanosecond)
    result = fun.()
    {System.monotonic_time(:nanosecond) - started, result}
  end

  # A pipeline that stands still for each: joins, windows and a scan with some state.
  defp checkpoints(n) do
    {:ok, p} =
      Pipeline.start(fn p ->
        left = Situ.sequence(p, 1, &(&1 + 1), every: 1_000_000, name: "Left")
        right = Situ.sequence(p, 3, &(&1 + 2), every: 1_500_000, name: "Right")

        left
        |> Situ.join(right, Situ.Reproducible.nearest(800_000))
        |> Situ.window(-500..0, &Enum.count/1)
        |> Situ.scan(0, &(&1 + &2))
      end)

    Process.sleep(1_000)
    {idle, _} = used(fn -> Process.sleep(1_000) end)

    {spent, wall} =
      used(fn ->
        for _ <- 1..n,
            do:
              {:ok, _} =
                Pipeline.checkpoint(p, fn memories -> :erlang.term_to_binary(memories) end)
      end)

    {:ok, _} = Pipeline.stop(p)
    own = max(spent - idle * wall / 1.0e6, 0) / n
    [{"checkpoint_cpu", own, "us"}, {"checkpoint_share_at_1s", own / 1.0e4, "%"}]
  end

  defp used(fun) do
    {cpu, started} = {Situ.Bench.cpu_us(), System.monotonic_time(:microsecond)}
    fun.()
    {Situ.Bench.cpu_us() - cpu, System.monotonic_time(:microsecond) - started}
  end

  # One link, one client.
  defp many_streams(n) do
    root = folder()
    {:ok, _} = Application.ensure_all_started(:situ_remote)
    {:ok, writer} = Writer.create("many", root)

    for i <- 1..n do
      {:ok, stream} = Writer.stream(writer, "stream #{i}")

      messages =
        for t <- 1..10,
            do: %Message{data: t, originating_time: t, creation_time: t, sequence_id: t}

      {:ok, _} = Writer.append(stream, messages)
    end

    :ok = Writer.close(writer)
    {:ok, server} = Remote.serve(writer.path, port: 0)
    before = Situ.Bench.rss_mib()

    try do
      {:ok, address} = Remote.Address.parse("situ://127.0.0.1:#{Server.port(server)}")
      opts = %{token: "", tls: [], now: &Situ.Time.now/0, position: nil, save_every: 1_000_000}
      {:ok, link} = Connection.start(address, opts, self())
      {:ok, catalogue} = Connection.catalogue(link, 60_000)
      ^n = map_size(catalogue)

      metrics =
        Situ.Bench.measure("link_many_streams", 10 * n, fn ->
          for {name, _} <- catalogue do
            wanted = %{
              name: name,
              from: :start,
              policy: nil,
              priority: 0,
              window: 65_536,
              times: :sender,
              datagram: nil
            }

            {:ok, _} = Connection.subscribe(link, wanted)
          end

          ended(n)
          []
        end)

      Connection.close(link)
      metrics ++ [{"link_many_streams_memory", Situ.Bench.rss_mib() - before, "MiB"}]
    after
      Server.close(server)
      File.rm_rf!(root)
    end
  end

  defp ended(0), do: :ok

  defp ended(left) do
    receive do
      {:situ_link, _, {:closed, _}} -> ended(left - 1)
      {:situ_link, _, _} -> ended(left)
    after
      120_000 -> raise "#{left} streams have not come"
    end
  end

  defp patiently(fun, 0), do: fun.()

  defp patiently(fun, left) do
    with {:error, _} <- fun.() do
      Process.sleep(50)
      patiently(fun, left - 1)
    end
  end

  defp nats do
    fetched = Path.expand("../../apps/situ_remote/priv/nats/nats-server", __DIR__)

    System.get_env("SITU_NATS_SERVER") || (File.exists?(fetched) && fetched) ||
      System.find_executable("nats-server")
  end

  defp folder do
    root =
      Path.join(
        System.tmp_dir!(),
        "situ-bench-#{System.pid()}-#{System.unique_integer([:positive])}"
      )

    File.mkdir_p!(root)
    root
  end

  defp free_port do
    {:ok, socket} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(socket)
    :gen_tcp.close(socket)
    port
  end
end
