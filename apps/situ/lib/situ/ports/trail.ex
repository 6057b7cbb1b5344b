defmodule Situ.Ports.Trail do
  @moduledoc false
  # When which originating times went by one end of an edge, for the last while: a ring of entries in the edge's shared
  # memory, written by that end alone, once per batch. An entry is of a millisecond of the pipeline's clock and holds
  # the last time that went by in it, so what is told is right within that.
  #
  #   word 0   how many entries were begun, 1 when the last one was; then pairs: originating time, when

  @entries 128
  @span 1_000_000
  @words 2 + 2 * @entries

  @doc "How many words one takes."
  @spec words() :: pos_integer()
  def words, do: @words

  @doc "Everything up to the originating time `time` has gone by at clock time `at`; `base` is its first word."
  @spec note(:atomics.atomics_ref(), pos_integer(), Situ.Time.t(), Situ.Time.t()) :: :ok
  def note(ref, base, time, at) do
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
  When the originating time `time`, or the first one behind it, went by: the clock time, `:forgotten` when that is too
  long ago, `nil` when none has.
  """
  @spec passed(:atomics.atomics_ref(), pos_integer(), Situ.Time.t()) ::
          Situ.Time.t() | :forgotten | nil
  def passed(ref, base, time) do
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
