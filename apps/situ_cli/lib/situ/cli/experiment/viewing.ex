defmodule Situ.CLI.Experiment.Viewing do
  @moduledoc false
  # `situ experiment list`, `show` and `compare`: prints runs as tables, JSON, Markdown or HTML.
  alias Situ.CLI.Experiment.Loading
  alias Situ.CLI.Output
  alias Situ.Error
  alias Situ.Experiment.{MlflowExport, ReportPage, ReportTable, RunRecord, Summary}

  @doc "Lists the runs of all experiments over a dataset."
  @spec list_runs(map(), keyword()) :: 0
  def list_runs(%{dataset: path}, opts) do
    runs = path |> RunRecord.experiments_folder() |> Error.unwrap!() |> RunRecord.list_runs()

    cond do
      opts[:json] ->
        Output.print_json(for {_, run} <- runs, do: list_entry(run))

      runs == [] ->
        Output.puts("No experiment has run over this dataset: see `situ experiment run --help`.")

      true ->
        Output.print_table(
          [
            ~w(run experiment status method sets sessions computed failed)
            | Enum.map(runs, &list_row/1)
          ],
          4
        )
    end

    0
  end

  defp list_entry(run) do
    run
    |> Map.take(~w(run experiment started ended method computed failed sessions))
    |> Map.put("status", RunRecord.status(run))
    |> Map.put("sets", length(run["sets"]))
  end

  defp list_row({_, run}) do
    [run["run"], run["experiment"], RunRecord.status(run), run["method"]] ++
      Enum.map(
        [
          length(run["sets"]),
          length(run["sessions"]),
          run["computed"] || "",
          run["failed"] || ""
        ],
        &to_string/1
      )
  end

  @doc "Shows one run."
  @spec show_run(map(), keyword()) :: 0
  def show_run(%{dataset: path, run: name}, opts) do
    {folder, run} = Loading.fetch_run!(path, name)
    print_run(folder, run, opts)
    0
  end

  @doc "Prints a run, and writes the reports that the options name."
  @spec print_run(Path.t(), map(), keyword()) :: :ok
  def print_run(folder, run, opts) do
    run = Map.put(run, "status", RunRecord.status(run))
    rows = Summary.list_rows(folder, run)
    if opts[:html], do: write_report(opts[:html], ReportPage.render_page(rows, run))
    if opts[:mlflow], do: Error.unwrap!(MlflowExport.write_folder(opts[:mlflow], rows, run))

    cond do
      opts[:json] -> Output.print_json(run_json(rows, run))
      opts[:markdown] -> Output.puts(String.trim_trailing(ReportTable.render_report(rows, run)))
      true -> print_text(rows, run, opts)
    end
  end

  defp write_report(path, page) do
    case File.write(path, page) do
      :ok ->
        Output.warn("report: #{path}")

      {:error, reason} ->
        raise Error.new(:not_saved, "cannot write #{path}",
                why: to_string(:file.format_error(reason))
              )
    end
  end

  defp run_json(rows, run) do
    sets =
      for row <- rows do
        metrics =
          Map.new(row.metrics, fn {name, m} ->
            interval = m.interval && Tuple.to_list(m.interval)

            {name,
             %{
               value: m.value,
               interval: interval,
               values: m.values,
               sessions: Map.new(m.sessions)
             }}
          end)

        %{
          number: row.number,
          parameters: row.parameters,
          sessions: row.sessions,
          metrics: metrics,
          failed: Map.new(row.failures)
        }
      end

    run |> Map.drop(["trials", "inputs"]) |> Map.put("sets", sets)
  end

  defp print_text(rows, run, opts) do
    [first | rest] = ReportTable.describe_run(rows, run)
    Output.puts(first)
    top = max(opts[:top] || length(rows), 1)
    rows |> Enum.take(top) |> ReportTable.table_rows(run) |> Output.print_table(3)
    hidden = length(rows) - top

    if hidden > 0, do: Output.puts("  and #{hidden} more: --top #{length(rows)}")
    for line <- rest, do: Output.puts(line)
    if opts[:sessions], do: print_sessions(rows, run, opts[:set])
    :ok
  end

  defp print_sessions(rows, run, number) do
    row = if number, do: Enum.find(rows, &(&1.number == number)), else: hd(rows)
    row = row || raise Error.new(:no_set, "run #{run["run"]} has no set #{number}")
    names = for m <- run["metrics"], do: m["name"]
    by_session = for name <- names, do: {name, Map.new(row.metrics[name].sessions)}

    body =
      for session <- run["sessions"] do
        [session | for({_, values} <- by_session, do: ReportTable.format_value(values[session]))]
      end

    Output.puts("Set #{row.number} (#{row.label}):")
    header = ["session" | for(m <- run["metrics"], do: "#{m["name"]}.#{m["main"]}")]
    Output.print_table([header | body], 1)
  end

  @doc "Compares two sets of a run."
  @spec compare_sets(map(), keyword()) :: 0
  def compare_sets(%{dataset: path, first: first, second: second}, opts) do
    {folder, run} = Loading.fetch_run!(path, opts[:run])
    numbers = {Loading.parse_set!(first), Loading.parse_set!(second)}
    comparison = Error.unwrap!(Summary.compare_sets(folder, run, numbers))
    table = ReportTable.comparison_rows(comparison, numbers)

    cond do
      opts[:json] -> Output.print_json(Enum.map(comparison, &comparison_json/1))
      opts[:markdown] -> Output.puts(ReportTable.render_markdown(table))
      true -> print_comparison(table, comparison)
    end

    0
  end

  defp print_comparison(table, comparison) do
    Output.print_table(table, 1)

    for c <- comparison,
        {word, sessions} <- [{"worse", c.worse}, {"better", c.better}],
        sessions != [] do
      named =
        sessions
        |> Enum.take(3)
        |> Enum.map_join(", ", fn {session, change} ->
          "#{session} (#{ReportTable.format_value(change)})"
        end)

      Output.puts("#{c.name} is #{word} in: #{named}")
    end
  end

  defp comparison_json(comparison) do
    comparison
    |> Map.update!(:interval, &(&1 && Tuple.to_list(&1)))
    |> Map.update!(:better, &Map.new/1)
    |> Map.update!(:worse, &Map.new/1)
  end
end
