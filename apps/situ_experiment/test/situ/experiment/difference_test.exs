defmodule Situ.Experiment.DifferenceTest do
  use ExUnit.Case, async: true
  alias Situ.{Annotation, Dataset, Experiment, Metric, Store}
  alias Situ.Experiment.{Baseline, Comments, Difference, DifferenceFiles, Progress}
  alias Situ.Experiment.{ResultsFile, RunRecord, Runner}
  alias Situ.Experiment.Test.LevelStudy

  @moduletag :tmp_dir
  @s 1_000_000_000

  defmodule Tune do
    @moduledoc false
    use Situ.Experiment

    @impl true
    def parameters, do: [threshold: [0.3, 0.4, 0.9]]

    @impl true
    def build(_p, session, %{threshold: threshold}) do
      level = Situ.Experiment.stream(session, "Level")

      %{
        "Speaking" => Situ.map(level, &(&1 > threshold), type: :boolean),
        "Level" => Situ.map(level, &(&1 + threshold), type: :float)
      }
    end

    @impl true
    def metrics do
      [
        speaking: Metric.intervals(truth: "Speaking.Truth", main: :time_f1),
        frames: Metric.classes(truth: "Speaking.Truth"),
        level: Metric.regression(truth: "Level", stream: "Level"),
        cost: Metric.cost()
      ]
    end
  end

  defmodule Counts do
    @moduledoc false
    use Situ.Experiment
    @impl true
    def parameters, do: [a: [1]]
    @impl true
    def build(_p, session, _), do: %{"Level" => Experiment.stream(session, "Level")}
    @impl true
    def metrics, do: [count: &Enum.count(Metric.messages(&1, "Level"))]
  end

  setup %{tmp_dir: root} do
    dataset = LevelStudy.create_dataset(root, 1)
    {:ok, session} = Dataset.session(dataset, "p1")
    {:ok, {folder, run}} = Runner.run(Tune, dataset)
    %{dataset: dataset, session: session, folder: folder, run: run}
  end

  defp seconds(annotation),
    do: {(annotation.from - 1000 * @s) / @s, (annotation.to - 1000 * @s) / @s}

  test "shows both outputs, the truth, and who is right", %{
    session: session,
    folder: folder,
    run: run
  } do
    set = {folder, run, 3}

    {:ok, %{path: path, name: name}} =
      DifferenceFiles.ensure_recording(session, set, {folder, run, 2})

    {:ok, store} = Store.open(path)

    names = for info <- Store.streams(store), do: info.name
    assert Enum.sort(names) == ~w(Baseline.Level Differences Set.Level Speaking Truth.Level)

    # The set with the threshold 0.9 never finds a voice.
    lanes = for m <- Store.messages(store, "Speaking"), a <- m.data, do: {a.track, seconds(a)}
    assert lanes |> Enum.map(&elem(&1, 0)) |> Enum.uniq() |> Enum.sort() == ~w(baseline set truth)
    assert for({"set", times} <- lanes, do: times) == [{2.0, 2.0}]
    assert {"truth", {2.0, 4.0}} in lanes

    found =
      for m <- Store.messages(store, "Differences"), a <- m.data, do: {a, m.originating_time}

    assert Enum.all?(found, fn {a, time} -> a.from == time end)

    worse =
      for {%Annotation{track: "Speaking"} = a, _} <- found, do: {a.values["Label"], seconds(a)}

    assert worse == [{"worse", {2.0, 4.0}}, {"worse", {6.0, 7.5}}]
    # All numbers differ, and the baseline's are nearer to the truth.
    assert [{"worse", {0.0, 9.95}}] =
             for({%{track: "Level"} = a, _} <- found, do: {a.values["Label"], seconds(a)})

    assert {:ok, %{title: "p1: set 3 and the baseline, set 2", count: 3, first: first}} =
             Difference.describe_recording(path)

    assert first == 1000 * @s
    assert DifferenceFiles.fetch_recording(Path.dirname(folder), name) == {:ok, path}
    # The same outputs are not compared twice.
    assert {:ok, %{path: ^path}} =
             DifferenceFiles.ensure_recording(session, set, {folder, run, 2})
  end

  test "a baseline is compared with the truth", %{session: session, folder: folder, run: run} do
    set = {folder, run, 3}
    {:ok, %{path: path}} = DifferenceFiles.ensure_recording(session, set, set)
    {:ok, store} = Store.open(path)

    found =
      for m <- Store.messages(store, "Differences"), a <- m.data, do: {a.track, a.values["Label"]}

    assert {"Speaking", "missed"} in found
    assert {:ok, %{title: "p1: set 3 and the truth"}} = Difference.describe_recording(path)
  end

  test "names of other files, and sets without outputs, are errors", context do
    %{session: session, folder: folder, run: run, dataset: dataset} = context
    experiments = Path.dirname(folder)

    for name <- [
          "Tune:../../x",
          "../Tune:" <> String.duplicate("0", 32),
          "Tune:" <> String.duplicate("0", 32),
          ""
        ],
        do: assert(DifferenceFiles.fetch_recording(experiments, name) == :error)

    assert {:error, %{code: :no_set}} =
             DifferenceFiles.ensure_recording(session, {folder, run, 9}, nil)

    File.rm_rf!(Path.join(folder, "outputs"))

    assert {:error, %{code: :no_output}} =
             DifferenceFiles.ensure_recording(session, {folder, run, 1}, nil)

    {:ok, {folder, run}} = Runner.run(Counts, dataset)

    assert {:error, %{code: :no_compared_streams}} =
             DifferenceFiles.ensure_recording(session, {folder, run, 1}, nil)
  end

  test "comments are kept with their author, also of two programs", %{folder: folder, run: run} do
    name = run["run"]
    assert Comments.list_comments(folder, name) == []
    assert :ok = Comments.add_comment(folder, {name, 2}, " Misses the laugh. ", "Ada")

    1..4
    |> Task.async_stream(&Comments.add_comment(folder, {name, 3}, "Number #{&1}"))
    |> Enum.each(&assert {:ok, :ok} = &1)

    assert [%{set: 2, by: "Ada", text: "Misses the laugh.", at: _} | others] =
             Comments.list_comments(folder, name)

    assert others |> Enum.map(& &1.text) |> Enum.sort() == for(n <- 1..4, do: "Number #{n}")
    assert Comments.list_comments(folder, "another run") == []
    assert {:error, %{code: :bad_comment}} = Comments.add_comment(folder, {name, 2}, "  ")
  end

  test "a set becomes the baseline of its experiment", %{folder: folder, run: run} do
    {:ok, baseline} = Baseline.promote_set(folder, run, 2)
    assert {:ok, read} = Baseline.read_file(Baseline.promoted_path(folder))
    assert read["set"] == 2 and read["parameters"] == baseline["parameters"]
  end

  test "the progress of a run can be read from its files", %{
    folder: folder,
    run: run,
    dataset: dataset
  } do
    results = ResultsFile.read_results(folder)
    now = Situ.Time.now()

    assert %{done: 3, total: 3, failed: 0, left_s: nil} =
             Progress.measure_progress(run, results, now)

    {:ok, {_, again}} = Runner.run(Tune, dataset)
    assert {again["kept"], again["total"]} == {3, 3}
    {:ok, {_, read}} = RunRecord.fetch_run(Path.dirname(folder), again["run"])
    assert %{done: 0} = Progress.measure_progress(read, %{}, now)
  end
end
