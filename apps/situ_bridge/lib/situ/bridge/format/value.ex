defmodule Situ.Bridge.Format.Value do
  @moduledoc false
  # Shared by all formats: converts terms to objects with ordered members, and back.

  @special_floats %{nan: "NaN", infinity: "Infinity", neg_infinity: "-Infinity"}

  @doc """
  Converts a term: objects become ordered pairs with string keys, special numbers become strings, and the fields of a
  struct keep the order of its definition. Bytes that are not UTF-8 text become base64, as in \\psi's JSON, or stay as
  they are with `:keep_bytes`. Throws `{:not_writable, term}`.

      iex> Situ.Bridge.Format.Value.to_plain(%{b: [1, :nan], a: nil})
      {[{"a", nil}, {"b", [1, "NaN"]}]}
      iex> Situ.Bridge.Format.Value.to_plain(%{jpeg: <<255, 216>>})
      {[{"jpeg", "/9g="}]}
  """
  @spec to_plain(term(), :encode_bytes | :keep_bytes) :: term()
  def to_plain(value, bytes \\ :encode_bytes)
  def to_plain(nil, _bytes), do: nil
  def to_plain(value, _bytes) when is_boolean(value) or is_number(value), do: value

  def to_plain(value, :encode_bytes) when is_binary(value),
    do: if(String.valid?(value), do: value, else: Base.encode64(value))

  def to_plain(value, :keep_bytes) when is_binary(value), do: value
  def to_plain(value, _) when is_map_key(@special_floats, value), do: @special_floats[value]
  def to_plain(value, _bytes) when is_atom(value), do: Atom.to_string(value)

  def to_plain({pairs}, bytes) when is_list(pairs),
    do: {Enum.map(pairs, &plain_pair(&1, bytes))}

  def to_plain(list, bytes) when is_list(list), do: Enum.map(list, &to_plain(&1, bytes))

  def to_plain(tuple, bytes) when is_tuple(tuple),
    do: tuple |> Tuple.to_list() |> to_plain(bytes)

  def to_plain(%module{} = struct, bytes) do
    {for(
       field <- struct_fields(module, struct),
       do: plain_pair({field, Map.get(struct, field)}, bytes)
     )}
  end

  def to_plain(map, bytes) when is_map(map),
    do: {map |> Enum.sort() |> Enum.map(&plain_pair(&1, bytes))}

  def to_plain(other, _bytes), do: throw({:not_writable, other})

  defp plain_pair({key, value}, bytes) when is_binary(key), do: {key, to_plain(value, bytes)}

  defp plain_pair({key, value}, bytes) when is_atom(key) or is_number(key),
    do: {to_string(key), to_plain(value, bytes)}

  defp plain_pair(other, _bytes), do: throw({:not_writable, other})

  defp struct_fields(module, struct) do
    if function_exported?(module, :__info__, 1),
      do: Enum.map(module.__info__(:struct), & &1.field),
      else: struct |> Map.from_struct() |> Map.keys()
  end

  @doc "Converts ordered pairs to maps recursively, unless `objects: :pairs` is given."
  @spec shape_objects(term(), keyword()) :: term()
  def shape_objects(value, opts),
    do: if(opts[:objects] == :pairs, do: value, else: pairs_to_maps(value))

  defp pairs_to_maps({pairs}),
    do: Map.new(pairs, fn {key, value} -> {key, pairs_to_maps(value)} end)

  defp pairs_to_maps(list) when is_list(list), do: Enum.map(list, &pairs_to_maps/1)
  defp pairs_to_maps(other), do: other

  @doc "Fetches a member of an object; returns `:error` if it is missing."
  @spec fetch_member([{String.t(), term()}], String.t()) :: {:ok, term()} | :error
  def fetch_member(pairs, key) do
    case List.keyfind(pairs, key, 0) do
      {_, value} -> {:ok, value}
      nil -> :error
    end
  end
end
