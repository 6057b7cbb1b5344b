defmodule Situ.Metrics.LatencyHistogram do
  @moduledoc false
  # The latencies of a connection as a histogram of Prometheus. Components count latencies in finer buckets in shared
  # memory (`Situ.Ports.Counters`), so nothing is computed before somebody reads the metrics.
  alias Situ.{Metrics, Time}
  alias Situ.Ports.Counters

  # Bucket limits are powers of two of ns: 16 us, 0.13 ms, then 0.5 ms to 1.1 s in steps of two, 8.6 s and 69 s.
  @exponents [14, 17] ++ Enum.to_list(19..30) ++ [33, 36]
  @limits for e <- @exponents, do: Float.to_string(Bitwise.bsl(1, e) / 1.0e9)

  @enforce_keys [:counts, :total, :sum_us]
  defstruct [:counts, :total, :sum_us]

  @typedoc "`counts`: messages below each limit; `total`: all messages; `sum_us`: the sum of their latencies."
  @type t :: %__MODULE__{
          counts: [non_neg_integer()],
          total: non_neg_integer(),
          sum_us: integer()
        }

  @doc "Reads the histogram of a connection."
  @spec read(Counters.t()) :: t()
  def read(counters) do
    {counts, total} = Counters.latency_counts(counters, @exponents)
    %__MODULE__{counts: counts, total: total, sum_us: Counters.latency_sum(counters)}
  end

  @doc "Adds two histograms."
  @spec add(t(), t()) :: t()
  def add(a, b) do
    counts = Enum.zip_with(a.counts, b.counts, &+/2)
    %__MODULE__{counts: counts, total: a.total + b.total, sum_us: a.sum_us + b.sum_us}
  end

  @doc "Returns the samples of the histogram for `Situ.Metrics`."
  @spec to_samples(t(), Metrics.labels()) :: [{Metrics.labels(), number(), atom()}]
  def to_samples(%__MODULE__{} = histogram, labels) do
    buckets =
      for {limit, count} <- Enum.zip(@limits ++ ["+Inf"], histogram.counts ++ [histogram.total]),
          do: {labels ++ [le: limit], count, :bucket}

    sum = Time.to_seconds(histogram.sum_us * 1000)
    buckets ++ [{labels, sum, :sum}, {labels, histogram.total, :count}]
  end
end
