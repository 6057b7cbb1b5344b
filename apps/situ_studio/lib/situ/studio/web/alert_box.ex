defmodule Situ.Studio.Web.AlertBox do
  @moduledoc false
  # Lists the alerts of a running pipeline on its page: active alerts with their start time, and cleared ones with both
  # times.
  use Situ.Live.Component

  attr(:alerts, :list, required: true)

  @doc false
  def box(assigns) do
    ~H"""
    <section :if={@alerts != []} class={["alerts", Enum.any?(@alerts, &(&1.cleared == nil)) && "raised"]} id="alerts"
        role="status" aria-label="Alerts">
      <span :for={a <- Enum.take(@alerts, 6)} :key={a.rule} class={if a.cleared, do: "cleared", else: "raised"}
          title={a.text}><b>{a.rule}</b> {since(a)}</span>
      <span :if={length(@alerts) > 6} class="hint">and {length(@alerts) - 6} more</span>
    </section>
    """
  end

  defp since(%{cleared: nil, raised: raised}), do: "since #{clock(raised)} UTC"
  defp since(%{raised: a, cleared: b}), do: "from #{clock(a)} to #{clock(b)} UTC"

  defp clock(ns), do: ns |> Situ.Time.to_iso8601() |> String.slice(11, 8)
end
