defmodule Situ.Bridge.Psi.Shapes do
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
  @deepest 10_000

  @doc "Returns the shape of a type, given its name and the names of its members."
  @spec of(String.t(), [String.t()]) :: atom()
  def of("System.Tuple`" <> _, _members), do: :tuple
  def of("System.ValueTuple`" <> _, _members), do: :tuple

  def of(name, members) do
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
  @spec value(atom(), [{String.t(), term()}]) :: term()
  def value(:map, members), do: Map.new(members)
  def value(:tuple, members), do: members |> Enum.map(&elem(&1, 1)) |> List.to_tuple()
  def value(:shared, [{_, inner}]), do: inner
  def value(:nullable, [{_, has?}, {_, value}]), do: if(has?, do: value)

  def value(:dictionary, [_comparer, {_, pairs}] = members) do
    if is_list(pairs) and Enum.all?(pairs, &match?(%{"key" => _, "value" => _}, &1)),
      do: Map.new(pairs, &{&1["key"], &1["value"]}),
      else: Map.new(members)
  end

  def value(shape, members) do
    plain = Map.new(members, fn {name, value} -> {plain(name), value} end)

    case collection(shape, plain) do
      {:ok, value} -> value
      :error -> members |> Map.new() |> media(shape)
    end
  end

  defp media(members, shape), do: Media.value(shape, members)

  # "_items" and "m_items" become "items".
  defp plain("m_" <> name), do: name
  defp plain("_" <> name), do: name
  defp plain(name), do: name

  defp collection(:list, %{"items" => items, "size" => size}), do: first(items, size)

  defp collection(:stack, %{"array" => items, "size" => size}) do
    with {:ok, items} <- first(items, size), do: {:ok, Enum.reverse(items)}
  end

  defp collection(:queue, %{"array" => items, "head" => head, "size" => size})
       when is_list(items) and is_integer(head) and head >= 0 do
    {before, behind} = Enum.split(items, head)
    first(behind ++ before, size)
  end

  defp collection(:old_dictionary, %{"entries" => entries}) when is_list(entries),
    do: {:ok, for(entry <- entries, used?(entry), into: %{}, do: {entry["key"], entry["value"]})}

  defp collection(:old_dictionary, _), do: {:ok, %{}}

  defp collection(:set, %{"entries" => entries, "count" => count})
       when is_list(entries) and is_integer(count),
       do: {:ok, entries |> Enum.take(max(count, 0)) |> items()}

  defp collection(:set, %{"slots" => slots, "lastIndex" => count})
       when is_list(slots) and is_integer(count),
       do: {:ok, slots |> Enum.take(max(count, 0)) |> items()}

  # A set that was never filled has no table.
  defp collection(:set, %{"count" => 0}), do: {:ok, []}

  defp collection(:linked, %{"head" => nil}), do: {:ok, []}
  defp collection(:linked, %{"head" => %{} = head}), do: {:ok, linked(head, [])}

  defp collection(:tree, %{"root" => root}),
    do: {:ok, root |> walk([], 0) |> Enum.map(& &1["item"])}

  defp collection(:tree_map, %{"set" => pairs}) when is_list(pairs), do: pairs(pairs)

  defp collection(:sorted_list, %{"keys" => keys, "values" => values, "size" => size})
       when is_list(keys) and is_list(values) and is_integer(size),
       do: {:ok, keys |> Enum.zip(values) |> Enum.take(max(size, 0)) |> Map.new()}

  defp collection(:concurrent, %{"tables" => tables}) when is_map(tables) do
    case named(tables, "buckets") do
      buckets when is_list(buckets) ->
        {:ok, for(bucket <- buckets, pair <- chain(bucket, 0), into: %{}, do: pair)}

      _ ->
        :error
    end
  end

  defp collection(:wrapped, %{"items" => items}) when is_list(items), do: {:ok, items}
  defp collection(:wrapped, %{"list" => items}) when is_list(items), do: {:ok, items}
  defp collection(_shape, _members), do: :error

  defp first(items, size) when is_list(items) and is_integer(size) and size >= 0,
    do: {:ok, Enum.take(items, size)}

  defp first(_items, _size), do: :error

  # Empty slots of a hash table have a negative hash (.NET Framework) or a negative link (.NET).
  defp used?(%{"next" => next, "key" => key} = entry),
    do: Map.get(entry, "hashCode", 0) >= 0 and next >= -1 and key != nil

  defp used?(_), do: false

  defp items(entries) do
    for entry <- entries, is_map(entry), held?(entry), do: named(entry, "value")
  end

  # In .NET the hash may be negative, and a link below -1 marks an empty slot.
  defp held?(%{"Next" => next}), do: next >= -1
  defp held?(%{"hashCode" => hash}), do: hash >= 0
  defp held?(_), do: false

  defp named(map, name) do
    key =
      Enum.find([name, "_" <> name, "m_" <> name, String.capitalize(name)], &is_map_key(map, &1))

    Map.get(map, key)
  end

  # The last node refers to the first one, which ends the list.
  defp linked(%{"item" => item, "next" => next}, found), do: linked(next, [item | found])
  defp linked(_reference, found), do: Enum.reverse(found)

  defp walk(%{} = node, found, depth) when depth < @deepest do
    item = named(node, "item")
    found = node |> named("right") |> walk(found, depth + 1)
    node |> named("left") |> walk([%{"item" => item} | found], depth + 1)
  end

  defp walk(_nothing, found, _depth), do: found

  defp pairs(pairs) do
    if Enum.all?(pairs, &match?(%{"key" => _, "value" => _}, &1)),
      do: {:ok, Map.new(pairs, &{&1["key"], &1["value"]})},
      else: :error
  end

  # A bucket is a node, or a struct whose only member is a node. Each node links to the next one.
  defp chain(%{"_node" => node}, depth), do: chain(node, depth)

  defp chain(%{} = node, depth) when depth < @deepest do
    if Enum.any?(["_key", "m_key"], &is_map_key(node, &1)),
      do: [{named(node, "key"), named(node, "value")} | chain(named(node, "next"), depth + 1)],
      else: []
  end

  defp chain(_nothing, _depth), do: []
end
