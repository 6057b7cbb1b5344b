defmodule Situ.Interpolator.Nearest do
  @moduledoc false
  # The message nearest to the asked time inside the window; of two at the same distance the later one.
  @behaviour Situ.Interpolator

  alias Situ.{Interval, Message}

  @type config :: {Interval.t(), waits? :: boolean()}

  @impl true
  def interpolate(_time, [], nil, {_window, true}), do: :insufficient_data
  def interpolate(_time, [], _closed, _config), do: {:does_not_exist, nil}

  def interpolate(time, messages, closed, {window, waits?}) do
    waits? = waits? and closed == nil
    low = edge(time, window.left)
    high = edge(time, window.right)
    scan(messages, time, {low, window.left_inclusive, high, window.right_inclusive, waits?}, nil)
  end

  # Runs through the queue; `best` is the nearest so far, nil before the first in the window.
  defp scan([%Message{originating_time: at} = message | rest], time, frame, nil) do
    {low, low_inclusive, high, high_inclusive, _waits?} = frame

    cond do
      # Both ends at one time and not both included: nothing can lie in such a window.
      at == low and low == high and not (low_inclusive and high_inclusive) -> none(time, high)
      not Interval.after_left?(at, low, low_inclusive) -> scan(rest, time, frame, nil)
      Interval.before_right?(at, high, high_inclusive) -> scan(rest, time, frame, message)
      true -> none(time, high)
    end
  end

  defp scan([%Message{originating_time: at} = message | rest], time, frame, best) do
    {_low, _low_inclusive, high, high_inclusive, _waits?} = frame

    if Interval.before_right?(at, high, high_inclusive) and
         abs(at - time) <= abs(best.originating_time - time),
       do: scan(rest, time, frame, message),
       else: created(best)
  end

  # Every message lies before the window: unless the stream has ended, one that fits may come. The first that could settle
  # it is one in the window from where no later one can be nearer.
  defp scan([], time, {low, _low_inclusive, high, _high_inclusive, true}, nil) do
    decided_at = decided_at(time, high)
    {:wait, if(low == :unbounded, do: decided_at, else: max(low, decided_at))}
  end

  defp scan([], time, {_low, _low_inclusive, high, _high_inclusive, false}, nil),
    do: none(time, high)

  defp scan([], time, {_low, _low_inclusive, high, _high_inclusive, true}, best) do
    decided_at = decided_at(time, high)

    if best.originating_time < decided_at,
      do: {:wait, decided_at},
      else: created(best)
  end

  defp scan([], _time, _frame, best), do: created(best)

  defp created(%Message{data: data, originating_time: at}), do: {:created, data, at}
  defp none(time, high), do: {:does_not_exist, decided_at(time, high)}

  # From here on no message can be nearer than one that is already there.
  defp decided_at(time, :unbounded), do: time
  defp decided_at(time, high), do: min(time, high)

  defp edge(_time, :unbounded), do: :unbounded
  defp edge(time, offset), do: time + offset
end
