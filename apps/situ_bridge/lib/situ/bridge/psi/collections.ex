defmodule Situ.Bridge.Psi.Collections do
  @moduledoc false
  # Builds the values of well-known types from their members, for example the items of a `List` instead of `_items`
  # and `_size`. The prefixes of member names are ignored, because they differ between .NET Framework (`m_slots`) and
  # .NET (`_entries`).
  alias Situ.Bridge.Psi.Media

  @generic "System.Collections.Generic."

  @shapes %{
    (@generic <> "List`1") => :list,
    (@generic <> "Dictionary`2") => :dictionary,
    (@generic <> "HashSet`1") => :set,
    (@generic <> "Queue`1") => :queue,
    (@generic <> "Stack`1") => :stack,
    (@generic <> "LinkedList`1") => :linked,
    (@generic <> "SortedSet`1") => :tree,
    (@generic <> "TreeSet`1") => :tree,
    (@generic <> "SortedDictionary`2") => :tree_map,
    (@generic <> "SortedList`2") => :sorted_list,
    "System.Collections.Concurrent.ConcurrentDictionary`2" => :concurrent,
    "System.Collections.ObjectModel.Collection`1" => :wrapped,
    "System.Collections.ObjectModel.ObservableCollection`1" => :wrapped,
    "System.Collections.ObjectModel.ReadOnlyCollection`1" => :wrapped,
    "System.Nullable`1" => :nullable,
    "Microsoft.Psi.Shared`1" => :shared,
    "Microsoft.Psi.SharedContainer`1" => :shared,
    "Microsoft.Psi.Imaging.Image" => :image,
    "Microsoft.Psi.Imaging.DepthImage" => :depth_image,
    "Microsoft.Psi.Imaging.EncodedImage" => :encoded_image,
    "Microsoft.Psi.Imaging.EncodedDepthImage" => :encoded_image,
    "Microsoft.Psi.Audio.AudioBuffer" => :audio
  }

  @lists [:list, :set, :queue, :stack, :linked, :tree, :wrapped]
  @maps [:dictionary, :tree_map, :sorted_list, :concurrent]
  @interfaces for name <-
                    ~w(IEnumerable`1 IList`1 ICollection`1 ISet`1 IReadOnlyList`1 IReadOnlyCollection`1),
                  do: @generic <> name

  # Limits the depth of trees and chains. Real collections are not this deep.
  @max_depth 10_000

  @doc "Returns the shape of a type, given its name and the names of its members."
  @spec shape_of(String.t(), [String.t()]) :: atom()
  def shape_of("System.Tuple`" <> _, _members), do: :tuple
  def shape_of("System.ValueTuple`" <> _, _members), do: :tuple

  def shape_of(name, members) do
    case Map.get(@shapes, name, :map) do
      :dictionary when members != ["Comparer", "KeyValuePairs"] -> :old_dictionary
      shape -> shape
    end
  end

  @doc "Returns whether values of the type with this name are lists."
  @spec list?(String.t()) :: boolean()
  def list?(name), do: @shapes[name] in @lists or name in @interfaces

  @doc "Returns whether values of the type with this name are dictionaries."
  @spec map?(String.t()) :: boolean()
  def map?(name),
    do:
      @shapes[name] in @maps or
        name in [@generic <> "IDictionary`2", @generic <> "IReadOnlyDictionary`2"]

  @doc "Builds the value of a shape from its members. Returns the members as a map if they are not valid."
  @spec build_value(atom(), [{String.t(), term()}]) :: term()
  def build_value(:map, members), do: Map.new(members)
  def build_value(:tuple, members), do: members |> Enum.map(&elem(&1, 1)) |> List.to_tuple()
  def build_value(:shared, [{_, inner}]), do: inner
  def build_value(:nullable, [{_, has?}, {_, value}]), do: if(has?, do: value)

  def build_value(:dictionary, [_comparer, {_, pairs}] = members) do
    if is_list(pairs) and Enum.all?(pairs, &match?(%{"key" => _, "value" => _}, &1)),
      do: Map.new(pairs, &{&1["key"], &1["value"]}),
      else: Map.new(members)
  end

  def build_value(shape, members) do
    plain = Map.new(members, fn {name, value} -> {strip_prefix(name), value} end)

    case build_collection(shape, plain) do
      {:ok, value} -> value
      :error -> members |> Map.new() |> build_media(shape)
    end
  end

  defp build_media(members, shape), do: Media.build_value(shape, members)

  # "_items" and "m_items" become "items".
  defp strip_prefix("m_" <> name), do: name
  defp strip_prefix("_" <> name), do: name
  defp strip_prefix(name), do: name

  defp build_collection(:list, %{"items" => items, "size" => size}), do: take_first(items, size)

  defp build_collection(:stack, %{"array" => items, "size" => size}) do
    with {:ok, items} <- take_first(items, size), do: {:ok, Enum.reverse(items)}
  end

  defp build_collection(:queue, %{"array" => items, "head" => head, "size" => size})
       when is_list(items) and is_integer(head) and head >= 0 do
    {head_items, tail_items} = Enum.split(items, head)
    take_first(tail_items ++ head_items, size)
  end

  defp build_collection(:old_dictionary, %{"entries" => entries}) when is_list(entries),
    do: {:ok, for(entry <- entries, used?(entry), into: %{}, do: {entry["key"], entry["value"]})}

  defp build_collection(:old_dictionary, _), do: {:ok, %{}}

  defp build_collection(:set, %{"entries" => entries, "count" => count})
       when is_list(entries) and is_integer(count),
       do: {:ok, entries |> Enum.take(max(count, 0)) |> collect_items()}

  defp build_collection(:set, %{"slots" => slots, "lastIndex" => count})
       when is_list(slots) and is_integer(count),
       do: {:ok, slots |> Enum.take(max(count, 0)) |> collect_items()}

  # A set that was never filled has no table.
  defp build_collection(:set, %{"count" => 0}), do: {:ok, []}

  defp build_collection(:linked, %{"head" => nil}), do: {:ok, []}
  defp build_collection(:linked, %{"head" => %{} = head}), do: {:ok, collect_linked(head, [])}

  defp build_collection(:tree, %{"root" => root}),
    do: {:ok, root |> walk_tree([], 0) |> Enum.map(& &1["item"])}

  defp build_collection(:tree_map, %{"set" => pairs}) when is_list(pairs), do: pairs_to_map(pairs)

  defp build_collection(:sorted_list, %{"keys" => keys, "values" => values, "size" => size})
       when is_list(keys) and is_list(values) and is_integer(size),
       do: {:ok, keys |> Enum.zip(values) |> Enum.take(max(size, 0)) |> Map.new()}

  defp build_collection(:concurrent, %{"tables" => tables}) when is_map(tables) do
    case get_member(tables, "buckets") do
      buckets when is_list(buckets) ->
        {:ok, for(bucket <- buckets, pair <- collect_chain(bucket, 0), into: %{}, do: pair)}

      _ ->
        :error
    end
  end

  defp build_collection(:wrapped, %{"items" => items}) when is_list(items), do: {:ok, items}
  defp build_collection(:wrapped, %{"list" => items}) when is_list(items), do: {:ok, items}
  defp build_collection(_shape, _members), do: :error

  defp take_first(items, size) when is_list(items) and is_integer(size) and size >= 0,
    do: {:ok, Enum.take(items, size)}

  defp take_first(_items, _size), do: :error

  # Empty slots of a hash table have a negative hash (.NET Framework) or a negative link (.NET).
  defp used?(%{"next" => next, "key" => key} = entry),
    do: Map.get(entry, "hashCode", 0) >= 0 and next >= -1 and key != nil

  defp used?(_), do: false

  defp collect_items(entries) do
    for entry <- entries, is_map(entry), occupied?(entry), do: get_member(entry, "value")
  end

  # In .NET the hash may be negative, and a link below -1 marks an empty slot.
  defp occupied?(%{"Next" => next}), do: next >= -1
  defp occupied?(%{"hashCode" => hash}), do: hash >= 0
  defp occupied?(_), do: false

  defp get_member(map, name) do
    key =
      Enum.find([name, "_" <> name, "m_" <> name, String.capitalize(name)], &is_map_key(map, &1))

    Map.get(map, key)
  end

  # The last node refers to the first one, which ends the list.
  defp collect_linked(%{"item" => item, "next" => next}, acc),
    do: collect_linked(next, [item | acc])

  defp collect_linked(_reference, acc), do: Enum.reverse(acc)

  defp walk_tree(%{} = node, acc, depth) when depth < @max_depth do
    item = get_member(node, "item")
    acc = node |> get_member("right") |> walk_tree(acc, depth + 1)
    node |> get_member("left") |> walk_tree([%{"item" => item} | acc], depth + 1)
  end

  defp walk_tree(_nothing, acc, _depth), do: acc

  defp pairs_to_map(pairs) do
    if Enum.all?(pairs, &match?(%{"key" => _, "value" => _}, &1)),
      do: {:ok, Map.new(pairs, &{&1["key"], &1["value"]})},
      else: :error
  end

  # A bucket is a node, or a struct whose only member is a node. Each node links to the next one.
  defp collect_chain(%{"_node" => node}, depth), do: collect_chain(node, depth)

  defp collect_chain(%{} = node, depth) when depth < @max_depth do
    if Enum.any?(["_key", "m_key"], &is_map_key(node, &1)),
      do: [
        {get_member(node, "key"), get_member(node, "value")}
        | collect_chain(get_member(node, "next"), depth + 1)
      ],
      else: []
  end

  defp collect_chain(_nothing, _depth), do: []
end
