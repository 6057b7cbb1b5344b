defmodule Situ.Interpolator.Nearest do
  @moduledoc false
  # Selects the message in the window nearest to the requested time; the later of two at the same distance.
  @behaviour Situ.Interpolator

  alias Situ.{Interval, Message}

  @type config :: {Interval.t(), waits? :: boolean()}

  # The ends of the window as guards. An atom sorts after every number, so an unbounded right end is after all times.
  defguardp from?(at, low, inclusive)
            when low == :unbounded or at > low or (inclusive and at == low)

  defguardp to?(at, high, inclusive) when at < high or (inclusive and at == high)

  @impl true
  def interpolate(_time, [], nil, {_window, true}), do: :insufficient_data
  def interpolate(_time, [], _closed, _config), do: {:does_not_exist, nil}

  def interpolate(time, messages, closed, {window, waits?}) do
    %{left_inclusive: low_in, right_inclusive: high_in} = window
    {low, high} = {edge(time, window.left), edge(time, window.right)}

    # If both ends have the same time and are not both included, the window cannot contain a message.
    if low == high and low != :unbounded and not (low_in and high_in),
      do: empty(messages, time, {low, high}, waits? and closed == nil),
      else: before(messages, time, {low, high, waits? and closed == nil}, low_in, high_in)
  end

  # Skips messages up to the first one in the window.
  defp before([%Message{originating_time: at} | rest], time, {low, _, _} = frame, low_in, high_in)
       when not from?(at, low, low_in),
       do: before(rest, time, frame, low_in, high_in)

  defp before(
         [%Message{originating_time: at} = first | rest],
         time,
         {_, high, _} = frame,
         _,
         high_in
       )
       when to?(at, high, high_in),
       do: scan(rest, time, high, high_in, frame, first, abs(at - time))

  defp before([_past | _], time, {_, high, _}, _low_in, _high_in), do: none(time, high)
  defp before([], time, frame, _low_in, _high_in), do: none_yet(time, frame)

  # Scans up to the first message that is past the window, or farther away than the best so far.
  defp scan(
         [%Message{originating_time: at} = message | rest],
         time,
         high,
         high_in,
         frame,
         best,
         distance
       )
       when to?(at, high, high_in) do
    case abs(at - time) do
      nearer when nearer <= distance ->
        scan(rest, time, high, high_in, frame, message, nearer)

      _farther ->
        created(best)
    end
  end

  defp scan([_past | _], _time, _high, _high_in, _frame, best, _distance), do: created(best)

  defp scan([], time, high, _high_in, {_low, _high, true}, best, _distance) do
    decided_at = decided_at(time, high)
    if best.originating_time < decided_at, do: {:wait, decided_at}, else: created(best)
  end

  defp scan([], _time, _high, _high_in, _frame, best, _distance), do: created(best)

  defp empty([%Message{originating_time: at} | rest], time, {low, _} = ends, waits?)
       when at < low,
       do: empty(rest, time, ends, waits?)

  defp empty([_there | _], time, {_low, high}, _waits?), do: none(time, high)
  defp empty([], time, {low, high}, waits?), do: none_yet(time, {low, high, waits?})

  # All messages are before the window. Unless the stream has ended, a matching message may still arrive. The result
  # can be certain only from the time in the window after which no later message can be nearer.
  defp none_yet(time, {low, high, true}) do
    decided_at = decided_at(time, high)
    {:wait, if(low == :unbounded, do: decided_at, else: max(low, decided_at))}
  end

  defp none_yet(time, {_low, high, false}), do: none(time, high)

  defp created(%Message{data: data, originating_time: at}), do: {:created, data, at}
  defp none(time, high), do: {:does_not_exist, decided_at(time, high)}

  # Returns the time from which no later message can be nearer than the messages that have already arrived.
  defp decided_at(time, :unbounded), do: time
  defp decided_at(time, high), do: min(time, high)

  defp edge(_time, :unbounded), do: :unbounded
  defp edge(time, offset), do: time + offset
end
