defmodule Situ.Studio.Web.TimeLabels do
  @moduledoc false
  # Renders a time in a list or among properties. The server renders it in UTC; the page's script then rewrites it as
  # the user prefers.
  use Situ.Live.Component
  alias Situ.Studio.StreamTotals

  attr(:ns, :any, required: true)
  attr(:part, :string, default: "all")

  @doc false
  def time_label(%{ns: nil} = assigns), do: ~H""

  def time_label(assigns) do
    ~H"""
    <time data-ns={@ns} data-part={@part}>{format_time(@ns, @part)}</time>
    """
  end

  attr(:choice, :atom, required: true)
  attr(:figures, :any, required: true)
  attr(:of, :string, default: "one")

  @doc "Renders the statistic next to a name, in parentheses if it belongs to a group."
  def figure_label(assigns) do
    part = %{began: "both", date: "date", time: "time"}[assigns.choice]
    text = if part, do: "", else: StreamTotals.format_figure(assigns.choice, assigns.figures)
    text = if assigns.of == "group" and text != "", do: "(#{text})", else: text
    assigns = assign(assigns, part: part, text: text)

    ~H"""
    <span class="info"><.time_label :if={@part} ns={@figures.from} part={@part} />{@text}</span>
    """
  end

  # Times before 1971 are not calendar dates (`isCalendarDate` of `assets/js/time/text.js` has the same rule).
  @dated 31_622_400_000_000_000

  defp format_time(ns, "date") when abs(ns) <= @dated, do: "no date"

  defp format_time(ns, _part) when abs(ns) <= @dated,
    do: "#{Situ.Time.format_duration(ns)} from 0"

  defp format_time(ns, part) do
    [date, clock] = ns |> Situ.Time.to_iso8601() |> String.split("T")

    case part do
      "date" -> date
      "time" -> String.slice(clock, 0, 8) <> " UTC"
      "both" -> "#{date} #{String.slice(clock, 0, 8)} UTC"
      "all" -> "#{date} #{String.slice(clock, 0, 12)} UTC"
    end
  end
end
