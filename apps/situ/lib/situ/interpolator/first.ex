defmodule Situ.Interpolator.First do
  @moduledoc false
  # Selects the first message in the window. Streams are ordered, so the first match is the earliest message.
  @behaviour Situ.Interpolator

  alias Situ.{Interval, Message}

  @impl true
  def interpolate(_time, [], nil, {_window, true}), do: :insufficient_data
  def interpolate(_time, [], _closed, _config), do: {:does_not_exist, nil}

  def interpolate(time, messages, closed, {window, waits?}) do
    low = time + window.left

    case Enum.find(
           messages,
           &Interval.after_left?(&1.originating_time, low, window.left_inclusive)
         ) do
      nil when waits? and closed == nil -> {:wait, low}
      nil -> {:does_not_exist, low}
      %Message{originating_time: at, data: data} -> value_if_inside(at, data, time, low, window)
    end
  end

  # `at` is the first message after the left end. If it is past the right end, the window is empty.
  defp value_if_inside(at, data, time, low, window) do
    if Interval.before_right?(
         at,
         Situ.Interval.translate(window, time).right,
         window.right_inclusive
       ),
       do: {:created, data, at},
       else: {:does_not_exist, low}
  end
end
