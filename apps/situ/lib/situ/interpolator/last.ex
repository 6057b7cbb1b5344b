defmodule Situ.Interpolator.Last do
  @moduledoc false
  # Selects the last message in the window. The choice is final once a message at or after the right end has arrived.
  @behaviour Situ.Interpolator

  alias Situ.{Interval, Message}

  @impl true
  def interpolate(_time, [], nil, {_window, true}), do: :insufficient_data
  def interpolate(_time, [], _closed, _config), do: {:does_not_exist, nil}

  def interpolate(time, messages, closed, {window, waits?}) do
    frame = Interval.translate(window, time)
    scan_messages(messages, frame, waits? and closed == nil, nil)
  end

  defp scan_messages([%Message{originating_time: at} = message | rest], frame, waits?, best) do
    cond do
      not Interval.before_right?(at, frame.right, frame.right_inclusive) ->
        decide_value(best, frame)

      Interval.after_left?(at, frame.left, frame.left_inclusive) ->
        scan_messages(rest, frame, waits?, message)

      true ->
        scan_messages(rest, frame, waits?, best)
    end
  end

  defp scan_messages([], frame, true, best) do
    if best != nil and frame.right_inclusive and best.originating_time == frame.right,
      do: decide_value(best, frame),
      else: {:wait, if(frame.right == :unbounded, do: :infinity, else: frame.right)}
  end

  defp scan_messages([], frame, false, best), do: decide_value(best, frame)

  defp decide_value(nil, %{left: :unbounded}), do: {:does_not_exist, nil}
  defp decide_value(nil, %{left: left}), do: {:does_not_exist, left}
  defp decide_value(%Message{data: data, originating_time: at}, _frame), do: {:created, data, at}
end
