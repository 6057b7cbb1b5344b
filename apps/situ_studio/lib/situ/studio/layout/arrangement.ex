defmodule Situ.Studio.Layout.Arrangement do
  @moduledoc false
  # Arranges the cells of an automatic layout: in rows above the timelines, or in a column next to them, whichever shows
  # their content larger in a window of 1280 x 800 pixels. Pure.
  alias Situ.Studio.Layout
  alias Situ.Studio.Layout.Rows

  @width elem(Rows.usual_size(), 0)
  @height elem(Rows.usual_size(), 1)
  @head elem(Rows.usual_size(), 2)
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
      iex> add = fn layout, stream, panel -> elem(Layout.add_stream(layout, stream, "x", panel, "", row: "r1"), 1) end
      iex> layout = Layout.new("") |> add.("Camera", :image) |> add.("Level", :plot) |> add.("Speed", :plot)
      iex> Layout.Arrangement.arrange(layout, %{"p1" => 16 / 9}).cell_column
      false
      iex> Layout.Arrangement.arrange(layout, %{"p1" => 3 / 4}).cell_column
      true
  """
  @spec arrange(Layout.t(), %{optional(String.t()) => float()}) :: Layout.t()
  def arrange(%Layout{} = layout, ratios) do
    {cells, timelines} = Enum.split_with(layout.rows, & &1.row)
    cells = Enum.map(cells, &%{&1 | aspect: aspect(&1, ratios)})
    rows = group_cells(cells)

    cond do
      cells == [] ->
        layout

      # Without timelines, the cells share the whole area.
      timelines == [] ->
        %{layout | rows: name_rows(rows) |> Enum.map(&%{&1 | aspect: nil})}

      length(timelines) > 1 and column_benefit(cells) > rows_benefit(rows, timelines) ->
        %{layout | rows: name_rows(Enum.map(cells, &[&1])) ++ timelines, cell_column: true}

      true ->
        %{layout | rows: name_rows(rows) ++ timelines}
    end
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

  defp name_rows(rows) do
    rows
    |> Enum.with_index(1)
    |> Enum.flat_map(fn {row, i} -> Enum.map(row, &%{&1 | row: "r#{i}"}) end)
  end

  defp rows_benefit(rows, timelines) do
    needed = timelines |> Enum.map(&Layout.line_height([&1])) |> Enum.sum()
    available = (@height - 1.1 * needed) |> max(@least * @height) |> min(@most * @height)
    rows |> Enum.map(&{&1, @width / Rows.sum_aspects(&1)}) |> benefit_within(available)
  end

  defp column_benefit(cells) do
    width = Rows.column_share(Enum.map(cells, &[&1])) * @width
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
