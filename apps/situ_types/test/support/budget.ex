defmodule Situ.Test.Budget do
  @moduledoc """
  Defines how long tests search for failures: briefly by default, for hours with `bin/test --long`.

      for _ <- 1..Situ.Test.Budget.mutations(500), do: ...

  ExUnit seeds the random numbers of each test from its `--seed`, so a search in the test's process needs no seed. For
  other processes, `random_seed/0` derives a seed from ExUnit's.
  """

  @doc """
  Returns how many times longer than usual a search lasts: the environment variable `SITU_TIMES`, 1 by default.

      iex> Situ.Test.Budget.repeat_factor() >= 1
      true
  """
  @spec repeat_factor() :: pos_integer()
  def repeat_factor, do: "SITU_TIMES" |> System.get_env("1") |> String.to_integer() |> max(1)

  @doc """
  Returns the number of corrupted inputs that a test tries: `usual`, or the number in the environment variable
  `SITU_MUTATIONS`. Raises `ArgumentError` if that is not an integer.
  """
  @spec mutation_count(pos_integer()) :: pos_integer()
  def mutation_count(usual),
    do: "SITU_MUTATIONS" |> System.get_env("#{usual}") |> String.to_integer()

  @doc "Returns a seed for `:rand.seed(:exsss, seed)` in a process that a test starts."
  @spec random_seed() :: non_neg_integer()
  def random_seed, do: :rand.uniform(1_000_000_000)

  @doc """
  Returns the time limit, in ms, of a test that does more work with `bin/test --long`: ten minutes, or ten hours.
  Without a limit, a test that waits forever would hang the whole run without being named.

      iex> Situ.Test.Budget.time_limit_ms() >= 600_000
      true
  """
  @spec time_limit_ms() :: pos_integer()
  def time_limit_ms do
    long? = repeat_factor() > 1 or System.get_env("SITU_MUTATIONS") != nil
    if long?, do: 36_000_000, else: 600_000
  end
end
