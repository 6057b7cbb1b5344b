defmodule Situ.CLI.Store.Statistics do
  @moduledoc false
  # Measures the timing of a stream's messages, in one pass over the envelopes and in constant memory. Percentiles come
  # from buckets that are 1 % wide, so they are accurate to half a percent.
  alias Situ.Store

  @width :math.log(1.01)

  defstruct count: 0,
            last: nil,
            periods: %{},
            latencies: %{},
            sum: 0.0,
            squares: 0.0,
            shortest: nil,
            longest: nil,
            gaps: 0,
            gap_time: 0,
            back: 0

  @doc "Measures periods (mean, deviation, percentiles), gaps longer than `gap` ns, and latencies, all in ns."
  @spec of(Store.Handle.t(), Store.StreamInfo.t(), pos_integer() | nil) :: map()
  def of(store, info, gap) do
    gap = gap || default_gap(info)
    messages = Store.messages(store, info, envelopes: true, skip_damage: true)
    messages |> Enum.reduce(%__MODULE__{}, &add(&1, &2, gap)) |> summary(info, gap)
  end

  # Returns ten times the average period, and at least 100 ms.
  defp default_gap(info) do
    case Store.StreamInfo.rate(info) do
      nil -> 100_000_000
      rate -> max(round(10.0e9 / rate), 100_000_000)
    end
  end

  defp add(message, stats, gap) do
    latency = message.creation_time - message.originating_time
    stats = %{stats | count: stats.count + 1, latencies: put(stats.latencies, latency)}
    stats = if latency < 0, do: %{stats | back: stats.back + 1}, else: stats
    period(stats, message.originating_time, gap)
  end

  defp period(%{last: nil} = stats, time, _gap), do: %{stats | last: time}

  defp period(stats, time, gap) do
    period = time - stats.last

    {gaps, gap_time} =
      if period > gap,
        do: {stats.gaps + 1, stats.gap_time + period},
        else: {stats.gaps, stats.gap_time}

    %{
      stats
      | last: time,
        periods: put(stats.periods, period),
        sum: stats.sum + period,
        squares: stats.squares + period * period / 1,
        shortest: min(stats.shortest || period, period),
        longest: max(stats.longest || period, period),
        gaps: gaps,
        gap_time: gap_time
    }
  end

  # Zero has a separate bucket, and negative values have mirrored buckets.
  defp put(buckets, value), do: Map.update(buckets, bucket(value), 1, &(&1 + 1))
  defp bucket(0), do: {0, 0}
  defp bucket(value) when value > 0, do: {1, floor(:math.log(value) / @width)}
  defp bucket(value), do: {-1, -floor(:math.log(-value) / @width)}

  defp middle({0, 0}), do: 0
  defp middle({1, n}), do: round(:math.exp((n + 0.5) * @width))
  defp middle({-1, n}), do: -round(:math.exp((-n + 0.5) * @width))

  defp summary(stats, info, gap) do
    periods = stats.count - 1

    %{
      stream: info.name,
      messages: stats.count,
      rate: Store.StreamInfo.rate(info),
      period_mean: if(periods > 0, do: stats.sum / periods),
      period_deviation: if(periods > 1, do: deviation(stats, periods)),
      period_least: stats.shortest,
      period_most: stats.longest,
      period_p50: percentile(stats.periods, periods, 0.5),
      period_p99: percentile(stats.periods, periods, 0.99),
      gap_limit: gap,
      gaps: stats.gaps,
      gap_time: stats.gap_time,
      latency_mean: Store.StreamInfo.average_latency(info),
      latency_p50: percentile(stats.latencies, stats.count, 0.5),
      latency_p95: percentile(stats.latencies, stats.count, 0.95),
      latency_p99: percentile(stats.latencies, stats.count, 0.99),
      made_before_they_happened: stats.back
    }
  end

  defp deviation(stats, n) do
    mean = stats.sum / n
    :math.sqrt(max((stats.squares - n * mean * mean) / (n - 1), 0.0))
  end

  defp percentile(_buckets, n, _share) when n < 1, do: nil

  defp percentile(buckets, n, share) do
    wanted = max(ceil(share * n), 1)

    buckets
    |> Enum.sort()
    |> Enum.reduce_while(0, fn {bucket, count}, seen ->
      if seen + count >= wanted, do: {:halt, {:at, bucket}}, else: {:cont, seen + count}
    end)
    |> then(fn {:at, bucket} -> middle(bucket) end)
  end
end
