defmodule Situ.Experiment.NodePoolTest do
  # A node computes one experiment at a time, and its cache folder is a variable of the environment.
  use ExUnit.Case, async: false
  import ExUnit.CaptureLog
  alias Situ.{Dataset, Metric}
  alias Situ.Experiment.{CodeVersion, NodeHost, RecordingCache, ResultsFile, Runner}
  alias Situ.Experiment.Test.LevelStudy

  @moduletag :tmp_dir

  defmodule Tune do
    @moduledoc false
    use Situ.Experiment

    @impl true
    def parameters, do: [threshold: [0.3, 0.4], smooth: [1, 3]]

    @impl true
    def build(_p, session, parameters) do
      case Process.whereis(:node_pool_test) do
        nil -> :ok
        test -> send(test, {:built, self()})
      end

      %{level: level} = Situ.Experiment.cached(session, :smooth, n: parameters.smooth)
      %{"Speaking" => Situ.map(level, &(&1 > parameters.threshold), type: :boolean)}
    end

    def smooth(session, %{n: n}) do
      level =
        session
        |> Situ.Experiment.stream("Level")
        |> Situ.scan([], fn x, last -> Enum.take([x | last], n) end)
        |> Situ.map(&(Enum.sum(&1) / length(&1)), type: :float)

      %{level: level}
    end

    @impl true
    def metrics,
      do: [speaking: Metric.intervals(truth: "Speaking.Truth", main: :time_f1)]
  end

  setup %{tmp_dir: root} do
    before = System.get_env("XDG_CACHE_HOME")
    System.put_env("XDG_CACHE_HOME", Path.join(root, "cache"))

    on_exit(fn ->
      if before,
        do: System.put_env("XDG_CACHE_HOME", before),
        else: System.delete_env("XDG_CACHE_HOME")
    end)

    %{dataset: LevelStudy.create_dataset(root, 2)}
  end

  # This VM is the only node.
  defp run_on_node(dataset, opts \\ []) do
    me = self()
    settings = [nodes: fn -> [node()] end, notify: &send(me, {:notice, &1})]
    Runner.run(Tune, dataset, settings ++ opts)
  end

  defp read_results(folder) do
    for {key, result} <- ResultsFile.read_results(folder),
        into: %{},
        do: {key, Map.drop(result, ~w(took_s busy_s node output))}
  end

  defp count_lines(folder),
    do:
      folder
      |> ResultsFile.file_path()
      |> File.read!()
      |> String.split("\n", trim: true)
      |> length()

  defp folders(root, name), do: root |> Path.join(name) |> Path.wildcard()

  test "a run on a node has the results of a local run", %{tmp_dir: root, dataset: dataset} do
    {:ok, {folder, local}} = Runner.run(Tune, dataset)
    local_results = read_results(folder)
    stages = File.ls!(Path.join(folder, "stages"))
    File.rm_rf!(folder)

    assert {:ok, {^folder, run}} = run_on_node(dataset, jobs: 2)
    assert {run["computed"], run["failed"], count_lines(folder)} == {8, 0, 8}
    assert read_results(folder) == local_results
    assert Enum.sort(File.ls!(Path.join(folder, "stages"))) == Enum.sort(stages)
    assert %{"nonode@nohost" => %{"host" => _, "cores" => _}} = run["nodes"]
    refute is_map_key(local, "nodes")
    assert folders(root, "**/*.unfinished") == []

    name = "#{node()} takes part"
    assert_received {:notice, ^name}
    assert {:ok, {_, %{"computed" => 0}}} = run_on_node(dataset)
  end

  test "a trial of a lost node is computed again, and counts once", %{dataset: dataset} do
    Process.register(self(), :node_pool_test)
    task = Task.async(fn -> run_on_node(dataset) end)
    assert_receive {:built, _}, 30_000
    NodeHost |> Process.whereis() |> Process.exit(:kill)
    assert {:ok, {folder, run}} = Task.await(task, 60_000)
    assert {run["computed"], run["failed"], count_lines(folder)} == {8, 0, 8}
  end

  test "a trial that ends every node is a failed result", %{dataset: dataset} do
    Process.register(self(), :node_pool_test)
    {:ok, dataset} = Dataset.remove_session(dataset, "p2")
    task = Task.async(fn -> run_on_node(dataset, only: %{"threshold" => 0.3, "smooth" => 1}) end)

    for _ <- 1..3 do
      assert_receive {:built, _}, 30_000
      NodeHost |> Process.whereis() |> Process.exit(:kill)
    end

    assert {:ok, {folder, %{"failed" => 1}}} = Task.await(task, 60_000)
    assert [{_, %{"error" => error}}] = Map.to_list(ResultsFile.read_results(folder))
    assert error =~ "3 nodes were lost"
  end

  test "a cancelled run ends the host and its jobs, and the next run finds no folder", %{
    tmp_dir: root,
    dataset: dataset
  } do
    Process.register(self(), :node_pool_test)
    {:ok, run} = Task.start(fn -> run_on_node(dataset) end)
    assert_receive {:built, pipeline}, 30_000
    host = Process.monitor(NodeHost)
    pipeline = Process.monitor(pipeline)
    Process.exit(run, :kill)
    assert_receive {:DOWN, ^host, _, _, _}, 10_000
    assert_receive {:DOWN, ^pipeline, _, _, _}, 10_000
    {:ok, _} = run_on_node(dataset)
    host = Process.monitor(NodeHost)
    assert_receive {:DOWN, ^host, _, _, _}, 10_000
    assert folders(root, "cache/situ/experiments/runs/*/*") == []
  end

  test "without any node, the run is an error", %{dataset: dataset} do
    assert {:error, %{code: :no_node}} = Runner.run(Tune, dataset, nodes: fn -> [] end)
    assert {:error, %{code: :unreachable}} = Runner.run(Tune, dataset, nodes: fn -> [:a@b] end)
  end

  describe "start/1" do
    defp setup_of(opts \\ []) do
      code = CodeVersion.new(Map.new(opts[:binaries] || %{}))

      %{
        pool: self(),
        module: Tune,
        binaries: code.binaries,
        parts: CodeVersion.list_parts(code, Tune, [:build, :metrics], Tune.parameters()),
        versions: Situ.Experiment.Provenance.list_versions(),
        apps: [:situ],
        peer: %{node: node(), folder: "/nowhere"}
      }
    end

    test "refuses other versions and other code, and names them" do
      setup = setup_of()

      assert {:error, %{code: :other_version, why: why}} =
               NodeHost.start(put_in(setup.versions["situ"], "99.0"))

      assert why =~ "99.0"

      assert {:error, %{code: :other_code, why: why}} =
               NodeHost.start(put_in(setup.parts.modules[Situ.Stream], "other"))

      assert why =~ "Situ.Stream"
      assets = [{"situ_store/native/unknown.so", "hash"}]

      assert {:error, %{code: :other_code, why: why}} =
               NodeHost.start(put_in(setup.parts.assets, assets))

      assert why =~ "situ_store/native/unknown.so"
      files = [{"/nowhere/model.onnx", "hash"}]

      assert {:error, %{code: :other_code, why: why}} =
               NodeHost.start(put_in(setup.parts.files, files))

      assert why =~ "/nowhere/model.onnx"
    end

    test "loads the code of the experiment, but replaces no module of the node" do
      [{module, beam}] = Code.compile_string("defmodule Situ.Experiment.Sent, do: def(a, do: 1)")
      :code.purge(module)
      :code.delete(module)
      assert {:ok, {host, folder, _}} = NodeHost.start(setup_of(binaries: [{module, beam}]))
      assert apply(module, :a, []) == 1
      assert File.dir?(folder)
      NodeHost.stop(host)

      other = fn ->
        Code.compile_string("defmodule Situ.Interval do\n  def other, do: 1\nend")
      end

      before = Code.compiler_options()[:ignore_module_conflict]
      Code.compiler_options(ignore_module_conflict: true)
      {_, own, file} = :code.get_object_code(Situ.Interval)
      [{Situ.Interval, beam}] = other.()
      {:module, _} = :code.load_binary(Situ.Interval, file, own)
      Code.compiler_options(ignore_module_conflict: before)

      assert {:error, %{code: :module_exists, why: why}} =
               NodeHost.start(setup_of(binaries: [{Situ.Interval, beam}]))

      assert why =~ "has its own"
    end
  end

  describe "locate_session/3" do
    setup %{dataset: dataset} do
      {:ok, session} = Dataset.session(dataset, "p1")
      stamps = Situ.Experiment.InputStamp.partition_stamps(session)
      %{session: session, stamps: stamps}
    end

    test "reads a recording under the same path in place", %{session: session, stamps: stamps} do
      inputs = RecordingCache.describe_inputs(session, stamps)
      assert {:ok, ^session} = RecordingCache.locate_session(session, inputs, node())
    end

    test "copies a recording that is not there, once", %{
      tmp_dir: root,
      session: session,
      stamps: stamps
    } do
      # The recordings are elsewhere on the other machine.
      inputs =
        for {name, {stamp, entries}} <- RecordingCache.describe_inputs(session, stamps),
            into: %{},
            do: {name, {stamp, for({file, size, time} <- entries, do: {file, size, time - 1})}}

      assert {:ok, copied} = RecordingCache.locate_session(session, inputs, node())
      assert hd(copied.partitions).path =~ Path.join(root, "cache")
      assert {:ok, store} = Dataset.Partition.open(hd(copied.partitions))
      assert Situ.Store.count(store, "Level") == 200

      # The files of the owner are not needed again.
      for partition <- session.partitions, do: File.rm_rf!(partition.path)
      assert {:ok, ^copied} = RecordingCache.locate_session(session, inputs, node())

      :ok = RecordingCache.delete_old_copies(System.os_time(:second) + 8 * 24 * 3600)

      log =
        capture_log(fn -> send(self(), RecordingCache.locate_session(session, inputs, node())) end)

      assert log == ""
      assert_received {:error, %{code: :not_copied}}
      assert folders(root, "cache/**/*.unfinished") == []
    end
  end
end
