defmodule Situ.Interpolator.Nearest do
  @moduledoc false
  # Selects the message in the window nearest to the requested time, or the later one of two at the same distance.
  @behaviour Situ.Interpolator

  alias Situ.{Interval, Message}

  @type config :: {Interval.t(), waits? :: boolean()}

  # The ends of the window as guards. An atom sorts after every number, so an unbounded right end is after all times.
  defguardp after_left?(at, low, inclusive)
            when low == :unbounded or at > low or (inclusive and at == low)

  defguardp before_right?(at, high, inclusive) when at < high or (inclusive and at == high)

  @impl true
  def interpolate(_time, [], nil, {_window, true}), do: :insufficient_data
  def interpolate(_time, [], _closed, _config), do: {:does_not_exist, nil}

  def interpolate(time, messages, closed, {window, waits?}) do
    %{left_inclusive: low_in, right_inclusive: high_in} = window
    {low, high} = {window_edge(time, window.left), window_edge(time, window.right)}

    # If both ends have the same time and are not both included, the window cannot contain a message.
    if low == high and low != :unbounded and not (low_in and high_in),
      do: scan_empty_window(messages, time, {low, high}, waits? and closed == nil),
      else:
        skip_before_window(messages, time, {low, high, waits? and closed == nil}, low_in, high_in)
  end

  # Skips messages up to the first one in the window.
  defp skip_before_window(
         [%Message{originating_time: at} | rest],
         time,
         {low, _, _} = frame,
         low_in,
         high_in
       )
       when not after_left?(at, low, low_in),
       do: skip_before_window(rest, time, frame, low_in, high_in)

  defp skip_before_window(
         [%Message{originating_time: at} = first | rest],
         time,
         {_, high, _} = frame,
         _,
         high_in
       )
       when before_right?(at, high, high_in),
       do: scan_nearest(rest, time, high, high_in, frame, first, abs(at - time))

  defp skip_before_window([_past | _], time, {_, high, _}, _low_in, _high_in),
    do: no_value_result(time, high)

  defp skip_before_window([], time, frame, _low_in, _high_in), do: undecided_result(time, frame)

  # Scans up to the first message that is past the window, or farther away than the best so far.
  defp scan_nearest(
         [%Message{originating_time: at} = message | rest],
         time,
         high,
         high_in,
         frame,
         best,
         distance
       )
       when before_right?(at, high, high_in) do
    case abs(at - time) do
      nearer when nearer <= distance ->
        scan_nearest(rest, time, high, high_in, frame, message, nearer)

      _farther ->
        created_result(best)
    end
  end

  defp scan_nearest([_past | _], _time, _high, _high_in, _frame, best, _distance),
    do: created_result(best)

  defp scan_nearest([], time, high, _high_in, {_low, _high, true}, best, _distance) do
    decided_at = decided_at(time, high)
    if best.originating_time < decided_at, do: {:wait, decided_at}, else: created_result(best)
  end

  defp scan_nearest([], _time, _high, _high_in, _frame, best, _distance), do: created_result(best)

  defp scan_empty_window([%Message{originating_time: at} | rest], time, {low, _} = ends, waits?)
       when at < low,
       do: scan_empty_window(rest, time, ends, waits?)

  defp scan_empty_window([_there | _], time, {_low, high}, _waits?),
    do: no_value_result(time, high)

  defp scan_empty_window([], time, {low, high}, waits?),
    do: undecided_result(time, {low, high, waits?})

  # All messages are before the window. Unless the stream has ended, a matching message may still arrive. The result
  # can be certain only from the time in the window after which no later message can be nearer.
  defp undecided_result(time, {low, high, true}) do
    decided_at = decided_at(time, high)
    {:wait, if(low == :unbounded, do: decided_at, else: max(low, decided_at))}
  end

  defp undecided_result(time, {_low, high, false}), do: no_value_result(time, high)

  defp created_result(%Message{data: data, originating_time: at}), do: {:created, data, at}
  defp no_value_result(time, high), do: {:does_not_exist, decided_at(time, high)}

  # Returns the time from which no later message can be nearer than the messages that have already arrived.
  defp decided_at(time, :unbounded), do: time
  defp decided_at(time, high), do: min(time, high)

  defp window_edge(_time, :unbounded), do: :unbounded
  defp window_edge(time, offset), do: time + offset
end
