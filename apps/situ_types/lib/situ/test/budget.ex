defmodule Situ.Test.Budget do
  @moduledoc """
  How long tests search: small by default, hours with `bin/test --long`.

      for _ <- 1..Situ.Test.Budget.mutations(500), do: ...

  ExUnit seeds the random numbers of each test by its `--seed`, so a search needs no seed of its own. In another process
  than the test's, `seed/0` gives one that follows from it.
  """

  @doc """
  Returns how many damaged inputs a test tries: `usual`, or the number in the environment variable `SITU_MUTATIONS`.
  Raises `ArgumentError` if that is not a whole number.
  """
  @spec mutations(pos_integer()) :: pos_integer()
  def mutations(usual),
    do: "SITU_MUTATIONS" |> System.get_env("#{usual}") |> String.to_integer()

  @doc "Returns a seed for `:rand.seed(:exsss, seed)` in a process that a test starts."
  @spec seed() :: non_neg_integer()
  def seed, do: :rand.uniform(1_000_000_000)
end
