defmodule Situ.Studio.Web.Experiment.SetDetails do
  @moduledoc false
  # Renders the selected set of a run: its parameters, its sessions from the worst to the best, the button that makes it
  # the baseline, and comments.
  use Situ.Live.Component
  import Situ.Studio.Web.TimeLabels
  alias Situ.Experiment.ReportTable
  alias Situ.Studio.Experiments

  attr(:row, :map, required: true)
  attr(:state, :any, required: true)
  attr(:metric, :map, required: true)
  attr(:read_only, :boolean, required: true)

  @doc false
  def set_details(assigns) do
    %{row: row, state: state, metric: metric} = assigns
    baseline = state.baseline

    assigns =
      assign(assigns,
        sessions: Experiments.rank_sessions(state, row, metric),
        baseline?: baseline != nil and baseline.promoted? and baseline.number == row.number
      )

    ~H"""
    <section class="set-details">
      <h2>Set {@row.number}</h2>
      <p class="label">{@row.label}</p>
      <p class="choices">
        <span :if={@baseline?} class="tag">baseline</span>
        <button :if={not @baseline? and not @read_only} class="btn primary" type="button" phx-click="promote"
            phx-value-set={@row.number}>Make it the baseline</button></p>
      <p :if={@row.failures != []} class="trouble">{failure_text(@row)}</p>
      <h3>Sessions, the worst first</h3>
      <table id="worst" class="set-table">
        <thead><tr><th scope="col">Session</th><th scope="col">{@metric["name"]}.{@metric["main"]}</th>
          <th scope="col">Baseline</th><th scope="col">Change</th></tr></thead>
        <tbody>
          <tr :for={{session, value, before} <- @sessions} :key={session}>
            <th scope="row"><button type="button" class="linkish" phx-click="open" phx-value-set={@row.number}
                phx-value-session={session} phx-value-metric={@metric["name"]}
                title={"Open #{session} where this set and the baseline differ"}>{session}</button></th>
            <td class="figure">{ReportTable.format_value(value)}</td>
            <td class="figure">{ReportTable.format_value(before)}</td>
            <td class={["figure", change_class(value, before, @metric)]}>{format_change(value, before)}</td>
          </tr>
        </tbody>
      </table>
    </section>
    """
  end

  attr(:row, :map, required: true)
  attr(:state, :any, required: true)
  attr(:read_only, :boolean, required: true)

  @doc "Renders the comments on the selected set, and the form for another one."
  @spec comment_list(map()) :: Situ.Live.Rendered.t()
  def comment_list(assigns) do
    comments = Enum.filter(assigns.state.comments, &(&1.set == assigns.row.number))
    assigns = assign(assigns, comments: comments)

    ~H"""
    <section class="set-comments">
      <h3>Comments</h3>
      <ol class="comments">
        <li :for={c <- @comments}><b>{c.by}</b> <.comment_time at={c.at} /><p>{c.text}</p></li>
      </ol>
      <p :if={@comments == []} class="hint">Nobody has written a comment on this set.</p>
      <form :if={not @read_only} id={"comment-#{@row.number}"} class="comment" phx-submit="comment" phx-hook="Comment">
        <input type="hidden" name="set" value={@row.number}>
        <label>Name <input name="by" maxlength="60" autocomplete="name" placeholder="you"></label>
        <label>Comment <textarea name="text" rows="2" maxlength="2000" required></textarea></label>
        <button class="btn" type="submit">Comment</button>
      </form>
    </section>
    """
  end

  attr(:at, :string, required: true)

  defp comment_time(assigns) do
    assigns = assign(assigns, ns: parse_time(assigns.at))

    ~H"""
    <.time_label :if={@ns} ns={@ns} />
    """
  end

  defp parse_time(text) do
    case Situ.Time.parse(text) do
      {:ok, ns} -> ns
      _ -> nil
    end
  end

  defp failure_text(row) do
    {session, error} = hd(row.failures)
    "#{length(row.failures)} failed, such as #{session}: #{error}"
  end

  defp format_change(value, before) when is_number(value) and is_number(before) do
    change = value - before
    if(change > 0, do: "+", else: "") <> ReportTable.format_value(change)
  end

  defp format_change(_value, _before), do: ""

  defp change_class(value, before, metric) when is_number(value) and is_number(before) do
    sign = if metric["better"][metric["main"]] == "lower", do: -1, else: 1

    cond do
      value == before -> nil
      sign * (value - before) > 0 -> "better"
      true -> "worse"
    end
  end

  defp change_class(_value, _before, _metric), do: nil
end
