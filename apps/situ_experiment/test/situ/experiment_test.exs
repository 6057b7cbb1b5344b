defmodule Situ.ExperimentTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureLog
  alias Situ.{Dataset, Experiment, Metric, Store}
  alias Situ.Experiment.Test.LevelStudy
  alias Situ.Experiment.{Baseline, Reproduction, ResultsFile, RunRecord, Runner, Summary}

  @moduletag :tmp_dir

  defmodule Tune do
    @moduledoc false
    use Situ.Experiment

    @impl true
    def parameters, do: [threshold: [0.3, 0.4, 0.7], smooth: [1, 3]]

    @impl true
    def build(_p, session, parameters) do
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
    def metrics do
      [
        speaking: Metric.intervals(truth: "Speaking.Truth", main: :time_f1),
        frames: Metric.classes(truth: "Speaking.Truth"),
        cost: Metric.cost(),
        changes: fn measured -> Enum.count(Metric.messages(measured, "Speaking")) end
      ]
    end
  end

  defmodule Failing do
    @moduledoc false
    use Situ.Experiment
    @impl true
    def parameters, do: [limit: [0, 2]]

    @impl true
    def build(_p, session, %{limit: limit}) do
      if Experiment.metadata(session)["noise"] > limit, do: raise("too noisy")
      %{"Speaking" => Experiment.stream(session, "Level")}
    end

    @impl true
    def metrics, do: [count: &Enum.count(Metric.messages(&1, "Speaking"))]
  end

  defp run(module, dataset, opts \\ []) do
    {:ok, result} = Runner.run(module, dataset, opts)
    result
  end

  defp lines(folder),
    do: folder |> ResultsFile.file_path() |> File.read!() |> String.split("\n", trim: true)

  defp stages(folder), do: File.ls!(Path.join(folder, "stages"))

  test "runs all sets over all sessions, and finds the best set", %{tmp_dir: root} do
    dataset = LevelStudy.create_dataset(root, 4)
    {folder, run} = run(Tune, dataset, jobs: 2)
    assert {run["status"], run["computed"], run["failed"]} == {"finished", 24, 0}
    assert length(lines(folder)) == 24

    [best | _] = rows = Summary.list_rows(folder, run)
    assert best.label == "threshold=0.4 smooth=1"
    assert %{value: value, interval: {low, high}, sessions: sessions} = best.metrics["speaking"]
    assert value > 0.9 and low <= value and value <= high
    assert length(sessions) == 4
    assert best.metrics["changes"].value == 200.0
    assert best.metrics["cost"].value > 0
    assert Enum.map(rows, & &1.sessions) == [4, 4, 4, 4, 4, 4]

    assert {:ok, {^folder, again}} = RunRecord.fetch_run(Path.dirname(folder), run["run"])
    assert again == run
    assert RunRecord.status(run) == "finished"
    assert %{"otp" => _, "elixir" => _} = run["environment"]["versions"]
    assert "sha256:" <> _ = run["inputs"]["p1"]["Room"]
  end

  test "computes a stage once for all sets that share it", %{tmp_dir: root} do
    {folder, _} = run(Tune, LevelStudy.create_dataset(root, 2))
    # Two sessions, and two values of the stage's only parameter.
    assert length(stages(folder)) == 4
  end

  test "computes nothing twice, and continues after a truncated line", %{tmp_dir: root} do
    dataset = LevelStudy.create_dataset(root, 2)
    {folder, %{"computed" => 12}} = run(Tune, dataset)
    assert {_, %{"computed" => 0}} = run(Tune, dataset)

    file = ResultsFile.file_path(folder)
    [last | _] = Enum.reverse(lines(folder))
    File.write!(file, String.replace(File.read!(file), last, String.slice(last, 0, 40)))
    assert {_, %{"computed" => 1} = run} = run(Tune, dataset)
    assert [%{sessions: 2} | _] = Summary.list_rows(folder, run)
  end

  test "computes the results of a changed recording again", %{tmp_dir: root} do
    dataset = LevelStudy.create_dataset(root, 2)
    run(Tune, dataset)

    {:ok, dataset} =
      Dataset.update_session(dataset, "p2", &{:ok, %{&1 | metadata: %{"noise" => 9}}})

    assert {_, %{"computed" => 6}} = run(Tune, dataset)
  end

  describe "after a change of the code" do
    @source """
    defmodule Situ.ExperimentTest.Changing do
      use Situ.Experiment
      @impl true
      def parameters, do: [threshold: [0.3, 0.4]]
      @impl true
      def build(_p, session, %{threshold: threshold}) do
        level = Situ.Experiment.stream(session, "Level")
        %{"Speaking" => Situ.map(level, &(&1 > threshold), type: :boolean)}
      end
      @impl true
      def metrics, do: [speaking: Situ.Metric.intervals(truth: "Speaking.Truth")]
    end
    """

    setup %{tmp_dir: root} do
      before = Code.compiler_options()[:ignore_module_conflict]
      Code.compiler_options(ignore_module_conflict: true)
      on_exit(fn -> Code.compiler_options(ignore_module_conflict: before) end)
      %{dataset: LevelStudy.create_dataset(root, 2)}
    end

    defp run_source(source, dataset) do
      [{module, _}] = binaries = Code.compile_string(source)
      {folder, run} = run(module, dataset, binaries: Map.new(binaries))

      {run["computed"], folder |> Path.join("outputs") |> File.ls!() |> length(),
       Summary.list_rows(folder, run)}
    end

    test "only results that the change affects are computed again", %{dataset: dataset} do
      assert {4, 4, [_, _]} = run_source(@source, dataset)
      assert {0, 4, _} = run_source(@source, dataset)

      # A new value runs its own set only.
      assert {2, 6, [_, _, _]} =
               run_source(String.replace(@source, "[0.3, 0.4]", "[0.3, 0.4, 0.5]"), dataset)

      # A new metric measures the recorded streams again.
      other = String.replace(@source, "Metric.intervals", "Metric.classes")
      assert {4, 6, [best | _]} = run_source(other, dataset)
      assert best.metrics["speaking"].values["kappa"] > 0.5

      # Other code in build/3 runs everything.
      assert {4, 10, _} =
               run_source(String.replace(@source, "&1 > threshold", "&1 >= threshold"), dataset)
    end
  end

  test "only sessions that fit take part", %{tmp_dir: root} do
    dataset = LevelStudy.create_dataset(root, 3)
    {_, run} = run(Tune, dataset, sessions: &("noisy" in &1.tags))
    assert run["sessions"] == ["p3"]
    assert {:error, %{code: :no_session}} = Runner.run(Tune, dataset, sessions: fn _ -> false end)
  end

  test "a failed session is a result, and runs again the next time", %{tmp_dir: root} do
    dataset = LevelStudy.create_dataset(root, 2)

    capture_log(fn ->
      {folder, run} = run(Failing, dataset)
      assert {run["computed"], run["failed"]} == {4, 2}
      rows = Summary.list_rows(folder, run)

      assert Enum.map(rows, &{&1.number, &1.sessions, length(&1.failures)}) == [
               {2, 2, 0},
               {1, 0, 2}
             ]

      [{_, error} | _] = List.last(rows).failures
      assert error =~ "too noisy"
      assert {_, %{"computed" => 2, "failed" => 2}} = run(Failing, dataset)
      assert {:error, %{code: :failed_sessions}} = Baseline.from_run(folder, run, 1)
      assert Path.wildcard(Path.join(folder, "**/*.unfinished")) == []
    end)
  end

  defmodule OneStream do
    @moduledoc false
    use Situ.Experiment
    @impl true
    def parameters, do: [shape: [:stream, :list]]
    @impl true
    def build(_p, session, %{shape: :stream}), do: Experiment.stream(session, "Level")
    def build(_p, session, %{shape: :list}), do: [Experiment.stream(session, "Level")]
    @impl true
    def metrics, do: [count: &Enum.count(Metric.messages(&1, "Level"))]
  end

  test "a stream without a name is an error that says how to return it", %{tmp_dir: root} do
    dataset = LevelStudy.create_dataset(root, 1)

    capture_log(fn ->
      {folder, run} = run(OneStream, dataset)
      assert run["failed"] == 2

      for row <- Summary.list_rows(folder, run),
          {"p1", error} <- row.failures,
          do: assert(error =~ "return the streams by name")
    end)
  end

  test "successive halving drops sets, and random search takes some", %{tmp_dir: root} do
    dataset = LevelStudy.create_dataset(root, 4)
    {folder, run} = run(Tune, dataset, method: :halving)
    [best | rows] = Summary.list_rows(folder, run)
    assert best.sessions == 4
    # Six sets over two sessions, then the better three over all four.
    assert Enum.map(rows, & &1.sessions) == [4, 4, 2, 2, 2]
    assert run["computed"] == 18

    {_, %{"sets" => sets}} = run(Tune, dataset, method: :random, trials: 2, seed: 5)
    assert length(sets) == 2
    assert {_, %{"sets" => ^sets}} = run(Tune, dataset, method: :random, trials: 2, seed: 5)
  end

  test "compares two sets session by session", %{tmp_dir: root} do
    {folder, run} = run(Tune, LevelStudy.create_dataset(root, 4))
    {:ok, [speaking | _]} = Summary.compare_sets(folder, run, {5, 3})
    assert speaking.difference > 0 and speaking.sessions == 4
    # Four sessions have 16 exchanges; all differences have the same sign.
    assert speaking.p == 0.125
    assert length(speaking.better) == 4 and speaking.worse == []
    assert {:error, %{code: :no_set}} = Summary.compare_sets(folder, run, {1, 99})
  end

  test "a baseline names the sessions and the moments that became worse", %{tmp_dir: root} do
    dataset = LevelStudy.create_dataset(root, 2)
    {folder, run} = run(Tune, dataset)
    {:ok, baseline} = Baseline.from_run(folder, run, 3)
    {:ok, baseline} = baseline |> Situ.JSON.encode() |> Situ.JSON.decode()
    {:ok, same} = Baseline.check_run(baseline, folder, run, 3)
    assert Enum.map(same, & &1.status) == [:ok, :unchecked, :ok, :ok]

    {:ok, findings} = Baseline.check_run(baseline, folder, run, 5)
    assert %{status: :worse, sessions: [{_, before, now, moments} | _]} = List.last(findings)
    assert now < before
    assert ["missed", "", from, to] = hd(moments)
    assert from >= 1.9 and to <= 4.1
  end

  test "a run can be reproduced, and a changed stream is named", %{tmp_dir: root} do
    dataset = LevelStudy.create_dataset(root, 2)
    {folder, run} = result = run(Tune, dataset)
    {:ok, report} = Reproduction.reproduce_set(Tune, dataset, result, set: 1)
    assert report.changes == []
    assert Enum.map(report.outcomes, &{&1.session, &1.differences}) == [{"p1", []}, {"p2", []}]

    # The output of set 5 takes the place of set 1's.
    {:ok, one} = Summary.fetch_results(folder, run, 1)
    {:ok, five} = Summary.fetch_results(folder, run, 5)
    path = &Path.join(folder, &1["p1"]["output"])
    File.rm_rf!(path.(one))
    File.cp_r!(path.(five), path.(one))
    {:ok, report} = Reproduction.reproduce_set(Tune, dataset, result, set: 1)
    assert [{"Speaking", why}] = hd(report.outcomes).differences
    assert why =~ "instead of"
  end

  test "latency needs real time", %{tmp_dir: root} do
    dataset = LevelStudy.create_dataset(root, 1)
    {:ok, session} = Dataset.session(dataset, "p1")
    open = Dataset.OpenSession.open(session)
    {:ok, output} = Dataset.OpenSession.fetch_store(open, "Room")

    measured = %{
      session: open,
      output: output,
      span: {0, 10_000_000_000},
      parameters: %{},
      busy_s: 1.0
    }

    metrics = [delay: Metric.latency(stream: "Level")]

    assert {:error, %{code: :no_latency}} =
             Metric.Measurement.measure_all(metrics, measured, :max)

    {:ok, %{"delay" => %{"counts" => counts}}} =
      Metric.Measurement.measure_all(metrics, measured, 1.0)

    assert_in_delta Metric.summarize(metrics[:delay], [counts])["p95_s"], 1.0e-6, 1.0e-12

    # Without a name, all streams count.
    metrics = [delay: Metric.latency()]
    assert {:ok, %{"delay" => all}} = Metric.Measurement.measure_all(metrics, measured, 1.0)
    assert all["counts"] == counts
  end

  defmodule NoMetrics do
    @moduledoc false
    use Situ.Experiment
    @impl true
    def parameters, do: [a: [1]]
    @impl true
    def build(_p, _session, _parameters), do: %{}
    @impl true
    def metrics, do: []
  end

  test "datasets without a file and wrong parameters are errors", %{tmp_dir: root} do
    {:ok, dataset} = Dataset.new("No file")
    assert {:error, %{code: :no_file}} = Runner.run(Tune, dataset)

    assert {:error, %{code: :bad_metrics}} =
             Runner.run(NoMetrics, LevelStudy.create_dataset(root, 1))

    assert {:error, %{code: :bad_parameters}} = Experiment.Parameters.list_sets(threshold: 0.4)

    assert {:error, %{code: :no_set}} =
             Runner.run(Tune, LevelStudy.create_dataset(Path.join(root, "other"), 1),
               only: %{"x" => 1}
             )
  end

  test "results are recordings of the streams of build/3", %{tmp_dir: root} do
    {folder, run} = run(Tune, LevelStudy.create_dataset(root, 1))
    {:ok, %{"p1" => result}} = Summary.fetch_results(folder, run, 3)
    store = Store.open!(Path.join(folder, result["output"]))
    assert [%{name: "Speaking"}] = Store.streams(store)
    assert Store.count(store, "Speaking") == 200
  end
end
