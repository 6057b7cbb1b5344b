defmodule Situ.Experiment.Bisection do
  @moduledoc false
  # Finds the first bad commit of a list, oldest first, of which the last one is known to be bad. A commit that cannot
  # be tested is skipped. Pure, except for the function that tests a commit.

  @type verdict :: :good | :bad | :untestable

  @doc """
  Returns the commits that may be the first bad one, oldest first: exactly one, unless commits next to it cannot be
  tested. The last one is known to be bad. The test gets a commit, and how many may still be the first bad one.

      iex> test = fn n, _left -> if n >= 5, do: :bad, else: :good end
      iex> Situ.Experiment.Bisection.find_first_bad(Enum.to_list(1..8), test)
      [5]
      iex> test = fn n, left -> if n in [4, 5], do: :untestable, else: test.(n, left) end
      iex> Situ.Experiment.Bisection.find_first_bad(Enum.to_list(1..8), test)
      [4, 5, 6]
  """
  @spec find_first_bad([commit, ...], (commit, pos_integer() -> verdict())) :: [commit, ...]
        when commit: term()
  def find_first_bad(commits, test), do: narrow_search(commits, test, MapSet.new())

  # The first bad commit is in the list, and its last one is bad.
  defp narrow_search(commits, test, skipped) do
    middle = div(length(commits) - 1, 2)

    commits
    |> Enum.drop(-1)
    |> Enum.with_index()
    |> Enum.reject(fn {commit, _} -> commit in skipped end)
    |> Enum.sort_by(fn {_, index} -> abs(index - middle) end)
    |> test_nearest(commits, test, skipped)
  end

  @doc """
  Returns about how many commits are still tested if so many may be the first bad one.

      iex> Enum.map([1, 2, 8, 9], &Situ.Experiment.Bisection.estimate_steps/1)
      [0, 1, 3, 4]
  """
  @spec estimate_steps(pos_integer()) :: non_neg_integer()
  def estimate_steps(commits), do: commits |> :math.log2() |> ceil()

  defp test_nearest([], commits, _test, _skipped), do: commits

  defp test_nearest([{commit, index} | _], commits, test, skipped) do
    case test.(commit, length(commits)) do
      :good -> commits |> Enum.drop(index + 1) |> narrow_search(test, skipped)
      :bad -> commits |> Enum.take(index + 1) |> narrow_search(test, skipped)
      :untestable -> narrow_search(commits, test, MapSet.put(skipped, commit))
    end
  end
end
