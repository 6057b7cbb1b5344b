defmodule Situ.Experiment.ReportTable do
  @moduledoc false
  # The report of a run as rows of text, for the command line and for Markdown.
  alias Situ.Experiment.Summary

  @doc """
  Formats a value with three decimals; small ones have an exponent.

      iex> alias Situ.Experiment.ReportTable
      iex> {ReportTable.format_value(0.91237), ReportTable.format_value(12), ReportTable.format_value(nil)}
      {"0.912", "12", "-"}
  """
  @spec format_value(number() | nil) :: String.t()
  def format_value(nil), do: "-"
  def format_value(n) when is_integer(n), do: to_string(n)
  def format_value(x) when abs(x) >= 1000, do: :erlang.float_to_binary(x, decimals: 0)
  def format_value(x) when x == 0, do: "0"
  def format_value(x) when abs(x) < 0.001, do: :erlang.float_to_binary(x, scientific: 1)
  def format_value(x), do: :erlang.float_to_binary(x * 1.0, decimals: 3)

  @doc "Formats a value with its 95 % interval: `0.912 [0.851, 0.954]`."
  @spec format_estimate(number() | nil, {number(), number()} | nil) :: String.t()
  def format_estimate(value, nil), do: format_value(value)

  def format_estimate(value, {low, high}),
    do: "#{format_value(value)} [#{format_value(low)}, #{format_value(high)}]"

  @doc "Returns the table of a run: a header and a row for each set. The best set is marked with `*`."
  @spec table_rows([Summary.row()], map()) :: [[String.t()]]
  def table_rows(rows, run) do
    metrics = run["metrics"]

    header =
      ["", "set", "parameters", "sessions"] ++ Enum.map(metrics, &"#{&1["name"]}.#{&1["main"]}")

    body =
      for {row, index} <- Enum.with_index(rows) do
        mark = if index == 0 and row.sessions > 0, do: "*", else: ""

        cells =
          for %{"name" => name} <- metrics do
            %{value: value, interval: interval} = row.metrics[name]
            format_estimate(value, interval)
          end

        [mark, "#{row.number}", row.label, count_sessions(row)] ++ cells
      end

    [header | body]
  end

  defp count_sessions(%{failures: []} = row), do: "#{row.sessions}"
  defp count_sessions(row), do: "#{row.sessions} (#{length(row.failures)} failed)"

  @doc "Returns sentences on the run: its size, the best set, its worst sessions, and failures."
  @spec describe_run([Summary.row()], map()) :: [String.t()]
  def describe_run([best | _] = rows, run) do
    [
      "#{run["experiment"]}, run #{run["run"]} (#{run["status"]}): #{count(length(rows), "set")}, " <>
        "#{count(length(run["sessions"]), "session")}, method #{run["method"]}"
    ] ++
      describe_best(best, run["metrics"]) ++
      describe_machines(rows, run) ++ describe_failures(rows)
  end

  def describe_run([], run), do: ["#{run["experiment"]}, run #{run["run"]}: no sets"]

  defp describe_best(%{sessions: 0}, _metrics), do: []
  defp describe_best(_best, []), do: []

  defp describe_best(best, [%{"name" => name} = metric | _]) do
    worst =
      best.metrics[name]
      |> Summary.worst_sessions(metric)
      |> Enum.take(3)
      |> Enum.map_join(", ", fn {session, value} -> "#{session} (#{format_value(value)})" end)

    [
      "Best set: #{best.number} (#{best.label})",
      "Its worst sessions by #{name}.#{metric["main"]}: #{worst}"
    ]
  end

  @doc "Returns a sentence that names the machines of computing times and latencies, if the run has such metrics."
  @spec describe_machines([Summary.row()], map()) :: [String.t()]
  def describe_machines(rows, run) do
    names =
      for %{"kind" => kind, "name" => name} <- run["metrics"],
          kind in ~w(cost latency),
          do: name

    machines = for row <- rows, machine <- Map.get(row, :machines, []), uniq: true, do: machine

    case {names, Enum.sort(machines)} do
      {[], _} -> []
      {_, []} -> []
      {_, [machine]} -> ["Machine of #{Enum.join(names, ", ")}: #{machine}"]
      {_, several} -> ["Machines of #{Enum.join(names, ", ")}: #{Enum.join(several, ", ")}"]
    end
  end

  defp describe_failures(rows) do
    failures = for row <- rows, {session, error} <- row.failures, do: {row.number, session, error}

    for {number, session, error} <- Enum.take(failures, 3),
        do: "Failed: set #{number}, session #{session}: #{error}"
  end

  defp count(1, noun), do: "1 #{noun}"
  defp count(n, noun), do: "#{n} #{noun}s"

  @doc "Returns the rows of a comparison: a header and a row for each metric."
  @spec comparison_rows([map()], {pos_integer(), pos_integer()}) :: [[String.t()]]
  def comparison_rows(comparison, {first, second}) do
    header = [
      "metric",
      "sessions",
      "set #{first}",
      "set #{second}",
      "difference",
      "p",
      "better",
      "worse"
    ]

    [
      header
      | for c <- comparison do
          [
            "#{c.name}.#{c.main}",
            "#{c.sessions}",
            format_value(c.first),
            format_value(c.second),
            format_estimate(c.difference, c.interval),
            format_value(c.p),
            "#{length(c.better)}",
            "#{length(c.worse)}"
          ]
        end
    ]
  end

  @doc "Renders rows as a Markdown table."
  @spec render_markdown([[String.t()]]) :: String.t()
  def render_markdown([header | rows]) do
    lines = [header, Enum.map(header, fn _ -> "---" end) | rows]

    Enum.map_join(lines, "\n", fn cells ->
      "| #{Enum.map_join(cells, " | ", &escape_cell/1)} |"
    end)
  end

  @doc "Renders the report on a run in Markdown."
  @spec render_report([Summary.row()], map()) :: String.t()
  def render_report(rows, run) do
    lines = Enum.join(describe_run(rows, run), "\n\n")

    """
    # #{run["experiment"]}

    #{lines}

    #{rows |> table_rows(run) |> render_markdown()}

    Values in brackets are 95 % intervals: a bootstrap over sessions, seed #{run["seed"]}.
    """
  end

  defp escape_cell(text), do: text |> String.replace("|", "\\|") |> String.replace(~r/\s+/, " ")
end
