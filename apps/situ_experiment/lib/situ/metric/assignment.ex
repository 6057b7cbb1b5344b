defmodule Situ.Metric.Assignment do
  @moduledoc false
  # Solves the assignment problem: pairs rows with columns so that the sum of costs is least. Pairs with the cost
  # `:never` are not allowed. As many rows as possible are paired, and among these solutions the cheapest is chosen.
  #
  # The method is the Hungarian algorithm with potentials (H. W. Kuhn, 1955; the O(n^3) form of J. Munkres, 1957).

  @type cost :: number() | :never

  @doc """
  Returns `[{row, column}]`, sorted by row.

      iex> Situ.Metric.Assignment.pair_rows([[4, 1, 3], [2, 0, 5], [3, 2, 2]])
      [{0, 1}, {1, 0}, {2, 2}]
      iex> Situ.Metric.Assignment.pair_rows([[1, :never], [2, :never]])
      [{0, 0}]
      iex> Situ.Metric.Assignment.pair_rows([])
      []
  """
  @spec pair_rows([[cost()]]) :: [{non_neg_integer(), non_neg_integer()}]
  def pair_rows([]), do: []
  def pair_rows([[] | _]), do: []

  def pair_rows(rows) do
    if length(rows) <= length(hd(rows)) do
      solve_wide(rows)
    else
      rows |> Enum.zip_with(& &1) |> solve_wide() |> Enum.map(fn {a, b} -> {b, a} end)
    end
    |> Enum.filter(fn {row, column} -> cost_at(rows, row, column) != :never end)
    |> Enum.sort()
  end

  defp cost_at(rows, row, column), do: rows |> Enum.at(row) |> Enum.at(column)

  # Rows and columns count from 1; column 0 means "not paired yet".
  defp solve_wide(rows) do
    forbidden = forbidden_cost(rows)
    costs = for row <- rows, do: List.to_tuple([0 | Enum.map(row, &finite_cost(&1, forbidden))])
    {n, m} = {length(costs), tuple_size(hd(costs)) - 1}
    zeros = fn count -> Map.new(0..count, &{&1, 0}) end
    state = %{costs: List.to_tuple([nil | costs]), m: m, u: zeros.(n), v: zeros.(m), p: zeros.(m)}
    %{p: pairs} = Enum.reduce(1..n, state, &add_row/2)
    for column <- 1..m, pairs[column] > 0, do: {pairs[column] - 1, column - 1}
  end

  # One forbidden pair costs more than all allowed pairs together.
  defp forbidden_cost(rows) do
    allowed = for row <- rows, cost <- row, cost != :never, do: abs(cost)
    1 + 2 * Enum.sum(allowed)
  end

  defp finite_cost(:never, forbidden), do: forbidden
  defp finite_cost(cost, _forbidden), do: cost

  defp add_row(row, state) do
    state = put_in(state.p[0], row)
    search = %{at: 0, least: Map.new(1..state.m, &{&1, :infinity}), from: %{}, used: [0]}
    {state, search} = find_free_column(state, search)
    swap_pairs(state, search.at, search.from)
  end

  defp find_free_column(state, search) do
    row = state.p[search.at]
    search = relax_columns(state, search, row)
    free = Enum.reject(1..state.m, &(&1 in search.used))
    next = Enum.min_by(free, &search.least[&1])
    state = shift_potentials(state, search, search.least[next])
    least = Map.new(search.least, &lower_least(&1, search, search.least[next]))
    search = %{search | at: next, least: least}

    if state.p[next] == 0,
      do: {state, search},
      else: find_free_column(state, %{search | used: [next | search.used]})
  end

  defp relax_columns(state, search, row) do
    Enum.reduce(1..state.m, search, fn column, search ->
      reduced = elem(elem(state.costs, row), column) - state.u[row] - state.v[column]

      if column not in search.used and reduced < search.least[column] do
        %{
          search
          | least: %{search.least | column => reduced},
            from: Map.put(search.from, column, search.at)
        }
      else
        search
      end
    end)
  end

  defp shift_potentials(state, search, delta) do
    Enum.reduce(search.used, state, fn column, state ->
      row = state.p[column]
      state = update_in(state.u[row], &(&1 + delta))
      update_in(state.v[column], &(&1 - delta))
    end)
  end

  defp lower_least({column, :infinity}, _search, _delta), do: {column, :infinity}

  defp lower_least({column, least}, search, delta),
    do: if(column in search.used, do: {column, least}, else: {column, least - delta})

  defp swap_pairs(state, 0, _from), do: state

  defp swap_pairs(state, column, from) do
    before = from[column]
    swap_pairs(put_in(state.p[column], state.p[before]), before, from)
  end
end
