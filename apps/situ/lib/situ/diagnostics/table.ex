defmodule Situ.Diagnostics.Table do
  @moduledoc false
  # Formats a snapshot as text for people.
  alias Situ.Diagnostics.{Snapshot, Window}

  @spec format(Snapshot.t()) :: String.t()
  def format(%Snapshot{} = snapshot) do
    paths = Map.new(snapshot.nodes, &{&1.id, &1.path})
    head = "#{snapshot.pipeline}  #{snapshot.state}  #{format_percent(snapshot.progress)}"

    rows =
      for edge <- snapshot.edges, edge.kind == :process do
        [
          "#{paths[edge.from]} -> #{paths[edge.to]}",
          edge.policy,
          "#{edge.processed}",
          "#{round(Window.rate(edge.window.processed, edge.window))}",
          "#{edge.queue}#{if edge.throttled, do: "!", else: ""}",
          "#{edge.dropped}",
          format_duration(edge.window.latency || edge.latency_mean),
          format_duration(edge.latency_p99),
          format_duration(edge.window.handling || edge.handling_mean)
        ]
      end

    processes =
      for process <- snapshot.processes do
        [
          Enum.join(process.nodes, " | "),
          process.status,
          "#{process.mailbox}",
          "#{div(process.memory, 1024)} KiB",
          process.busy_in
        ]
      end

    Enum.join(
      [
        head,
        format_table([~w(edge policy done done/s queue dropped mean p99 handling) | rows]),
        format_table([~w(process status mailbox memory in) | processes])
      ],
      "\n\n"
    )
  end

  defp format_duration(ns), do: Situ.Time.format_duration(ns)
  defp format_percent(progress), do: "#{round(progress * 100)} %"

  defp format_table(rows) do
    widths =
      rows |> Enum.zip_with(fn column -> column |> Enum.map(&String.length/1) |> Enum.max() end)

    Enum.map_join(rows, "\n", fn row ->
      row
      |> Enum.zip(widths)
      |> Enum.map_join("  ", fn {cell, w} -> String.pad_trailing(cell, w) end)
    end)
  end
end
