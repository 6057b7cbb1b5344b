defmodule Situ.Generator.ItemFeed do
  @moduledoc false
  # A generator's items, one at a time: `next_item/1` returns `{time, value, feed}` or `:done`. Pure, except for users'
  # enumerables. Times of a paced feed are start, start + interval, ...

  alias Situ.{Columns, Sampling}

  @type t :: {:paced, items(), Situ.Time.t(), Situ.Time.duration()} | {:timed, items()}
  @type items ::
          {:sequence, term(), (term() -> term()), non_neg_integer() | :infinity}
          | {:list, list()}
          | {:range, Range.t()}
          | {:enum, (Enumerable.acc() -> Enumerable.result()) | :done}
          | {:next, term(), items()}

  @doc "Builds a feed of items at an interval, from `start` or the first aligned time after it."
  @spec build_paced(items(), Situ.Time.t(), Situ.Time.duration(), Situ.Time.t() | nil) :: t()
  def build_paced(items, start, interval, align),
    do: {:paced, items, Sampling.first_tick(start, interval, align), interval}

  @doc "Builds a feed of items that contain their times: `{time, value}`, a `Situ.Message` or `Situ.Columns`."
  @spec build_timed(items()) :: t()
  def build_timed(items), do: {:timed, items}

  @doc "Converts an enumerable to items, which are read on demand."
  @spec to_items(Enumerable.t()) :: items()
  def to_items(list) when is_list(list), do: {:list, list}
  def to_items(%Range{} = range), do: {:range, range}

  def to_items(enumerable) do
    {:enum, &Enumerable.reduce(enumerable, &1, fn item, _ -> {:suspend, {:item, item}} end)}
  end

  @doc "Returns the next item and the rest of the feed."
  @spec next_item(t()) :: {Situ.Time.t(), term(), t()} | :done
  def next_item({:paced, {:sequence, _, _, 0}, _time, _interval}), do: :done

  def next_item({:paced, {:sequence, value, fun, 1}, time, interval}),
    do: {time, value, {:paced, {:sequence, nil, fun, 0}, time + interval, interval}}

  def next_item({:paced, {:sequence, value, fun, left}, time, interval}) do
    left = if left == :infinity, do: left, else: left - 1
    {time, value, {:paced, {:sequence, fun.(value), fun, left}, time + interval, interval}}
  end

  def next_item({:paced, items, time, interval}) do
    with {value, items} <- take_item(items),
         do: {time, value, {:paced, items, time + interval, interval}}
  end

  def next_item({:timed, items}) do
    case take_item(items) do
      :done -> :done
      {{time, value}, items} when is_integer(time) -> {time, value, {:timed, items}}
      {%Situ.Message{} = m, items} -> {m.originating_time, m.data, {:timed, items}}
      {%Columns{} = columns, items} -> pop_column(columns, items)
      {other, _items} -> raise no_time_error(other)
    end
  end

  defp pop_column(columns, items) do
    [{time, value}] = columns |> Columns.slice(0, 1) |> Columns.to_pairs()
    {time, value, {:timed, put_rest(columns, 1, items)}}
  end

  defp put_rest(%{count: count}, count, items), do: items

  defp put_rest(%{count: count} = columns, n, items),
    do: {:next, Columns.slice(columns, n, count - n), items}

  @doc """
  Takes up to `n` items that can be emitted together, none of them earlier than `from` or later than `till`: of a paced
  feed, or numbers that are columns already. Returns them, how many items were taken, and the rest of the feed.
  """
  @spec take_together(t(), pos_integer(), {Situ.Time.t() | nil, Situ.Time.t() | :infinity}) ::
          {{[Situ.Time.t()], [term()]} | Columns.t() | nil, non_neg_integer(), t()}
  def take_together({:paced, _items, _time, _interval} = feed, n, {_from, till}),
    do: take_paced(feed, n, till)

  def take_together({:timed, items}, n, {from, till}) do
    case take_item(items) do
      {%Columns{} = columns, items} -> take_columns(columns, items, n, {from, till})
      {item, items} -> {nil, 0, {:timed, {:next, item, items}}}
      :done -> {nil, 0, {:timed, {:list, []}}}
    end
  end

  defp take_columns(columns, items, n, {from, till}) do
    early = if from == nil, do: 0, else: Columns.count_until(columns, from - 1)
    open = if till == :infinity, do: columns.count, else: Columns.count_until(columns, till)
    taken = min(max(open, early), early + n)
    found = if taken > early, do: Columns.slice(columns, early, taken - early)
    {found, taken, {:timed, put_rest(columns, taken, items)}}
  end

  defp take_paced({:paced, items, time, interval} = feed, n, till) when time <= till do
    n = if interval > 0 and till != :infinity, do: min(n, div(till - time, interval) + 1), else: n

    case take_items(items, n) do
      {[], _items} ->
        {nil, 0, feed}

      {values, items} ->
        count = length(values)
        last = time + (count - 1) * interval
        times = spread_times(time, last, interval, values)
        {{times, values}, count, {:paced, items, last + interval, interval}}
    end
  end

  defp take_paced(feed, _n, _till), do: {nil, 0, feed}

  defp spread_times(time, _last, _interval, [_]), do: [time]
  defp spread_times(time, last, interval, _values), do: :lists.seq(time, last, interval)

  defp take_items({:list, list}, n) do
    {values, rest} = Enum.split(list, n)
    {values, {:list, rest}}
  end

  defp take_items({:range, %{first: first, last: last, step: step} = range}, n) do
    count = min(n, Range.size(range))
    next = first + count * step
    values = if count == 0, do: [], else: :lists.seq(first, next - step, step)
    {values, {:range, %{range | first: if(count == 0, do: first, else: next), last: last}}}
  end

  defp take_items(items, n), do: take_each(items, n, [])

  defp take_each({:sequence, _, _, 0} = items, _n, values), do: {:lists.reverse(values), items}
  defp take_each(items, 0, values), do: {:lists.reverse(values), items}

  defp take_each({:sequence, value, _fun, 1}, _n, values),
    do: {:lists.reverse(values, [value]), {:sequence, nil, nil, 0}}

  defp take_each({:sequence, value, fun, left}, n, values) do
    left = if left == :infinity, do: left, else: left - 1
    take_each({:sequence, fun.(value), fun, left}, n - 1, [value | values])
  end

  defp take_each(items, n, values) do
    case take_item(items) do
      :done -> {:lists.reverse(values), {:enum, :done}}
      {value, items} -> take_each(items, n - 1, [value | values])
    end
  end

  @doc "Returns whether no item up to `till` is left, as far as this is known without reading another item."
  @spec known_ended?(t(), Situ.Time.t() | :infinity) :: boolean()
  def known_ended?({:timed, items}, _till), do: no_items?(items)

  def known_ended?({:paced, items, time, _interval}, till),
    do: no_items?(items) or (time > till and not match?({:enum, _}, items))

  defp no_items?({:sequence, _value, _fun, left}), do: left == 0
  defp no_items?({:list, list}), do: list == []
  defp no_items?({:range, range}), do: Enum.empty?(range)
  defp no_items?({:enum, continue}), do: continue == :done
  defp no_items?({:next, _item, _items}), do: false

  @doc "Closes an enumerable that was not read to its end (open files ...)."
  @spec close(t()) :: :ok
  def close({:paced, items, _, _}), do: halt_items(items)
  def close({:timed, items}), do: halt_items(items)

  defp take_item({:next, item, items}), do: {item, items}
  defp take_item({:list, []}), do: :done
  defp take_item({:list, [value | rest]}), do: {value, {:list, rest}}

  defp take_item({:range, %{first: first, last: last, step: step} = range}) do
    if (step > 0 and first > last) or (step < 0 and first < last),
      do: :done,
      else: {first, {:range, %{range | first: first + step}}}
  end

  defp take_item({:enum, :done}), do: :done

  defp take_item({:enum, continue}) do
    case continue.({:cont, nil}) do
      {:suspended, {:item, value}, continue} -> {value, {:enum, continue}}
      # `Stream.take/2` ends with its last item.
      {_done_or_halted, {:item, value}} -> {value, {:enum, :done}}
      {_done_or_halted, nil} -> :done
    end
  end

  defp halt_items({:next, _item, items}), do: halt_items(items)

  defp halt_items({:enum, continue}) when is_function(continue, 1) do
    continue.({:halt, nil})
    :ok
  end

  defp halt_items(_items), do: :ok

  defp no_time_error(other) do
    Situ.Error.new(
      :no_time,
      "expected {time, value}, a message or columns, got: #{inspect(other, limit: 5)}",
      fix: "set every: if the values have no times"
    )
  end
end
