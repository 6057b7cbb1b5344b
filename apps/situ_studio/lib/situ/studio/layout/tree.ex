defmodule Situ.Studio.Layout.Tree do
  @moduledoc false
  # Arranges panels as a tree of rows, columns and tabs; see
  # docs/adr/0188-a-layout-is-a-tree-of-rows-columns-and-tabs.md. A tree contains only the ids of panels. Pure.
  #
  # Every change keeps a tree in its simplest form: a row, a column and tabs have at least two parts, no row is a part
  # of a row and no column of a column, and the parts of tabs are panels.
  alias Situ.Error
  alias __MODULE__, as: Tree

  @enforce_keys [:id]
  defstruct [:id, :size, way: :panel, parts: [], active: nil]

  @typedoc """
  A panel, or parts side by side, one above the other, or in tabs. `size` is the height in pixels of a part
  of a column, and the share of the width of a part of a row; `nil` is chosen by the content. `active` is the id of the
  tab in front.
  """
  @type t :: %Tree{
          id: String.t(),
          way: :panel | :row | :column | :tabs,
          size: number() | nil,
          parts: [t()],
          active: String.t() | nil
        }

  @type side :: :above | :below | :left | :right | :tab
  @type changed :: {:ok, t() | nil} | {:error, Error.t()}

  @max_parts 8
  @max_depth 8

  @doc "Returns the maximum number of parts side by side, and of levels of a tree."
  @spec size_limits() :: {pos_integer(), pos_integer()}
  def size_limits, do: {@max_parts, @max_depth}

  @doc "Creates the tree of a single panel."
  @spec new_panel(String.t()) :: t()
  def new_panel(id), do: %Tree{id: id}

  @doc """
  Puts trees in a row, a column or tabs. Returns `nil` without trees.

      iex> alias Situ.Studio.Layout.Tree
      iex> row = Tree.combine(:row, [Tree.new_panel("p1"), Tree.new_panel("p2")])
      iex> Tree.to_list(Tree.combine(:column, [row, Tree.new_panel("p3")]))
      [:column, [:row, "p1", "p2"], "p3"]
  """
  @spec combine(:row | :column | :tabs, [t()]) :: t() | nil
  def combine(_, []), do: nil

  def combine(way, parts) do
    {tree, _} = %Tree{id: "", way: way, parts: parts} |> simplify() |> number_parts(1)
    tree
  end

  defp number_parts(%Tree{way: :panel} = tree, n), do: {tree, n}

  defp number_parts(tree, n) do
    {parts, next} = Enum.map_reduce(tree.parts, n + 1, &number_parts/2)
    {%{tree | id: "s#{n}", parts: parts}, next}
  end

  @doc "Returns the tree as nested lists, without ids of rows, columns and tabs, and without sizes."
  @spec to_list(t() | nil) :: term()
  def to_list(nil), do: []
  def to_list(%Tree{way: :panel, id: id}), do: id
  def to_list(%Tree{way: way, parts: parts}), do: [way | Enum.map(parts, &to_list/1)]

  @doc "Returns the ids of the panels from top to bottom and from left to right."
  @spec panel_ids(t() | nil) :: [String.t()]
  def panel_ids(nil), do: []
  def panel_ids(%Tree{way: :panel, id: id}), do: [id]
  def panel_ids(%Tree{parts: parts}), do: Enum.flat_map(parts, &panel_ids/1)

  @doc "Returns the part with this id, or `nil`."
  @spec find(t() | nil, String.t()) :: t() | nil
  def find(nil, _), do: nil
  def find(%Tree{id: id} = tree, id), do: tree
  def find(%Tree{parts: parts}, id), do: Enum.find_value(parts, &find(&1, id))

  @doc "Returns the parts that contain the part `id`, from the inside to the outside, each with its index in the next."
  @spec ancestors(t() | nil, String.t()) :: [{t(), index :: non_neg_integer()}]
  def ancestors(nil, _), do: []

  def ancestors(%Tree{parts: parts} = tree, id) do
    case Enum.find_index(parts, &(find(&1, id) != nil)) do
      nil -> []
      i -> ancestors(Enum.at(parts, i), id) ++ [{tree, i}]
    end
  end

  @doc "Applies `fun` to the part with this id."
  @spec update(t() | nil, String.t(), (t() -> t())) :: t() | nil
  def update(nil, _, _), do: nil
  def update(%Tree{id: id} = tree, id, fun), do: fun.(tree)
  def update(tree, id, fun), do: %{tree | parts: Enum.map(tree.parts, &update(&1, id, fun))}

  @doc "Removes a panel, or a part with all of its panels."
  @spec remove(t() | nil, String.t()) :: t() | nil
  def remove(tree, id), do: tree |> drop_part(id) |> simplify()

  defp drop_part(nil, _), do: nil
  defp drop_part(%Tree{id: id}, id), do: nil

  defp drop_part(%Tree{parts: parts} = tree, id),
    do: %{tree | parts: for(part <- parts, kept = drop_part(part, id), do: kept)}

  @doc """
  Moves a panel to a side of another part, or as a tab in front of it. The target `"all"` is the whole tree. Unknown
  ids change nothing.

      iex> alias Situ.Studio.Layout.Tree
      iex> tree = Tree.combine(:column, Enum.map(["p1", "p2", "p3"], &Tree.new_panel/1))
      iex> {:ok, tree} = Tree.move(tree, "p3", {:left, "p1"})
      iex> Tree.to_list(tree)
      [:column, [:row, "p3", "p1"], "p2"]
      iex> {:ok, tree} = Tree.move(tree, "p2", {:tab, "p1"})
      iex> Tree.to_list(tree)
      [:row, "p3", [:tabs, "p1", "p2"]]
  """
  @spec move(t() | nil, String.t(), {side(), String.t()}) :: changed()
  def move(tree, id, {side, target}) do
    with %Tree{way: :panel} = panel when id != target <- find(tree, id),
         %Tree{} = rest <- remove(tree, id),
         target when target != nil <- target_without(tree, rest, {side, target}, id) do
      insert(rest, %{panel | size: nil}, {side, target})
    else
      _ -> {:ok, tree}
    end
  end

  defp target_without(_, rest, {_, "all"}, _), do: rest.id

  # A row or column of two parts is gone when one is removed; its other panels remain.
  defp target_without(tree, rest, {side, target}, id) do
    left = panel_ids(find(tree, target)) -- [id]
    same = rest |> list_parts() |> Enum.find(&(panel_ids(&1) == left))

    cond do
      find(rest, target) -> target
      same -> same.id
      side in [:left, :above] -> List.first(left)
      true -> List.last(left)
    end
  end

  @doc "Inserts a part at a side of the part `target`, or as a tab in front of it."
  @spec insert(t() | nil, t(), {side(), String.t()}) :: changed()
  def insert(nil, part, _), do: {:ok, part}

  def insert(tree, part, {side, target}) do
    # A part that is put at a side of a tab is at this side of all tabs.
    {target, around} =
      case ancestors(tree, target) do
        [{%Tree{way: :tabs} = tabs, _} | outer] -> {tabs.id, outer}
        outer -> {target, outer}
      end

    way = side_way(side)

    tree =
      case {find(tree, target), around} do
        {%Tree{way: :tabs}, _} when side == :tab ->
          update(tree, target, &%{&1 | parts: &1.parts ++ panels_of(part), active: part.id})

        {_, [{%Tree{way: ^way} = outer, i} | _]} when side != :tab ->
          update(tree, outer.id, &insert_at(&1, i, part, side))

        _ ->
          update(tree, target, &split_part(&1, part, side, unused_id([tree, part])))
      end

    check_size(simplify(tree))
  end

  # The new part of a row takes half of the share of the part next to it.
  defp insert_at(outer, i, part, side) do
    next = Enum.at(outer.parts, i)
    half = if outer.way == :row and next.size, do: max(next.size / 2, 1.0)
    parts = if half, do: List.replace_at(outer.parts, i, %{next | size: half}), else: outer.parts
    at = if side in [:right, :below], do: i + 1, else: i
    %{outer | parts: List.insert_at(parts, at, %{part | size: half})}
  end

  defp split_part(target, part, :tab, id),
    do: %Tree{
      id: id,
      way: :tabs,
      size: target.size,
      active: part.id,
      parts: panels_of(target) ++ panels_of(part)
    }

  defp split_part(target, part, side, id) do
    parts = [%{target | size: nil}, %{part | size: nil}]
    parts = if side in [:left, :above], do: Enum.reverse(parts), else: parts
    %Tree{id: id, way: side_way(side), size: target.size, parts: parts}
  end

  defp panels_of(tree), do: tree |> panel_ids() |> Enum.map(&new_panel/1)

  defp side_way(side) when side in [:left, :right], do: :row
  defp side_way(side) when side in [:above, :below], do: :column
  defp side_way(:tab), do: :tabs

  @doc """
  Moves a panel one step: past its neighbor, out of its row or column, or to this side of all others.

      iex> alias Situ.Studio.Layout.Tree
      iex> tree = Tree.combine(:column, Enum.map(["p1", "p2", "p3"], &Tree.new_panel/1))
      iex> {:ok, tree} = Tree.shift(tree, "p1", :down)
      iex> Tree.to_list(tree)
      [:column, "p2", "p1", "p3"]
      iex> {:ok, tree} = Tree.shift(tree, "p1", :right)
      iex> Tree.to_list(tree)
      [:row, [:column, "p2", "p3"], "p1"]
  """
  @spec shift(t() | nil, String.t(), :up | :down | :left | :right) :: changed()
  def shift(tree, id, way) do
    {axis, step, side} = axis_of(way)
    around = ancestors(tree, id)
    room? = fn {outer, i} -> outer.way == axis and (i + step) in 0..(length(outer.parts) - 1) end

    case {around, Enum.find_index(around, room?)} do
      {[], _} -> {:ok, tree}
      {[{outer, i} | _], 0} -> {:ok, update(tree, outer.id, &swap_parts(&1, i, i + step))}
      {[{%Tree{way: ^axis}, _}], nil} -> {:ok, tree}
      {_, nil} -> move(tree, id, {side, "all"})
      {_, n} -> move(tree, id, {side, around |> Enum.at(n - 1) |> elem(0) |> Map.fetch!(:id)})
    end
  end

  defp axis_of(:up), do: {:column, -1, :above}
  defp axis_of(:down), do: {:column, 1, :below}
  defp axis_of(:left), do: {:row, -1, :left}
  defp axis_of(:right), do: {:row, 1, :right}

  defp swap_parts(%Tree{parts: parts} = tree, i, k) do
    {a, b} = {Enum.at(parts, i), Enum.at(parts, k)}
    %{tree | parts: parts |> List.replace_at(i, b) |> List.replace_at(k, a)}
  end

  @doc "Brings a tree into its simplest form."
  @spec simplify(t() | nil) :: t() | nil
  def simplify(nil), do: nil
  def simplify(%Tree{way: :panel} = tree), do: tree

  def simplify(%Tree{way: way, size: size} = tree) do
    case tree.parts |> Enum.map(&simplify/1) |> Enum.flat_map(&merge_part(&1, way)) do
      [] -> nil
      [part] -> %{part | size: size}
      parts -> %{tree | parts: parts, active: active_tab(way, parts, tree.active)}
    end
  end

  defp merge_part(nil, _), do: []
  defp merge_part(part, :tabs), do: panels_of(part)
  # The sizes of an inner row are shares of another width.
  defp merge_part(%Tree{way: :row, parts: parts}, :row), do: Enum.map(parts, &%{&1 | size: nil})
  defp merge_part(%Tree{way: :column, parts: parts}, :column), do: parts
  defp merge_part(part, _), do: [part]

  defp active_tab(:tabs, parts, active),
    do: if(Enum.any?(parts, &(&1.id == active)), do: active, else: hd(parts).id)

  defp active_tab(_, _, _), do: nil

  defp check_size(tree) do
    cond do
      tree |> list_parts() |> Enum.any?(&(&1.way == :row and length(&1.parts) > @max_parts)) ->
        {:error, Error.new(:full, "a row holds at most #{@max_parts} panels side by side")}

      count_levels(tree) > @max_depth ->
        {:error, Error.new(:full, "panels can be split at most #{@max_depth} times")}

      true ->
        {:ok, tree}
    end
  end

  defp count_levels(%Tree{parts: parts}),
    do: 1 + (parts |> Enum.map(&count_levels/1) |> Enum.max(fn -> 0 end))

  defp list_parts(%Tree{parts: parts} = tree),
    do: [tree | Enum.flat_map(parts, &list_parts/1)]

  defp unused_id(trees) do
    taken = trees |> Enum.flat_map(&list_parts/1) |> MapSet.new(& &1.id)
    1 |> Stream.iterate(&(&1 + 1)) |> Stream.map(&"s#{&1}") |> Enum.find(&(&1 not in taken))
  end
end
