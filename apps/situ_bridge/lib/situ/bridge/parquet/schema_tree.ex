defmodule Situ.Bridge.Parquet.SchemaTree do
  @moduledoc false
  # The schema of a Parquet file as columns. A flat column is a leaf. A column of lists, maps or structs is a tree,
  # whose values are assembled from its leaves by their repetition and definition levels (Dremel encoding). Pure.
  # Throws `{:not_parquet, why}`.
  alias Situ.Bridge.Columnar.ColumnNames
  alias Situ.Bridge.Parquet.Leaf

  @max_depth 32
  @repeated 2

  @typedoc "`definition` is the level from which a node is present, `level` the level at which its elements begin."
  @type tree :: %{
          name: String.t(),
          kind: :leaf | :struct | :list | :map,
          repetition: 0..2,
          definition: non_neg_integer(),
          level: non_neg_integer(),
          children: [tree()],
          leaves: [Leaf.t()]
        }
  @type column :: Leaf.t() | %{name: String.t(), time?: false, tree: tree()}
  @typedoc "The value of a leaf with its repetition and definition levels."
  @type entry :: {non_neg_integer(), non_neg_integer(), term()}

  @doc "Builds the columns of a schema from its elements without the root. Duplicate names are numbered."
  @spec build_columns([map()]) :: [column()]
  def build_columns(elements),
    do: elements |> collect_columns(0, []) |> ColumnNames.number_duplicates()

  defp collect_columns([], _at, acc), do: Enum.reverse(acc)

  defp collect_columns(elements, at, acc) do
    {tree, rest, at} = build_node(elements, at, {0, 0}, 0)
    collect_columns(rest, at, [leaf_or_tree(tree) | acc])
  end

  defp leaf_or_tree(%{kind: :leaf, repetition: repetition, leaves: [leaf]})
       when repetition != @repeated,
       do: leaf

  defp leaf_or_tree(tree), do: %{name: tree.name, time?: false, tree: tree}

  defp build_node(_elements, _at, _levels, depth) when depth > @max_depth,
    do: throw_malformed("its columns are nested too deeply")

  defp build_node([%{4 => name} = element | rest], at, {definition, level}, depth)
       when is_binary(name) do
    repetition = element[3] || 0
    definition = if repetition == 0, do: definition, else: definition + 1
    level = if repetition == @repeated, do: level + 1, else: level
    base = %{name: name, repetition: repetition, definition: definition, level: level}

    if is_integer(element[5]) do
      {children, rest, at} =
        build_children(element[5], rest, at, {definition, level}, depth + 1, [])

      leaves = Enum.flat_map(children, & &1.leaves)
      if leaves == [], do: throw_malformed("a group has no columns")
      children = ColumnNames.number_duplicates(children)

      tree =
        Map.merge(base, %{kind: group_kind(element, children), children: children, leaves: leaves})

      {tree, rest, at}
    else
      leaf = Leaf.new(element, at, definition, level)
      {Map.merge(base, %{kind: :leaf, children: [], leaves: [leaf]}), rest, at + 1}
    end
  end

  defp build_node(_other, _at, _levels, _depth), do: throw_malformed("its schema is malformed")

  defp build_children(0, rest, at, _levels, _depth, acc), do: {Enum.reverse(acc), rest, at}

  defp build_children(n, rest, at, levels, depth, acc) when n > 0 do
    {child, rest, at} = build_node(rest, at, levels, depth)
    build_children(n - 1, rest, at, levels, depth, [child | acc])
  end

  defp build_children(_n, _rest, _at, _levels, _depth, _acc),
    do: throw_malformed("its schema is malformed")

  # Lists and maps are groups whose only child is a repeated group.
  defp group_kind(element, [%{repetition: @repeated}]) do
    cond do
      element[6] == 3 or match?(%{3 => _}, element[10]) -> :list
      element[6] in [1, 2] or match?(%{2 => _}, element[10]) -> :map
      true -> :struct
    end
  end

  defp group_kind(_element, _children), do: :struct

  @doc "Returns the value of one row, assembled from the entries of each leaf."
  @spec row_value(tree(), [[entry()]]) :: term()
  def row_value(tree, rows) do
    positions = Enum.map(tree.leaves, & &1.at)
    node_value(tree, positions |> Enum.zip(rows) |> Map.new())
  end

  # A repetition level up to `level` begins a new element.
  defp split_entries([], _level), do: []

  defp split_entries([first | rest], level) do
    {last, elements} =
      Enum.reduce(rest, {[first], []}, fn {at, _, _} = entry, {element, elements} ->
        if at <= level,
          do: {[entry], [Enum.reverse(element) | elements]},
          else: {[entry | element], elements}
      end)

    Enum.reverse([Enum.reverse(last) | elements])
  end

  defp node_value(%{repetition: @repeated} = node, entries),
    do: for(entries <- node_elements(node, entries), do: node_content(node, entries))

  defp node_value(node, entries), do: if(defined?(node, entries), do: node_content(node, entries))

  defp defined?(%{definition: definition, leaves: [leaf | _]}, entries) do
    [{_, level, _} | _] = Map.fetch!(entries, leaf.at)
    level >= definition
  end

  defp node_elements(node, entries) do
    if defined?(node, entries) do
      positions = Enum.map(node.leaves, & &1.at)

      positions
      |> Enum.map(&split_entries(Map.fetch!(entries, &1), node.level))
      |> Enum.zip_with(&(positions |> Enum.zip(&1) |> Map.new()))
    else
      []
    end
  end

  defp node_content(%{kind: :leaf, leaves: [leaf]}, entries) do
    [{_, _, value} | _] = Map.fetch!(entries, leaf.at)
    value
  end

  defp node_content(%{kind: :struct, children: children}, entries),
    do: Map.new(children, &{&1.name, node_value(&1, entries)})

  defp node_content(%{kind: :list, name: name, children: [repeated]}, entries) do
    for entries <- node_elements(repeated, entries), do: list_element(repeated, name, entries)
  end

  defp node_content(%{kind: :map, children: [%{children: [key, value]} = pairs]}, entries),
    do:
      for(
        entries <- node_elements(pairs, entries),
        into: %{},
        do: {node_value(key, entries), node_value(value, entries)}
      )

  defp node_content(%{kind: :map, children: [pairs]}, entries),
    do: for(entries <- node_elements(pairs, entries), do: node_content(pairs, entries))

  # Old writers omit the group between the list and its elements.
  defp list_element(%{kind: :struct, children: [child], name: group}, name, entries) do
    if group in ["array", name <> "_tuple"],
      do: %{child.name => node_value(child, entries)},
      else: node_value(child, entries)
  end

  defp list_element(repeated, _name, entries), do: node_content(repeated, entries)

  defp throw_malformed(why), do: throw({:not_parquet, why})
end
