defmodule Situ.Test.Gen do
  @moduledoc """
  Generators for `Situ.Test.Property`: PropEr's, under Elixir's names, and some for streams.

  A tuple or a list of generators is a generator; so is any plain value (it generates itself).

      iex> {:ok, n} = :proper_gen.pick(Situ.Test.Gen.integer(1, 6))
      iex> n in 1..6
      true
  """

  @type t :: term()

  @doc "Any integer, small ones more often."
  @spec integer() :: t()
  def integer, do: :proper_types.integer()

  @doc "An integer of `low..high`; shrinks towards the end nearer to zero."
  @spec integer(integer(), integer()) :: t()
  def integer(low, high), do: :proper_types.integer(low, high)

  @doc "An integer above zero."
  @spec pos_integer() :: t()
  def pos_integer, do: :proper_types.pos_integer()

  @doc "An integer of zero or more."
  @spec non_neg_integer() :: t()
  def non_neg_integer, do: :proper_types.non_neg_integer()

  @doc "Any float."
  @spec float() :: t()
  def float, do: :proper_types.float()

  @doc "A float of `low..high`."
  @spec float(float(), float()) :: t()
  def float(low, high), do: :proper_types.float(low, high)

  @doc "`true` or `false`."
  @spec boolean() :: t()
  def boolean, do: :proper_types.boolean()

  @doc "Any bytes."
  @spec binary() :: t()
  def binary, do: :proper_types.binary()

  @doc "`bytes` bytes."
  @spec binary(non_neg_integer()) :: t()
  def binary(bytes), do: :proper_types.binary(bytes)

  @doc "Text of printable ASCII characters."
  @spec text() :: t()
  def text, do: map(list(integer(32, 126)), &List.to_string/1)

  @doc "Any term."
  @spec term() :: t()
  def term, do: :proper_types.term()

  @doc "A list of `generator`'s values."
  @spec list(t()) :: t()
  def list(generator), do: :proper_types.list(generator)

  @doc "A list of exactly `length` values."
  @spec list(t(), non_neg_integer()) :: t()
  def list(generator, length), do: :proper_types.vector(length, generator)

  @doc "A list of at least one value."
  @spec nonempty_list(t()) :: t()
  def nonempty_list(generator), do: :proper_types.non_empty(list(generator))

  @doc "One of these generators (or plain values); shrinks towards the first."
  @spec one_of([t()]) :: t()
  def one_of(generators), do: :proper_types.oneof(generators)

  @doc "One of these generators, as often as its weight says: `[{3, integer()}, {1, nil}]`."
  @spec frequency([{pos_integer(), t()}]) :: t()
  def frequency(weighted), do: :proper_types.frequency(weighted)

  @doc "Always this very value, even if it looks like a generator."
  @spec constant(term()) :: t()
  def constant(value), do: :proper_types.exactly(value)

  @doc "`fun` of each value; `fun` may also return a generator."
  @spec map(t(), (term() -> term())) :: t()
  def map(generator, fun), do: :proper_types.bind(generator, fun, false)

  @doc "Only values for which `fun` is true; it should be true for most."
  @spec filter(t(), (term() -> boolean())) :: t()
  def filter(generator, fun), do: :proper_types.add_constraint(generator, fun, true)

  @doc "A generator built from the current size."
  @spec sized((non_neg_integer() -> t())) :: t()
  def sized(fun), do: :proper_types.sized(fun)

  @doc "`generator` at a fixed size."
  @spec resize(t(), non_neg_integer()) :: t()
  def resize(generator, size), do: :proper_types.resize(size, generator)

  @doc """
  The messages of a stream: `[{originating_time, value}]` with strictly increasing times, steps of 1 to `max_step` ns.
  """
  @spec timed(t(), pos_integer()) :: t()
  def timed(generator, max_step \\ 10) do
    map(list({integer(1, max_step), generator}), fn steps ->
      {messages, _} =
        Enum.map_reduce(steps, 0, fn {step, value}, time ->
          {{time + step, value}, time + step}
        end)

      messages
    end)
  end

  @doc "`items` in batches of random sizes (none empty): how a schedule may deliver them."
  @spec batches([term()]) :: t()
  def batches(items) do
    map(list(integer(1, 8)), &cut(items, &1))
  end

  defp cut([], _sizes), do: []
  defp cut(items, []), do: [items]

  defp cut(items, [size | sizes]) do
    {batch, rest} = Enum.split(items, size)
    [batch | cut(rest, sizes)]
  end
end
