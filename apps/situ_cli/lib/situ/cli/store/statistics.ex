defmodule Situ.CLI.Store.Statistics do
  @moduledoc false
  # Measures the timing of a stream's messages, in one pass over the envelopes and in constant memory. Percentiles come
  # from buckets that are 1 % wide, so they are accurate to half a percent.
  alias Situ.CLI.Store.StreamDetails
  alias Situ.Store

  @width :math.log(1.01)
  @no_latency %{latency_mean: nil, latency_p50: nil, latency_p95: nil, latency_p99: nil}

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
  @spec measure_stream(Store.t(), Store.StreamInfo.t(), pos_integer() | nil) :: map()
  def measure_stream(store, info, gap) do
    gap = gap || default_gap(info)
    messages = Store.messages(store, info, envelopes: true, skip_damage: true)
    stats = Enum.reduce(messages, %__MODULE__{}, &add_message(&1, &2, gap))

    known? = StreamDetails.latency_known?(store, info) or Map.keys(stats.latencies) != [{0, 0}]
    summary = summarize(stats, info, gap)
    if known?, do: summary, else: Map.merge(summary, @no_latency)
  end

  # Returns ten times the average period, and at least 100 ms.
  defp default_gap(info) do
    case Store.StreamInfo.message_rate(info) do
      nil -> 100_000_000
      rate -> max(round(10.0e9 / rate), 100_000_000)
    end
  end

  defp add_message(message, stats, gap) do
    latency = message.creation_time - message.originating_time
    stats = %{stats | count: stats.count + 1, latencies: count_value(stats.latencies, latency)}
    stats = if latency < 0, do: %{stats | back: stats.back + 1}, else: stats
    add_period(stats, message.originating_time, gap)
  end

  defp add_period(%{last: nil} = stats, time, _gap), do: %{stats | last: time}

  defp add_period(stats, time, gap) do
    period = time - stats.last

    {gaps, gap_time} =
      if period > gap,
        do: {stats.gaps + 1, stats.gap_time + period},
        else: {stats.gaps, stats.gap_time}

    %{
      stats
      | last: time,
        periods: count_value(stats.periods, period),
        sum: stats.sum + period,
        squares: stats.squares + period * period / 1,
        shortest: min(stats.shortest || period, period),
        longest: max(stats.longest || period, period),
        gaps: gaps,
        gap_time: gap_time
    }
  end

  # Zero has a separate bucket, and negative values have mirrored buckets.
  defp count_value(buckets, value), do: Map.update(buckets, bucket_index(value), 1, &(&1 + 1))
  defp bucket_index(0), do: {0, 0}
  defp bucket_index(value) when value > 0, do: {1, floor(:math.log(value) / @width)}
  defp bucket_index(value), do: {-1, -floor(:math.log(-value) / @width)}

  defp bucket_middle({0, 0}), do: 0
  defp bucket_middle({1, n}), do: round(:math.exp((n + 0.5) * @width))
  defp bucket_middle({-1, n}), do: -round(:math.exp((-n + 0.5) * @width))

  defp summarize(stats, info, gap) do
    periods = stats.count - 1

    %{
      stream: info.name,
      messages: stats.count,
      rate: Store.StreamInfo.message_rate(info),
      period_mean: if(periods > 0, do: stats.sum / periods),
      period_deviation: if(periods > 1, do: standard_deviation(stats, periods)),
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

  defp standard_deviation(stats, n) do
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
    |> then(fn {:at, bucket} -> bucket_middle(bucket) end)
  end
end
