defmodule Situ.Component.Functions do
  @moduledoc false
  # The functions in a component's options, matched by position. A code change replaces the functions of the old version
  # of a module with their new versions, in the component's state as well. Pure.

  @typedoc "Each old function with its replacement."
  @type exchange :: %{fun() => fun()}

  @doc """
  Pairs each function in `old` with the function at the same position in `new`, if both have the same arity.

      iex> {f, g} = {&String.upcase/1, &String.downcase/1}
      iex> Situ.Component.Functions.pairs([fun: f, n: 1], [fun: g, n: 2]) == %{f => g}
      true
      iex> Situ.Component.Functions.pairs([fun: f], [fun: &Enum.map/2])
      %{}
  """
  @spec pairs(term(), term()) :: exchange()
  def pairs(old, new), do: pairs(old, new, %{})

  defp pairs(same, same, found), do: found

  defp pairs(old, new, found) when is_function(old) and is_function(new) do
    if arity(old) == arity(new), do: Map.put(found, old, new), else: found
  end

  defp pairs([old | olds], [new | news], found), do: pairs(olds, news, pairs(old, new, found))

  defp pairs(old, new, found)
       when is_tuple(old) and is_tuple(new) and tuple_size(old) == tuple_size(new),
       do: pairs(Tuple.to_list(old), Tuple.to_list(new), found)

  defp pairs(old, new, found) when is_map(old) and is_map(new) do
    for {key, value} <- Map.to_list(old), is_map_key(new, key), reduce: found do
      found -> pairs(value, Map.fetch!(new, key), found)
    end
  end

  defp pairs(_old, _new, found), do: found

  defp arity(fun), do: :erlang.fun_info(fun, :arity)

  @doc """
  Returns the term with its functions replaced and everything else unchanged.

      iex> {f, g} = {&String.upcase/1, &String.downcase/1}
      iex> Situ.Component.Functions.exchange(%{fun: f, seen: [{1, f}]}, %{f => g}) == %{fun: g, seen: [{1, g}]}
      true
  """
  @spec exchange(term(), exchange()) :: term()
  def exchange(term, exchange) when exchange == %{}, do: term
  def exchange(fun, exchange) when is_function(fun), do: Map.get(exchange, fun, fun)
  def exchange([head | tail], all), do: [exchange(head, all) | exchange(tail, all)]

  def exchange(tuple, all) when is_tuple(tuple),
    do: tuple |> Tuple.to_list() |> exchange(all) |> List.to_tuple()

  def exchange(map, all) when is_map(map),
    do: :maps.map(fn _key, value -> exchange(value, all) end, map)

  def exchange(term, _all), do: term
end
