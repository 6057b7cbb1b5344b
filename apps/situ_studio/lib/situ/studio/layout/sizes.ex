defmodule Situ.Studio.Layout.Sizes do
  @moduledoc false
  # Chooses the sizes of a layout's parts: the sizes that the user set, or minimum heights and shares by the content.
  # Pure.
  alias Situ.Studio.Layout
  alias Situ.Studio.Layout.{Panel, Places, Tree, Visualization}

  @typedoc "The number of lanes by stream, for streams with more than one."
  @type lanes :: %{optional(String.t()) => pos_integer()}

  # The minimum height of a row, and its share of the remaining height.
  @heights %{
    plot: 84,
    lanes: 34,
    image: 200,
    space: 260,
    map: 220,
    value: 160,
    bars: 160,
    text: 90,
    log: 160,
    table: 120,
    xy: 220,
    own: 200
  }
  @weights %{plot: 4, lanes: 1, image: 9, space: 9, map: 8, value: 6, bars: 6, text: 3}
           |> Map.merge(%{log: 6, table: 5, xy: 9, own: 8})
  @lane 26
  # The maximum height of a lane, so that a panel with few lanes leaves the remaining height to other panels.
  @lane_most 36
  # The limits of the height of a row whose cells have a known aspect, in pixels and in percent of the window.
  @least_cells 180
  @most_cells 48
  # Panels with more lanes get the height of this many.
  @max_lanes 12
  # The height of a strip of tabs.
  @tabs 28
  # The ratio of a cell whose content has no known ratio.
  @aspect 1.3

  # The area of the panels in a window of 1280 x 800 pixels, and the head of a cell.
  @width 1_040
  @height 640
  @head 26

  @doc "Returns the usual width and height of the area of all panels, and the height of a cell's head, in pixels."
  @spec usual_size() :: {pos_integer(), pos_integer(), pos_integer()}
  def usual_size, do: {@width, @height, @head}

  @doc "Returns the minimum height of tabs with panels of this kind in pixels."
  @spec tabs_height(atom()) :: pos_integer()
  def tabs_height(kind), do: @heights[kind] + @tabs

  @doc "Returns the ratio of width to height of a row of cells."
  @spec sum_aspects([Panel.t(), ...]) :: float()
  def sum_aspects(row), do: row |> Enum.map(&(&1.aspect || @aspect)) |> Enum.sum()

  @doc """
  Returns the width of a column of cells that fills its height with their content, as a share of the width of all
  panels: 0.25 to 0.5.

      iex> alias Situ.Studio.Layout.{Panel, Sizes}
      iex> Sizes.column_share([[%Panel{id: "p1", panel: :image, aspect: 0.5}]])
      0.3
  """
  @spec column_share([[Panel.t(), ...], ...]) :: float()
  def column_share(rows) do
    content = @height - @head * length(rows)
    width = content / (rows |> Enum.map(&(1 / sum_aspects(&1))) |> Enum.sum())
    (width / @width) |> max(0.25) |> min(0.5) |> Float.round(2)
  end

  @doc """
  Returns the CSS of the height of a part of a column: the height that the user set, or a minimum height and a share of
  the rest.

      iex> alias Situ.Studio.Layout
      iex> {:ok, layout, _} = Layout.add_stream(Layout.new(""), "A", "line", :plot, "")
      iex> Layout.Sizes.height_style(layout, layout.tree, %{})
      "flex: 4 0 84px"
      iex> Layout.Sizes.height_style(layout, %{layout.tree | size: 300}, %{})
      "flex: 0 0 300px"
  """
  @spec height_style(Layout.t(), Tree.t(), lanes()) :: String.t()
  def height_style(_, %Tree{size: size}, _) when size != nil, do: "flex: 0 0 #{round(size)}px"

  def height_style(layout, part, lanes) do
    case known_aspect(layout, part) do
      nil ->
        "flex: #{content_weight(layout, part)} 0 #{least_height(layout, part, lanes)}px" <>
          max_height_style(layout, part, lanes)

      aspect ->
        "flex: 0 1 auto; min-height: #{@least_cells}px; max-height: #{@most_cells}vh; " <>
          "aspect-ratio: #{aspect}"
    end
  end

  # The ratio of a cell, or of a row of cells, of which at least one has content with a known shape.
  defp known_aspect(layout, part) do
    parts = if part.way == :row, do: part.parts, else: [part]

    panels =
      for %Tree{way: :panel, id: id} <- Enum.map(parts, &front_part/1),
          do: Layout.find_panel(layout, id)

    if length(panels) == length(parts) and Enum.any?(panels, & &1.aspect) and
         not Enum.any?(panels, &Layout.timeline?(&1.panel)),
       do: sum_aspects(panels)
  end

  # The panel in front of others in tabs, which have the same place.
  defp front_part(%Tree{way: :tabs, active: active}), do: Tree.new_panel(active)
  defp front_part(part), do: part

  defp content_weight(layout, %Tree{way: :panel, id: id}), do: @weights[panel_kind(layout, id)]

  defp content_weight(layout, %Tree{way: :column, parts: parts}),
    do: parts |> Enum.map(&content_weight(layout, &1)) |> Enum.sum()

  defp content_weight(layout, %Tree{parts: parts}),
    do: parts |> Enum.map(&content_weight(layout, &1)) |> Enum.max()

  defp panel_kind(layout, id), do: Layout.find_panel(layout, id).panel

  defp max_height_style(layout, %Tree{way: :panel, id: id}, lanes) do
    case Layout.find_panel(layout, id) do
      %Panel{panel: :lanes, vis: [_ | _] = vis} ->
        "; max-height: #{count_lanes(vis, lanes) * @lane_most + 8}px"

      _ ->
        ""
    end
  end

  defp max_height_style(_, _, _), do: ""

  @doc """
  Returns the minimum height of the content of a part in pixels.

      iex> alias Situ.Studio.Layout
      iex> {:ok, layout, _} = Layout.add_stream(Layout.new(""), "A", "states", :lanes, "")
      iex> for lanes <- [%{}, %{"A" => 3}], do: Layout.Sizes.least_height(layout, layout.tree, lanes)
      [34, 86]
      iex> Layout.Sizes.height_style(layout, layout.tree, %{"A" => 3})
      "flex: 1 0 86px; max-height: 116px"
  """
  @spec least_height(Layout.t(), Tree.t(), lanes()) :: pos_integer()
  def least_height(layout, %Tree{way: :panel, id: id}, lanes) do
    case Layout.find_panel(layout, id) do
      %Panel{panel: :lanes, vis: vis} -> min(count_lanes(vis, lanes), @max_lanes) * @lane + 8
      %Panel{panel: kind} -> @heights[kind]
    end
  end

  def least_height(layout, %Tree{way: way, parts: parts}, lanes) do
    heights = Enum.map(parts, &least_height(layout, &1, lanes))

    case way do
      :column -> Enum.sum(heights)
      :row -> Enum.max(heights)
      :tabs -> Enum.max(heights) + @tabs
    end
  end

  defp count_lanes(vis, lanes), do: vis |> Enum.map(&lanes_of(&1, lanes)) |> Enum.sum()

  # Message marks always use one lane.
  defp lanes_of(%Visualization{viz: "messages"}, _), do: 1

  defp lanes_of(%Visualization{stream: stream, path: path}, lanes),
    do: Map.get(lanes, stream <> path, 1)

  @doc """
  Returns the shares of the width of a row's parts: the shares that the user set, or by the shapes of the content.
  Together they are 100.

      iex> alias Situ.Studio.Layout
      iex> {:ok, layout, a} = Layout.add_stream(Layout.new(""), "A", "line", :plot, "")
      iex> {:ok, layout, b} = Layout.add_stream(layout, "B", "line", :plot, "")
      iex> {:ok, layout} = Layout.move_panel(layout, b, {:left, a})
      iex> Layout.Sizes.row_shares(layout, layout.tree)
      [50.0, 50.0]
  """
  @spec row_shares(Layout.t(), Tree.t()) :: [float()]
  def row_shares(layout, %Tree{way: :row, parts: parts}) do
    set = for %Tree{size: size} when size != nil <- parts, do: size

    cond do
      set != [] ->
        Enum.map(parts, &(&1.size || Enum.sum(set) / length(set)))

      Enum.all?(parts, &(&1.way in [:panel, :tabs])) ->
        Enum.map(parts, &panel_share(layout, front_part(&1)))

      true ->
        content_shares(layout, parts)
    end
    |> to_percent()
  end

  defp panel_share(layout, %Tree{id: id}), do: Layout.find_panel(layout, id).aspect || @aspect

  # Columns of cells are as wide as their content needs, and the timelines share the rest.
  defp content_shares(layout, parts) do
    times = Layout.timeline_ids(layout)

    shares =
      for part <- parts, do: if(Places.only_cells?(part, times), do: cells_share(layout, part))

    rest = max(100 - (shares |> Enum.reject(&is_nil/1) |> Enum.sum()), 20)
    Enum.map(shares, &(&1 || rest / Enum.count(shares, fn share -> share == nil end)))
  end

  defp cells_share(layout, part) do
    rows = if part.way == :column, do: part.parts, else: [part]

    panels =
      for row <- rows,
          do: row |> shown_ids() |> Enum.map(&Layout.find_panel(layout, &1))

    all = List.flatten(panels)

    cond do
      Enum.any?(all, & &1.aspect) -> 100 * column_share(panels)
      # 3D panels need more room.
      Enum.any?(all, &(&1.panel == :space)) -> 50
      true -> 36
    end
  end

  defp shown_ids(%Tree{way: :tabs, active: active}), do: [active]
  defp shown_ids(part), do: Tree.panel_ids(part)

  defp to_percent(shares) do
    sum = Enum.sum(shares)
    Enum.map(shares, &Float.round(100 * &1 / sum, 1))
  end
end
