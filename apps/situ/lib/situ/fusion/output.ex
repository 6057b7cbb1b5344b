defmodule Situ.Fusion.Output do
  @moduledoc false
  # The output of a fusion operator: the function that builds it, and its type. Pure.
  alias Situ.Fusion.Arguments
  alias Situ.{Interpolator, Type}

  @doc """
  Returns the function that builds the output from a primary and the values of its secondaries, the output's type, and
  the form in which the function takes the values. `interpolators` are the secondaries' interpolators.
  """
  @spec plan_output(Arguments.streams(), [Interpolator.t()], keyword()) ::
          {(term(), term() -> term()), Type.t(), :one | :list | :map}
  def plan_output({:one, primary, secondary}, [interpolator], opts) do
    {creator, type} =
      output_creator(primary.type, interpolated_values(interpolator, secondary.type), opts)

    {creator, type, :one}
  end

  def plan_output({:many, primary, secondaries}, interpolators, opts) do
    type = {:tuple, [primary.type, {:list, common_type(value_types(interpolators, secondaries))}]}
    {opts[:with] || (&{&1, &2}), output_type(type, opts), :list}
  end

  def plan_output({:vector, [primary | secondaries]}, interpolators, opts) do
    type = {:list, common_type([primary.type | value_types(interpolators, secondaries)])}
    {opts[:with] || fn p, s -> [p | s] end, output_type(type, opts), :list}
  end

  def plan_output({:keyed, primary, _keyed}, _interpolators, opts) do
    type = {:tuple, [primary.type, {:map, :any, :any}]}
    {opts[:with] || (&{&1, &2}), output_type(type, opts), :map}
  end

  defp value_types(interpolators, secondaries) do
    Enum.zip_with(interpolators, secondaries, &Interpolator.value_type(&1, &2.type))
  end

  defp output_type(default, opts), do: if(opts[:with], do: :any, else: default)

  @typedoc "The type of a stream's values, and the default used in place of a missing value."
  @type values :: {Type.t(), :none | {:value, term()}}

  @doc "Returns the type and default of the values that an interpolator produces from a stream of this type."
  @spec interpolated_values(Interpolator.t(), Type.t()) :: values()
  def interpolated_values(interpolator, type),
    do: {Interpolator.value_type(%{interpolator | default: :none}, type), interpolator.default}

  @doc "Returns the function that builds the output from a primary and one value, and the output's type."
  @spec output_creator(Type.t(), values(), keyword()) :: {(term(), term() -> term()), Type.t()}
  def output_creator(primary, {type, default} = values, opts) do
    cond do
      opts[:with] ->
        {opts[:with], :any}

      opts[:flatten] == false ->
        {&{&1, &2}, {:tuple, [primary, Interpolator.widen_type(type, default)]}}

      true ->
        flat_creator(primary, values)
    end
  end

  # A default that is not a tuple applies to each element of the tuple.
  defp flat_creator(primary, {{:tuple, types}, default}) do
    n = length(types)

    case default do
      :none ->
        {tuple_creator(primary, n), tuple_type(primary, types)}

      {:value, value} when tuple_size(value) == n ->
        {tuple_creator(primary, n), tuple_type(primary, widen_types(types, Tuple.to_list(value)))}

      {:value, value} when is_tuple(value) ->
        {tuple_creator(primary, n), :any}

      {:value, value} ->
        {tuple_creator(primary, n),
         tuple_type(primary, widen_types(types, List.duplicate(value, n)))}
    end
  end

  defp flat_creator({:tuple, types}, {type, default}) do
    type = Interpolator.widen_type(type, default)
    {&Tuple.insert_at(&1, tuple_size(&1), &2), {:tuple, types ++ [type]}}
  end

  defp flat_creator(primary, {type, default}),
    do: {&{&1, &2}, {:tuple, [primary, Interpolator.widen_type(type, default)]}}

  defp tuple_creator({:tuple, _}, n),
    do: &List.to_tuple(Tuple.to_list(&1) ++ Tuple.to_list(to_tuple(&2, n)))

  defp tuple_creator(_primary, n), do: &Tuple.insert_at(to_tuple(&2, n), 0, &1)

  defp tuple_type({:tuple, a}, b), do: {:tuple, a ++ b}
  defp tuple_type(a, b), do: {:tuple, [a | b]}

  defp widen_types(types, values),
    do: Enum.zip_with(types, values, &Interpolator.widen_type(&1, {:value, &2}))

  defp to_tuple(tuple, _n) when is_tuple(tuple), do: tuple
  defp to_tuple(default, n), do: Tuple.duplicate(default, n)

  @doc "Returns the type common to all, or `:any`."
  @spec common_type([Type.t()]) :: Type.t()
  def common_type(types) do
    case Enum.uniq(types) do
      [type] -> type
      _ -> :any
    end
  end
end
