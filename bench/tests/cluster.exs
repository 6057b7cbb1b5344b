defmodule Situ.Bench.Cluster do
  # Clusters: an edge between two nodes (separate virtual machines, whose CPU time is counted),
  # with the log and direct; the latency of a message; checkpoints; a link with very many streams.
  alias Situ.{Message, Pipeline, Link}
  alias Situ.Link.{Connection, Server}
  alias Situ.Store.Writer

  def tests do
    [
      {"cluster-edge", &edge("cluster_edge", "numbers", [], max(2_000, round(400_000 * &1)))},
      {"cluster-edge-direct",
       &edge("cluster_edge_direct", "numbers", ["Made"], max(2_000, round(400_000 * &1)))},
      {"cluster-edge-1mb", &edge("cluster_edge_1mb", "pictures", [], max(20, round(300 * &1)))},
      {"cluster-edge-1mb-direct",
       &edge("cluster_edge_1mb_direct", "pictures", ["Picture"], max(20, round(600 * &1)))},
      {"cluster-edge-one", &one(max(200, round(2_000 * &1)))},
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
      build(Situ.sequence(p, 1, &(&1 + 1), count: opts[:count], every: opts[:every], name: "Made"), opts[:kind], opts)
    end

    defp build(made, "numbers", opts), do: last(made, opts)

    defp build(made, "pictures", opts) do
      data = :binary.copy(<<7>>, 1024 * 1024)
      made |> Situ.map(fn _ -> data end, name: "Picture") |> last(opts)
    end

    # The latency of each message in ns, by the clock of the machine that runs both nodes.
    defp build(made, "one", opts) do
      n = opts[:count]

      made
      |> Situ.map(fn _ -> :os.system_time(:nanosecond) end, name: "Picture")
      |> Situ.composite("Far", fn far ->
        far
        |> Situ.map(&(:os.system_time(:nanosecond) - &1))
        |> Situ.scan([], &[&1 | &2])
        |> Situ.filter(&(length(&1) == n), name: "Seen")
      end)
    end

    defp last(made, opts) do
      Situ.composite(made, "Far", fn far -> Situ.count(far) |> Situ.filter(&(&1 == opts[:count])) end)
    end
  end
  """

  defp edge(metric, kind, direct, n) do
    clustered(fn nodes ->
      # A deployment with a few messages shows the cost of starting and ending.
      opts = [kind: kind, every: 1_000]
      deployed(nodes, opts, direct, 5)
      {least_wall, least_cpu, _} = deployed(nodes, opts, direct, 5)
      {wall, cpu, _} = deployed(nodes, opts, direct, n)
      rate = n * 1.0e9 / max(wall - least_wall, 1)
      used = max(cpu - least_cpu, 0) / n

      if kind == "pictures",
        do: [{metric, rate * 1.048576, "MB/s"}, {metric <> "_cpu", used, "us/msg"}],
        else: [{metric, rate, "msg/s"}, {metric <> "_cpu", used, "us/msg"}]
    end)
  end

  # One message at a time, a thousand per second.
  defp one(n) do
    clustered(fn [left, _] = nodes ->
      opts = [kind: "one", every: 1_000_000]
      {_, _, deployment} = deployed(nodes, opts, [], n, speed: 1.0, publish: ["Far.Seen"])
      {:ok, [%{data: times}]} = call(left, Situ.Cluster, :read, [deployment, "Far.Seen"])
      times = Enum.sort(times)
      at = &(Enum.at(times, div(n * &1, 100)) / 1.0e3)
      [{"cluster_edge_one_p50", at.(50), "us"}, {"cluster_edge_one_p95", at.(95), "us"}]
    end)
  end

  defp clustered(fun) do
    root = Situ.Bench.folder!()
    Code.put_compiler_option(:ignore_module_conflict, true)
    code = for {module, beam} <- Code.compile_string(@pipe), do: {module, beam}
    nodes = for name <- ["left", "right"], do: node(name, code)

    try do
      [left, right] = nodes
      true = call(left, Node, :connect, [right.name])

      for {node, label} <- [{left, "left"}, {right, "right"}] do
        {:ok, _} = call(node, Application, :ensure_all_started, [:situ_cluster])

        {:ok, _} =
          call(node, Situ.Cluster, :join, [[log: Path.join(root, "log"), labels: [label]]])
      end

      fun.(nodes)
    after
      for %{pid: pid} <- nodes, do: System.cmd("kill", ["-KILL", pid], stderr_to_stdout: true)
      File.rm_rf!(root)
    end
  end

  # Wall time in ns, and CPU time of both nodes in us.
  defp deployed([left, _] = nodes, opts, direct, n, settings \\ []) do
    {before, started} = {cpu_us(nodes), System.monotonic_time(:nanosecond)}

    {:ok, deployment} =
      call(left, Situ.Cluster, :deploy, [
        Situ.Bench.ClusterPipe,
        [
          name: "bench#{System.unique_integer([:positive])}",
          opts: [{:count, n} | opts],
          place: [
            {"Far", on: "right", deterministic: true},
            {:rest, on: "left", deterministic: true}
          ],
          direct: direct,
          publish: settings[:publish] || [],
          pipeline: [replay: [interval: {0, :unbounded}, speed: settings[:speed] || :max]]
        ]
      ])

    :ok = call(left, Situ.Cluster, :await, [deployment, 600_000])
    {System.monotonic_time(:nanosecond) - started, cpu_us(nodes) - before, deployment}
  end

  defp cpu_us(nodes), do: nodes |> Enum.map(&Situ.Bench.cpu_us(&1.pid)) |> Enum.sum()

  defp node(name, code) do
    paths = Enum.flat_map(:code.get_path(), &[~c"-pa", &1])

    flags =
      ~w(-setcookie bench -start_epmd false -epmd_module Elixir.Situ.Cluster.Epmd) ++
        Situ.Bench.vm_flags()

    kernel = ~w(-kernel inet_dist_use_interface {127,0,0,1} -kernel logger_level error)

    {:ok, peer, node} =
      :peer.start(%{
        name: to_charlist("#{name}-#{Situ.Bench.free_port()}"),
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

  # The pipeline is paused for each checkpoint. It has joins, windows and a scan with some state.
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
    root = Situ.Bench.folder!()
    {:ok, _} = Application.ensure_all_started(:situ_cluster)
    {:ok, writer} = Writer.create("many", root)

    for i <- 1..n do
      {:ok, stream} = Writer.stream(writer, "stream #{i}")

      messages =
        for t <- 1..10,
            do: %Message{data: t, originating_time: t, creation_time: t, sequence_id: t}

      {:ok, _} = Writer.append(stream, messages)
    end

    :ok = Writer.close(writer)
    {:ok, server} = Link.serve(writer.path, port: 0)
    before = Situ.Bench.rss_mib()

    try do
      {:ok, address} = Link.Address.parse("situ://127.0.0.1:#{Server.port(server)}")
      opts = %{token: "", tls: [], now: &Situ.Time.now/0, position: nil, save_every: 1_000_000}
      {:ok, link} = Connection.start(address, opts, self())
      {:ok, catalogue} = Connection.await_catalogue(link, 60_000)
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
end
