defmodule Situ.ClusterTest do
  use ExUnit.Case, async: false

  alias Situ.{Cluster, Pipeline}
  alias Situ.Test.ClusterSums

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
