defmodule Situ.Experiment.ReportPage do
  @moduledoc false
  # The report of a run as a page of HTML in one file: the table, and each metric as a drawing of values with their
  # intervals.
  alias Situ.Experiment.{ReportTable, Summary}

  @width 420
  @line 22

  @style """
  body { font: 15px/1.5 system-ui, sans-serif; margin: 2em auto; max-width: 85em; }
  tr { border-bottom: 1px solid #d8dde6; } body { padding: 0 1em; color: #1c2330; }
  table { border-collapse: collapse; } th, td { padding: .25em .8em; text-align: left; white-space: nowrap; }
  td:nth-child(n+4) { font-variant-numeric: tabular-nums; } tr.best { background: #e7f3ea; font-weight: 600; }
  svg text { font: 12px system-ui, sans-serif; fill: #1c2330; }
  pre { background: #f4f6f9; padding: 1em; overflow: auto; }
  """

  @doc "Renders the page."
  @spec render_page([Summary.row()], map()) :: String.t()
  def render_page(rows, run) do
    [header | body] = ReportTable.table_rows(rows, run)

    """
    <!doctype html>
    <html lang="en"><head><meta charset="utf-8"><title>#{escape_text(run["experiment"])} #{run["run"]}</title>
    <style>#{@style}</style></head><body>
    <h1>#{escape_text(run["experiment"])}</h1>
    #{Enum.map_join(ReportTable.describe_run(rows, run), "\n", &"<p>#{escape_text(&1)}</p>")}
    <table><tr>#{render_cells(header, "th")}</tr>
    #{Enum.map_join(body, "\n", &"<tr#{row_class(&1)}>#{render_cells(&1, "td")}</tr>")}
    </table>
    <p>Values in brackets are 95 % intervals: a bootstrap over sessions with the seed #{run["seed"]}.</p>
    #{Enum.map_join(run["metrics"], "\n", &draw_metric(&1, rows))}
    <h2>Environment</h2>
    <pre>#{run["environment"] |> Situ.JSON.encode_pretty() |> escape_text()}</pre>
    </body></html>
    """
  end

  defp row_class(["*" | _]), do: ~s( class="best")
  defp row_class(_), do: ""

  defp render_cells(cells, tag),
    do: Enum.map_join(cells, "", fn cell -> "<#{tag}>#{escape_text(cell)}</#{tag}>" end)

  # One line for each set: a dot at the value, and a bar over its interval.
  defp draw_metric(%{"name" => name, "main" => main}, rows) do
    known =
      for row <- rows,
          value = row.metrics[name].value,
          do: {row, value, row.metrics[name].interval || {value, value}}

    if known == [] do
      ""
    else
      low = known |> Enum.map(fn {_, v, {a, _}} -> min(v, a) end) |> Enum.min()
      high = known |> Enum.map(fn {_, v, {_, b}} -> max(v, b) end) |> Enum.max()
      height = @line * (length(known) + 1)

      """
      <h2>#{escape_text("#{name}.#{main}")}</h2>
      <svg width="#{@width + 360}" height="#{height}" role="img">
      #{known |> Enum.with_index() |> Enum.map_join("\n", &draw_row(&1, low, high))}
      <text x="0" y="#{height - 4}">#{ReportTable.format_value(low)}</text>
      <text x="#{@width}" y="#{height - 4}" text-anchor="end">#{ReportTable.format_value(high)}</text>
      </svg>
      """
    end
  end

  defp draw_row({{row, value, {a, b}}, index}, low, high) do
    y = @line * index + 11

    at = fn x ->
      if high > low, do: Float.round(@width * (x - low) / (high - low), 1), else: @width / 2
    end

    ~s(<line x1="#{at.(a)}" x2="#{at.(b)}" y1="#{y}" y2="#{y}" stroke="#7f8ea3" stroke-width="3"/>) <>
      ~s(<circle cx="#{at.(value)}" cy="#{y}" r="5" fill="#{if index == 0, do: "#1f8a4c", else: "#2f5d9b"}"/>) <>
      ~s(<text x="#{@width + 15}" y="#{y + 4}">#{row.number}: #{escape_text(row.label)}</text>)
  end

  defp escape_text(text) do
    text
    |> to_string()
    |> String.replace("&", "&amp;")
    |> String.replace("<", "&lt;")
    |> String.replace(">", "&gt;")
    |> String.replace("\"", "&quot;")
  end
end
