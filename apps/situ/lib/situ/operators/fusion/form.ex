defmodule Situ.Fusion.Form do
  @moduledoc false
  # The forms in which streams are given to a fusion operator, and what comes out of each: the function that makes the output, and its
  # type. Pure.
  alias Situ.{Interpolator, Stream, Type}

  @type streams ::
          {:one, Stream.t(), Stream.t()}
          | {:many, Stream.t(), [Stream.t()]}
          | {:keyed, Stream.t(), %{term() => Stream.t()}}
          | {:vector, [Stream.t()]}

  @doc "The arguments of join and fuse: a primary with its secondaries, or a list whose first is the primary."
  @spec arguments(term(), term(), term(), keyword()) :: {streams(), term(), keyword()}
  def arguments(first, second, third, opts) when is_list(first) do
    {interpolator, opts} = last(second, third, opts)
    {{:vector, some!(first)}, interpolator, opts}
  end

  def arguments(%Stream{} = primary, %Stream{} = secondary, third, opts) do
    {interpolator, opts} = last(third, opts, [])
    {{:one, primary, secondary}, interpolator, opts}
  end

  def arguments(%Stream{} = primary, secondaries, third, opts) when is_list(secondaries) do
    {interpolator, opts} = last(third, opts, [])
    {{:many, primary, some!(secondaries)}, interpolator, opts}
  end

  def arguments(%Stream{} = primary, %{} = keyed, third, opts) when not is_struct(keyed) do
    {interpolator, opts} = last(third, opts, [])
    if keyed != %{}, do: some!(Map.values(keyed))
    {{:keyed, primary, keyed}, interpolator, opts}
  end

  defp last(opts, [], []) when is_list(opts) do
    if Keyword.keyword?(opts), do: {:default, opts}, else: {opts, []}
  end

  defp last([], opts, []), do: {:default, opts}
  defp last(interpolator, opts, []), do: {interpolator, opts}
  defp last(interpolator, [], opts), do: {interpolator, opts}

  @doc "The interpolator that was given, or the default."
  @spec given(term(), Interpolator.t() | :none) :: Interpolator.t() | [Interpolator.t()]
  def given(:default, :none), do: raise(ArgumentError, "fuse needs an interpolator; see join")
  def given(:default, default), do: default
  def given(list, _default) when is_list(list), do: Enum.map(list, &Interpolator.from/1)
  def given(other, _default), do: Interpolator.from(other)

  @doc "One interpolator for each of `n` secondaries."
  @spec each(Interpolator.t() | [Interpolator.t()], non_neg_integer()) :: [Interpolator.t()]
  def each(%Interpolator{} = one, n), do: List.duplicate(one, n)
  def each(list, n) when length(list) == n, do: list

  def each(list, n),
    do: raise(ArgumentError, "#{length(list)} interpolators for #{n} secondary streams")

  @doc "Primary and secondary streams of any form."
  @spec sides(streams()) :: {Stream.t(), [Stream.t()]}
  def sides({:one, primary, secondary}), do: {primary, [secondary]}
  def sides({:many, primary, secondaries}), do: {primary, secondaries}
  def sides({:keyed, primary, keyed}), do: {primary, Map.values(keyed)}
  def sides({:vector, [primary | secondaries]}), do: {primary, secondaries}

  @doc "What makes the output of a primary and the values of its secondaries, given their types; and the output's type."
  @spec plan(streams(), [Type.t()], keyword()) :: {(term(), term() -> term()), Type.t()}
  def plan({:one, primary, _secondary}, [type], opts), do: creator(primary.type, type, opts)

  def plan({:many, primary, secondaries}, types, opts) do
    type = {:tuple, [primary.type, {:list, common(types)}]}
    {listed(opts[:with] || (&{&1, &2}), secondaries), type(type, opts)}
  end

  def plan({:vector, [primary | secondaries]}, types, opts) do
    creator = opts[:with] || fn p, s -> [p | s] end
    {listed(creator, secondaries), type({:list, common([primary.type | types])}, opts)}
  end

  def plan({:keyed, primary, _keyed}, _types, opts) do
    type = {:tuple, [primary.type, {:map, :any, :any}]}
    {opts[:with] || (&{&1, &2}), type(type, opts)}
  end

  # Of one secondary the core gives the value alone.
  defp listed(creator, [_only]), do: fn primary, value -> creator.(primary, [value]) end
  defp listed(creator, _several), do: creator

  defp type(default, opts), do: if(opts[:with], do: :any, else: default)

  @doc "What makes the output of one primary and one secondary value, and its type."
  @spec creator(Type.t(), Type.t(), keyword()) :: {(term(), term() -> term()), Type.t()}
  def creator(primary, secondary, opts) do
    cond do
      opts[:with] -> {opts[:with], :any}
      opts[:flatten] == false -> {&{&1, &2}, {:tuple, [primary, secondary]}}
      true -> flat(primary, secondary)
    end
  end

  defp flat({:tuple, a}, {:tuple, b}) do
    n = length(b)
    {&List.to_tuple(Tuple.to_list(&1) ++ Tuple.to_list(wide(&2, n))), {:tuple, a ++ b}}
  end

  defp flat({:tuple, a}, b), do: {&Tuple.insert_at(&1, tuple_size(&1), &2), {:tuple, a ++ [b]}}

  defp flat(a, {:tuple, b}) do
    n = length(b)
    {&Tuple.insert_at(wide(&2, n), 0, &1), {:tuple, [a | b]}}
  end

  defp flat(a, b), do: {&{&1, &2}, {:tuple, [a, b]}}

  # A default that stands for a tuple stands for each of its elements.
  defp wide(tuple, _n) when is_tuple(tuple), do: tuple
  defp wide(default, n), do: Tuple.duplicate(default, n)

  @doc "The arguments of zip and merge."
  @spec inputs(term(), term(), keyword()) :: {[Stream.t()], keyword()}
  def inputs(%Stream{} = first, %Stream{} = second, opts), do: {[first, second], opts}
  def inputs(streams, opts, []) when is_list(streams), do: {some!(streams), opts}

  defp some!([]), do: raise(ArgumentError, "no streams given: there is nothing to bring together")

  defp some!(streams) do
    if Enum.all?(streams, &is_struct(&1, Stream)),
      do: streams,
      else: raise(ArgumentError, "expected streams, got: #{inspect(streams, limit: 5)}")
  end

  @doc "The type that all of them have, or any."
  @spec common([Type.t()]) :: Type.t()
  def common(types) do
    case Enum.uniq(types) do
      [type] -> type
      _ -> :any
    end
  end
end
