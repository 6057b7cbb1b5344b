defmodule Situ.Window.Trailing do
  @moduledoc false
  # Windows that end with the message itself, as steps of a chain: the last n messages, or the messages of a time span.
  # Both keep the newest message first, so that adding a message and dropping old ones is a single pass.

  alias Situ.Interval

  @spec by_count(pos_integer(), fun() | nil, :data | :messages) :: Situ.Operator.step()
  def by_count(n, fun, with) do
    step = fn data, message, {count, items} ->
      item = if with == :data, do: data, else: %{message | data: data}

      if count < n - 1 do
        {:skip, {count + 1, [item | items]}}
      else
        items = [item | take_newest(items, n - 1)]
        list = :lists.reverse(items)
        {:emit, if(fun == nil, do: list, else: fun.(list)), {count, items}}
      end
    end

    {:step, step, {0, []}}
  end

  @spec by_time(Interval.t(), fun() | nil, :data | :messages) :: Situ.Operator.step()
  def by_time(%Interval{left: left, left_inclusive: inclusive}, fun, with) do
    step = fn data, %{originating_time: time} = message, items ->
      item = if with == :data, do: data, else: %{message | data: data}
      items = [{time, item} | take_since(items, time + left, inclusive)]
      list = reverse_items(items, [])
      {:emit, if(fun == nil, do: list, else: fun.(list)), items}
    end

    {:step, step, []}
  end

  defp take_newest(_list, 0), do: []
  defp take_newest([item | rest], n), do: [item | take_newest(rest, n - 1)]
  defp take_newest([], _n), do: []

  defp take_since([{time, _} = entry | rest], low, inclusive)
       when time > low or (inclusive and time == low),
       do: [entry | take_since(rest, low, inclusive)]

  defp take_since(_older, _low, _inclusive), do: []

  defp reverse_items([{_time, item} | rest], list), do: reverse_items(rest, [item | list])
  defp reverse_items([], list), do: list
end
