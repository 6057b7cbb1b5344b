defmodule Situ.Bridge.Format.Value do
  @moduledoc false
  # Shared by all formats: converts terms to objects with ordered members, and back.

  @special %{nan: "NaN", infinity: "Infinity", neg_infinity: "-Infinity"}

  @doc """
  Converts a term: objects become ordered pairs with string keys, special numbers become strings, and the fields of a
  struct keep the order of its definition. Throws `{:not_writable, term}`.

      iex> Situ.Bridge.Format.Value.plain(%{b: [1, :nan], a: nil})
      {[{"a", nil}, {"b", [1, "NaN"]}]}
  """
  @spec plain(term()) :: term()
  def plain(nil), do: nil
  def plain(value) when is_boolean(value) or is_number(value) or is_binary(value), do: value
  def plain(value) when is_map_key(@special, value), do: @special[value]
  def plain(value) when is_atom(value), do: Atom.to_string(value)
  def plain({pairs}) when is_list(pairs), do: {Enum.map(pairs, &pair/1)}
  def plain(list) when is_list(list), do: Enum.map(list, &plain/1)
  def plain(tuple) when is_tuple(tuple), do: tuple |> Tuple.to_list() |> plain()

  def plain(%module{} = struct),
    do: {for(field <- fields(module, struct), do: pair({field, Map.get(struct, field)}))}

  def plain(map) when is_map(map), do: {map |> Enum.sort() |> Enum.map(&pair/1)}
  def plain(other), do: throw({:not_writable, other})

  defp pair({key, value}) when is_binary(key), do: {key, plain(value)}
  defp pair({key, value}) when is_atom(key) or is_number(key), do: {to_string(key), plain(value)}
  defp pair(other), do: throw({:not_writable, other})

  defp fields(module, struct) do
    if function_exported?(module, :__info__, 1),
      do: Enum.map(module.__info__(:struct), & &1.field),
      else: struct |> Map.from_struct() |> Map.keys()
  end

  @doc "Converts ordered pairs to maps recursively, unless `objects: :pairs` is given."
  @spec shaped(term(), keyword()) :: term()
  def shaped(value, opts), do: if(opts[:objects] == :pairs, do: value, else: maps(value))

  defp maps({pairs}), do: Map.new(pairs, fn {key, value} -> {key, maps(value)} end)
  defp maps(list) when is_list(list), do: Enum.map(list, &maps/1)
  defp maps(other), do: other

  @doc "Fetches a member of an object; returns `:error` if it is missing."
  @spec fetch([{String.t(), term()}], String.t()) :: {:ok, term()} | :error
  def fetch(pairs, key) do
    case List.keyfind(pairs, key, 0) do
      {_, value} -> {:ok, value}
      nil -> :error
    end
  end
end
