defmodule Situ.Ports.ProgressRing do
  @moduledoc false
  # Records when originating times recently passed one end of an edge: a ring of entries in the edge's shared memory,
  # written only by that end, once per batch. Each entry covers a millisecond of the pipeline's clock and holds the last
  # time that passed in it, so the results are accurate to a millisecond.
  #
  #   word 0   the number of entries begun
  #   word 1   when the last one was begun; then pairs of originating time and clock time

  @compile {:inline, slot: 2, put: 4}

  @entries 128
  @span 1_000_000
  @words 2 + 2 * @entries

  @doc "Returns the number of words that one ring takes."
  @spec word_count() :: pos_integer()
  def word_count, do: @words

  @doc "Records that everything up to the originating time `time` had passed at clock time `at`; `base` is word 0."
  @spec record_passage(:atomics.atomics_ref(), pos_integer(), Situ.Time.t(), Situ.Time.t()) :: :ok
  def record_passage(ref, base, time, at) do
    n = :atomics.get(ref, base)

    if n > 0 and at - :atomics.get(ref, base + 1) < @span do
      put(ref, slot(base, n), time, at)
    else
      put(ref, slot(base, n + 1), time, at)
      :atomics.put(ref, base + 1, at)
      :atomics.put(ref, base, n + 1)
    end
  end

  defp put(ref, slot, time, at) do
    :atomics.put(ref, slot, time)
    :atomics.put(ref, slot + 1, at)
  end

  @doc """
  Returns the clock time at which the originating time `time`, or the first one after it, passed; `:forgotten` if
  that is too long ago, `nil` if none has passed.
  """
  @spec find_passage(:atomics.atomics_ref(), pos_integer(), Situ.Time.t()) ::
          Situ.Time.t() | :forgotten | nil
  def find_passage(ref, base, time) do
    case :atomics.get(ref, base) do
      0 -> nil
      n -> seek(ref, base, time, max(n - @entries + 1, 1), n)
    end
  end

  defp seek(ref, base, time, first, n) do
    case Enum.find(first..n, &(:atomics.get(ref, slot(base, &1)) >= time)) do
      nil -> nil
      ^first when first > 1 -> :forgotten
      found -> :atomics.get(ref, slot(base, found) + 1)
    end
  end

  defp slot(base, n), do: base + 2 + 2 * rem(n - 1, @entries)
end
