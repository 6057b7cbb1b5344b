defmodule Situ.Studio.Web.Experiment.SetTable do
  @moduledoc false
  # Renders the sets of a run as a table: parameters, and each metric with its interval.
  use Situ.Live.Component
  alias Situ.Experiment.ReportTable
  alias Situ.Studio.Experiments.Axis

  # More rows are found by sorting and filtering.
  @most 200

  attr(:rows, :list, required: true)
  attr(:total, :integer, required: true)
  attr(:run, :map, required: true)
  attr(:sort, :string, required: true)
  attr(:selected, :any, required: true)
  attr(:state, :any, required: true)
  attr(:opening, :boolean, required: true)

  @doc false
  def set_table(assigns) do
    comments = Enum.frequencies_by(assigns.state.comments, & &1.set)
    baseline = assigns.state.baseline

    assigns =
      assign(assigns,
        shown: Enum.take(assigns.rows, @most),
        names: Axis.parameter_names(assigns.run),
        comments: comments,
        baseline: baseline && baseline.number,
        promoted: baseline != nil and baseline.promoted?,
        best: assigns.state.rows |> List.first() |> then(&(&1 && &1.sessions > 0 && &1.number))
      )

    ~H"""
    <div class="table-scroll">
      <table id="sets" class="set-table" aria-busy={to_string(@opening)}>
        <caption>{table_caption(length(@rows), @total)}</caption>
        <thead>
          <tr>
            <.column_header id="set" label="Set" sort={@sort} hint="" />
            <.column_header :for={name <- @names} id={"p." <> name} label={name} sort={@sort} hint="" />
            <.column_header id="sessions" label="Sessions" sort={@sort} hint="" />
            <.column_header :for={m <- @run["metrics"]} id={"m." <> m["name"]} label={m["name"] <> "." <> m["main"]}
                sort={@sort} hint={" (#{m["better"][m["main"]]} is better)"} />
          </tr>
        </thead>
        <tbody>
          <tr :for={row <- @shown} :key={row.number} id={"set-#{row.number}"}
              class={[row.number == @selected.number && "selected", row.number == @baseline && "baseline"]}>
            <th scope="row"><button type="button" class="linkish" phx-click="select" phx-value-set={row.number}
                aria-pressed={to_string(row.number == @selected.number)}
                title={"Select set #{row.number}"}>{row.number}</button>
              <span :if={row.number == @baseline and @promoted} class="tag">baseline</span>
              <span :if={row.number == @best} class="tag">best</span>
              <span :if={@comments[row.number]} class="hint" title="Comments">✎ {@comments[row.number]}</span></th>
            <td :for={name <- @names}>{row.texts[name]}</td>
            <td>{row.sessions}<span :if={row.failures != []} class="trouble"
              title={failure_text(row)}> {length(row.failures)} failed</span></td>
            <td :for={m <- @run["metrics"]} class="figure"><button type="button" class="cell" phx-click="open"
                phx-value-set={row.number} phx-value-metric={m["name"]} title={open_title(row, @baseline)}
                disabled={row.sessions == 0}>{ReportTable.format_value(row.metrics[m["name"]].value)}
              <small>{format_interval(row.metrics[m["name"]].interval)}</small></button></td>
          </tr>
        </tbody>
      </table>
      <p :if={length(@rows) > length(@shown)} class="hint">{length(@rows) - length(@shown)} more: sort or filter
        them</p>
    </div>
    """
  end

  attr(:id, :string, required: true)
  attr(:label, :string, required: true)
  attr(:sort, :string, required: true)
  attr(:hint, :string, required: true)

  defp column_header(assigns) do
    ~H"""
    <th scope="col" aria-sort={sort_state(@sort, @id)}><button type="button" class="linkish" phx-click="sort"
        phx-value-column={@id} title={"Sort by " <> @label <> @hint}>{@label}
      {sort_mark(@sort, @id)}</button></th>
    """
  end

  defp sort_state(column, column), do: "ascending"
  defp sort_state("-" <> column, column), do: "descending"
  defp sort_state(_, _), do: "none"

  defp sort_mark(column, column), do: "▴"
  defp sort_mark("-" <> column, column), do: "▾"
  defp sort_mark(_, _), do: ""

  defp table_caption(total, total),
    do: "#{total} sets. Click a value to see where the set and the baseline differ."

  defp table_caption(n, total), do: "#{n} of #{total} sets are within the marked ranges."

  defp open_title(%{number: same}, same), do: "Open the session in which this set is worst"
  defp open_title(_row, nil), do: "Open the worst session"

  defp open_title(row, baseline),
    do: "Open the session in which set #{row.number} and set #{baseline} differ most"

  defp failure_text(row) do
    Enum.map_join(Enum.take(row.failures, 5), "\n", fn {session, error} ->
      "#{session}: #{error}"
    end)
  end

  defp format_interval(nil), do: ""

  defp format_interval({low, high}),
    do: "[#{ReportTable.format_value(low)}, #{ReportTable.format_value(high)}]"
end
