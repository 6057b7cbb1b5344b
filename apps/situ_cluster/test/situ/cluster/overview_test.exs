defmodule Situ.Cluster.OverviewTest do
  # The overview of a cluster, of complete deployments and their logs; code upgrades; log trimming.
  use ExUnit.Case, async: false
  import Situ.Test.LinkRecordings, only: [eventually: 1]
  alias Situ.{Cluster, Time}
  alias Situ.Cluster.Log
  alias Situ.Test.ClusterSums

  @moduletag :tmp_dir
  @moduletag capture_log: true

  defp deployed(dir, opts) do
    start_supervised!({Cluster, log: dir, labels: ["lab"], devices: ["camera0"]})

    {:ok, deployment} =
      Cluster.deploy(
        ClusterSums,
        Keyword.merge(
          [
            opts: [count: 50_000],
            place: [
              {"Sum", on: {:near, "camera0"}, deterministic: true},
              {"Smooth", deterministic: true}
            ],
            publish: ["Result"],
            checkpoint: Time.ms(100),
            pipeline: [replay: [interval: {0, Time.s(3_600)}, speed: 1.0]]
          ],
          opts
        )
      )

    eventually(fn -> match?({:ok, [_ | _]}, Cluster.read(deployment, "Result")) end)
    deployment
  end

  test "shows nodes, parts, streams, readers and one pipeline per deployment", %{tmp_dir: dir} do
    deployment = deployed(dir, [])
    eventually(fn -> match?(%{nodes: [%{devices: ["camera0"]}]}, Cluster.overview()) end)
    overview = Cluster.overview()
    assert [%{node: node, labels: ["lab"]}] = overview.nodes
    assert node == node()
    sum = Enum.find(overview.parts, &(&1.part == "Sum"))
    assert %{phase: :running, deployment: "ClusterSums", streams: [stream]} = sum
    assert %{messages: n, readers: [%{part: "Smooth", behind: behind}]} = stream
    assert n > 0 and behind >= 0

    snapshot = Cluster.info(deployment)
    paths = for n <- snapshot.nodes, do: n.path
    assert "Left" in paths and "Result" in paths
    refute Enum.any?(paths, &(&1 =~ ~r/^(In|Out)let/))
    assert paths == Enum.uniq(paths)
    # Every edge connects two components of the snapshot.
    ids = for n <- snapshot.nodes, do: n.id
    assert Enum.all?(snapshot.edges, &(&1.from in ids and &1.to in ids))

    crossing =
      Enum.find(snapshot.edges, fn e ->
        Enum.any?(snapshot.nodes, &(&1.id == e.to and &1.path == "Result"))
      end)

    assert crossing != nil and
             Enum.find(snapshot.nodes, &(&1.id == crossing.from)).scope == "Smooth"

    assert {_, find} = List.keyfind(Cluster.pipelines(), "ClusterSums/Sum", 0)
    assert is_pid(find.()) and find.() == Cluster.Overview.find_pipeline("ClusterSums", "Sum")
    assert Cluster.Overview.find_pipeline("ClusterSums", "Nothing") == nil
    assert Cluster.Overview.find_pipeline("Nothing", "Sum") == nil
    assert {:ok, nil} = Cluster.balance(deployment)
    assert {:ok, lines} = Cluster.logs()
    assert is_list(lines)
  end

  test "upgrades code while parts are running, and rejects code with another graph", %{
    tmp_dir: dir
  } do
    deployment = deployed(dir, [])
    epoch = fn -> Enum.find(Cluster.overview().parts, &(&1.part == "Sum")).epoch end
    before = epoch.()
    assert {:ok, [node]} = Cluster.upgrade([ClusterSums])
    assert node == node() and epoch.() > before
    {:ok, seen} = Cluster.read(deployment, "Result")
    eventually(fn -> length(elem(Cluster.read(deployment, "Result"), 1)) > length(seen) + 20 end)
    {:ok, results} = Cluster.read(deployment, "Result")
    times = for m <- results, do: m.originating_time
    assert times == Enum.uniq(Enum.sort(times))

    source = """
    defmodule Situ.Test.ClusterSums do
      use Situ.Pipeline
      @impl true
      def build(p, _opts), do: p |> Situ.sequence(1, & &1, count: 3, every: 5, name: "Other")
    end
    """

    [{module, beam}] = compiled(source)
    assert {:error, error} = Cluster.upgrade([{module, beam}])
    assert error.code in [:other_plan, :unknown_component]
    assert error.what =~ "keep the old code"
    # The old code is restored.
    assert {:ok, %{parts: parts}} = Cluster.plan(ClusterSums, place: [{"Sum", []}])
    assert "Sum" in parts
    assert {:error, %{code: :no_code}} = Cluster.upgrade([:no_such_module])
  end

  # Compiling loads the code; this test is about the code that nodes load.
  defp compiled(source) do
    {module, beam, file} = :code.get_object_code(ClusterSums)
    Code.put_compiler_option(:ignore_module_conflict, true)
    [{^module, other}] = Code.compile_string(source)
    :code.purge(module)
    {:module, ^module} = :code.load_binary(module, file, beam)
    :code.purge(module)
    [{module, other}]
  after
    Code.put_compiler_option(:ignore_module_conflict, false)
  end

  test "trims the log to the configured time", %{tmp_dir: dir} do
    deployment = deployed(dir, retain: Time.ms(500))
    {:ok, log} = Log.connect(dir)
    subject = {:stream, "ClusterSums.Result"}
    eventually(fn -> match?({:ok, [%{seq: seq}]} when seq > 3, Log.read(log, subject, 1, 1)) end)
    assert %{phase: :running} = Cluster.status(deployment).parts["rest"]
  end
end
