defmodule Situ.Experiment.Search do
  @moduledoc false
  # Chooses which sets of parameters run over which sessions. A grid runs all; a random search runs some of them; and
  # successive halving (K. Jamieson, A. Talwalkar, 2016) runs all sets over few sessions, keeps the better half, and
  # doubles the sessions until the remaining sets have run over all of them.
  alias Situ.Metric.Statistics

  @doc "Returns `items` in a random order that the seed determines."
  @spec shuffle([item], integer()) :: [item] when item: term()
  def shuffle(items, seed) do
    {keyed, _} =
      Enum.map_reduce(items, Statistics.seed_random(seed), fn item, state ->
        {x, state} = :rand.uniform_s(state)
        {{x, item}, state}
      end)

    keyed |> Enum.sort_by(&elem(&1, 0)) |> Enum.map(&elem(&1, 1))
  end

  @doc """
  Returns the rounds of successive halving as `{number of sets, number of sessions}`.

      iex> Situ.Experiment.Search.halving_rounds(8, 12)
      [{8, 2}, {4, 4}, {2, 8}, {1, 12}]
      iex> Situ.Experiment.Search.halving_rounds(1, 12)
      [{1, 12}]
  """
  @spec halving_rounds(pos_integer(), pos_integer()) :: [{pos_integer(), pos_integer()}]
  def halving_rounds(sets, sessions),
    do: list_rounds(sets, first_sessions(sets, sessions), sessions)

  # The number of sessions doubles whenever the number of sets halves, and reaches all sessions with the last set.
  defp first_sessions(sets, sessions) do
    rounds = sets |> :math.log2() |> ceil()
    max(ceil(sessions / 2 ** rounds), min(2, sessions))
  end

  defp list_rounds(1, _sessions, all), do: [{1, all}]
  defp list_rounds(sets, sessions, all) when sessions >= all, do: [{sets, all}]

  defp list_rounds(sets, sessions, all),
    do: [{sets, sessions} | list_rounds(div(sets + 1, 2), min(2 * sessions, all), all)]

  @doc """
  Returns the best `count` of `[{item, value}]`. Undefined values are the worst.

      iex> Situ.Experiment.Search.keep_best([a: 0.1, b: nil, c: 0.3], 2, :higher)
      [:c, :a]
  """
  @spec keep_best([{item, number() | nil}], pos_integer(), :higher | :lower) :: [item]
        when item: term()
  def keep_best(scored, count, direction) do
    {known, unknown} = Enum.split_with(scored, fn {_, value} -> is_number(value) end)
    sign = if direction == :higher, do: -1, else: 1
    known = Enum.sort_by(known, fn {_, value} -> sign * value end)
    (known ++ unknown) |> Enum.take(count) |> Enum.map(&elem(&1, 0))
  end
end
