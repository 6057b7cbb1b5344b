defmodule Situ.Bridge.Columnar.Shape do
  @moduledoc false
  # The keys of a message's data, including the keys of nested maps. Most messages of a stream have the same keys, so
  # the names of their columns are computed only once. Pure.
  alias Situ.Bridge.Columnar.{Cell, Column}

  @typedoc "The keys of a map, and the shape of each value: `nil` if it is not a map, or is empty."
  @type keys :: {[term()], [keys() | nil]}
  @typedoc "The kinds of the values of a map, in the order of its keys. The name of a struct has no kind."
  @type kinds :: {[term()], [kinds() | Column.kind() | nil | :ignored]}
  @typedoc "The keys of a message, and for each column the path to its value and its kind."
  @type plan :: {keys(), [{path :: [term()] | nil, Column.kind()}]}

  @doc "Returns the kinds of a message's values, or `nil` if its data is not a map."
  @spec build_kinds(term(), %{String.t() => Column.kind() | nil}) :: kinds() | nil
  def build_kinds(data, kinds) when is_map(data) and map_size(data) > 0,
    do: map_kinds(data, kinds, "")

  def build_kinds(_data, _kinds), do: nil

  defp map_kinds(map, kinds, prefix) do
    {:maps.keys(map),
     for({key, value} <- :maps.to_list(map), do: value_kinds(key, value, kinds, prefix))}
  end

  defp value_kinds(:__struct__, module, _kinds, _prefix) when is_atom(module), do: :ignored

  defp value_kinds(key, map, kinds, prefix) when is_map(map) and map_size(map) > 0,
    do: map_kinds(map, kinds, prefix <> Cell.member_name(key) <> ".")

  defp value_kinds(key, _value, kinds, prefix), do: kinds[prefix <> Cell.member_name(key)]

  @doc "Returns whether data has the same keys, and adds nothing to the kinds."
  @spec same_kinds?(term(), kinds() | nil) :: boolean()
  def same_kinds?(map, {keys, kinds}) when is_map(map),
    do: :maps.keys(map) == keys and each_same_kind?(:maps.values(map), kinds)

  def same_kinds?(map, _kind) when is_map(map) and map_size(map) > 0, do: false
  def same_kinds?(_value, {_keys, _kinds}), do: false
  def same_kinds?(_module, :ignored), do: true
  def same_kinds?(nil, _kind), do: true
  def same_kinds?(x, :float) when is_float(x), do: true
  def same_kinds?(value, kind), do: kind != nil and Cell.merge_value(kind, value) == kind

  defp each_same_kind?([value | values], [kind | kinds]),
    do: same_kinds?(value, kind) and each_same_kind?(values, kinds)

  defp each_same_kind?([], []), do: true

  @doc "Returns how to find the values of the columns in data with the same keys, or `nil` if the data is not a map."
  @spec build_plan(term(), [Column.t()]) :: plan() | nil
  def build_plan(data, columns) when is_map(data) do
    paths = data |> list_paths("", []) |> Map.new()
    {map_keys(data), for(%{name: name, kind: kind} <- columns, do: {paths[name], kind})}
  end

  def build_plan(_data, _columns), do: nil

  defp map_keys(map) when is_map(map) and map_size(map) > 0,
    do: {:maps.keys(map), Enum.map(:maps.values(map), &map_keys/1)}

  defp map_keys(_value), do: nil

  defp list_paths(map, prefix, path) do
    Enum.flat_map(:maps.to_list(map), fn
      {:__struct__, _module} ->
        []

      {key, value} when is_map(value) and map_size(value) > 0 ->
        list_paths(value, prefix <> Cell.member_name(key) <> ".", [key | path])

      {key, _value} ->
        [{prefix <> Cell.member_name(key), Enum.reverse([key | path])}]
    end)
  end

  @doc "Returns whether data has the keys of a plan."
  @spec same_keys?(term(), keys() | nil) :: boolean()
  def same_keys?(map, {keys, values}) when is_map(map),
    do: :maps.keys(map) == keys and each_same_keys?(:maps.values(map), values)

  def same_keys?(map, nil) when is_map(map), do: map_size(map) == 0
  def same_keys?(_value, keys), do: keys == nil

  defp each_same_keys?([value | values], [keys | rest]) when is_map(value),
    do: same_keys?(value, keys) and each_same_keys?(values, rest)

  defp each_same_keys?([_value | values], [nil | rest]), do: each_same_keys?(values, rest)
  defp each_same_keys?([_value | _], [_keys | _]), do: false
  defp each_same_keys?([], []), do: true

  @doc "Returns the value at a path."
  @spec value_at(term(), [term()] | nil) :: term()
  def value_at(data, [key]), do: :erlang.map_get(key, data)
  def value_at(data, [key | path]), do: value_at(:erlang.map_get(key, data), path)
  def value_at(_data, nil), do: nil
end
