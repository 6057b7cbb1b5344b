defmodule Situ.ClusterTest do
  use ExUnit.Case, async: false

  alias Situ.{Cluster, Pipeline}
  alias Situ.Cluster.Past
  alias Situ.Test.{ClusterSums, NatsServer}

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

  test "parts on one node give what the pipeline gives alone", %{tmp_dir: dir} do
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

  # A NATS server where there is one, else a folder: the same must hold.
  defp log(dir) do
    if NatsServer.path() do
      server = NatsServer.start(dir)
      on_exit(fn -> NatsServer.kill(server) end)
      {server.url, fn -> length(File.ls!("/proc/#{server.pid}/fd")) end}
    else
      {dir, fn -> 0 end}
    end
  end

  test "the log of an ended deployment stays until it is pruned, files and all", %{tmp_dir: dir} do
    {address, files} = log(dir)
    start_supervised!({Cluster, log: address})
    opts = [opts: [count: 300], place: @place, publish: ["Result"], pipeline: @pipeline]
    {:ok, kept} = Cluster.deploy(ClusterSums, [name: "kept"] ++ opts)
    assert :ok = Cluster.await(kept, 60_000)
    before = files.()
    {:ok, gone} = Cluster.deploy(ClusterSums, [name: "gone"] ++ opts)
    assert :ok = Cluster.await(gone, 60_000)
    {:ok, all} = Cluster.kept()
    assert [%{deployment: "gone", streams: 5, bytes: bytes}, %{deployment: "kept"}] = all
    assert bytes > 0
    assert {:ok, n} = Cluster.prune("gone")
    assert n > 5
    assert {:ok, [%{deployment: "kept"}]} = Cluster.kept()
    assert files.() == before
    assert read(kept, "Result") == alone(count: 300)
    assert {:error, %{code: :not_found, fix: fix}} = Cluster.prune("gone")
    assert fix =~ "kept"
    # Its name is free, and its log begins anew.
    {:ok, again} = Cluster.deploy(ClusterSums, [name: "gone"] ++ opts)
    assert :ok = Cluster.await(again, 60_000)
    assert read(again, "Result") == alone(count: 300)
  end

  test "the log of a running deployment is not pruned, whoever runs it", %{tmp_dir: dir} do
    deployment = slow(dir)
    running(deployment.name, "Sum")
    assert {:error, %{code: :in_use}} = Cluster.prune(deployment.name)
    {:ok, log} = Situ.Remote.Log.connect(dir)
    {:ok, [kept]} = Past.list(log)
    # Somebody else's, as far as this one knows: its leases change.
    assert {:error, %{code: :in_use}} = Past.unused(log, kept, 300)
    assert :ok = Cluster.await(deployment, 60_000)
    assert read(deployment, "Result") == alone(count: 600)
    assert {:error, %{code: :bad_option}} = Cluster.deploy(ClusterSums, name: "a.b")
  end

  test "direct streams bypass the log, and lose nothing while all is well", %{tmp_dir: dir} do
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

  # Until a part runs; the runner of it and its publisher.
  defp running(name, part) do
    %{^part => runner} = Cluster.Agent.runners(name)

    case Cluster.Runner.info(runner) do
      %{phase: :running} -> {runner, :sys.get_state(runner).publisher}
      _ -> running(name, part)
    end
  end

  test "who asks about a part at the moment that its publisher is lost harms nobody", %{
    tmp_dir: dir
  } do
    deployment = slow(dir)
    {runner, publisher} = running(deployment.name, "Sum")
    :sys.suspend(runner)
    asked = Task.async(fn -> Cluster.Runner.info(runner) end)
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

  test "a runner that is lost is found again", %{tmp_dir: dir} do
    deployment = slow(dir)
    {runner, _} = running(deployment.name, "Sum")
    Process.exit(runner, :kill)
    assert :ok = Cluster.await(deployment, 60_000)
    assert read(deployment, "Result") == alone(count: 600)
    assert Cluster.status(deployment).parts["Sum"].phase == :done
  end
end
