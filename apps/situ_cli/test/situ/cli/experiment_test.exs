defmodule Situ.CLI.ExperimentTest do
  # A run replaces the handler of signals of the VM while it lasts.
  use ExUnit.Case, async: false
  import ExUnit.CaptureIO
  alias Situ.Experiment.Test.LevelStudy

  @moduletag :tmp_dir

  # Each test has its own module, because tests run at the same time.
  @source """
  defmodule MODULE do
    use Situ.Experiment
    @impl true
    def parameters, do: [threshold: [0.3, 0.4, 0.7]]
    @impl true
    def build(_p, session, %{threshold: threshold}) do
      level = Situ.Experiment.stream(session, "Level")
      %{"Speaking" => Situ.map(level, &(&1 > threshold), type: :boolean)}
    end
    @impl true
    def metrics, do: [speaking: Situ.Metric.intervals(truth: "Speaking.Truth", main: :time_f1)]
  end
  """

  setup %{tmp_dir: root} do
    LevelStudy.create_dataset(root, 4)
    file = Path.join(root, "tune.exs")
    name = "Situ.CLI.ExperimentTest.Tune#{System.unique_integer([:positive])}"
    File.write!(file, String.replace(@source, "MODULE", name))
    %{tune: file, study: Path.join(root, "study.json")}
  end

  defp run(words), do: with_io(fn -> Situ.CLI.run(["experiment" | words]) end)

  defp run_json(words) do
    {status, text} = run(words ++ ["--json"])
    {:ok, json} = Situ.JSON.decode(text)
    {status, json}
  end

  defp fails(words) do
    capture_io(:stderr, fn -> assert elem(run(words), 0) == 1 end)
  end

  test "runs, lists, shows and compares", %{tune: file, study: study} do
    assert {0, text} = run(["run", file, study])
    assert text =~ "3 sets, 4 sessions"
    assert text =~ ~r/\*  2 +threshold=0.4 +4  [\d.]+ \[/
    assert text =~ "worst sessions by speaking.time_f1: p"
    assert text =~ "where they differ: situ studio #{study}"

    assert {0, [%{"status" => "finished", "computed" => 12}]} = run_json(["list", study])
    assert {0, text} = run(["show", study, "--sessions", "--top", "1"])
    assert text =~ "and 2 more: --top 3"
    assert text =~ ~r/p1 +[\d.]+/

    assert {0, %{"sets" => [%{"number" => 2, "metrics" => metrics} | _]}} =
             run_json(["show", study])

    assert %{"speaking" => %{"interval" => [_, _], "sessions" => %{"p1" => _}}} = metrics

    assert {0, text} = run(["compare", study, "3", "2"])
    assert text =~ "speaking is better in: p"
    assert {0, [%{"p" => 0.125}]} = run_json(["compare", study, "3", "2"])
    assert {0, "| metric" <> _} = run(["compare", study, "3", "2", "--markdown"])
  end

  test "an expression over the metadata chooses sessions", %{tune: file, study: study} do
    assert {0, json} =
             run_json(["run", file, study, "--where", "noise >= 3 and contains(tags, 'noisy')"])

    assert json["sessions"] == ["p3", "p4"]
    assert fails(["run", file, study, "--where", "noise > 99"]) =~ "no session takes part"
    assert fails(["run", file, study, "--session", "p9"]) =~ "did you mean"
  end

  test "a baseline is checked, and a regression is status 1", context do
    %{tune: file, study: study, tmp_dir: root} = context
    baseline = Path.join(root, "baseline.json")
    {0, _} = run(["run", file, study])
    assert {0, _} = run(["promote", study, "-o", baseline])

    assert {0, text} =
             with_warnings(fn -> run(["check", file, study, "--baseline", baseline]) end)

    assert text =~ ~r/speaking.time_f1 +ok/

    File.write!(file, String.replace(File.read!(file), "&1 > threshold", "&1 > threshold + 0.25"))

    assert {1, text} =
             with_warnings(fn -> run(["check", file, study, "--baseline", baseline]) end)

    assert text =~ ~r/speaking.time_f1 +worse/
    assert text =~ "fell in p"
    assert text =~ ~r/missed from [\d.]+ s to [\d.]+ s/

    # The latest run is the one with all sets: otherwise, the regression would become the next baseline.
    assert {0, [_, _, %{"method" => "check"}]} = run_json(["list", study])
    assert {0, %{"sets" => [_, _, _]}} = run_json(["show", study])

    # The outputs, the truth and their differences are recorded for the worst sessions.
    recorded = Regex.scan(~r/difference in (p\d) is recorded: situ studio (\S+)/, text)
    assert length(recorded) == 3

    for [_, session, path] <- recorded do
      {:ok, %{title: title, count: count}} = Situ.Experiment.Difference.describe_recording(path)
      assert title =~ ~r/^#{session}: set 2 of run \S+ and the baseline of run /
      assert count > 0
    end
  end

  test "without a file, the baseline that was promoted last is checked", context do
    %{tune: file, study: study, tmp_dir: root} = context
    {0, _} = run(["run", file, study])
    {0, _} = run(["promote", study, "-o", Path.join(root, "other.json")])
    assert {0, text} = with_warnings(fn -> run(["check", file, study]) end)
    assert text =~ ~r/speaking.time_f1 +ok/
    assert fails(["check", file, study, "--bisect", "HEAD"]) =~ "no commits after"
  end

  test "a run is reproduced", %{tune: file, study: study} do
    {0, _} = run(["run", file, study])
    assert {0, text} = with_warnings(fn -> run(["reproduce", study]) end)
    assert text =~ "all streams of 4 sessions are equal"
  end

  # A file that is compiled twice in one VM redefines its module.
  defp with_warnings(fun) do
    me = self()
    capture_io(:stderr, fn -> send(me, {:result, fun.()}) end)
    assert_receive {:result, result}
    result
  end

  test "options of a cluster that do not fit are errors", context do
    %{tune: file, study: study, tmp_dir: root} = context
    assert fails(["run", file, study, "--cluster"]) =~ "give --node"
    usage = fn words -> capture_io(:stderr, fn -> assert elem(run(words), 0) == 2 end) end
    assert usage.(["run", file, study, "--label", "gpu"]) =~ "need --cluster"
    {0, _} = with_warnings(fn -> run(["run", file, study]) end)
    base = Path.join(root, "base.json")
    {0, _} = run(["promote", study, "-o", base])
    check = ["check", file, study, "--baseline", base, "--node", "situ-1@127.0.0.1"]
    assert usage.(check) =~ "need --cluster"
    assert usage.(check ++ ["--cluster", "--bisect", "HEAD"]) =~ "runs here"
  end

  test "files without an experiment, and runs that do not exist, are errors", context do
    %{study: study, tmp_dir: root, tune: file} = context
    other = Path.join(root, "other.exs")

    File.write!(
      other,
      "defmodule Situ.CLI.ExperimentTest.Nothing#{System.unique_integer([:positive])}, do: nil"
    )

    assert fails(["run", other, study]) =~ "defines no experiment"
    assert fails(["run", "No.Such.Module", study]) =~ "is not an experiment"
    assert fails(["show", study]) =~ "no experiment has run"

    assert fails(["check", file, study, "--baseline", "missing.json"]) =~
             "cannot read missing.json"
  end
end
