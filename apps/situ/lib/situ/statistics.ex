defmodule Situ.Statistics do
  @moduledoc false
  # Computes the count, sum, minimum, maximum, average and standard deviation of a list, or step by step. `Situ.sum/2`
  # describes the values. `:min` and `:max` take any terms of one kind.
  #
  # The deviation is the sample deviation (n - 1). A list of fewer than two numbers has a deviation of 0.0. If
  # computed step by step, the deviation of the first number is `:nan` (or the option `initial:`).
  alias Situ.Number

  @kinds [:count, :sum, :min, :max, :average, :std]

  @type kind :: :count | :sum | :min | :max | :average | :std
  @opaque state :: {kind(), term(), map()}

  @doc "Computes the statistic of a list."
  @spec of_list(kind(), list(), keyword()) :: term()
  def of_list(kind, list, opts \\ [])
  def of_list(:count, list, _opts), do: length(list)
  def of_list(:std, list, _opts), do: list |> Enum.reject(&is_nil/1) |> sample_deviation()
  def of_list(:sum, list, _opts), do: Enum.reduce(list, 0, &add_to_sum/2)

  def of_list(kind, [], opts) do
    if opts[:nullable] do
      nil
    else
      raise Situ.Error.new(:empty_list, "an empty list has no #{kind}",
              why: "an empty list has no values",
              fix: "set nullable: true to get nil, or filter out empty lists"
            )
    end
  end

  def of_list(kind, list, opts) when kind in @kinds do
    {results, _state} = Enum.map_reduce(list, initial_state(kind, opts), &add_value(&2, &1))
    List.last(results)
  end

  @doc "Returns the state before the first value."
  @spec initial_state(kind(), keyword()) :: state()
  def initial_state(kind, opts \\ []) when kind in @kinds do
    {kind, zero_state(kind), Map.new(opts)}
  end

  @doc """
  Adds a value, and returns the statistic of all values so far and the next state.

      iex> Situ.Statistics.of_list(:std, [1, 2, 3, 4])
      1.2909944487358056
      iex> state = Situ.Statistics.initial_state(:min)
      iex> {results, _state} = Enum.map_reduce([5, 3, 4], state, &Situ.Statistics.add_value(&2, &1))
      iex> results
      [5, 3, 3]
  """
  @spec add_value(state(), term()) :: {term(), state()}
  def add_value({:count, n, opts}, _value), do: {n + 1, {:count, n + 1, opts}}

  def add_value({:sum, sum, opts}, value) do
    sum = add_to_sum(value, sum)
    {sum, {:sum, sum, opts}}
  end

  def add_value({kind, best, opts}, nil) when kind in [:min, :max], do: {best, {kind, best, opts}}

  def add_value({kind, nil, opts}, value) when kind in [:min, :max],
    do: {value, {kind, value, opts}}

  def add_value({kind, best, opts}, value) when kind in [:min, :max] do
    best = pick_better(kind, best, value, opts)
    {best, {kind, best, opts}}
  end

  def add_value({:average, {n, _sum} = state, opts}, nil),
    do: {if(n > 0, do: divide_sum(state)), {:average, state, opts}}

  def add_value({:average, {n, sum}, opts}, value) do
    state = {n + 1, Number.add(sum, value)}
    {divide_sum(state), {:average, state, opts}}
  end

  def add_value({:std, {n, _, _} = state, opts}, nil),
    do: {if(n > 0, do: running_deviation(state, opts)), {:std, state, opts}}

  # Welford's algorithm avoids differences of large squares.
  def add_value({:std, {n, mean, squares}, opts}, value) do
    delta = Number.subtract(value, mean)
    mean = Number.add(mean, Number.divide(delta, n + 1))
    squares = Number.add(squares, Number.multiply(delta, Number.subtract(value, mean)))
    state = {n + 1, mean, squares}
    {running_deviation(state, opts), {:std, state, opts}}
  end

  defp zero_state(:average), do: {0, 0}
  defp zero_state(:std), do: {0, 0.0, 0.0}
  defp zero_state(kind) when kind in [:min, :max], do: nil
  defp zero_state(_kind), do: 0

  defp add_to_sum(nil, sum), do: sum
  defp add_to_sum(value, sum), do: Number.add(sum, value)

  defp divide_sum({n, sum}), do: Number.divide(sum, n)

  defp running_deviation({1, _mean, squares}, opts) do
    if squares == :nan, do: :nan, else: Map.get(opts, :initial, :nan)
  end

  defp running_deviation({n, _mean, squares}, _opts),
    do: squares |> Number.divide(n - 1) |> Number.sqrt()

  defp sample_deviation([]), do: 0.0
  defp sample_deviation([_]), do: 0.0

  defp sample_deviation(list) do
    n = length(list)
    mean = list |> Enum.reduce(0, &Number.add(&2, &1)) |> Number.divide(n)

    list
    |> Enum.reduce(0.0, fn value, squares ->
      delta = Number.subtract(value, mean)
      Number.add(squares, Number.multiply(delta, delta))
    end)
    |> Number.divide(n - 1)
    |> Number.sqrt()
  end

  @doc false
  # Returns the lesser or greater of two values, or the first if they are equal.
  @spec pick_better(:min | :max, term(), term(), map()) :: term()
  def pick_better(:min, a, b, %{compare: fun}), do: if(fun.(a, b), do: a, else: b)
  def pick_better(:max, a, b, %{compare: fun}), do: if(fun.(a, b), do: b, else: a)

  def pick_better(:min, a, b, _opts),
    do: if(Number.number?(a), do: Number.min(a, b), else: min(a, b))

  def pick_better(:max, a, b, _opts),
    do: if(Number.number?(a), do: Number.max(a, b), else: max(a, b))
end
