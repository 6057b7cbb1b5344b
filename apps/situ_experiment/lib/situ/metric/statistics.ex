defmodule Situ.Metric.Statistics do
  @moduledoc false
  # Intervals and tests over sessions. A statistic is a function of a list of measurements, one for each session.
  #
  # Sessions are drawn again with replacement (the percentile bootstrap of B. Efron, 1979). Two variants are compared
  # by exchanging their measurements within sessions (the permutation test of R. A. Fisher, 1935): the p-value is the
  # share of exchanges with a difference at least as large as the real one. All random choices follow from the seed.

  @type statistic :: ([term()] -> number() | nil)

  @resamples 1_000
  @most_exact 12
  @permutations 4_096

  @doc """
  Returns the bounds of the 95 % interval of a statistic, or `nil` if fewer than two sessions have been measured or the
  statistic is undefined.

      iex> mean = &(Enum.sum(&1) / length(&1))
      iex> {low, high} = Situ.Metric.Statistics.bootstrap_interval([1, 2, 3, 4, 5], mean, 1)
      iex> low < 3 and high > 3
      true
      iex> Situ.Metric.Statistics.bootstrap_interval([2, 2, 2], mean, 1)
      {2.0, 2.0}
  """
  @spec bootstrap_interval([term()], statistic(), integer()) :: {number(), number()} | nil
  def bootstrap_interval(items, _statistic, _seed) when length(items) < 2, do: nil

  def bootstrap_interval(items, statistic, seed) do
    values = for sample <- draw_samples(items, seed), value = statistic.(sample), do: value
    if values == [], do: nil, else: {quantile(values, 0.025), quantile(values, 0.975)}
  end

  defp draw_samples(items, seed) do
    {items, n} = {List.to_tuple(items), length(items)}
    state = seed_random(seed)

    {samples, _} =
      Enum.map_reduce(1..@resamples, state, fn _, state ->
        Enum.map_reduce(1..n, state, fn _, state ->
          {i, state} = :rand.uniform_s(n, state)
          {elem(items, i - 1), state}
        end)
      end)

    samples
  end

  @doc "Returns the state of a random number generator for a seed."
  @spec seed_random(integer()) :: :rand.state()
  def seed_random(seed), do: :rand.seed_s(:exsss, {seed, 171, 172})

  @doc """
  Returns a quantile with linear interpolation between the values.

      iex> Situ.Metric.Statistics.quantile([4, 1, 3, 2], 0.5)
      2.5
  """
  @spec quantile([number()], number()) :: float()
  def quantile(values, share) do
    sorted = values |> Enum.sort() |> List.to_tuple()
    at = share * (tuple_size(sorted) - 1)
    low = trunc(at)
    high = min(low + 1, tuple_size(sorted) - 1)
    elem(sorted, low) + (at - low) * (elem(sorted, high) - elem(sorted, low)) * 1.0
  end

  @doc """
  Compares two variants on the same sessions. Returns the difference of the statistic (second minus first), its 95 %
  interval and the two-sided p-value. The test is exact for up to 12 sessions.

      iex> mean = &(Enum.sum(&1) / length(&1))
      iex> result = Situ.Metric.Statistics.compare_pairs([{1, 2}, {2, 3}, {5, 6}, {3, 4}], mean, 1)
      iex> {result.difference, result.p}
      {1.0, 0.125}
  """
  @spec compare_pairs([{term(), term()}], statistic(), integer()) :: %{
          difference: number() | nil,
          interval: {number(), number()} | nil,
          p: float() | nil
        }
  def compare_pairs(pairs, statistic, seed) do
    difference = fn pairs ->
      {first, second} = Enum.unzip(pairs)

      with a when a != nil <- statistic.(first),
           b when b != nil <- statistic.(second),
           do: b - a
    end

    case pairs != [] && difference.(pairs) do
      none when none in [nil, false] ->
        %{difference: nil, interval: nil, p: nil}

      real ->
        %{
          difference: real,
          interval: bootstrap_interval(pairs, difference, seed),
          p: permutation_p(pairs, difference, abs(real), seed)
        }
    end
  end

  # Rounding errors must not make an exchange look smaller than the real difference.
  defp permutation_p(pairs, difference, real, seed) do
    exact? = length(pairs) <= @most_exact
    exchanges = if exact?, do: all_exchanges(pairs), else: random_exchanges(pairs, seed)
    limit = real - 1.0e-12 * max(real, 1.0)
    values = for exchange <- exchanges, value = difference.(exchange), do: abs(value)
    extreme = Enum.count(values, &(&1 >= limit))

    cond do
      values == [] -> nil
      exact? -> extreme / length(values)
      true -> (extreme + 1) / (length(values) + 1)
    end
  end

  defp all_exchanges([]), do: [[]]

  defp all_exchanges([{a, b} | rest]) do
    for others <- all_exchanges(rest), pair <- [{a, b}, {b, a}], do: [pair | others]
  end

  defp random_exchanges(pairs, seed) do
    {exchanges, _} =
      Enum.map_reduce(1..@permutations, seed_random(seed), fn _, state ->
        Enum.map_reduce(pairs, state, fn {a, b}, state ->
          {coin, state} = :rand.uniform_s(2, state)
          {if(coin == 1, do: {a, b}, else: {b, a}), state}
        end)
      end)

    exchanges
  end
end
