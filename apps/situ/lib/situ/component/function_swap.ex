defmodule Situ.Component.FunctionSwap do
  @moduledoc false
  # The functions in a component's options, matched by position. A code change replaces the functions of the old version
  # of a module with their new versions, in the component's state as well. Pure.

  @typedoc "Each old function with its replacement."
  @type exchange :: %{fun() => fun()}

  @doc """
  Pairs each function in `old` with the function at the same position in `new`, if both have the same arity.

      iex> {f, g} = {&String.upcase/1, &String.downcase/1}
      iex> Situ.Component.FunctionSwap.pair_functions([fun: f, n: 1], [fun: g, n: 2]) == %{f => g}
      true
      iex> Situ.Component.FunctionSwap.pair_functions([fun: f], [fun: &Enum.map/2])
      %{}
  """
  @spec pair_functions(term(), term()) :: exchange()
  def pair_functions(old, new), do: collect_pairs(old, new, %{})

  defp collect_pairs(same, same, found), do: found

  defp collect_pairs(old, new, found) when is_function(old) and is_function(new) do
    if function_arity(old) == function_arity(new), do: Map.put(found, old, new), else: found
  end

  defp collect_pairs([old | olds], [new | news], found),
    do: collect_pairs(olds, news, collect_pairs(old, new, found))

  defp collect_pairs(old, new, found)
       when is_tuple(old) and is_tuple(new) and tuple_size(old) == tuple_size(new),
       do: collect_pairs(Tuple.to_list(old), Tuple.to_list(new), found)

  defp collect_pairs(old, new, found) when is_map(old) and is_map(new) do
    for {key, value} <- Map.to_list(old), is_map_key(new, key), reduce: found do
      found -> collect_pairs(value, Map.fetch!(new, key), found)
    end
  end

  defp collect_pairs(_old, _new, found), do: found

  defp function_arity(fun), do: :erlang.fun_info(fun, :arity)

  @doc """
  Returns the term with its functions replaced and everything else unchanged.

      iex> {f, g} = {&String.upcase/1, &String.downcase/1}
      iex> Situ.Component.FunctionSwap.replace_functions(%{fun: f, seen: [{1, f}]}, %{f => g}) ==
      ...>   %{fun: g, seen: [{1, g}]}
      true
  """
  @spec replace_functions(term(), exchange()) :: term()
  def replace_functions(term, exchange) when exchange == %{}, do: term
  def replace_functions(fun, exchange) when is_function(fun), do: Map.get(exchange, fun, fun)

  def replace_functions([head | tail], all),
    do: [replace_functions(head, all) | replace_functions(tail, all)]

  def replace_functions(tuple, all) when is_tuple(tuple),
    do: tuple |> Tuple.to_list() |> replace_functions(all) |> List.to_tuple()

  def replace_functions(map, all) when is_map(map),
    do: :maps.map(fn _key, value -> replace_functions(value, all) end, map)

  def replace_functions(term, _all), do: term
end
