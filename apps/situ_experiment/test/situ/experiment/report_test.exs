defmodule Situ.Experiment.ReportTest do
  use ExUnit.Case, async: true
  alias Situ.Experiment.{MlflowExport, ReportPage, ReportTable}

  @moduletag :tmp_dir

  @run %{
    "run" => "20260131-120000",
    "experiment" => "Tune",
    "module" => "Tune",
    "status" => "finished",
    "started" => "2026-01-31T12:00:00.000000000Z",
    "method" => "grid",
    "seed" => 1,
    "sessions" => ["p1", "p2"],
    "metrics" => [%{"name" => "speaking", "main" => "f1", "better" => %{"f1" => "higher"}}],
    "environment" => %{
      "file" => "/a/<tune>.exs",
      "commit" => %{"id" => "abc", "changed_files" => false}
    }
  }

  defp row(number, label, value, interval) do
    metric = %{
      value: value,
      interval: interval,
      values: %{"f1" => value, "recall" => nil},
      sessions: [{"p1", 0.9}, {"p2", 0.7}]
    }

    %{
      number: number,
      label: label,
      parameters: %{"on" => 0.5, "detector" => "A|B"},
      sessions: 2,
      failures: [],
      metrics: %{"speaking" => metric}
    }
  end

  defp rows, do: [row(2, "on=0.5 detector=<A|B>", 0.8, {0.7, 0.9}), row(1, "on=0.4", nil, nil)]

  test "tables mark the best set and show intervals and undefined values" do
    assert [header, best, other] = ReportTable.table_rows(rows(), @run)
    assert header == ["", "set", "parameters", "sessions", "speaking.f1"]
    assert best == ["*", "2", "on=0.5 detector=<A|B>", "2", "0.800 [0.700, 0.900]"]
    assert List.last(other) == "-"

    assert "Its worst sessions by speaking.f1: p2 (0.700), p1 (0.900)" in ReportTable.describe_run(
             rows(),
             @run
           )
  end

  test "the report names the machines on which costs were measured" do
    cost = %{"name" => "cost", "main" => "busy_s_per_s", "kind" => "cost", "better" => %{}}
    run = update_in(@run["metrics"], &(&1 ++ [cost]))
    on = fn row, machine -> Map.put(row, :machines, [machine]) end
    [first, second] = rows()
    lines = ReportTable.describe_run([on.(first, "lab2"), on.(second, "lab1")], run)
    assert "Machines of cost: lab1, lab2" in lines
    lines = ReportTable.describe_run([on.(first, "lab1"), on.(second, "lab1")], run)
    assert "Machine of cost: lab1" in lines
    refute Enum.any?(ReportTable.describe_run([on.(first, "lab1")], @run), &(&1 =~ "Machine"))
  end

  test "Markdown and HTML escape text" do
    markdown = rows() |> ReportTable.table_rows(@run) |> ReportTable.render_markdown()
    assert markdown =~ "detector=<A\\|B>"
    page = ReportPage.render_page(rows(), @run)
    assert page =~ "detector=&lt;A|B&gt;"
    refute page =~ "<A|B>"
    assert page =~ "/a/&lt;tune&gt;.exs" or page =~ "\\/a\\/&lt;tune&gt;.exs"
    assert page =~ "<circle"
  end

  test "runs are exported in the layout of MLflow, and a second export changes nothing", %{
    tmp_dir: root
  } do
    for _ <- 1..2, do: assert(MlflowExport.write_folder(root, rows(), @run) == :ok)
    assert [experiment] = Path.wildcard(Path.join(root, "*/meta.yaml"))
    assert File.read!(experiment) =~ ~s(name: "Tune")

    assert [set, _] =
             root
             |> Path.join("*/*/meta.yaml")
             |> Path.wildcard()
             |> Enum.map(&Path.dirname/1)
             |> Enum.sort_by(&(not File.exists?(Path.join(&1, "metrics/speaking.f1"))))

    assert File.read!(Path.join(set, "params/on")) == "0.5"
    assert File.read!(Path.join(set, "metrics/speaking.f1")) == "1769860800000 0.8 0\n"
    assert File.read!(Path.join(set, "metrics/speaking.interval_low")) =~ " 0.7 0"
    refute File.exists?(Path.join(set, "metrics/speaking.recall"))
    assert File.read!(Path.join(set, "tags/mlflow.source.git.commit")) == "abc"
    assert File.read!(Path.join(set, "meta.yaml")) =~ "status: 3\n"

    :ok = MlflowExport.write_folder(root, rows(), %{@run | "status" => "interrupted"})
    assert File.read!(Path.join(set, "meta.yaml")) =~ "status: 5\n"
  end
end
