defmodule Situ.Ports.Counters do
  @moduledoc false
  # The counters of one edge, in shared memory. The two ends write once per batch, and any process can read at any time.
  # Latency goes into a histogram with four buckets per power of two, so p99 is accurate within 25 %.

  alias Situ.Delivery.Batch
  alias Situ.Ports.ProgressRing

  @compile {:inline, microseconds: 1, bucket: 1}

  # The producer writes the first eight words, the consumer the rest: each has cache lines of its own.
  @emitted 1
  @created_last 2
  @created_sum 3
  @posted_last 4
  @kept_sum 5
  @waiting 6
  @held 7
  @wanted 8
  @handed 9
  @handed_time 10
  @processed 17
  @dropped 18
  @reached 19
  @latency_last 20
  @latency_sum 21
  @handling_last 22
  @busy 23
  @queue_sum 24
  @size_last 25
  @size_sum 26
  @size_count 27
  @first 28
  @buckets 176
  @sent @first + @buckets
  @taken @sent + ProgressRing.word_count()

  # Sums are of microseconds, and of at most an hour each: data replayed from 1970 must not overflow 64 bits.
  @most_us 3_600_000_000

  @type t :: :atomics.atomics_ref()
  @typedoc "The counters and sums that only grow; the difference of two of them covers the time in between."
  @type totals :: %{
          emitted: non_neg_integer(),
          processed: non_neg_integer(),
          dropped: non_neg_integer(),
          created: integer(),
          posted: integer(),
          latency: integer(),
          busy: non_neg_integer(),
          queue: non_neg_integer(),
          size: non_neg_integer(),
          sized: non_neg_integer()
        }

  @spec new() :: t()
  def new, do: :atomics.new(@taken + ProgressRing.word_count(), signed: true)

  @doc "Counts `n` emitted messages; the last was created and posted `created` and `posted` ns after its time."
  @spec count_emitted(t(), pos_integer(), integer(), integer()) :: :ok
  def count_emitted(ref, n, created, posted) do
    :atomics.put(ref, @created_last, created)
    :atomics.add(ref, @created_sum, microseconds(created) * n)
    :atomics.put(ref, @posted_last, posted)
    if posted != created, do: :atomics.add(ref, @kept_sum, microseconds(posted - created) * n)
    :atomics.add(ref, @emitted, n)
  end

  @doc "Sets whether the producer waits for this edge (1) or not (0)."
  @spec set_waiting(t(), 0 | 1) :: :ok
  def set_waiting(ref, flag), do: :atomics.put(ref, @waiting, flag)

  @doc "Sets how many messages a lossy policy holds back at the producer."
  @spec put_held_count(t(), non_neg_integer()) :: :ok
  def put_held_count(ref, n), do: :atomics.put(ref, @held, n)

  @doc "Counts `n` messages that were sent to the consumer, the last at the originating time `time`."
  @spec count_handed(t(), pos_integer(), Situ.Time.t()) :: :ok
  def count_handed(ref, n, time) do
    :atomics.put(ref, @handed_time, time)
    :atomics.add(ref, @handed, n)
  end

  @doc """
  Forgets messages that a dead producer had emitted, but not sent; returns how many it had sent, and the last time.
  """
  @spec forget_unsent(t()) :: {non_neg_integer(), Situ.Time.t()}
  def forget_unsent(ref) do
    handed = :atomics.get(ref, @handed)
    :atomics.put(ref, @emitted, handed)
    {handed, :atomics.get(ref, @handed_time)}
  end

  @doc "Forgets messages that a dead process had emitted to another of its steps, which had not handled them."
  @spec forget_unhandled(t()) :: :ok
  def forget_unhandled(ref) do
    {_emitted, processed, dropped} = flow_counts(ref)
    :atomics.put(ref, @emitted, processed + dropped)
  end

  @doc "Returns how many messages are held back at the producer."
  @spec held_count(t()) :: non_neg_integer()
  def held_count(ref), do: :atomics.get(ref, @held)

  @doc "Requests all messages that are held back, immediately."
  @spec request_held(t()) :: :ok
  def request_held(ref), do: :atomics.put(ref, @wanted, 1)

  @doc "Returns whether the consumer has such a request, and clears it; the caller must then reply to the consumer."
  @spec take_held_request?(t()) :: boolean()
  def take_held_request?(ref),
    do: :atomics.get(ref, @wanted) == 1 and :atomics.compare_exchange(ref, @wanted, 1, 0) == :ok

  @doc "Counts `n` messages that the policy dropped."
  @spec count_dropped(t(), pos_integer()) :: :ok
  def count_dropped(ref, n), do: :atomics.add(ref, @dropped, n)

  @doc "Counts the sizes of data that arrived."
  @spec count_sizes(t(), [term()]) :: :ok
  def count_sizes(ref, data) do
    {n, sum, last} = Enum.reduce(data, {0, 0, 0}, &add_size/2)
    :atomics.put(ref, @size_last, last)
    :atomics.add(ref, @size_sum, sum)
    :atomics.add(ref, @size_count, n)
  end

  defp add_size(data, {n, sum, _last}) do
    size = Batch.data_size(data)
    {n + 1, sum + size, size}
  end

  @doc "Counts `n` handled messages; the last had a latency of `latency` ns, and handling all of them took `busy` ns."
  @spec count_processed(t(), pos_integer(), integer(), integer()) :: :ok
  def count_processed(ref, n, latency, busy) do
    :atomics.put(ref, @latency_last, latency)
    :atomics.add(ref, @latency_sum, microseconds(latency) * n)
    :atomics.add(ref, @first + bucket(latency), n)
    :atomics.put(ref, @handling_last, div(busy, n))
    :atomics.add(ref, @busy, busy)
    done = :atomics.add_get(ref, @processed, n)
    waits = :atomics.get(ref, @emitted) - :atomics.get(ref, @dropped) - done
    if waits > 0, do: :atomics.add(ref, @queue_sum, waits * n), else: :ok
  end

  @doc "Records that all messages up to the originating time `time` were handed over by clock time `at`."
  @spec record_sent(t(), Situ.Time.t(), Situ.Time.t()) :: :ok
  def record_sent(ref, time, at), do: ProgressRing.record_passage(ref, @sent, time, at)

  @doc "Records that the consumer took the message of the originating time `time` at clock time `at`."
  @spec record_reached(t(), Situ.Time.t(), Situ.Time.t()) :: :ok
  def record_reached(ref, time, at) do
    :atomics.put(ref, @reached, time)
    ProgressRing.record_passage(ref, @taken, time, at)
  end

  @doc "Returns when the originating time `time` was handed over, and when it was taken."
  @spec passage_times(t(), Situ.Time.t()) :: {passed, passed}
        when passed: Situ.Time.t() | :forgotten | nil
  def passage_times(ref, time),
    do:
      {ProgressRing.find_passage(ref, @sent, time), ProgressRing.find_passage(ref, @taken, time)}

  @doc "Returns the originating time of the last `record_reached/3`; 0 before the first."
  @spec last_time(t()) :: integer()
  def last_time(ref), do: :atomics.get(ref, @reached)

  @doc "Returns the emitted, processed and dropped counts; no messages are in flight if the first equals their sum."
  @spec flow_counts(t()) :: {non_neg_integer(), non_neg_integer(), non_neg_integer()}
  def flow_counts(ref) do
    {:atomics.get(ref, @emitted), :atomics.get(ref, @processed), :atomics.get(ref, @dropped)}
  end

  @doc "Returns the counters that only grow; latencies are sums over messages, in microseconds."
  @spec read_totals(t()) :: totals()
  def read_totals(ref) do
    {emitted, processed, dropped} = flow_counts(ref)
    created = :atomics.get(ref, @created_sum)

    %{
      emitted: emitted,
      processed: processed,
      dropped: dropped,
      created: created,
      posted: created + :atomics.get(ref, @kept_sum),
      latency: :atomics.get(ref, @latency_sum),
      busy: :atomics.get(ref, @busy),
      queue: :atomics.get(ref, @queue_sum),
      size: :atomics.get(ref, @size_sum),
      sized: :atomics.get(ref, @size_count)
    }
  end

  @doc "Returns the current and the last values as a map with the keys of `Situ.Diagnostics.Edge`."
  @spec read_values(t(), totals()) :: map()
  def read_values(ref, totals) do
    %{emitted: emitted, processed: processed, dropped: dropped} = totals

    %{
      emitted: emitted,
      processed: processed,
      dropped: dropped,
      queue: max(emitted - processed - dropped, 0),
      throttled: :atomics.get(ref, @waiting) == 1,
      created_last: :atomics.get(ref, @created_last),
      posted_last: :atomics.get(ref, @posted_last),
      latency_last: :atomics.get(ref, @latency_last),
      latency_p99: latency_quantile(ref, processed, 0.99),
      handling_last: :atomics.get(ref, @handling_last),
      busy: totals.busy,
      size_last: :atomics.get(ref, @size_last)
    }
  end

  defp microseconds(ns), do: ns |> div(1000) |> min(@most_us) |> max(-@most_us)

  @doc "Returns the upper bound, in ns, of the bucket that contains the quantile."
  @spec latency_quantile(t(), non_neg_integer(), float()) :: non_neg_integer()
  def latency_quantile(_ref, 0, _q), do: 0
  def latency_quantile(ref, count, q), do: seek(ref, 0, ceil(count * q))

  defp seek(_ref, bucket, _left) when bucket >= @buckets, do: bound(@buckets - 1)

  defp seek(ref, bucket, left) do
    left = left - :atomics.get(ref, @first + bucket)
    if left <= 0, do: bound(bucket), else: seek(ref, bucket + 1, left)
  end

  @doc """
  Returns how many messages had a latency of less than 2^e ns, for each exponent `e` (ascending, 10 or more), and the
  number of all messages. All numbers are from one reading, so they never decrease.
  """
  @spec latency_counts(t(), [pos_integer()]) :: {[non_neg_integer()], non_neg_integer()}
  def latency_counts(ref, exponents) do
    ends = Enum.map(exponents, &((&1 - 10) * 4))

    {counts, {next, sum}} =
      Enum.map_reduce(ends, {0, 0}, fn last, {next, sum} ->
        sum = sum + sum_buckets(ref, next, last)
        {sum, {last + 1, sum}}
      end)

    {counts, sum + sum_buckets(ref, next, @buckets - 1)}
  end

  @doc "Returns the sum of the latencies of all messages, in microseconds."
  @spec latency_sum(t()) :: integer()
  def latency_sum(ref), do: :atomics.get(ref, @latency_sum)

  defp sum_buckets(ref, first, last),
    do: Enum.reduce(first..last//1, 0, &(&2 + :atomics.get(ref, @first + &1)))

  # Buckets 0..3 hold less than 1.024, 1.28, 1.536, 1.792 us ..., four to each power of two.
  defp bucket(latency) when latency < 1024, do: 0

  defp bucket(latency) do
    exponent = log2(latency, 0)

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

  # Latencies of 1 us to 1 s take four steps.
  defp log2(value, exponent) when value >= 0x10000,
    do: log2(Bitwise.bsr(value, 16), exponent + 16)

  defp log2(value, exponent) when value >= 0x100, do: log2(Bitwise.bsr(value, 8), exponent + 8)
  defp log2(value, exponent) when value >= 0x10, do: log2(Bitwise.bsr(value, 4), exponent + 4)
  defp log2(value, exponent) when value >= 4, do: log2(Bitwise.bsr(value, 2), exponent + 2)
  defp log2(value, exponent), do: exponent + Bitwise.bsr(value, 1)
end
