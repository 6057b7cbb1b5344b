defmodule Situ.Interpolator.Adjacent do
  @moduledoc false
  # Applies a function to the two messages on either side of the requested time. A message at exactly that time is
  # returned unchanged.
  @behaviour Situ.Interpolator

  alias Situ.Message

  @impl true
  def interpolate(time, messages, closed, {fun, max_span}) do
    find_neighbors(messages, nil, time, closed, fun, max_span)
  end

  defp find_neighbors(
         [%Message{originating_time: at} = message | rest],
         _previous,
         time,
         closed,
         fun,
         span
       )
       when at < time,
       do: find_neighbors(rest, message, time, closed, fun, span)

  defp find_neighbors(
         [%Message{originating_time: time, data: data} | _],
         _previous,
         time,
         _,
         _fun,
         _span
       ),
       do: {:created, data, time}

  defp find_neighbors([_message | _], nil, _time, _closed, _fun, _span),
    do: {:does_not_exist, nil}

  defp find_neighbors([message | _], previous, time, _closed, fun, max_span) do
    gap = message.originating_time - previous.originating_time

    # An atom sorts after every number, so :infinity is wider than any gap.
    if gap < max_span do
      ratio = (time - previous.originating_time) / gap
      {:created, fun.(previous.data, message.data, ratio), previous.originating_time}
    else
      {:does_not_exist, previous.originating_time}
    end
  end

  defp find_neighbors([], _previous, time, nil, _fun, _span), do: {:wait, time}
  defp find_neighbors([], nil, _time, _closed, _fun, _span), do: {:does_not_exist, nil}

  defp find_neighbors([], last, _time, _closed, _fun, _span),
    do: {:does_not_exist, last.originating_time}
end
