defmodule Situ.Statistics.Sliding do
  @moduledoc """
  A statistic of the values in a sliding window. The newest value is added, the oldest is removed, and the result is
  available in constant time for any window size.

      iex> window = Enum.reduce([5, 1, 4], Situ.Statistics.Sliding.new(:max), &Situ.Statistics.Sliding.push(&2, 0, &1))
      iex> Situ.Statistics.Sliding.result(window)
      5
      iex> window |> Situ.Statistics.Sliding.pop() |> Situ.Statistics.Sliding.result()
      4

  The window is two stacks of partial results (Tangwongsan, Hirzel, Schneider, Wu: General incremental sliding-window
  aggregation, VLDB 2015), so nothing is ever subtracted: sums do not drift, and a `:nan` is forgotten when it leaves. A
  value costs about three combinations of partial results, on average. Deviations are combined by the formula of Chan,
  Golub and LeVeque (1979).

  Values and results are as in `Situ.Statistics`.
  """

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

  @doc "Adds the newest value with its time."
  @spec push(t(), Situ.Time.t(), term()) :: t()
  def push(%__MODULE__{} = window, time, value) do
    one = lift(window.kind, value)
    result = if window.back_result == :none, do: one, else: join(window, window.back_result, one)
    %{window | back: [{time, value} | window.back], back_result: result, size: window.size + 1}
  end

  @doc "Removes the oldest value."
  @spec pop(t()) :: t()
  def pop(%__MODULE__{front: [_oldest | front]} = window),
    do: %{window | front: front, size: window.size - 1}

  def pop(%__MODULE__{back: [_ | _]} = window), do: window |> turn() |> pop()

  @doc "Removes the values before `time`."
  @spec since(t(), Situ.Time.t()) :: t()
  def since(%__MODULE__{front: [{at, _} | _]} = window, time) when at < time,
    do: window |> pop() |> since(time)

  def since(%__MODULE__{front: [], back: [_ | _]} = window, time),
    do: window |> turn() |> since(time)

  def since(window, _time), do: window

  @doc "Returns the statistic of the values in the window, which must not be empty."
  @spec result(t()) :: term()
  def result(%__MODULE__{front: [], back_result: back} = window), do: final(window, back)

  def result(%__MODULE__{front: [{_, front} | _], back_result: :none} = window),
    do: final(window, front)

  def result(%__MODULE__{front: [{_, front} | _], back_result: back} = window),
    do: final(window, join(window, front, back))

  # Moves the back to the front, as partial results from each value to the newest.
  defp turn(%{back: [{time, value} | older]} = window) do
    newest = {time, lift(window.kind, value)}
    %{window | front: suffixes(older, [newest], window), back: [], back_result: :none}
  end

  defp suffixes([], front, _window), do: front

  defp suffixes([{time, value} | older], [{_, result} | _] = front, window) do
    result = join(window, lift(window.kind, value), result)
    suffixes(older, [{time, result} | front], window)
  end

  defp lift(:count, _value), do: 1
  defp lift(:sum, nil), do: 0
  defp lift(:sum, value), do: Number.add(value, 0)
  defp lift(:average, nil), do: {0, 0}
  defp lift(:average, value), do: {1, Number.add(value, 0)}
  defp lift(:std, nil), do: {0, 0.0, 0.0}
  defp lift(:std, value), do: {1, Number.add(value, 0), 0.0}
  defp lift(_least_or_greatest, value), do: value

  defp join(%{kind: :count}, a, b), do: a + b
  defp join(%{kind: :sum}, a, b), do: Number.add(a, b)
  defp join(%{kind: :average}, {n, a}, {m, b}), do: {n + m, Number.add(a, b)}
  defp join(%{kind: :std}, {0, _, _}, b), do: b
  defp join(%{kind: :std}, a, {0, _, _}), do: a

  defp join(%{kind: :std}, {n, mean, squares}, {m, other, more}) do
    size = n + m
    apart = Number.subtract(other, mean)
    mean = Number.add(mean, Number.multiply(apart, m / size))
    {size, mean, Number.add(Number.add(squares, more), between(apart, n * m / size))}
  end

  defp join(%{kind: _least_or_greatest}, nil, b), do: b
  defp join(%{kind: _least_or_greatest}, a, nil), do: a
  defp join(%{kind: kind, opts: opts}, a, b), do: Statistics.better(kind, a, b, opts)

  # Deviations from an infinite mean are undefined.
  defp between(apart, weight) when is_number(apart),
    do: Number.multiply(Number.multiply(apart, apart), weight)

  defp between(_not_finite, _weight), do: :nan

  defp final(%{kind: :average}, {0, _}), do: nil
  defp final(%{kind: :average}, {n, sum}), do: Number.divide(sum, n)
  defp final(%{kind: :std}, {n, _, _}) when n < 2, do: 0.0

  defp final(%{kind: :std}, {n, _, squares}),
    do: squares |> Number.divide(n - 1) |> Number.sqrt()

  defp final(_window, result), do: result
end
