defmodule Situ.Statistics.Sliding do
  @moduledoc false
  # A statistic of the values in a sliding window. The newest value is added, the oldest is removed, and the result is
  # available in constant time for any window size.
  #
  # The window is two stacks of partial results (Tangwongsan, Hirzel, Schneider, Wu: General incremental
  # sliding-window aggregation, VLDB 2015). Nothing is ever subtracted, so sums do not drift, and a `:nan` has no
  # effect after it has left the window. A value costs about three combinations of partial results, on average.
  # Deviations are combined by the formula of Chan, Golub and LeVeque (1979). Values and results are as in
  # `Situ.Statistics`.
  alias Situ.{Number, Statistics}

  # front: `{time, result from here to the end of the front}`, oldest first; back: `{time, value}`, newest first,
  # and its result.
  @enforce_keys [:kind, :opts]
  defstruct [:kind, :opts, front: [], back: [], back_result: :none, size: 0]

  @type t :: %__MODULE__{
          kind: Statistics.kind(),
          opts: map(),
          front: [{Situ.Time.t(), term()}],
          back: [{Situ.Time.t(), term()}],
          back_result: term(),
          size: non_neg_integer()
        }

  @doc "Builds an empty window. Only the option `compare:` has an effect."
  @spec new(Statistics.kind(), keyword()) :: t()
  def new(kind, opts \\ []), do: %__MODULE__{kind: kind, opts: Map.new(opts)}

  @doc "Returns the number of values in the window."
  @spec size(t()) :: non_neg_integer()
  def size(%__MODULE__{size: size}), do: size

  @doc """
  Adds the newest value with its time.

      iex> window = Enum.reduce([5, 1, 4], Situ.Statistics.Sliding.new(:max), &Situ.Statistics.Sliding.push(&2, 0, &1))
      iex> Situ.Statistics.Sliding.current_result(window)
      5
      iex> window |> Situ.Statistics.Sliding.pop() |> Situ.Statistics.Sliding.current_result()
      4
  """
  @spec push(t(), Situ.Time.t(), term()) :: t()
  def push(%__MODULE__{} = window, time, value) do
    one = lift_value(window.kind, value)

    result =
      if window.back_result == :none,
        do: one,
        else: combine_results(window, window.back_result, one)

    %{window | back: [{time, value} | window.back], back_result: result, size: window.size + 1}
  end

  @doc "Removes the oldest value."
  @spec pop(t()) :: t()
  def pop(%__MODULE__{front: [_oldest | front]} = window),
    do: %{window | front: front, size: window.size - 1}

  def pop(%__MODULE__{back: [_ | _]} = window), do: window |> move_back_to_front() |> pop()

  @doc "Removes the values before `time`."
  @spec drop_before(t(), Situ.Time.t()) :: t()
  def drop_before(%__MODULE__{front: [{at, _} | _]} = window, time) when at < time,
    do: window |> pop() |> drop_before(time)

  def drop_before(%__MODULE__{front: [], back: [_ | _]} = window, time),
    do: window |> move_back_to_front() |> drop_before(time)

  def drop_before(window, _time), do: window

  @doc "Returns the statistic of the values in the window, which must not be empty."
  @spec current_result(t()) :: term()
  def current_result(%__MODULE__{front: [], back_result: back} = window),
    do: final_result(window, back)

  def current_result(%__MODULE__{front: [{_, front} | _], back_result: :none} = window),
    do: final_result(window, front)

  def current_result(%__MODULE__{front: [{_, front} | _], back_result: back} = window),
    do: final_result(window, combine_results(window, front, back))

  # Moves the back to the front, as partial results from each value to the newest.
  defp move_back_to_front(%{back: [{time, value} | older]} = window) do
    newest = {time, lift_value(window.kind, value)}
    %{window | front: suffix_results(older, [newest], window), back: [], back_result: :none}
  end

  defp suffix_results([], front, _window), do: front

  defp suffix_results([{time, value} | older], [{_, result} | _] = front, window) do
    result = combine_results(window, lift_value(window.kind, value), result)
    suffix_results(older, [{time, result} | front], window)
  end

  defp lift_value(:count, _value), do: 1
  defp lift_value(:sum, nil), do: 0
  defp lift_value(:sum, value), do: Number.add(value, 0)
  defp lift_value(:average, nil), do: {0, 0}
  defp lift_value(:average, value), do: {1, Number.add(value, 0)}
  defp lift_value(:std, nil), do: {0, 0.0, 0.0}
  defp lift_value(:std, value), do: {1, Number.add(value, 0), 0.0}
  defp lift_value(_least_or_greatest, value), do: value

  defp combine_results(%{kind: :count}, a, b), do: a + b
  defp combine_results(%{kind: :sum}, a, b), do: Number.add(a, b)
  defp combine_results(%{kind: :average}, {n, a}, {m, b}), do: {n + m, Number.add(a, b)}
  defp combine_results(%{kind: :std}, {0, _, _}, b), do: b
  defp combine_results(%{kind: :std}, a, {0, _, _}), do: a

  defp combine_results(%{kind: :std}, {n, mean, squares}, {m, other, more}) do
    size = n + m
    apart = Number.subtract(other, mean)
    mean = Number.add(mean, Number.multiply(apart, m / size))
    {size, mean, Number.add(Number.add(squares, more), squares_between(apart, n * m / size))}
  end

  defp combine_results(%{kind: _least_or_greatest}, nil, b), do: b
  defp combine_results(%{kind: _least_or_greatest}, a, nil), do: a

  defp combine_results(%{kind: kind, opts: opts}, a, b),
    do: Statistics.pick_better(kind, a, b, opts)

  # Deviations from an infinite mean are undefined.
  defp squares_between(apart, weight) when is_number(apart),
    do: Number.multiply(Number.multiply(apart, apart), weight)

  defp squares_between(_not_finite, _weight), do: :nan

  defp final_result(%{kind: :average}, {0, _}), do: nil
  defp final_result(%{kind: :average}, {n, sum}), do: Number.divide(sum, n)
  defp final_result(%{kind: :std}, {n, _, _}) when n < 2, do: 0.0

  defp final_result(%{kind: :std}, {n, _, squares}),
    do: squares |> Number.divide(n - 1) |> Number.sqrt()

  defp final_result(_window, result), do: result
end
