defmodule Situ.CLI.Experiment do
  @moduledoc false
  # The verbs of `situ experiment`: run a pipeline with many parameters over a dataset, and look at the results.
  @behaviour Situ.CLI.Verb
  alias Situ.CLI.Experiment.{Checking, Running, Viewing}
  alias Situ.CLI.{ClusterConnection, Option, Verb}

  @dataset [kind: :file, doc: "a dataset file"]
  @file_argument [kind: :file, doc: "FILE.exs with the experiment, or the name of a module"]

  @impl true
  def verbs do
    [
      %Verb{
        words: ["experiment", "run"],
        summary: "run a pipeline with many parameters over the sessions of a dataset",
        about: """
        FILE defines a module with `use Situ.Experiment`. Every result is written before the next one begins, so the
        same command continues a run that was stopped or killed. Results whose code, parameters and recordings have not
        changed are not computed again. The folder DATASET.experiments contains the results.

        With --cluster, the nodes of `situ cluster join` compute the results. They get the code of the experiment, and
        recordings that they do not have under the same path. A node with other code of Situ does not take part.
        """,
        arguments: [file: @file_argument, dataset: @dataset],
        options:
          session_options() ++
            [
              jobs_option(),
              Option.new(
                :method,
                ["grid", "random", "halving"],
                "all sets of parameters, some of them, or successive halving",
                default: "grid"
              ),
              Option.new(:trials, :integer, "the number of sets of a random search", default: 20),
              Option.new(:seed, :integer, "the seed of all random choices", default: 1),
              Option.new(
                :studio,
                :flag,
                "show the experiment in the browser while it runs, and until Ctrl-C"
              ),
              top_option()
            ] ++ cluster_options(),
        examples: [
          "situ experiment run tune.exs study.json --jobs 2",
          "situ experiment run tune.exs study.json --cluster --node situ-9301@10.0.0.1",
          "situ experiment run tune.exs study.json --where \"contains(tags, 'noisy')\" --method halving"
        ],
        run: &Running.run_experiment/2
      },
      %Verb{
        words: ["experiment", "list"],
        aliases: ["ls"],
        summary: "list the runs over a dataset",
        arguments: [dataset: @dataset],
        examples: ["situ experiment list study.json"],
        run: &Viewing.list_runs/2
      },
      %Verb{
        words: ["experiment", "show"],
        summary:
          "show the sets of a run: each metric with its interval, the best set, its worst sessions",
        about:
          "Values in brackets are 95 % intervals, a bootstrap over sessions. Without RUN, shows the latest run.",
        arguments: [
          dataset: @dataset,
          run: [kind: :text, optional: true, doc: "the run, from `situ experiment list`"]
        ],
        options: [
          top_option(),
          Option.new(:sessions, :flag, "also show every session of the best set"),
          Option.new(:set, :integer, "the set of --sessions (default: the best)"),
          Option.new(:markdown, :flag, "print the tables in Markdown"),
          Option.new(:html, :path, "write a report as a page of HTML", value: "FILE"),
          Option.new(:mlflow, :path, "write the sets to a folder in MLflow's file format",
            value: "FOLDER"
          )
        ],
        examples: [
          "situ experiment show study.json",
          "situ experiment show study.json --html report.html"
        ],
        run: &Viewing.show_run/2
      },
      %Verb{
        words: ["experiment", "compare"],
        summary:
          "compare two sets of a run on the same sessions: differences, intervals, p-values",
        about: """
        The p-value is the share of exchanges of the two sets within sessions with at least this difference. It is exact
        for up to 12 sessions.
        """,
        arguments: [
          dataset: @dataset,
          first: [kind: :text, doc: "the number of a set"],
          second: [kind: :text, doc: "the number of another set"]
        ],
        options: [
          run_option(),
          Option.new(:markdown, :flag, "print the table in Markdown")
        ],
        examples: ["situ experiment compare study.json 1 7"],
        run: &Viewing.compare_sets/2
      },
      %Verb{
        words: ["experiment", "promote"],
        summary:
          "make a set the baseline of its experiment, and write it to a file for later checks",
        about:
          "Tolerances in the file may be edited; a metric with the tolerance null is not checked.",
        arguments: [dataset: @dataset],
        options: [
          run_option(),
          Option.new(:set, :integer, "the set (default: the best)"),
          Option.new(:output, :path, "the file to write", short: :o, default: "baseline.json")
        ],
        examples: ["situ experiment promote study.json --set 7 -o baseline.json"],
        run: &Checking.promote_set/2
      },
      %Verb{
        words: ["experiment", "check"],
        summary: "check that no metric has fallen below a baseline; status 1 if one has",
        about: """
        Runs the baseline's parameters over its sessions, and names the sessions and times that became worse. For up to
        three of them, it records the output of the baseline, the output now, the truth and their differences.

        With --bisect, it looks for the commit that made the metric fall: commits after GOOD in the repository of the
        experiment are checked in a separate worktree. In a checkout of Situ, the worktree starts from the build there.
        In your own repository, --build is a command that builds a commit, and --copy a folder to start from. A commit
        that cannot be built is skipped.
        """,
        arguments: [file: @file_argument, dataset: @dataset],
        options: [
          Option.new(
            :baseline,
            :path,
            "the baseline (default: baseline.json, otherwise the set promoted last)",
            value: "FILE"
          ),
          Option.new(:bisect, :string, "find the commit after GOOD that made the metric fall",
            value: "GOOD"
          ),
          Option.new(:build, :string, "with --bisect: builds a commit, in its folder",
            value: "COMMAND"
          ),
          Option.new(:copy, :string, "with --bisect: a folder that git ignores, for the builds",
            many?: true,
            value: "FOLDER"
          ),
          jobs_option()
          | cluster_options()
        ],
        examples: [
          "situ experiment check tune.exs study.json --baseline baseline.json",
          "situ experiment check tune.exs study.json --bisect HEAD~20",
          "situ experiment check tune.exs study.json --bisect v1.2 --build 'make models' --copy models"
        ],
        run: &Checking.check_baseline/2
      },
      %Verb{
        words: ["experiment", "reproduce"],
        summary:
          "compute a set of a run again, and name the streams that differ; status 1 if one does",
        arguments: [
          dataset: @dataset,
          run: [kind: :text, optional: true, doc: "the run (default: the latest)"]
        ],
        options: [
          Option.new(:set, :integer, "the set (default: the best)"),
          Option.new(:file, :path, "the experiment (default: the file that the run names)",
            value: "FILE"
          )
        ],
        examples: ["situ experiment reproduce study.json 20260131-120000 --set 7"],
        run: &Checking.reproduce_run/2
      }
    ]
  end

  defp jobs_option do
    Option.new(
      :jobs,
      :integer,
      "the number of results to compute in parallel; with --cluster, on each node",
      default: 1
    )
  end

  defp cluster_options do
    [
      Option.new(:cluster, :flag, "compute on the nodes of a cluster; needs --node"),
      Option.new(:label, :string, "with --cluster: only on nodes with this label", many?: true)
      | ClusterConnection.options()
    ]
  end

  defp top_option, do: Option.new(:top, :integer, "show only the best N sets", default: 20)
  defp run_option, do: Option.new(:run, :string, "the run (default: the latest)", value: "RUN")

  defp session_options do
    [
      Option.new(:where, :string, "only sessions for which this expression is true", value: "EXPR"),
      Option.new(:session, :string, "only this session", many?: true, value: "NAME"),
      Option.new(:tag, :string, "only sessions with this tag", many?: true)
    ]
  end
end
