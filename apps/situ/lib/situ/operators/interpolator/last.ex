defmodule Situ.Interpolator.Last do
  @moduledoc false
  # Selects the last message in the window. It is certain when a message at or after the right end has arrived.
  @behaviour Situ.Interpolator

  alias Situ.{Interval, Message}

  @impl true
  def interpolate(_time, [], nil, {_window, true}), do: :insufficient_data
  def interpolate(_time, [], _closed, _config), do: {:does_not_exist, nil}

  def interpolate(time, messages, closed, {window, waits?}) do
    frame = Interval.translate(window, time)
    scan(messages, frame, waits? and closed == nil, nil)
  end

  defp scan([%Message{originating_time: at} = message | rest], frame, waits?, best) do
    cond do
      not Interval.before_right?(at, frame.right, frame.right_inclusive) ->
        decide(best, frame)

      Interval.after_left?(at, frame.left, frame.left_inclusive) ->
        scan(rest, frame, waits?, message)

      true ->
        scan(rest, frame, waits?, best)
    end
  end

  defp scan([], frame, true, best) do
    if best != nil and frame.right_inclusive and best.originating_time == frame.right,
      do: decide(best, frame),
      else: {:wait, if(frame.right == :unbounded, do: :infinity, else: frame.right)}
  end

  defp scan([], frame, false, best), do: decide(best, frame)

  defp decide(nil, %{left: :unbounded}), do: {:does_not_exist, nil}
  defp decide(nil, %{left: left}), do: {:does_not_exist, left}
  defp decide(%Message{data: data, originating_time: at}, _frame), do: {:created, data, at}
end
