defmodule Situ.Stage.Counters do
  @moduledoc false
  # The numbers of one edge, in shared memory: written once per batch by its two ends, read by anyone at any time.
  # Latency goes into a histogram of four buckets per power of two, so p99 is right within 25 %.

  @emitted 1
  @processed 2
  @dropped 3
  @latency_last 4
  @latency_sum 5
  @latency_count 6
  @busy 7
  @waiting 8
  @last_time 9
  @first 10
  @buckets 176

  # The sum is of microseconds, and of at most an hour each: data replayed from 1970 must not overflow a 64-bit counter.
  @most_us 3_600_000_000

  @type t :: :counters.counters_ref()

  @spec new() :: t()
  def new, do: :counters.new(@first + @buckets, [])

  @doc "`n` messages were handed to the queue."
  @spec emitted(t(), pos_integer()) :: :ok
  def emitted(ref, n), do: :counters.add(ref, @emitted, n)

  @doc "The producer waits for this edge (1) or not (0)."
  @spec waiting(t(), 0 | 1) :: :ok
  def waiting(ref, flag), do: :counters.put(ref, @waiting, flag)

  @doc "The policy dropped `n`."
  @spec dropped(t(), pos_integer()) :: :ok
  def dropped(ref, n), do: :counters.add(ref, @dropped, n)

  @doc "`n` messages were taken, the last of them `latency` old; handling took `busy` ns."
  @spec processed(t(), pos_integer(), integer(), integer()) :: :ok
  def processed(ref, n, latency, busy) do
    :counters.add(ref, @latency_sum, min(div(latency, 1000), @most_us) * n)
    :counters.add(ref, @latency_count, n)
    :counters.put(ref, @latency_last, latency)
    :counters.add(ref, @first + bucket(latency), n)
    :counters.add(ref, @busy, busy)
    :counters.add(ref, @processed, n)
  end

  @doc "The originating time the consumer has reached."
  @spec reached(t(), integer()) :: :ok
  def reached(ref, time), do: :counters.put(ref, @last_time, time)

  @doc "What `reached/2` said last; 0 before."
  @spec last_time(t()) :: integer()
  def last_time(ref), do: :counters.get(ref, @last_time)

  @doc "Emitted, processed, dropped: equal sums mean nothing is on its way."
  @spec flow(t()) :: {non_neg_integer(), non_neg_integer(), non_neg_integer()}
  def flow(ref) do
    {:counters.get(ref, @emitted), :counters.get(ref, @processed), :counters.get(ref, @dropped)}
  end

  @doc "Everything, as a map with the keys of `Situ.Diagnostics.Edge`."
  @spec read(t()) :: map()
  def read(ref) do
    {emitted, processed, dropped} = flow(ref)
    count = :counters.get(ref, @latency_count)

    %{
      emitted: emitted,
      processed: processed,
      dropped: dropped,
      queue: max(emitted - processed - dropped, 0),
      throttled: :counters.get(ref, @waiting) == 1,
      latency_last: :counters.get(ref, @latency_last),
      latency_mean: mean(:counters.get(ref, @latency_sum), count),
      latency_p99: quantile(ref, count, 0.99),
      busy: :counters.get(ref, @busy)
    }
  end

  defp mean(_sum_us, 0), do: 0
  defp mean(sum_us, count), do: div(sum_us * 1000, count)

  @doc "Upper bound, in ns, of the bucket in which the quantile lies."
  @spec quantile(t(), non_neg_integer(), float()) :: non_neg_integer()
  def quantile(_ref, 0, _q), do: 0
  def quantile(ref, count, q), do: seek(ref, 0, ceil(count * q))

  defp seek(_ref, bucket, _left) when bucket >= @buckets, do: bound(@buckets - 1)

  defp seek(ref, bucket, left) do
    left = left - :counters.get(ref, @first + bucket)
    if left <= 0, do: bound(bucket), else: seek(ref, bucket + 1, left)
  end

  # Buckets 0..3 hold less than 1.024, 1.28, 1.536, 1.792 us ..., four to each power of two.
  defp bucket(latency) when latency < 1024, do: 0

  defp bucket(latency) do
    exponent = log2(latency, 10)

    min(
      (exponent - 10) * 4 + Bitwise.band(Bitwise.bsr(latency, exponent - 2), 3) + 1,
      @buckets - 1
    )
  end

  defp bound(0), do: 1024

  defp bound(bucket) do
    exponent = div(bucket - 1, 4) + 10
    Bitwise.bsl(1, exponent) + (rem(bucket - 1, 4) + 1) * Bitwise.bsl(1, exponent - 2)
  end

  defp log2(value, exponent) do
    cond do
      value >= Bitwise.bsl(1, exponent + 8) -> log2(value, exponent + 8)
      value >= Bitwise.bsl(1, exponent + 1) -> log2(value, exponent + 1)
      true -> exponent
    end
  end
end
