defmodule Situ.Examples.Demo.ClusterCommand do
  @usage """
  Usage: bin/demo --cluster [--input FILE] [--out FOLDER] [--kill lips|sound|recording|none]
                            [--headless]

  Runs the demo on three nodes of this machine, each in its own OS process: one records (and reads the clip), one
  analyzes the audio, and one analyzes the lips. Midway, one node is killed with -9. The last line reports whether the
  recording equals the recording of the same job on one machine, which runs first.

    --input FILE   a media file (default: the clip included with Situ)
    --out FOLDER   folder for both recordings (default: "recordings/cluster")
    --kill PART    the part whose node is killed (default: lips)
    --headless     has no effect: this demo never starts the studio

  Exit status: 0 equal, 1 not equal or failed, 2 wrong usage.
  """
  @moduledoc """
  The cluster demo, `bin/demo --cluster`: runs `Situ.Examples.MultimodalVoiceActivity` on three nodes and kills a node
  midway.

  ```text
  #{@usage}
  ```
  """
  alias Situ.Examples.Demo.{CommandLine, Options}
  alias Situ.Examples.MultimodalVoiceActivity
  alias Situ.{Cluster, Error, Store}

  @parts %{"lips" => "MouthShape", "sound" => "VoiceActivity", "recording" => "rest"}
  @minutes 10
  @name "bin/demo --cluster"

  @doc """
  Runs the demo and returns the exit status. `record` runs the same job on one machine
  (`Situ.Examples.Demo.record_clip/1`).
  """
  @spec run(
          [String.t()],
          (keyword() -> {:ok, Situ.Pipeline.Report.t(), float()} | {:error, Situ.Error.t()})
        ) ::
          0 | 1 | 2
  def run(argv, record) do
    switches = [cluster: :boolean, input: :string, out: :string, kill: :string]
    switches = [headless: :boolean, help: :boolean] ++ switches
    command = %{name: @name, usage: @usage, switches: switches}
    CommandLine.run(argv, command, &validate_and_run(&1, record))
  end

  defp validate_and_run(opts, record) do
    kill = opts[:kill] || "lips"
    input = Path.expand(opts[:input] || Options.default_clip())
    out = Path.expand(opts[:out] || "recordings/cluster")

    cond do
      kill != "none" and not is_map_key(@parts, kill) ->
        CommandLine.print_usage_error("--kill #{kill}: no such part", @name)

      not File.regular?(input) ->
        CommandLine.print_usage_error("cannot find the file #{input}", @name)

      true ->
        run_and_compare(input, out, kill, record)
    end
  end

  defp run_and_compare(input, out, kill, record) do
    log = Error.unwrap!(Situ.TempFolder.create_folder("demo"))
    Process.put(:nodes, [])

    try do
      print_progress("on one machine ...")

      with {:ok, report, _s} <- record.(input: input, out: Path.join(out, "one")) do
        compare_recordings(
          report.result.path,
          run_on_three_nodes(input, Path.join(out, "three"), log, kill)
        )
      end
      |> exit_status()
    after
      for {_, node} <- Process.get(:nodes), do: kill_node(node)
      Situ.TempFolder.remove_folder(log)
    end
  end

  defp exit_status({:error, error}) do
    IO.puts(:stderr, Exception.message(error))
    1
  end

  defp exit_status(status), do: status

  # On three nodes

  defp run_on_three_nodes(input, out, log, kill) do
    print_progress("starting three nodes ...")
    cookie = Base.encode16(:crypto.strong_rand_bytes(16))
    nodes = for name <- Map.keys(@parts), into: %{}, do: {name, start_node(name, cookie)}
    first = nodes["recording"]

    for {name, node} <- nodes do
      unless node == first, do: true = call_node(node, Node, :connect, [first.name])
      {:ok, _} = call_node(node, Application, :ensure_all_started, [:situ_examples])
      {:ok, _} = call_node(node, Cluster, :join, [[log: log, labels: [name]]])
    end

    # Decoding and inference are deterministic, so outputs do not have to wait for a checkpoint.
    place = for {label, part} <- @parts, do: {part_selector(part), on: label, deterministic: true}

    {:ok, deployment} =
      call_node(first, Cluster, :deploy, [
        MultimodalVoiceActivity,
        [
          name: "Talk",
          opts: [input: input, path: out],
          place: place,
          lease: Situ.Time.s(5),
          pipeline: [replay: [speed: :max]]
        ]
      ])

    print_progress(
      "on three nodes: " <> Enum.map_join(nodes, ", ", fn {name, n} -> "#{name} (#{n.pid})" end)
    )

    nodes = if kill == "none", do: nodes, else: kill_node_midway(nodes, deployment, kill)
    {_, any} = Enum.at(nodes, 0)

    with :ok <- call_node(any, Cluster, :await, [deployment, @minutes * 60_000]),
         do: {:ok, Store.newest("Talk", out)}
  end

  defp part_selector("rest"), do: :rest
  defp part_selector(path), do: path

  # Waits until 40 messages of the mouths have been published (more than a second of video), then kills the node.
  defp kill_node_midway(nodes, deployment, name) do
    {_, watcher} = Enum.find(nodes, fn {other, _} -> other != name end)
    wait_for_messages(watcher, deployment, 40)
    print_progress("kill -9 #{nodes[name].pid}: the node of #{name}")
    kill_node(nodes[name])
    Map.delete(nodes, name)
  end

  defp wait_for_messages(node, deployment, n) do
    %{parts: parts} = call_node(node, Cluster, :status, [deployment])
    streams = get_in(parts, ["MouthShape", :publisher, :streams]) || %{}

    unless Enum.any?(streams, fn {_, stream} -> stream.messages >= n end) or
             any_part_ended?(parts) do
      receive do
      after
        50 -> wait_for_messages(node, deployment, n)
      end
    end
  end

  defp any_part_ended?(parts),
    do: Enum.any?(parts, fn {_, part} -> part.phase in [:done, :failed] end)

  # A node is an OS process that runs the same code as this one and is connected only to the other nodes.
  defp start_node(name, cookie) do
    port = free_port()
    paths = for path <- :code.get_path(), path != ~c".", arg <- [~c"-pa", path], do: arg

    args =
      [~c"-boot", ~c"no_dot_erlang"] ++
        paths ++
        [~c"-setcookie", to_charlist(cookie), ~c"-start_epmd", ~c"false"] ++
        [~c"-epmd_module", ~c"Elixir.Situ.Cluster.Epmd", ~c"+sbwt", ~c"none"] ++
        [~c"-kernel", ~c"inet_dist_use_interface", ~c"{127,0,0,1}"] ++
        [
          ~c"-kernel",
          ~c"prevent_overlapping_partitions",
          ~c"false",
          ~c"-kernel",
          ~c"logger_level",
          ~c"error"
        ]

    {:ok, peer, node} =
      :peer.start(%{
        name: to_charlist("#{name}-#{port}"),
        host: ~c"127.0.0.1",
        longnames: true,
        connection: :standard_io,
        exec: erlang_command(),
        args: args,
        wait_boot: 120_000
      })

    :peer.call(peer, :code, :del_path, [~c"."])
    {:ok, _} = :peer.call(peer, :application, :ensure_all_started, [:elixir], 60_000)
    pid = :peer.call(peer, :os, :getpid, [], 60_000) |> to_string()
    started = %{peer: peer, name: node, pid: pid}
    Process.put(:nodes, [{name, started} | Process.get(:nodes)])
    started
  end

  # While Erlang starts, it also loads modules from the current folder, so it is started in a folder of this app.
  defp erlang_command do
    erl = System.find_executable("erl") || Path.join([:code.root_dir(), "bin", "erl"])
    folder = Path.join(to_string(:code.priv_dir(:situ_examples)), "demo")
    start = ["-c", ~S(cd "$0" && erl=$1 && shift && exec "$erl" "$@"), folder, erl]
    {~c"/bin/sh", Enum.map(start, &to_charlist/1)}
  end

  defp call_node(node, module, function, args),
    do: :peer.call(node.peer, module, function, args, (@minutes + 1) * 60_000)

  defp kill_node(%{pid: pid}), do: System.cmd("kill", ["-KILL", pid], stderr_to_stdout: true)

  defp free_port do
    {:ok, socket} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(socket)
    :gen_tcp.close(socket)
    port
  end

  # Comparison

  defp compare_recordings(_one, {:error, error}), do: {:error, error}

  defp compare_recordings(one, {:ok, three}) do
    stores = for path <- [one, three], do: Store.open!(path)
    [names, others] = for store <- stores, do: stream_names(store)
    different = for name <- Enum.uniq(names ++ others), not same_stream?(stores, name), do: name

    if different == [] do
      IO.puts(
        "equal: #{length(names)} streams, #{count_messages(hd(stores), names)} messages: #{one} and #{three}"
      )

      0
    else
      IO.puts("NOT equal: #{Enum.join(different, ", ")} differ: #{one} and #{three}")
      1
    end
  end

  # Diagnostics differ from run to run.
  defp stream_names(store),
    do: for(s <- Store.streams(store), s.name != "Talk.Diagnostics", do: s.name) |> Enum.sort()

  defp same_stream?(stores, name) do
    [one, three] =
      for store <- stores, do: Store.has_stream?(store, name) && stream_content(store, name)

    one == three
  end

  defp stream_content(store, name) do
    store
    |> Store.messages(name)
    |> Enum.map(&{&1.originating_time, &1.sequence_id, &1.data})
    |> :erlang.term_to_binary()
  end

  defp count_messages(store, names), do: names |> Enum.map(&Store.count(store, &1)) |> Enum.sum()
  defp print_progress(text), do: IO.puts(:stderr, text)
end
