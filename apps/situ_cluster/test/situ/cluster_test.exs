defmodule Situ.ClusterTest do
  use ExUnit.Case, async: false

  alias Situ.{Cluster, Pipeline}
  alias Situ.Cluster.Retention
  alias Situ.Test.{ClusterFan, ClusterSums, NatsServer}
  import Situ.Test.LinkRecordings, only: [eventually: 1, eventually: 2]

  @moduletag :tmp_dir
  @moduletag capture_log: true

  @pipeline [replay: [interval: {0, Situ.Time.s(3_600)}, speed: :max]]
  @place [{"Sum", deterministic: true}, {"Smooth", []}]

  defp alone(opts) do
    me = self()

    build = fn p ->
      p |> ClusterSums.build(opts) |> Situ.each(&send(me, {:m, &1, &2.originating_time}))
    end

    {:ok, _} = Pipeline.run(build, pipeline: @pipeline)
    heard([])
  end

  defp heard(list) do
    receive do
      {:m, data, time} -> heard([{data, time} | list])
    after
      0 -> Enum.reverse(list)
    end
  end

  defp read(deployment, stream) do
    {:ok, messages} = Cluster.read(deployment, stream)
    for m <- messages, do: {m.data, m.originating_time}
  end

  test "parts on one node give the same result as the pipeline alone", %{tmp_dir: dir} do
    start_supervised!({Cluster, log: dir})

    {:ok, deployment} =
      Cluster.deploy(ClusterSums,
        opts: [count: 500],
        place: @place,
        publish: ["Result"],
        checkpoint: Situ.Time.ms(100),
        pipeline: @pipeline
      )

    assert :ok = Cluster.await(deployment, 60_000)
    assert read(deployment, "Result") == alone(count: 500)
  end

  # Uses a NATS server if one is available, otherwise a folder; the results must be the same.
  defp log(dir) do
    if NatsServer.path() do
      server = NatsServer.start(dir)
      on_exit(fn -> NatsServer.kill(server) end)
      {server.url, fn -> length(File.ls!("/proc/#{server.pid}/fd")) end}
    else
      {dir, fn -> 0 end}
    end
  end

  test "the log of an ended deployment and its files are kept until it is pruned", %{tmp_dir: dir} do
    {address, files} = log(dir)
    start_supervised!({Cluster, log: address})
    opts = [opts: [count: 300], place: @place, publish: ["Result"], pipeline: @pipeline]
    {:ok, kept} = Cluster.deploy(ClusterSums, [name: "kept"] ++ opts)
    assert :ok = Cluster.await(kept, 60_000)
    before = files.()
    {:ok, gone} = Cluster.deploy(ClusterSums, [name: "gone"] ++ opts)
    assert :ok = Cluster.await(gone, 60_000)
    {:ok, all} = Cluster.list_log_usage()
    assert [%{deployment: "gone", streams: 5, bytes: bytes}, %{deployment: "kept"}] = all
    assert bytes > 0
    assert {:ok, n} = Cluster.prune("gone")
    assert n > 5
    assert {:ok, [%{deployment: "kept"}]} = Cluster.list_log_usage()
    assert files.() == before
    assert read(kept, "Result") == alone(count: 300)
    assert {:error, %{code: :not_found, fix: fix}} = Cluster.prune("gone")
    assert fix =~ "kept"
    # Its name is free, and its log begins again.
    {:ok, again} = Cluster.deploy(ClusterSums, [name: "gone"] ++ opts)
    assert :ok = Cluster.await(again, 60_000)
    assert read(again, "Result") == alone(count: 300)
  end

  test "the log of a running deployment is never pruned by any node", %{tmp_dir: dir} do
    deployment = slow(dir)
    running(deployment.name, "Sum")
    assert {:error, %{code: :in_use}} = Cluster.prune(deployment.name)
    {:ok, log} = Situ.Cluster.Log.connect(dir)
    {:ok, [kept]} = Retention.list(log)
    # Check the log alone, as for another cluster's deployment: its leases are changing.
    assert {:error, %{code: :in_use}} = Retention.check_unused(log, kept, 300)
    assert :ok = Cluster.await(deployment, 60_000)
    assert read(deployment, "Result") == alone(count: 600)
    assert {:error, %{code: :bad_option}} = Cluster.deploy(ClusterSums, name: "a.b")
  end

  test "direct streams bypass the log and lose nothing while all parts are up", %{tmp_dir: dir} do
    start_supervised!({Cluster, log: dir})

    {:ok, deployment} =
      Cluster.deploy(ClusterSums,
        opts: [count: 5_000],
        place: [{"Sum", []}, {"Smooth", []}],
        direct: ["Left", "Right"],
        publish: ["Result"],
        checkpoint: Situ.Time.ms(100),
        pipeline: @pipeline
      )

    assert :ok = Cluster.await(deployment, 60_000)
    assert read(deployment, "Result") == alone(count: 5_000)
    assert read(deployment, "Left") == []
  end

  defp slow(dir) do
    start_supervised!({Cluster, log: dir})

    {:ok, deployment} =
      Cluster.deploy(ClusterSums,
        opts: [count: 600],
        place: @place,
        publish: ["Result"],
        checkpoint: Situ.Time.ms(100),
        lease: Situ.Time.ms(300),
        pipeline: [replay: [interval: {0, Situ.Time.s(3_600)}, speed: 1.0]]
      )

    deployment
  end

  # Waits until a part is running; returns its runner and its publisher.
  defp running(name, part) do
    %{^part => runner} = Cluster.Agent.list_runners(name)

    case Cluster.Runner.part_info(runner) do
      %{phase: :running} -> {runner, :sys.get_state(runner).publisher}
      _ -> running(name, part)
    end
  end

  test "asking about a part just as its publisher is lost does no harm", %{
    tmp_dir: dir
  } do
    deployment = slow(dir)
    {runner, publisher} = running(deployment.name, "Sum")
    :sys.suspend(runner)
    asked = Task.async(fn -> Cluster.Runner.part_info(runner) end)
    queued(runner)
    monitor = Process.monitor(publisher)
    Process.exit(publisher, :kill)
    assert_receive {:DOWN, ^monitor, _, _, :killed}, 5_000
    :sys.resume(runner)
    assert %{phase: :running, publisher: nil} = Task.await(asked)
    assert Process.alive?(runner)
    assert :ok = Cluster.await(deployment, 60_000)
    assert read(deployment, "Result") == alone(count: 600)
  end

  defp queued(pid) do
    if Process.info(pid, :message_queue_len) == {:message_queue_len, 0}, do: queued(pid)
  end

  test "finds a lost runner again", %{tmp_dir: dir} do
    deployment = slow(dir)
    {runner, _} = running(deployment.name, "Sum")
    Process.exit(runner, :kill)
    assert :ok = Cluster.await(deployment, 60_000)
    assert read(deployment, "Result") == alone(count: 600)
    assert Cluster.status(deployment).parts["Sum"].phase == :done
  end

  defp raw(dir), do: elem(Situ.Cluster.Log.connect(dir), 1)

  # As a writer with access to the log but without the cookie: appends after the last entry until it succeeds.
  defp forge(log, subject, entry, last \\ 0) do
    case Situ.Cluster.Log.append(log, subject, last, entry) do
      {:refused, last} -> forge(log, subject, entry, last.seq)
      {:ok, seq} -> seq
    end
  end

  @forged [
    fence: %{"Epoch" => "999999", "Kind" => "fence", "Last" => "0"},
    close: %{"Epoch" => "999999", "Kind" => "fence", "Last" => "0", "Closing" => "1"}
  ]

  for {what, head} <- @forged do
    test "a #{what} from outside the cluster ends the part with the reason", %{
      tmp_dir: dir
    } do
      deployment = slow(dir)
      running(deployment.name, "Sum")

      [name | _] =
        for {name, %{part: "Sum"}} <- Cluster.Agent.find_plan(deployment.name).streams, do: name

      subject = {:stream, "#{deployment.name}.#{name}"}
      entry = %Situ.Cluster.Log.Entry{op: "x", head: unquote(Macro.escape(head))}
      forge(raw(dir), subject, entry)
      assert {:error, error} = Cluster.await(deployment, 60_000)
      assert error.code == :part_failed
      assert Exception.message(error) =~ "has no seal"
      assert {:error, %{code: :unsealed_entry}} = Cluster.read(deployment, name)
    end
  end

  test "takes over a lease from outside the cluster", %{tmp_dir: dir} do
    deployment = slow(dir)
    running(deployment.name, "Sum")
    key = {:key, Cluster.Runner.log_key(deployment, "Sum", "lease")}
    forge(raw(dir), key, %Situ.Cluster.Log.Entry{op: "x", head: %{"Node" => "evil@host"}})
    assert :ok = Cluster.await(deployment, 60_000)
    assert read(deployment, "Result") == alone(count: 600)
  end

  test "rejects the end of a part from outside the cluster", %{tmp_dir: dir} do
    deployment = slow(dir)
    running(deployment.name, "Sum")
    key = {:key, Cluster.Runner.log_key(deployment, "Sum", "state")}
    forge(raw(dir), key, %Situ.Cluster.Log.Entry{op: "x", head: %{"State" => "done"}})
    assert {:error, %{code: :unsealed_entry}} = Cluster.await(deployment, 60_000)
  end

  test "after the loss of all nodes, deployments restart unless they have ended", %{
    tmp_dir: dir
  } do
    deployment = slow(dir)
    running(deployment.name, "Sum")
    stop_supervised!(Cluster)
    start_supervised!({Cluster, log: dir})
    eventually(fn -> Cluster.Agent.info().deployments == [deployment] end)
    assert :ok = Cluster.await(deployment, 60_000)
    assert read(deployment, "Result") == alone(count: 600)
    stop_supervised!(Cluster)
    assert deployments_after_start(dir) == []
  end

  # The loader runs again, so the node has certainly read the complete log.
  defp deployments_after_start(dir) do
    start_supervised!({Cluster, log: dir})
    :ok = Cluster.DeploymentLoader.run(raw(dir), Cluster.Agent, false)
    Cluster.Agent.info().deployments
  end

  test "repeating a deployment changes nothing, and another of its name is rejected", %{
    tmp_dir: dir
  } do
    start_supervised!({Cluster, log: dir})
    opts = [place: [{"P1", on: "nowhere", only: true}], pipeline: @pipeline]
    {:ok, deployment} = Cluster.deploy(ClusterFan, [opts: [parts: 1]] ++ opts)
    runners = Cluster.Agent.list_runners(deployment.name)
    assert {:ok, ^deployment} = Cluster.deploy(ClusterFan, [opts: [parts: 1]] ++ opts)
    assert Cluster.Agent.list_runners(deployment.name) == runners

    assert {:error, %{code: :duplicate_name}} =
             Cluster.deploy(ClusterFan, [opts: [parts: 2]] ++ opts)
  end

  test "a forgotten deployment does not come back", %{tmp_dir: dir} do
    deployment = slow(dir)
    running(deployment.name, "Sum")
    assert :ok = Cluster.forget(deployment)
    stop_supervised!(Cluster)
    assert deployments_after_start(dir) == []
  end

  test "a deployment whose log was deleted does not come back and begins again", %{
    tmp_dir: dir
  } do
    deployment = slow(dir)
    running(deployment.name, "Sum")
    stop_supervised!(Cluster)
    assert {:ok, _} = Retention.prune(raw(dir), deployment.name, 0)
    assert deployments_after_start(dir) == []
    opts = [opts: [count: 100], place: @place, publish: ["Result"], pipeline: @pipeline]
    assert {:ok, %{run: run} = again} = Cluster.deploy(ClusterSums, opts)
    assert run != deployment.run
    assert :ok = Cluster.await(again, 60_000)
    assert read(again, "Result") == alone(count: 100)
  end

  test "forgetting 40 parts blocks nobody", %{tmp_dir: dir} do
    start_supervised!({Cluster, log: dir})
    agent = Process.whereis(Cluster.Agent)

    {:ok, deployment} =
      Cluster.deploy(ClusterFan,
        opts: [parts: 40],
        place: for(i <- 1..40, do: {"P#{i}", on: "nowhere", only: true}),
        pipeline: @pipeline
      )

    runners = Map.values(Cluster.Agent.list_runners(deployment.name))
    assert length(runners) > 40
    # Stopping these takes a while, but the agent must not wait.
    for runner <- runners, do: :sys.suspend(runner)
    asked = Task.async(fn -> Cluster.forget(deployment) end)
    eventually(fn -> Cluster.Agent.info().deployments == [] end)
    assert Enum.all?(runners, &Process.alive?/1)
    for runner <- runners, do: :sys.resume(runner)
    assert :ok = Task.await(asked, 30_000)
    refute Enum.any?(runners, &Process.alive?/1)
    assert Process.whereis(Cluster.Agent) == agent
  end

  test "a node keeps its rank when the process that moves a part has gone", %{tmp_dir: dir} do
    deployment = slow(dir)
    {runner, _} = running(deployment.name, "Sum")
    mover = spawn(fn -> receive do: (:never -> :ok) end)
    :ok = Cluster.Runner.set_demotion(runner, 2)
    :ok = Cluster.Runner.set_demotion(runner, 3, mover)
    assert Cluster.Runner.part_info(runner).demotion == 3
    Process.exit(mover, :kill)
    eventually(fn -> Cluster.Runner.part_info(runner).demotion == 2 end)
  end

  test "one part that does not respond hides no other from the status", %{tmp_dir: dir} do
    deployment = slow(dir)
    {runner, _} = running(deployment.name, "Sum")
    running(deployment.name, "Smooth")
    :sys.suspend(runner)

    assert [%{}, %{phase: :running}] =
             Cluster.Runners.collect_infos(
               [runner, Cluster.Agent.list_runners(deployment.name)["Smooth"]],
               200
             )

    :sys.resume(runner)
  end

  test "only the part that writes a recording creates it", %{tmp_dir: dir} do
    start_supervised!({Cluster, log: Path.join(dir, "log")})
    root = Path.join(dir, "recordings")

    # Both parts are closed this way; a part that writes nothing would create an empty recording at its end.
    opts = [opts: [root: root, count: 50], place: [{"Recording", deterministic: true}]]
    {:ok, deployment} = Cluster.deploy(Situ.Test.ClusterRecorded, [pipeline: @pipeline] ++ opts)
    assert :ok = Cluster.await(deployment, 60_000)
    stores = for path <- Situ.Store.list(root), {:ok, store} = Situ.Store.open(path), do: store
    assert [placed, unplaced] = Enum.sort_by(stores, & &1.path)
    assert Situ.Store.count(placed, "numbers") == 50
    assert Situ.Store.count(unplaced, "doubles") == 50
    refute Situ.Store.live?(placed) or Situ.Store.live?(unplaced)
  end

  test "a recorder that is taken over continues with a bounded log", %{tmp_dir: dir} do
    start_supervised!({Cluster, log: Path.join(dir, "log")})
    root = Path.join(dir, "recordings")

    {:ok, deployment} =
      Cluster.deploy(Situ.Test.ClusterRecorded,
        opts: [root: root, count: 4_000],
        place: [{"Recording", deterministic: true}],
        checkpoint: Situ.Time.ms(50),
        lease: Situ.Time.ms(300),
        retain: Situ.Time.ms(1_500),
        pipeline: [replay: [interval: {0, Situ.Time.s(3_600)}, speed: 1.0]]
      )

    runner = Cluster.Agent.list_runners(deployment.name)["Recording"]
    eventually(fn -> recorded_count(root) > 2_500 end, 30_000)
    assert %{checkpoints: %{refused: nil, taken: taken}} = Cluster.Runner.part_info(runner)
    assert taken > 0
    Process.exit(runner, :kill)
    assert :ok = Cluster.await(deployment, 60_000)

    {:ok, store} = Situ.Store.open(Situ.Store.newest("placed", root))

    assert store |> Situ.Store.messages("numbers") |> Enum.map(& &1.data) ==
             Enum.to_list(1..4_000)

    # On a busy machine, the part may lose its lease once more.
    versions = Enum.filter(Situ.Store.list(root), &(Path.basename(&1) =~ ~r/^placed/))
    assert length(versions) >= 2
  end

  defp recorded_count(root) do
    with path when path != nil <- Situ.Store.newest("placed", root),
         {:ok, store} <- Situ.Store.open(path),
         true <- Situ.Store.has_stream?(store, "numbers") do
      Situ.Store.count(store, "numbers")
    else
      _ -> 0
    end
  end

  if NatsServer.path() do
    test "a node that starts before its log waits for it", %{tmp_dir: dir} do
      port = Situ.Test.FreePort.find_tcp()

      log =
        ExUnit.CaptureLog.capture_log(fn ->
          start_supervised!(
            {Cluster, log: "nats://127.0.0.1:#{port}", log_options: [timeout: 500]}
          )

          assert {:error, %{code: :log_away}} = Cluster.deploy(ClusterSums, opts: [count: 300])
        end)

      assert log =~ "cannot connect to a NATS server at 127.0.0.1:#{port}: connection refused"
      server = NatsServer.start(dir, port: port)
      on_exit(fn -> NatsServer.kill(server) end)
      opts = [opts: [count: 300], place: @place, publish: ["Result"], pipeline: @pipeline]

      eventually(fn ->
        match?({:ok, _}, Situ.Cluster.Log.list_subjects(Cluster.Agent.get_log()))
      end)

      {:ok, deployment} = Cluster.deploy(ClusterSums, opts)
      assert :ok = Cluster.await(deployment, 60_000)
      assert read(deployment, "Result") == alone(count: 300)
    end

    test "does not wait for a server that nobody can use", %{tmp_dir: dir} do
      server = NatsServer.start(dir, settings: ~s(authorization { token: "s3cret" }))
      on_exit(fn -> NatsServer.kill(server) end)
      Process.flag(:trap_exit, true)
      assert {:error, %{code: :refused_login}} = Cluster.start_link(log: server.url)
    end
  end
end
