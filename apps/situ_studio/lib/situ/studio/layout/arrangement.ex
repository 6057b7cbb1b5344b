defmodule Situ.Studio.Layout.Arrangement do
  @moduledoc false
  # Arranges the cells of an automatic layout: in rows above the timelines, or in a column next to them, whichever shows
  # their content larger in a window of 1280 x 800 pixels. Pure.
  alias Situ.Studio.Layout
  alias Situ.Studio.Layout.{Places, Sizes, Tree}

  @width elem(Sizes.usual_size(), 0)
  @height elem(Sizes.usual_size(), 1)
  @head elem(Sizes.usual_size(), 2)
  # The rows of cells above the timelines get at least and at most this share of the height.
  @least 0.3
  @most 0.6
  # A cell with at least this ratio of width to height has a separate row.
  @wide 2.2
  @cells 3
  @aspects %{space: 1.6, map: 1.3, bars: 1.2}
  @other 1.3

  @doc """
  Arranges the cells of a layout. `ratios` maps the ids of panels to the ratio of width to height of their content.

      iex> alias Situ.Studio.Layout
      iex> add = fn layout, stream, panel -> elem(Layout.add_stream(layout, stream, "x", panel, ""), 1) end
      iex> layout = Layout.new("") |> add.("Camera", :image) |> add.("Level", :plot) |> add.("Speed", :plot)
      iex> Layout.Tree.to_list(Layout.Arrangement.arrange(layout, %{"p1" => 16 / 9}).tree)
      [:column, "p1", "p2", "p3"]
      iex> Layout.Tree.to_list(Layout.Arrangement.arrange(layout, %{"p1" => 3 / 4}).tree)
      [:row, "p1", [:column, "p2", "p3"]]
  """
  @spec arrange(Layout.t(), %{optional(String.t()) => float()}) :: Layout.t()
  def arrange(%Layout{} = layout, ratios) do
    {timelines, cells} = Enum.split_with(layout.panels, &Layout.timeline?(&1.panel))
    cells = Enum.map(cells, &%{&1 | aspect: aspect(&1, ratios)})
    rows = group_cells(cells)
    lines = Enum.map(timelines, &[&1])

    cond do
      cells == [] ->
        layout

      # Without timelines, the cells share the whole area.
      timelines == [] ->
        put_rows(layout, Enum.map(rows, fn row -> Enum.map(row, &%{&1 | aspect: nil}) end), false)

      length(timelines) > 1 and column_benefit(cells) > rows_benefit(layout, rows, timelines) ->
        put_rows(layout, Enum.map(cells, &[&1]) ++ lines, true)

      true ->
        put_rows(layout, rows ++ lines, false)
    end
  end

  defp put_rows(layout, rows, side?) do
    ids = for row <- rows, do: Enum.map(row, & &1.id)
    tree = Places.from_rows(ids, Layout.timeline_ids(layout), side?)
    Layout.put_tree(%{layout | panels: List.flatten(rows)}, tree)
  end

  defp aspect(panel, ratios) do
    ratio = ratios[panel.id] || @aspects[panel.panel] || @other
    ratio |> max(0.45) |> min(10.0) |> Float.round(2)
  end

  # Wide cells have separate rows, and the others are side by side.
  defp group_cells(cells) do
    {wide, others} = Enum.split_with(cells, &(&1.aspect >= @wide))
    Enum.map(wide, &[&1]) ++ Enum.chunk_every(others, @cells)
  end

  defp rows_benefit(layout, rows, timelines) do
    least = &Sizes.least_height(layout, Tree.new_panel(&1.id), %{})
    needed = timelines |> Enum.map(least) |> Enum.sum()
    available = (@height - 1.1 * needed) |> max(@least * @height) |> min(@most * @height)
    rows |> Enum.map(&{&1, @width / Sizes.sum_aspects(&1)}) |> benefit_within(available)
  end

  defp column_benefit(cells) do
    width = Sizes.column_share(Enum.map(cells, &[&1])) * @width
    cells |> Enum.map(&{[&1], width / &1.aspect}) |> benefit_within(@height)
  end

  # The sum of the logarithms of the cells' areas if all rows together have at most this height. A loss
  # of size counts more than an equal gain.
  defp benefit_within(rows, available) do
    wanted = rows |> Enum.map(fn {_, height} -> height + @head end) |> Enum.sum()
    factor = min(available / wanted, 1.0)

    for {row, height} <- rows, cell <- row, reduce: 0.0 do
      sum -> sum + :math.log(cell.aspect * max(factor * (height + @head) - @head, 1) ** 2)
    end
  end
end
