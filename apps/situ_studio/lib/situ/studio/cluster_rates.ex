defmodule Situ.Studio.ClusterRates do
  @moduledoc false
  # Rates between two snapshots of a cluster: messages per second of each stream and bytes per
  # second of each link. Pure.
  alias Situ.Cluster.Overview

  @doc """
  Returns messages per second by deployment, part and stream, for streams that are in both
  snapshots.

      iex> alias Situ.Studio.ClusterRates
      iex> part = %{deployment: "Hall", part: "Lips", streams: [%{name: "Mouth", messages: 100, readers: []}]}
      iex> before = %Situ.Cluster.Overview{time: 0, parts: [part]}
      iex> later = put_in(part.streams, [%{name: "Mouth", messages: 160, readers: []}])
      iex> now = %Situ.Cluster.Overview{time: 2_000_000_000, parts: [later]}
      iex> ClusterRates.stream_rates(before, now)
      %{{"Hall", "Lips", "Mouth"} => 30.0}
      iex> ClusterRates.stream_rates(nil, now)
      %{}
  """
  @spec stream_rates(Overview.t() | nil, Overview.t()) :: %{
          {String.t(), String.t(), String.t()} => float()
        }
  def stream_rates(before, now), do: compute_rates(before, now, &message_counts/1)

  @doc "Returns bytes per second by node and address."
  @spec link_rates(Overview.t() | nil, Overview.t()) :: %{{node(), String.t()} => float()}
  def link_rates(before, now),
    do:
      compute_rates(
        before,
        now,
        &for(l <- &1.links, into: %{}, do: {{l.node, l.address}, l.bytes})
      )

  defp message_counts(overview) do
    for p <- overview.parts,
        s <- p.streams,
        into: %{},
        do: {{p.deployment, p.part, s.name}, s.messages}
  end

  # A count that decreased was reset by a restart of its part, so it has no rate.
  defp compute_rates(%Overview{time: from} = before, %Overview{time: to} = now, counts)
       when to > from do
    earlier = counts.(before)

    for {key, n} <- counts.(now),
        m = earlier[key],
        n >= m,
        into: %{},
        do: {key, (n - m) * 1.0e9 / (to - from)}
  end

  defp compute_rates(_none, _now, _counts), do: %{}

  @doc """
  Returns whether a reader is catching up: it lags by more than one second of messages and by more than 100 messages.

      iex> Situ.Studio.ClusterRates.catching_up?(5_000, 30.0)
      true
      iex> Situ.Studio.ClusterRates.catching_up?(20, 30.0)
      false
  """
  @spec catching_up?(non_neg_integer(), float()) :: boolean()
  def catching_up?(behind, rate), do: behind > max(rate, 100)
end
