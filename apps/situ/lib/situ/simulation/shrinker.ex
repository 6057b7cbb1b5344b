defmodule Situ.Simulation.Shrinker do
  @moduledoc false
  # Shrinks a failing schedule: removes deviations from the usual course as long as it still fails in the same way,
  # first long ranges of them and then shorter ones.

  @typep deviations :: %{pos_integer() => pos_integer()}

  @doc "Returns fewer deviations with which `fails?` still returns true; runs it at most `most` times."
  @spec shrink_deviations(deviations(), pos_integer(), (deviations() -> boolean())) ::
          deviations()
  def shrink_deviations(deviations, most, fails?) do
    list = Enum.sort(deviations)
    {list, _left} = remove_ranges(list, max(div(length(list) + 1, 2), 1), most, fails?)
    Map.new(list)
  end

  defp remove_ranges(list, 0, left, _fails?), do: {list, left}
  defp remove_ranges([], _size, left, _fails?), do: {[], left}

  defp remove_ranges(list, size, left, fails?) do
    {shorter, left} = remove_each(list, size, left, fails?)
    # After a success of the smallest ranges, others may have become removable.
    next = if size == 1 and length(shorter) < length(list) and left > 0, do: 1, else: div(size, 2)
    remove_ranges(shorter, next, left, fails?)
  end

  # The tail first: choices after the failure have no effect.
  defp remove_each(list, size, left, fails?) do
    starts = 0..max(length(list) - 1, 0)//size |> Enum.reverse()

    Enum.reduce(starts, {list, left}, fn start, {list, left} ->
      candidate = Enum.take(list, start) ++ Enum.drop(list, start + size)

      if left > 0 and candidate != list and fails?.(Map.new(candidate)),
        do: {candidate, left - 1},
        else: {list, max(left - 1, 0)}
    end)
  end
end
