defmodule Situ.Studio.Web.AlertBox do
  @moduledoc false
  # Lists the alerts of a running pipeline on its page: active alerts with their start time, and cleared ones with both
  # times.
  use Situ.Live.Component

  attr(:alerts, :list, required: true)

  @doc false
  def alert_list(assigns) do
    ~H"""
    <section :if={@alerts != []} class={["alerts", Enum.any?(@alerts, &(&1.cleared == nil)) && "raised"]} id="alerts"
        role="status" aria-label="Alerts">
      <span :for={a <- Enum.take(@alerts, 6)} :key={a.rule} class={if a.cleared, do: "cleared", else: "raised"}
          title={a.text}><b>{a.rule}</b> {period_text(a)}</span>
      <span :if={length(@alerts) > 6} class="hint">and {length(@alerts) - 6} more</span>
    </section>
    """
  end

  defp period_text(%{cleared: nil, raised: raised}), do: "since #{format_clock(raised)} UTC"

  defp period_text(%{raised: a, cleared: b}),
    do: "from #{format_clock(a)} to #{format_clock(b)} UTC"

  defp format_clock(ns), do: ns |> Situ.Time.to_iso8601() |> String.slice(11, 8)
end
