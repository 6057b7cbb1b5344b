defmodule Situ.Bridge.Parquet.Tree do
  @moduledoc false
  # The schema of a Parquet file as columns. A flat column is a leaf. A column of lists, maps or structs is a tree,
  # whose values are assembled from its leaves by their repetition and definition levels (Dremel encoding). Pure.
  # Throws `{:not_parquet, why}`.
  alias Situ.Bridge.Columnar.Names
  alias Situ.Bridge.Parquet.Leaf

  @deepest 32
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
  @spec columns([map()]) :: [column()]
  def columns(elements), do: elements |> columns(0, []) |> Names.distinguish()

  defp columns([], _at, found), do: Enum.reverse(found)

  defp columns(elements, at, found) do
    {tree, rest, at} = node(elements, at, {0, 0}, 0)
    columns(rest, at, [column(tree) | found])
  end

  defp column(%{kind: :leaf, repetition: repetition, leaves: [leaf]})
       when repetition != @repeated,
       do: leaf

  defp column(tree), do: %{name: tree.name, time?: false, tree: tree}

  defp node(_elements, _at, _levels, depth) when depth > @deepest,
    do: fail("its columns are nested too deeply")

  defp node([%{4 => name} = element | rest], at, {definition, level}, depth)
       when is_binary(name) do
    repetition = element[3] || 0
    definition = if repetition == 0, do: definition, else: definition + 1
    level = if repetition == @repeated, do: level + 1, else: level
    base = %{name: name, repetition: repetition, definition: definition, level: level}

    if is_integer(element[5]) do
      {children, rest, at} = children(element[5], rest, at, {definition, level}, depth + 1, [])
      leaves = Enum.flat_map(children, & &1.leaves)
      if leaves == [], do: fail("a group has no columns")
      children = Names.distinguish(children)

      tree = Map.merge(base, %{kind: kind(element, children), children: children, leaves: leaves})

      {tree, rest, at}
    else
      leaf = Leaf.new(element, at, definition, level)
      {Map.merge(base, %{kind: :leaf, children: [], leaves: [leaf]}), rest, at + 1}
    end
  end

  defp node(_other, _at, _levels, _depth), do: fail("its schema is malformed")

  defp children(0, rest, at, _levels, _depth, found), do: {Enum.reverse(found), rest, at}

  defp children(n, rest, at, levels, depth, found) when n > 0 do
    {child, rest, at} = node(rest, at, levels, depth)
    children(n - 1, rest, at, levels, depth, [child | found])
  end

  defp children(_n, _rest, _at, _levels, _depth, _found), do: fail("its schema is malformed")

  # Lists and maps are groups whose only child is a repeated group.
  defp kind(element, [%{repetition: @repeated}]) do
    cond do
      element[6] == 3 or match?(%{3 => _}, element[10]) -> :list
      element[6] in [1, 2] or match?(%{2 => _}, element[10]) -> :map
      true -> :struct
    end
  end

  defp kind(_element, _children), do: :struct

  @doc "Returns the value of one row, assembled from the entries of each leaf."
  @spec row_value(tree(), [[entry()]]) :: term()
  def row_value(tree, rows) do
    places = Enum.map(tree.leaves, & &1.at)
    value(tree, places |> Enum.zip(rows) |> Map.new())
  end

  # A repetition level up to `level` begins a new element.
  defp split([], _level), do: []

  defp split([first | rest], level) do
    {last, done} =
      Enum.reduce(rest, {[first], []}, fn {at, _, _} = entry, {element, done} ->
        if at <= level,
          do: {[entry], [Enum.reverse(element) | done]},
          else: {[entry | element], done}
      end)

    Enum.reverse([Enum.reverse(last) | done])
  end

  defp value(%{repetition: @repeated} = node, held),
    do: for(held <- elements(node, held), do: content(node, held))

  defp value(node, held), do: if(there?(node, held), do: content(node, held))

  defp there?(%{definition: definition, leaves: [leaf | _]}, held) do
    [{_, defined, _} | _] = Map.fetch!(held, leaf.at)
    defined >= definition
  end

  defp elements(node, held) do
    if there?(node, held) do
      places = Enum.map(node.leaves, & &1.at)

      places
      |> Enum.map(&split(Map.fetch!(held, &1), node.level))
      |> Enum.zip_with(&(places |> Enum.zip(&1) |> Map.new()))
    else
      []
    end
  end

  defp content(%{kind: :leaf, leaves: [leaf]}, held) do
    [{_, _, value} | _] = Map.fetch!(held, leaf.at)
    value
  end

  defp content(%{kind: :struct, children: children}, held),
    do: Map.new(children, &{&1.name, value(&1, held)})

  defp content(%{kind: :list, name: name, children: [repeated]}, held) do
    for held <- elements(repeated, held), do: element(repeated, name, held)
  end

  defp content(%{kind: :map, children: [%{children: [key, value]} = pairs]}, held),
    do: for(held <- elements(pairs, held), into: %{}, do: {value(key, held), value(value, held)})

  defp content(%{kind: :map, children: [pairs]}, held),
    do: for(held <- elements(pairs, held), do: content(pairs, held))

  # Old writers omit the group between the list and its elements.
  defp element(%{kind: :struct, children: [one], name: between}, name, held) do
    if between in ["array", name <> "_tuple"],
      do: %{one.name => value(one, held)},
      else: value(one, held)
  end

  defp element(repeated, _name, held), do: content(repeated, held)

  defp fail(why), do: throw({:not_parquet, why})
end
