defmodule Situ.Studio.Layout.Rows do
  @moduledoc false
  # Orders a layout's panels: rows from top to bottom, and the cells of a row from left to right. Pure.
  alias Situ.Error
  alias Situ.Studio.Layout.Panel

  @type target ::
          {:above | :below, row_id :: String.t()} | {:left | :right, panel_id :: String.t()}
  @type placed :: {:ok, [Panel.t()]} | {:error, Error.t()}

  @max_cells 5

  @doc "Returns the id of a panel's row."
  @spec panel_row(Panel.t()) :: String.t()
  def panel_row(%Panel{row: row, id: id}), do: row || id

  @doc "Groups panels that are side by side into rows."
  @spec group_rows([Panel.t()]) :: [[Panel.t(), ...]]
  def group_rows(panels), do: Enum.chunk_by(panels, &panel_row/1)

  # The ratio of a cell whose content has no known ratio.
  @aspect 1.3

  @doc "Returns the ratio of width to height of a row of cells."
  @spec sum_aspects([Panel.t(), ...]) :: float()
  def sum_aspects(row), do: row |> Enum.map(&(&1.aspect || @aspect)) |> Enum.sum()

  # The area of the panels in a window of 1280 x 800 pixels, and the head of a cell.
  @width 1_040
  @height 640
  @head 26

  @doc "Returns the usual width and height of the area of all panels, and the height of a cell's head, in pixels."
  @spec usual_size() :: {pos_integer(), pos_integer(), pos_integer()}
  def usual_size, do: {@width, @height, @head}

  @doc """
  Returns the width of a column of cells that fills its height with their content, as a share of the width of all
  panels: 0.25 to 0.5.

      iex> alias Situ.Studio.Layout.{Panel, Rows}
      iex> Rows.column_share([[%Panel{id: "p1", panel: :image, aspect: 0.5}]])
      0.3
  """
  @spec column_share([[Panel.t(), ...], ...]) :: float()
  def column_share(rows) do
    content = @height - @head * length(rows)
    width = content / (rows |> Enum.map(&(1 / sum_aspects(&1))) |> Enum.sum())
    (width / @width) |> max(0.25) |> min(0.5) |> Float.round(2)
  end

  @doc "Inserts a new panel. Cells stay together, above the timelines."
  @spec insert([Panel.t()], Panel.t()) :: [Panel.t()]
  def insert(panels, %Panel{row: nil} = panel), do: panels ++ [panel]

  def insert(panels, %Panel{row: row} = panel) do
    case panels |> Enum.with_index() |> Enum.filter(fn {p, _} -> p.row == row end) do
      [] ->
        {cells, timelines} = Enum.split_while(panels, & &1.row)
        cells ++ [panel | timelines]

      found ->
        {_, last} = List.last(found)
        List.insert_at(panels, last + 1, panel)
    end
  end

  @doc "Returns an unused name for a row of cells."
  @spec unused_row_name([Panel.t()]) :: String.t()
  def unused_row_name(panels) do
    taken = MapSet.new(panels, & &1.row)
    1 |> Stream.iterate(&(&1 + 1)) |> Stream.map(&"r#{&1}") |> Enum.find(&(&1 not in taken))
  end

  @spec move_row([Panel.t()], String.t(), -1 | 1) :: [Panel.t()]
  def move_row(panels, row_id, by) do
    lines = group_rows(panels)
    from = row_index(lines, row_id)
    to = from && from + by

    if from && to in 0..(length(lines) - 1)//1 do
      {line, rest} = List.pop_at(lines, from)
      rest |> List.insert_at(to, line) |> List.flatten()
    else
      panels
    end
  end

  @spec place_panel([Panel.t()], String.t(), target()) :: placed()
  def place_panel(panels, id, {side, target}) when side in [:above, :below] do
    {taken, rest} = Enum.split_with(panels, &(&1.id == id))
    lines = group_rows(rest)

    case {taken, row_index(lines, target)} do
      {[panel], at} when at != nil ->
        panel = if panel.row, do: %{panel | row: unused_row_name(rest)}, else: panel
        at = if side == :below, do: at + 1, else: at
        {:ok, lines |> List.insert_at(at, [panel]) |> List.flatten()}

      _ ->
        {:ok, panels}
    end
  end

  def place_panel(panels, id, {side, target}) when side in [:left, :right] do
    {taken, rest} = Enum.split_with(panels, &(&1.id == id))

    with [%Panel{row: own} = panel] when own != nil <- taken,
         at when at != nil <- Enum.find_index(rest, &(&1.id == target)),
         %Panel{row: row, height: height} when row != nil <- Enum.at(rest, at) do
      if Enum.count(rest, &(&1.row == row)) < @max_cells do
        at = if side == :right, do: at + 1, else: at
        {:ok, List.insert_at(rest, at, %{panel | row: row, height: height})}
      else
        {:error, Error.new(:full, "a row holds at most #{@max_cells} panels side by side")}
      end
    else
      _ -> {:ok, panels}
    end
  end

  @spec shift_panel([Panel.t()], String.t(), :up | :down | :left | :right) :: placed()
  def shift_panel(panels, id, way) do
    lines = group_rows(panels)
    at = Enum.find_index(lines, fn line -> Enum.any?(line, &(&1.id == id)) end)
    if at, do: shift_panel(panels, lines, at, id, way), else: {:ok, panels}
  end

  # Moves a whole row, or a cell out of its row.
  defp shift_panel(panels, lines, at, id, way) when way in [:up, :down] do
    {by, side} = if way == :up, do: {-1, :above}, else: {1, :below}

    case Enum.at(lines, at) do
      [panel] -> {:ok, move_row(panels, panel_row(panel), by)}
      [panel | _] -> place_panel(panels, id, {side, panel_row(panel)})
    end
  end

  # Moves a panel past its neighbour, or from the end of a row of cells into the next row of cells.
  defp shift_panel(panels, lines, at, id, way) do
    line = Enum.at(lines, at)
    step = if way == :left, do: -1, else: 1
    i = Enum.find_index(line, &(&1.id == id)) + step

    cond do
      i in 0..(length(line) - 1)//1 -> place_panel(panels, id, {way, Enum.at(line, i).id})
      at + step < 0 -> {:ok, panels}
      true -> join_row(panels, id, way, Enum.at(lines, at + step))
    end
  end

  defp join_row(panels, _, _, nil), do: {:ok, panels}

  defp join_row(panels, id, :left, line),
    do: place_panel(panels, id, {:right, List.last(line).id})

  defp join_row(panels, id, :right, line), do: place_panel(panels, id, {:left, hd(line).id})

  defp row_index(lines, row_id),
    do: Enum.find_index(lines, fn [panel | _] -> panel_row(panel) == row_id end)
end
