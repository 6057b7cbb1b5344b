defmodule Situ.Link.LinkMetrics do
  @moduledoc false
  # The metrics of the links that pipelines of this node have open, for `Situ.Metrics`.
  @behaviour Situ.Metrics

  alias Situ.{Link, Time}

  @impl true
  def collect_metrics, do: build_metrics(Link.links())

  @doc "Builds the metrics from the results of `Situ.Link.links/0`. Several links to the same address are joined."
  @spec build_metrics([map()]) :: [Situ.Metrics.metric()]
  def build_metrics(links) do
    streams =
      for link <- links,
          {name, stats} <- link.streams,
          do: {[address: link.address, stream: name], stats}

    links = for link <- links, do: {[address: link.address], link}
    link_metrics(links) ++ stream_metrics(streams)
  end

  defp link_metrics(links) do
    [
      gauge(
        "connected",
        "Whether all links to an address are connected (1).",
        collect(links, &if(&1.connected?, do: 1, else: 0), &Enum.min/1)
      ),
      gauge(
        "round_trip_seconds",
        "Shortest recent round trip to the other machine.",
        collect(links, &to_seconds(&1.round_trip), &Enum.min/1)
      ),
      counter(
        "connections_total",
        "Connections made.",
        collect(links, & &1.connections, &Enum.sum/1)
      ),
      counter(
        "received_bytes_total",
        "Bytes received.",
        collect(links, & &1.bytes, &Enum.sum/1)
      )
    ]
  end

  defp stream_metrics(streams) do
    [
      counter(
        "received_messages_total",
        "Messages received.",
        collect(streams, & &1.received, &Enum.sum/1)
      ),
      counter(
        "lost_messages_total",
        "Messages that the sender has left out.",
        collect(streams, & &1.lost, &Enum.sum/1)
      ),
      gauge(
        "waiting_bytes",
        "Bytes received that wait for the pipeline.",
        collect(streams, & &1.under_way, &Enum.sum/1)
      ),
      gauge(
        "lag_seconds",
        "Age of the last message when the pipeline took it, by the sender's clock.",
        collect(streams, &to_seconds(&1.lag), &Enum.max/1)
      )
    ]
  end

  defp collect(entries, read, join) do
    entries
    |> Enum.group_by(&elem(&1, 0), &read.(elem(&1, 1)))
    |> Enum.sort()
    |> Enum.flat_map(fn {labels, values} ->
      case Enum.reject(values, &is_nil/1) do
        [] -> []
        values -> [{labels, join.(values)}]
      end
    end)
  end

  defp to_seconds(nil), do: nil
  defp to_seconds(ns), do: Time.to_seconds(ns)

  defp gauge(name, help, samples),
    do: %{name: "situ_link_" <> name, type: :gauge, help: help, samples: samples}

  defp counter(name, help, samples),
    do: %{name: "situ_link_" <> name, type: :counter, help: help, samples: samples}
end
