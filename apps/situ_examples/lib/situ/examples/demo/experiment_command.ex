defmodule Situ.Examples.Demo.ExperimentCommand do
  @usage """
  Usage: bin/demo --experiment [--out FOLDER] [--jobs N] [--json]

  Tunes the detection of speakers: makes 15 sessions out of the three clips included with Situ (as they are, mirrored,
  with noise, with a voice from outside the image, and with the sound of another clip), runs 18 sets of parameters over
  all of them, and compares the best set with the default parameters.

    --out FOLDER     folder for the dataset and the results (default: "experiment"); a second run reuses them
    --jobs N         number of results to compute in parallel (default: 2)
    --json           print one JSON object and nothing else

  Exit status: 0 success, 1 failure, 2 wrong usage.
  """
  @moduledoc """
  The `bin/demo --experiment` command: runs `Situ.Examples.WhoSpeaksExperiment` over variants of the demo's clips.

  ```text
  #{@usage}
  ```
  """
  alias Situ.Examples.{ClipVariants, WhoSpeaksExperiment}
  alias Situ.Examples.Demo.CommandLine
  alias Situ.Experiment.{RunRecord, Summary}

  @switches [experiment: :boolean, out: :string, jobs: :integer, json: :boolean, help: :boolean]

  @doc "Runs the demo and returns the exit status."
  @spec run([String.t()]) :: 0..255
  def run(argv) do
    command = %{name: "bin/demo --experiment", usage: @usage, switches: @switches}
    CommandLine.run(argv, command, &run_experiment/1)
  end

  defp run_experiment(opts) do
    for app <- [:situ_examples, :situ_dataset], do: {:ok, _} = Application.ensure_all_started(app)
    folder = opts[:out] || "experiment"

    case ClipVariants.create_dataset(list_clips(), folder) do
      {:ok, dataset} -> tune_parameters(dataset, opts)
      {:error, error} -> CommandLine.print_error(error)
    end
  end

  defp list_clips do
    folder = Application.app_dir(:situ_examples, "priv/demo")

    for clip <- ~w(talk1 talk2 talk3),
        do: {Path.join(folder, clip <> ".mp4"), Path.join(folder, clip <> ".truth.json")}
  end

  defp tune_parameters(dataset, opts) do
    json? = opts[:json] == true
    unless json?, do: IO.puts("#{length(dataset.sessions)} sessions: #{dataset.file}")

    argv = [
      "experiment",
      "run",
      inspect(WhoSpeaksExperiment),
      dataset.file,
      "--jobs",
      "#{opts[:jobs] || 2}"
    ]

    argv = argv ++ ["--top", "8"] ++ if(json?, do: ["--json"], else: [])

    status = Situ.CLI.run(argv)
    if status == 0 and not json?, do: compare_with_default(dataset), else: status
  end

  # One set contains the defaults of `Situ.Infer.who_speaks/3`.
  defp compare_with_default(dataset) do
    {:ok, experiments} = RunRecord.experiments_folder(dataset)
    {:ok, {folder, run}} = RunRecord.fetch_run(experiments, nil)
    [best | _] = rows = Summary.list_rows(folder, run)
    default = Enum.find(rows, &(&1.parameters == WhoSpeaksExperiment.default_parameters()))

    IO.puts(
      "\nThe default parameters (set #{default.number}: #{default.label}) and the best set:"
    )

    status =
      Situ.CLI.run(["experiment", "compare", dataset.file, "#{default.number}", "#{best.number}"])

    IO.puts("""

    Look at the sets, and at the sessions where they differ (button "Experiments"):
      bin/situ studio #{dataset.file}
    """)

    status
  end
end
