defmodule Situ.Simulation.Choices do
  @moduledoc false
  # The choices of a schedule: small integers in shared memory, in the order in which they were made. All processes of a
  # simulation draw from them, without a message. A schedule is drawn from a seed, or replayed from a list; after the
  # end of the list every choice is 0, the usual course.
  import Bitwise

  @most 65_536
  @cursor 1

  @enforce_keys [:cells, :values, :seed, :given]
  defstruct [:cells, :values, :seed, :given]

  @typedoc "`given` is the number of choices that are replayed; `seed` is `nil` in a replay."
  @type t :: %__MODULE__{
          cells: :atomics.atomics_ref(),
          values: :atomics.atomics_ref(),
          seed: integer() | nil,
          given: non_neg_integer()
        }

  @doc "Returns choices that are drawn from a seed, or replayed from a list. `old` choices give up their memory."
  @spec new(integer() | [non_neg_integer()], t() | nil) :: t()
  def new(source, old \\ nil)

  def new(seed, old) when is_integer(seed), do: %{allocate(old) | seed: seed}

  def new(list, old) when is_list(list) do
    choices = allocate(old)
    list = Enum.take(list, @most)
    for {value, i} <- Enum.with_index(list, 1), do: :atomics.put(choices.values, i, value)
    %{choices | given: length(list)}
  end

  defp allocate(nil) do
    cells = :atomics.new(1, signed: true)
    %__MODULE__{cells: cells, values: :atomics.new(@most, signed: true), seed: nil, given: 0}
  end

  defp allocate(old) do
    :atomics.put(old.cells, @cursor, 0)
    %{old | seed: nil, given: 0}
  end

  @doc """
  Chooses a number below `n`. In a new schedule, `propose` gets a random number and returns the choice.
  """
  @spec choose(t(), pos_integer(), (non_neg_integer() -> non_neg_integer())) :: non_neg_integer()
  def choose(%__MODULE__{} = choices, n, propose) do
    i = :atomics.add_get(choices.cells, @cursor, 1)
    value = choose_at(choices, i, n, propose)
    if i <= @most, do: :atomics.put(choices.values, i, value)
    value
  end

  defp choose_at(%{seed: nil, given: given}, i, _n, _propose) when i > given, do: 0

  defp choose_at(%{seed: nil, values: values}, i, n, _propose),
    do: min(:atomics.get(values, i), n - 1)

  defp choose_at(%{seed: seed}, i, n, propose), do: min(propose.(random(seed, i)), n - 1)

  @doc "Chooses 0, or once in about `odds` times another number below `n`."
  @spec choose_rarely(t(), pos_integer(), pos_integer()) :: non_neg_integer()
  def choose_rarely(choices, n, odds) do
    choose(choices, n, fn random ->
      if rem(random, odds) == 0, do: 1 + rem(div(random, odds), n - 1), else: 0
    end)
  end

  @doc "Returns a number below 2^32 for a seed and any term."
  @spec random(integer(), term()) :: non_neg_integer()
  def random(seed, term), do: :erlang.phash2({seed, term, seed}, 1 <<< 32)

  @doc "Returns all choices that were made, without zeros at the end."
  @spec to_list(t()) :: [non_neg_integer()]
  def to_list(%__MODULE__{cells: cells, values: values}) do
    n = min(:atomics.get(cells, @cursor), @most)
    trim_zeros(for i <- 1..n//1, do: :atomics.get(values, i))
  end

  @doc "Removes zeros from the end of a list of choices."
  @spec trim_zeros([non_neg_integer()]) :: [non_neg_integer()]
  def trim_zeros(list),
    do: list |> Enum.reverse() |> Enum.drop_while(&(&1 == 0)) |> Enum.reverse()
end
