defmodule Situ.Studio.Layout.Arrangement do
  @moduledoc false
  # Arranges the panels of an automatic layout. Cells are in rows above the timelines, or in a column next to them,
  # whichever shows their content larger in a window of 1280 x 800 pixels. If there are more panels than fit into the
  # window, neighbors share a place as tabs. Pure.
  alias Situ.Studio.Layout
  alias Situ.Studio.Layout.{Places, Sizes, Tree}

  @width elem(Sizes.usual_size(), 0)
  @height elem(Sizes.usual_size(), 1)
  @head elem(Sizes.usual_size(), 2)
  # The rows of cells above the timelines get at least and at most this share of the height.
  @least 0.3
  @most 0.6
  # Plots keep at least this many places.
  @least_plots 3
  # A cell with at least this ratio of width to height has a separate row.
  @wide 2.2
  @cells 3
  # More rows of cells than this would be small.
  @rows 2
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
    column? = cells != [] and column?(layout, rows, timelines)
    below? = cells != [] and not column?
    lines = group_timelines(layout, timelines, if(below?, do: 1 - @least, else: 1))

    cond do
      cells == [] ->
        put_rows(layout, lines, false)

      # Without timelines, the cells share the whole area.
      timelines == [] ->
        put_rows(layout, Enum.map(rows, fn row -> Enum.map(row, &forget_aspect/1) end), false)

      column? ->
        put_rows(layout, Enum.map(cells, &[&1]) ++ lines, true)

      true ->
        put_rows(layout, rows ++ lines, false)
    end
  end

  # A place is a panel, or a list of panels in tabs.
  defp put_rows(layout, rows, side?) do
    ids = for row <- rows, do: Enum.map(row, &place_ids/1)
    tree = Places.from_rows(ids, Layout.timeline_ids(layout), side?)
    Layout.put_tree(%{layout | panels: List.flatten(rows)}, tree)
  end

  defp place_ids(tabs) when is_list(tabs), do: Enum.map(tabs, & &1.id)
  defp place_ids(panel), do: panel.id

  defp forget_aspect(tabs) when is_list(tabs), do: Enum.map(tabs, &forget_aspect/1)
  defp forget_aspect(panel), do: %{panel | aspect: nil}

  # Cells in tabs keep their row.
  defp column?(layout, rows, timelines) do
    cells = List.flatten(rows)

    length(timelines) > 1 and length(cells) <= @cells and
      column_benefit(cells) > rows_benefit(layout, rows, timelines)
  end

  defp aspect(panel, ratios) do
    ratio = ratios[panel.id] || @aspects[panel.panel] || @other
    ratio |> max(0.45) |> min(10.0) |> Float.round(2)
  end

  # Wide cells have separate rows, and the others are side by side. Of more than two rows, wide cells share one as tabs,
  # and so do the others.
  defp group_cells(cells) do
    {wide, others} = Enum.split_with(cells, &(&1.aspect >= @wide))
    rows = Enum.map(wide, &[&1]) ++ Enum.chunk_every(others, @cells)

    if length(rows) <= @rows,
      do: rows,
      else: Enum.reject([share_places(wide, 1), share_cells(others)], &(&1 == []))
  end

  # 3D views and maps, in which one moves about, have a place each.
  defp share_cells(cells) do
    {large, others} = Enum.split_with(cells, &(&1.panel in [:space, :map]))
    large ++ share_places(others, max(@cells - length(large), 1))
  end

  # Puts panels into at most `count` places, in order.
  defp share_places(panels, count) when length(panels) <= count, do: panels

  defp share_places(panels, count) do
    size = ceil(length(panels) / count)

    for tabs <- Enum.chunk_every(panels, size),
        do: if(match?([_], tabs), do: hd(tabs), else: tabs)
  end

  # If the timelines need more than this share of the window's height, plots share places; lanes do not.
  defp group_timelines(layout, timelines, share) do
    {plots, others} = Enum.split_with(timelines, &(&1.panel == :plot))
    heights = Map.new(timelines, &{&1.id, least_height(layout, &1)})
    sum = fn panels -> panels |> Enum.map(&heights[&1.id]) |> Enum.sum() end
    room = share * @height

    if sum.(timelines) <= room do
      Enum.map(timelines, &[&1])
    else
      count = max(div(round(room) - sum.(others), Sizes.tabs_height(:plot)), @least_plots)
      share_lines(timelines, plots, count)
    end
  end

  # The places of plots are where their first plots were.
  defp share_lines(timelines, plots, count) do
    places = Map.new(share_places(plots, count), &{hd(List.wrap(&1)).id, &1})

    for panel <- timelines,
        panel.panel != :plot or is_map_key(places, panel.id),
        do: [Map.get(places, panel.id, panel)]
  end

  defp least_height(layout, panel), do: Sizes.least_height(layout, Tree.new_panel(panel.id), %{})

  defp rows_benefit(layout, rows, timelines) do
    needed = timelines |> Enum.map(&least_height(layout, &1)) |> Enum.sum()
    available = (@height - 1.1 * needed) |> max(@least * @height) |> min(@most * @height)

    rows
    |> Enum.map(fn row -> Enum.map(row, &(&1 |> List.wrap() |> hd())) end)
    |> Enum.map(&{&1, @width / Sizes.sum_aspects(&1)})
    |> benefit_within(available)
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
