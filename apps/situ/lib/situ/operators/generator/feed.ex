defmodule Situ.Generator.Feed do
  @moduledoc false
  # A generator's items, one at a time: `next/1` returns `{time, value, feed}` or `:done`. Pure, except for users'
  # enumerables. Times of a paced feed are start, start + interval, ...

  alias Situ.Sampling

  @type t :: {:paced, items(), Situ.Time.t(), Situ.Time.duration()} | {:timed, items()}
  @type items ::
          {:sequence, term(), (term() -> term()), non_neg_integer() | :infinity}
          | {:list, list()}
          | {:range, Range.t()}
          | {:enum, (Enumerable.acc() -> Enumerable.result()) | :done}

  @doc "Builds a feed of items at an interval, from `start` or the first aligned time after it."
  @spec paced(items(), Situ.Time.t(), Situ.Time.duration(), Situ.Time.t() | nil) :: t()
  def paced(items, start, interval, align),
    do: {:paced, items, Sampling.first_tick(start, interval, align), interval}

  @doc "Builds a feed of items that contain their times: `{time, value}` or a `Situ.Message`."
  @spec timed(items()) :: t()
  def timed(items), do: {:timed, items}

  @doc "Converts an enumerable to items, which are read on demand."
  @spec items(Enumerable.t()) :: items()
  def items(list) when is_list(list), do: {:list, list}
  def items(%Range{} = range), do: {:range, range}

  def items(enumerable) do
    {:enum, &Enumerable.reduce(enumerable, &1, fn item, _ -> {:suspend, {:item, item}} end)}
  end

  @doc "Returns the next item and the rest of the feed."
  @spec next(t()) :: {Situ.Time.t(), term(), t()} | :done
  def next({:paced, {:sequence, _, _, 0}, _time, _interval}), do: :done

  def next({:paced, {:sequence, value, fun, 1}, time, interval}),
    do: {time, value, {:paced, {:sequence, nil, fun, 0}, time + interval, interval}}

  def next({:paced, {:sequence, value, fun, left}, time, interval}) do
    left = if left == :infinity, do: left, else: left - 1
    {time, value, {:paced, {:sequence, fun.(value), fun, left}, time + interval, interval}}
  end

  def next({:paced, items, time, interval}) do
    with {value, items} <- item(items),
         do: {time, value, {:paced, items, time + interval, interval}}
  end

  def next({:timed, items}) do
    case item(items) do
      :done -> :done
      {{time, value}, items} when is_integer(time) -> {time, value, {:timed, items}}
      {%Situ.Message{} = m, items} -> {m.originating_time, m.data, {:timed, items}}
      {other, _items} -> raise not_timed(other)
    end
  end

  @doc "Returns whether it is known, without reading an item, that there are no more items up to `till`."
  @spec ended?(t(), Situ.Time.t() | :infinity) :: boolean()
  def ended?({:timed, items}, _till), do: none?(items)

  def ended?({:paced, items, time, _interval}, till),
    do: none?(items) or (time > till and not match?({:enum, _}, items))

  defp none?({:sequence, _value, _fun, left}), do: left == 0
  defp none?({:list, list}), do: list == []
  defp none?({:range, range}), do: Enum.empty?(range)
  defp none?({:enum, continue}), do: continue == :done

  @doc "Closes an enumerable that was not read to its end (open files ...)."
  @spec close(t()) :: :ok
  def close({:paced, items, _, _}), do: halt(items)
  def close({:timed, items}), do: halt(items)

  defp item({:list, []}), do: :done
  defp item({:list, [value | rest]}), do: {value, {:list, rest}}

  defp item({:range, %{first: first, last: last, step: step} = range}) do
    if (step > 0 and first > last) or (step < 0 and first < last),
      do: :done,
      else: {first, {:range, %{range | first: first + step}}}
  end

  defp item({:enum, :done}), do: :done

  defp item({:enum, continue}) do
    case continue.({:cont, nil}) do
      {:suspended, {:item, value}, continue} -> {value, {:enum, continue}}
      {_done_or_halted, _acc} -> :done
    end
  end

  defp halt({:enum, continue}) when is_function(continue, 1) do
    continue.({:halt, nil})
    :ok
  end

  defp halt(_items), do: :ok

  defp not_timed(other) do
    Situ.Error.new(
      :no_time,
      "expected {time, value} or a message, got: #{inspect(other, limit: 5)}",
      fix: "set every: if the values have no times"
    )
  end
end
