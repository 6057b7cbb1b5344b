defmodule Situ.Fusion.Output do
  @moduledoc false
  # The output of a fusion operator: the function that builds it, and its type. Pure.
  alias Situ.Fusion.Arguments
  alias Situ.{Interpolator, Type}

  @doc """
  Returns the function that builds the output from a primary and the values of its secondaries, the output's type, and
  the form in which the function takes the values. `interpolators` are the secondaries' interpolators.
  """
  @spec plan(Arguments.streams(), [Interpolator.t()], keyword()) ::
          {(term(), term() -> term()), Type.t(), :one | :list | :map}
  def plan({:one, primary, secondary}, [interpolator], opts) do
    {creator, type} = creator(primary.type, values(interpolator, secondary.type), opts)
    {creator, type, :one}
  end

  def plan({:many, primary, secondaries}, interpolators, opts) do
    type = {:tuple, [primary.type, {:list, common(types(interpolators, secondaries))}]}
    {opts[:with] || (&{&1, &2}), type(type, opts), :list}
  end

  def plan({:vector, [primary | secondaries]}, interpolators, opts) do
    type = {:list, common([primary.type | types(interpolators, secondaries)])}
    {opts[:with] || fn p, s -> [p | s] end, type(type, opts), :list}
  end

  def plan({:keyed, primary, _keyed}, _interpolators, opts) do
    type = {:tuple, [primary.type, {:map, :any, :any}]}
    {opts[:with] || (&{&1, &2}), type(type, opts), :map}
  end

  defp types(interpolators, secondaries) do
    Enum.zip_with(interpolators, secondaries, &Interpolator.type(&1, &2.type))
  end

  defp type(default, opts), do: if(opts[:with], do: :any, else: default)

  @typedoc "The type of a stream's values, and the default used in place of a missing value."
  @type values :: {Type.t(), :none | {:value, term()}}

  @doc "Returns the type and default of the values that an interpolator produces from a stream of this type."
  @spec values(Interpolator.t(), Type.t()) :: values()
  def values(interpolator, type),
    do: {Interpolator.type(%{interpolator | default: :none}, type), interpolator.default}

  @doc "Returns the function that builds the output from a primary and one value, and the output's type."
  @spec creator(Type.t(), values(), keyword()) :: {(term(), term() -> term()), Type.t()}
  def creator(primary, {type, default} = values, opts) do
    cond do
      opts[:with] ->
        {opts[:with], :any}

      opts[:flatten] == false ->
        {&{&1, &2}, {:tuple, [primary, Interpolator.widened(type, default)]}}

      true ->
        flat(primary, values)
    end
  end

  # A default that is not a tuple applies to each element of the tuple.
  defp flat(primary, {{:tuple, types}, default}) do
    n = length(types)

    case default do
      :none ->
        {put(primary, n), tuple(primary, types)}

      {:value, value} when tuple_size(value) == n ->
        {put(primary, n), tuple(primary, each(types, Tuple.to_list(value)))}

      {:value, value} when is_tuple(value) ->
        {put(primary, n), :any}

      {:value, value} ->
        {put(primary, n), tuple(primary, each(types, List.duplicate(value, n)))}
    end
  end

  defp flat({:tuple, types}, {type, default}) do
    type = Interpolator.widened(type, default)
    {&Tuple.insert_at(&1, tuple_size(&1), &2), {:tuple, types ++ [type]}}
  end

  defp flat(primary, {type, default}),
    do: {&{&1, &2}, {:tuple, [primary, Interpolator.widened(type, default)]}}

  defp put({:tuple, _}, n), do: &List.to_tuple(Tuple.to_list(&1) ++ Tuple.to_list(wide(&2, n)))
  defp put(_primary, n), do: &Tuple.insert_at(wide(&2, n), 0, &1)

  defp tuple({:tuple, a}, b), do: {:tuple, a ++ b}
  defp tuple(a, b), do: {:tuple, [a | b]}

  defp each(types, values),
    do: Enum.zip_with(types, values, &Interpolator.widened(&1, {:value, &2}))

  defp wide(tuple, _n) when is_tuple(tuple), do: tuple
  defp wide(default, n), do: Tuple.duplicate(default, n)

  @doc "Returns the type common to all, or `:any`."
  @spec common([Type.t()]) :: Type.t()
  def common(types) do
    case Enum.uniq(types) do
      [type] -> type
      _ -> :any
    end
  end
end
