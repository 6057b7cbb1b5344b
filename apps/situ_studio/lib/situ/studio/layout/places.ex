defmodule Situ.Studio.Layout.Places do
  @moduledoc false
  # Chooses where panels are in the tree of a layout: the place of a new panel, and cells next to the timelines or above
  # them. `times` contains the ids of the timelines; the other panels are cells. Pure.
  alias Situ.Studio.Layout.Tree

  @type times :: MapSet.t(String.t())

  # A new cell joins a row with fewer cells.
  @cells 3

  @doc """
  Builds the tree of rows of panels, of which several may share a place as tabs. Cells are in a column next to the
  timelines, or in rows above them.

      iex> alias Situ.Studio.Layout.{Places, Tree}
      iex> Tree.to_list(Places.from_rows([["p1"], ["p2"]], MapSet.new(["p2"]), true))
      [:row, "p1", "p2"]
      iex> Tree.to_list(Places.from_rows([["p1", ["p2", "p3"]]], MapSet.new(), false))
      [:row, "p1", [:tabs, "p2", "p3"]]
  """
  @spec from_rows([[String.t() | [String.t(), ...], ...]], times(), boolean()) :: Tree.t() | nil
  def from_rows(rows, times, side?) do
    {timelines, cells} =
      Enum.split_with(rows, fn [first | _] -> hd(List.wrap(first)) in times end)

    if side? and cells != [] and timelines != [],
      do: Tree.combine(:row, for(part <- [cells, timelines], do: combine_rows(part))),
      else: combine_rows(rows)
  end

  defp combine_rows(rows) do
    Tree.combine(
      :column,
      for(places <- rows, do: Tree.combine(:row, Enum.map(places, &combine_tabs/1)))
    )
  end

  defp combine_tabs(place),
    do: Tree.combine(:tabs, place |> List.wrap() |> Enum.map(&Tree.new_panel/1))

  @doc "Adds a panel: a timeline below the other timelines, a cell next to other cells or above the timelines."
  @spec add_panel(Tree.t() | nil, String.t(), times()) :: Tree.t()
  def add_panel(tree, id, times) do
    part = Tree.new_panel(id)
    place = if id in times, do: below_timelines(tree, times), else: next_to_cells(tree, times)

    case Tree.insert(tree, part, place) do
      {:ok, tree} -> tree
      {:error, _} -> Tree.combine(:column, [tree, part])
    end
  end

  defp below_timelines(nil, _), do: {:below, ""}

  defp below_timelines(tree, times) do
    case timeline_part(tree, times) do
      %Tree{way: :column, parts: parts} -> {:below, List.last(parts).id}
      part -> {:below, part.id}
    end
  end

  defp next_to_cells(nil, _), do: {:right, ""}

  defp next_to_cells(tree, times) do
    case {tree |> rows_with_room(times) |> List.last(), timeline_part(tree, times)} do
      {%Tree{way: :row, parts: parts}, _} -> {:right, List.last(parts).id}
      {%Tree{id: id}, _} -> {:right, id}
      {nil, %Tree{way: :column, parts: parts}} -> {:above, first_with_timeline(parts, times).id}
      {nil, part} -> {:above, part.id}
    end
  end

  defp first_with_timeline(parts, times),
    do: Enum.find(parts, hd(parts), &(not only_cells?(&1, times)))

  # Rows of few cells, and cells that are not in a row.
  defp rows_with_room(%Tree{way: :panel} = tree, times),
    do: if(only_cells?(tree, times), do: [tree], else: [])

  defp rows_with_room(%Tree{way: :tabs}, _), do: []

  defp rows_with_room(%Tree{way: :row, parts: parts} = row, times) do
    if Enum.all?(parts, &(&1.way == :panel and only_cells?(&1, times))),
      do: if(length(parts) < @cells, do: [row], else: []),
      else: parts |> Enum.reject(&(&1.way == :panel)) |> Enum.flat_map(&rows_with_room(&1, times))
  end

  defp rows_with_room(%Tree{parts: parts}, times),
    do: Enum.flat_map(parts, &rows_with_room(&1, times))

  @doc "Returns the part that contains all timelines, below the time navigator; the whole tree if there is none."
  @spec timeline_part(Tree.t() | nil, times()) :: Tree.t() | nil
  def timeline_part(%Tree{way: :row, parts: parts} = row, times) do
    case Enum.reject(parts, &only_cells?(&1, times)) do
      [part] -> timeline_part(part, times)
      _ -> row
    end
  end

  def timeline_part(tree, _), do: tree

  @doc "Returns whether a part has only cells."
  @spec only_cells?(Tree.t(), times()) :: boolean()
  def only_cells?(part, times), do: part |> Tree.panel_ids() |> Enum.all?(&(&1 not in times))

  @doc "Returns whether cells are next to the timelines."
  @spec has_side?(Tree.t() | nil, times()) :: boolean()
  def has_side?(tree, times),
    do: tree != nil and tree.way == :row and timeline_part(tree, times) != tree

  @doc "Moves the cells to a column next to the timelines, or back to rows above them."
  @spec toggle_side(Tree.t() | nil, times()) :: Tree.t() | nil
  def toggle_side(tree, times) do
    cells = cell_parts(tree, times)
    rest = Enum.reduce(cells, tree, &Tree.remove(&2, &1.id))
    cells = cells |> Enum.flat_map(&list_cells/1) |> Enum.map(&%{&1 | size: nil})

    cond do
      cells == [] or rest == nil ->
        tree

      has_side?(tree, times) ->
        rows = for row <- Enum.chunk_every(cells, @cells), do: Tree.combine(:row, row)
        Tree.combine(:column, rows ++ [%{rest | size: nil}])

      true ->
        Tree.combine(:row, [Tree.combine(:column, cells), %{rest | size: nil}])
    end
  end

  # Panels, and tabs of panels.
  defp list_cells(%Tree{way: way, parts: parts}) when way in [:row, :column],
    do: Enum.flat_map(parts, &list_cells/1)

  defp list_cells(part), do: [part]

  # The largest parts that contain only cells.
  defp cell_parts(nil, _), do: []

  defp cell_parts(part, times) do
    if only_cells?(part, times),
      do: [part],
      else: Enum.flat_map(part.parts, &cell_parts(&1, times))
  end
end
