defmodule Situ.Test.Generators do
  @moduledoc """
  Generators for `Situ.Test.Property`: PropEr's generators under Elixir names, and some for streams.

  A tuple or list of generators is itself a generator. Any other value generates itself.

      iex> {:ok, n} = :proper_gen.pick(Situ.Test.Generators.integer(1, 6))
      iex> n in 1..6
      true
  """

  @type t :: term()

  @doc "Generates integers, preferring small ones."
  @spec integer() :: t()
  def integer, do: :proper_types.integer()

  @doc "Generates integers in `low..high`; shrinks towards the end nearer to zero."
  @spec integer(integer(), integer()) :: t()
  def integer(low, high), do: :proper_types.integer(low, high)

  @doc "Generates integers above zero."
  @spec pos_integer() :: t()
  def pos_integer, do: :proper_types.pos_integer()

  @doc "Generates integers of zero or more."
  @spec non_neg_integer() :: t()
  def non_neg_integer, do: :proper_types.non_neg_integer()

  @doc "Generates floats."
  @spec float() :: t()
  def float, do: :proper_types.float()

  @doc "Generates floats in `low..high`."
  @spec float(float(), float()) :: t()
  def float(low, high), do: :proper_types.float(low, high)

  @doc "Generates `true` or `false`."
  @spec boolean() :: t()
  def boolean, do: :proper_types.boolean()

  @doc "Generates binaries."
  @spec binary() :: t()
  def binary, do: :proper_types.binary()

  @doc "Generates binaries of `bytes` bytes."
  @spec binary(non_neg_integer()) :: t()
  def binary(bytes), do: :proper_types.binary(bytes)

  @doc "Generates strings of printable ASCII characters."
  @spec ascii_text() :: t()
  def ascii_text, do: map(list(integer(32, 126)), &List.to_string/1)

  @doc "Generates terms."
  @spec term() :: t()
  def term, do: :proper_types.term()

  @doc "Generates lists of the generator's values."
  @spec list(t()) :: t()
  def list(generator), do: :proper_types.list(generator)

  @doc "Generates lists of exactly `length` values."
  @spec list(t(), non_neg_integer()) :: t()
  def list(generator, length), do: :proper_types.vector(length, generator)

  @doc "Generates lists of at least one value."
  @spec nonempty_list(t()) :: t()
  def nonempty_list(generator), do: :proper_types.non_empty(list(generator))

  @doc "Chooses among the generators (or plain values); shrinks towards the first."
  @spec one_of([t()]) :: t()
  def one_of(generators), do: :proper_types.oneof(generators)

  @doc "Chooses among the generators according to their weights: `[{3, integer()}, {1, nil}]`."
  @spec frequency([{pos_integer(), t()}]) :: t()
  def frequency(weighted), do: :proper_types.frequency(weighted)

  @doc "Always generates this value, even if it looks like a generator."
  @spec constant(term()) :: t()
  def constant(value), do: :proper_types.exactly(value)

  @doc "Applies `fun` to each value; `fun` may also return a generator."
  @spec map(t(), (term() -> term())) :: t()
  def map(generator, fun), do: :proper_types.bind(generator, fun, false)

  @doc "Keeps the values for which `fun` returns true, which should be most of them."
  @spec filter(t(), (term() -> boolean())) :: t()
  def filter(generator, fun), do: :proper_types.add_constraint(generator, fun, true)

  @doc "Builds a generator from the current size."
  @spec sized((non_neg_integer() -> t())) :: t()
  def sized(fun), do: :proper_types.sized(fun)

  @doc "Runs `generator` at a fixed size."
  @spec resize(t(), non_neg_integer()) :: t()
  def resize(generator, size), do: :proper_types.resize(size, generator)

  @doc """
  Generates the messages of a stream, `[{originating_time, value}]`, with strictly increasing times in steps of 1 to
  `max_step` ns.
  """
  @spec timed_values(t(), pos_integer()) :: t()
  def timed_values(generator, max_step \\ 10) do
    map(list({integer(1, max_step), generator}), fn steps ->
      {messages, _} =
        Enum.map_reduce(steps, 0, fn {step, value}, time ->
          {{time + step, value}, time + step}
        end)

      messages
    end)
  end

  @doc "Splits `items` into non-empty batches of random sizes, as a scheduler may deliver them."
  @spec random_batches([term()]) :: t()
  def random_batches(items) do
    map(list(integer(1, 8)), &cut_batches(items, &1))
  end

  defp cut_batches([], _sizes), do: []
  defp cut_batches(items, []), do: [items]

  defp cut_batches(items, [size | sizes]) do
    {batch, rest} = Enum.split(items, size)
    [batch | cut_batches(rest, sizes)]
  end
end
