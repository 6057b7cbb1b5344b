defmodule Situ.Simulation.Choices do
  @moduledoc false
  # The choices of a schedule: small integers in shared memory, in the order in which they were made. All processes of a
  # simulation draw from them, without a message. A schedule is drawn from a seed, or replayed. Choice 0 is the usual
  # course, so a schedule is given by its other choices, the deviations.
  import Bitwise

  @most 65_536
  @cursor 1
  @deviations 2

  @enforce_keys [:cells, :values, :seed, :given]
  defstruct [:cells, :values, :seed, :given]

  @typedoc "The choices that are not 0, by position."
  @type deviations :: %{pos_integer() => pos_integer()}
  @typedoc "`given` is the number of choices that are replayed; `seed` is `nil` in a replay."
  @type t :: %__MODULE__{
          cells: :atomics.atomics_ref(),
          values: :atomics.atomics_ref(),
          seed: integer() | nil,
          given: non_neg_integer()
        }

  @doc """
  Returns choices that are drawn from a seed, or replayed from the choices that are not 0, by position. They take over
  the memory of `old` choices.
  """
  @spec new(integer() | deviations(), t() | nil) :: t()
  def new(source, old \\ nil)

  def new(seed, old) when is_integer(seed), do: %{allocate(old) | seed: seed}

  def new(deviations, old) when is_map(deviations) do
    choices = allocate(old)
    given = deviations |> Map.keys() |> Enum.filter(&(&1 <= @most)) |> Enum.max(fn -> 0 end)
    for i <- 1..given//1, do: :atomics.put(choices.values, i, Map.get(deviations, i, 0))
    %{choices | given: given}
  end

  defp allocate(nil) do
    cells = :atomics.new(2, signed: true)
    %__MODULE__{cells: cells, values: :atomics.new(@most, signed: true), seed: nil, given: 0}
  end

  defp allocate(old) do
    for cell <- [@cursor, @deviations], do: :atomics.put(old.cells, cell, 0)
    %{old | seed: nil, given: 0}
  end

  @doc """
  Chooses a number below `n`. In a new schedule, `propose` gets a random number and returns the choice.
  """
  @spec choose_number(t(), pos_integer(), (non_neg_integer() -> non_neg_integer())) ::
          non_neg_integer()
  def choose_number(%__MODULE__{} = choices, n, propose) do
    i = :atomics.add_get(choices.cells, @cursor, 1)
    value = choose_at(choices, i, n, propose)
    if i <= @most, do: :atomics.put(choices.values, i, value)
    if value != 0, do: :atomics.add(choices.cells, @deviations, 1)
    value
  end

  defp choose_at(%{seed: nil, given: given}, i, _n, _propose) when i > given, do: 0

  defp choose_at(%{seed: nil, values: values}, i, n, _propose),
    do: min(:atomics.get(values, i), n - 1)

  defp choose_at(_choices, i, _n, _propose) when i > @most, do: 0

  defp choose_at(%{seed: seed}, i, n, propose), do: min(propose.(random_number(seed, i)), n - 1)

  @doc "Chooses 0, or once in about `odds` times another number below `n`."
  @spec choose_rarely(t(), pos_integer(), pos_integer()) :: non_neg_integer()
  def choose_rarely(_choices, 1, _odds), do: 0

  def choose_rarely(choices, n, odds) do
    choose_number(choices, n, fn random ->
      if rem(random, odds) == 0, do: 1 + rem(div(random, odds), n - 1), else: 0
    end)
  end

  @doc "Returns a number below 2^32 for a seed and any term."
  @spec random_number(integer(), term()) :: non_neg_integer()
  def random_number(seed, term), do: :erlang.phash2({seed, term, seed}, 1 <<< 32)

  @doc "Returns how many choices were not 0."
  @spec count_deviations(t()) :: non_neg_integer()
  def count_deviations(%__MODULE__{cells: cells}), do: :atomics.get(cells, @deviations)

  @doc "Returns the choices that were not 0, by position."
  @spec list_deviations(t()) :: deviations()
  def list_deviations(%__MODULE__{cells: cells, values: values}) do
    n = min(:atomics.get(cells, @cursor), @most)
    for i <- 1..n//1, value = :atomics.get(values, i), value != 0, into: %{}, do: {i, value}
  end
end
