defmodule Situ.Studio.Layout do
  @moduledoc false
  # Describes the layout of a page: rows from top to bottom, each with one panel on the time axis
  # or several cells at the cursor. A layout is pure data with a JSON form
  # (`Situ.Studio.Layout.Json`), so it can be saved to a file or written by hand.
  alias Situ.Error

  defmodule Visualization do
    @moduledoc false
    # Represents a stream with a visualizer; `path` selects a part of its messages.
    @enforce_keys [:viz, :stream]
    defstruct [:viz, :stream, path: "", props: %{}]

    @type t :: %__MODULE__{
            viz: String.t(),
            stream: String.t(),
            path: String.t(),
            props: %{optional(String.t()) => String.t() | number() | boolean()}
          }
  end

  defmodule Panel do
    @moduledoc false
    # Represents a panel: `:plot` and `:lanes` fill a row, other panels are cells of a row. With
    # `axis: :own`, each line of a plot is scaled to its own minimum and maximum within the view.
    # `threshold` covers the values below or above a limit, so that the other values stand out.
    # `aspect` is the ratio of width to height of a cell, which divides the width of its row.
    @enforce_keys [:id, :panel]
    defstruct [:id, :panel, :aspect, row: nil, height: nil, vis: [], axis: nil, threshold: nil]

    @type t :: %__MODULE__{
            id: String.t(),
            panel:
              :plot
              | :lanes
              | :image
              | :space
              | :map
              | :value
              | :bars
              | :text
              | :log
              | :table
              | :xy
              | :own,
            row: String.t() | nil,
            aspect: float() | nil,
            height: pos_integer() | nil,
            vis: [Visualization.t()],
            axis: {number(), number()} | :own | nil,
            threshold: {:below | :above, number()} | nil
          }
  end

  alias Situ.Studio.Layout.Rows

  @enforce_keys [:name]
  defstruct [:name, rows: [], next: 1, cell_column: false, compared: nil]

  @typedoc """
  `rows` contains panels; neighbors with the same `row` are shown side by side. With `cell_column`, the cells have a
  column to the left of the timelines. `compared` contains the id of the compared recording and the shift of its times
  in ns, from which `Situ.Studio.Comparison` restores the comparison.
  """
  @type t :: %__MODULE__{
          name: String.t(),
          rows: [Panel.t()],
          next: pos_integer(),
          cell_column: boolean(),
          compared: {id :: String.t(), Situ.Time.duration()} | nil
        }

  @timeline [:plot, :lanes]
  @panels [:plot, :lanes, :image, :space, :map, :value, :bars, :text, :log, :table, :xy, :own]
  @max_panels 64
  @max_vis 32
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

  @doc "Returns the kinds of panels."
  @spec panel_kinds() :: [atom()]
  def panel_kinds, do: @panels

  @doc "Returns the maximum number of panels in a layout and of streams in a panel."
  @spec size_limits() :: {pos_integer(), pos_integer()}
  def size_limits, do: {@max_panels, @max_vis}

  @doc """
  Creates an empty layout.

      iex> layout = Situ.Studio.Layout.new("mine")
      iex> {:ok, layout, id} = Situ.Studio.Layout.add_stream(layout, "A.level", "line", :plot, "")
      iex> {:ok, again} = layout |> Situ.Studio.Layout.Json.to_json() |> Situ.Studio.Layout.Json.parse_json()
      iex> {again == layout, id, hd(layout.rows).panel}
      {true, "p1", :plot}
  """
  @spec new(String.t()) :: t()
  def new(name), do: %__MODULE__{name: name}

  @doc "Returns whether panels of this kind have a time axis."
  @spec timeline?(atom()) :: boolean()
  def timeline?(panel), do: panel in @timeline

  @doc """
  Adds a stream to the panel `into` if its kind fits, else to a new panel. Shapes are added to the first image panel.
  """
  @spec add_stream(t(), String.t(), String.t(), atom(), String.t(), keyword()) ::
          {:ok, t(), panel_id :: String.t()} | {:error, Error.t()}
  def add_stream(%__MODULE__{} = layout, stream, viz, panel, into, opts \\ []) do
    vis = %Visualization{
      viz: viz,
      stream: stream,
      path: opts[:path] || "",
      props: opts[:props] || %{}
    }

    target = Enum.find(layout.rows, &(&1.id == into and shares_panel?(&1.panel, panel)))
    target = target || if(overlay?(viz, panel), do: Enum.find(layout.rows, &(&1.panel == :image)))

    cond do
      target != nil and length(target.vis) >= @max_vis ->
        full_error("panel", @max_vis)

      target != nil ->
        {:ok, update_panel(layout, target.id, &%{&1 | vis: &1.vis ++ [vis]}), target.id}

      length(layout.rows) >= @max_panels ->
        full_error("layout", @max_panels)

      true ->
        add_panel(layout, panel, vis, opts[:row])
    end
  end

  # Visualizers of image panels other than images and depth images are drawn as overlays.
  defp overlay?(viz, panel), do: panel == :image and viz not in ["image", "depth"]

  # Values and charts show one stream per panel; lines, lanes, images and tables show several.
  defp shares_panel?(panel, panel),
    do: panel in [:plot, :lanes, :image, :space, :map, :table, :xy]

  defp shares_panel?(_, _), do: false

  defp add_panel(layout, panel, vis, row) do
    id = "p#{layout.next}"

    row =
      if panel in @timeline,
        do: nil,
        else: row || cell_row(layout) || Rows.unused_row_name(layout.rows)

    new = %Panel{id: id, panel: panel, row: row, vis: [vis]}
    {:ok, %{layout | rows: Rows.insert(layout.rows, new), next: layout.next + 1}, id}
  end

  # A new cell joins the last line of cells that has room.
  defp cell_row(layout) do
    layout.rows
    |> Enum.reject(&is_nil(&1.row))
    |> Enum.group_by(& &1.row)
    |> Enum.filter(fn {_, cells} -> length(cells) < 3 end)
    |> Enum.map(&elem(&1, 0))
    |> List.last()
  end

  @doc "Returns the streams that no panel shows."
  @spec left_out(t(), [stream]) :: [stream] when stream: %{name: String.t()}
  def left_out(%__MODULE__{rows: rows}, streams) do
    shown = for panel <- rows, vis <- panel.vis, into: MapSet.new(), do: vis.stream
    Enum.reject(streams, &(&1.name in shown))
  end

  @doc """
  Appends the panels of another layout, with new ids. Cells are inserted below the other cells.

      iex> [a, b] = for stream <- ["A", "B"] do
      ...>   {:ok, layout, "p1"} = Situ.Studio.Layout.add_stream(Situ.Studio.Layout.new(""), stream, "line", :plot, "")
      ...>   layout
      ...> end
      iex> for p <- Situ.Studio.Layout.append(a, b).rows, do: {p.id, hd(p.vis).stream}
      [{"p1", "A"}, {"p2", "B"}]
  """
  @spec append(t(), t()) :: t()
  def append(%__MODULE__{} = layout, %__MODULE__{} = other) do
    other
    |> panel_lines()
    |> Enum.take(max(@max_panels - length(layout.rows), 0))
    |> Enum.reduce(layout, fn line, layout ->
      row = if hd(line).row, do: Rows.unused_row_name(layout.rows)
      Enum.reduce(line, layout, &append_panel(&2, %{&1 | row: row}))
    end)
  end

  defp append_panel(layout, panel) do
    panel = %{panel | id: "p#{layout.next}"}
    %{layout | rows: Rows.insert(layout.rows, panel), next: layout.next + 1}
  end

  @doc "Applies `fun` to one panel."
  @spec update_panel(t(), String.t(), (Panel.t() -> Panel.t())) :: t()
  def update_panel(%__MODULE__{rows: rows} = layout, id, fun),
    do: %{layout | rows: Enum.map(rows, fn p -> if p.id == id, do: fun.(p), else: p end)}

  @doc "Returns the panel `id`, or `nil`."
  @spec find_panel(t(), String.t() | nil) :: Panel.t() | nil
  def find_panel(%__MODULE__{rows: rows}, id), do: Enum.find(rows, &(&1.id == id))

  @doc "Removes a panel."
  @spec remove_panel(t(), String.t()) :: t()
  def remove_panel(%__MODULE__{rows: rows} = layout, id),
    do: %{layout | rows: Enum.reject(rows, &(&1.id == id))}

  @doc "Removes one stream from a panel, and the panel if it was the last stream."
  @spec remove_vis(t(), String.t(), non_neg_integer()) :: t()
  def remove_vis(layout, id, index) do
    case find_panel(layout, id) do
      %Panel{vis: [_]} when index == 0 -> remove_panel(layout, id)
      _ -> update_panel(layout, id, &%{&1 | vis: List.delete_at(&1.vis, index)})
    end
  end

  @doc "Sets the height of a row, that is, of a panel or of every cell in a line."
  @spec resize_row(t(), String.t(), integer()) :: t()
  def resize_row(%__MODULE__{rows: rows} = layout, row_id, height) do
    height = height |> max(28) |> min(2_000)

    rows =
      Enum.map(rows, fn p ->
        if Rows.panel_row(p) == row_id, do: %{p | height: height}, else: p
      end)

    %{layout | rows: rows}
  end

  @doc "Moves a row up (-1) or down (1)."
  @spec move_row(t(), String.t(), -1 | 1) :: t()
  def move_row(%__MODULE__{} = layout, row_id, by),
    do: %{layout | rows: Rows.move_row(layout.rows, row_id, by)}

  @doc """
  Moves a panel above or below a row or, if both are cells, to the left or right of another cell. An unknown id
  changes nothing; a full row is an error.

      iex> layout = Situ.Studio.Layout.new("")
      iex> {:ok, layout, a} = Situ.Studio.Layout.add_stream(layout, "A", "line", :plot, "")
      iex> {:ok, layout, b} = Situ.Studio.Layout.add_stream(layout, "B", "line", :plot, "")
      iex> {:ok, layout} = Situ.Studio.Layout.move_panel(layout, b, {:above, a})
      iex> for p <- layout.rows, do: hd(p.vis).stream
      ["B", "A"]
  """
  @spec move_panel(t(), String.t(), Rows.target()) :: {:ok, t()} | {:error, Error.t()}
  def move_panel(%__MODULE__{} = layout, id, where) do
    with {:ok, rows} <- Rows.place_panel(layout.rows, id, where),
         do: {:ok, %{layout | rows: rows}}
  end

  @doc "Moves a panel one step: timelines move up and down; cells also move left and right, out of and into rows."
  @spec shift_panel(t(), String.t(), :up | :down | :left | :right) ::
          {:ok, t()} | {:error, Error.t()}
  def shift_panel(%__MODULE__{} = layout, id, way) do
    with {:ok, rows} <- Rows.shift_panel(layout.rows, id, way), do: {:ok, %{layout | rows: rows}}
  end

  @doc "Returns the rows as displayed: lists of panels that are side by side."
  @spec panel_lines(t()) :: [[Panel.t(), ...]]
  def panel_lines(%__MODULE__{rows: rows}), do: Rows.group_rows(rows)

  @doc "Moves the cells to a column next to the timelines, or back above them."
  @spec toggle_cell_column(t()) :: t()
  def toggle_cell_column(%__MODULE__{} = layout),
    do: %{layout | cell_column: not layout.cell_column}

  @doc """
  Returns the CSS of a line's height: the height that the user set, or a minimum height and a share of the rest.

      iex> {:ok, layout, _} = Situ.Studio.Layout.add_stream(Situ.Studio.Layout.new(""), "A", "line", :plot, "")
      iex> [line] = Situ.Studio.Layout.panel_lines(layout)
      iex> Situ.Studio.Layout.line_style(line, %{})
      "flex: 4 0 84px"
      iex> [line] = layout |> Situ.Studio.Layout.resize_row("p1", 300) |> Situ.Studio.Layout.panel_lines()
      iex> Situ.Studio.Layout.line_style(line, %{})
      "flex: 0 0 300px"
  """
  @spec line_style([Panel.t(), ...], map()) :: String.t()
  def line_style(line, lanes) do
    cond do
      Enum.any?(line, & &1.height) ->
        "flex: 0 0 #{line_height(line, lanes)}px"

      Enum.any?(line, & &1.aspect) ->
        "flex: 0 1 auto; min-height: #{@least_cells}px; max-height: #{@most_cells}vh; " <>
          "aspect-ratio: #{Rows.sum_aspects(line)}"

      true ->
        weight = line |> Enum.map(&@weights[&1.panel]) |> Enum.max()
        "flex: #{weight} 0 #{line_height(line, lanes)}px#{max_height_style(line, lanes)}"
    end
  end

  @doc "Returns the CSS of a cell's share of the width of its row, or `nil`."
  @spec cell_style(Panel.t()) :: String.t() | nil
  def cell_style(%Panel{aspect: nil}), do: nil
  def cell_style(%Panel{aspect: aspect}), do: "flex-grow: #{aspect}"

  @doc "Returns the CSS of the column of cells, or `nil` if the shapes of their content are unknown."
  @spec column_style([[Panel.t(), ...], ...]) :: String.t() | nil
  def column_style(lines) do
    if lines |> List.flatten() |> Enum.any?(& &1.aspect),
      do: "--side-share: #{round(100 * Rows.column_share(lines))}%"
  end

  defp max_height_style([%Panel{panel: :lanes, vis: [_ | _] = vis}], lanes),
    do: "; max-height: #{count_lanes(vis, lanes) * @lane_most + 8}px"

  defp max_height_style(_, _), do: ""

  @doc """
  Returns the minimum height of a line in pixels. `lanes` contains the number of lanes by stream, for streams with
  more than one.

      iex> {:ok, layout, _} = Situ.Studio.Layout.add_stream(Situ.Studio.Layout.new(""), "A", "states", :lanes, "")
      iex> [line] = Situ.Studio.Layout.panel_lines(layout)
      iex> {Situ.Studio.Layout.line_height(line), Situ.Studio.Layout.line_height(line, %{"A" => 3})}
      {34, 86}
      iex> Situ.Studio.Layout.line_style(line, %{"A" => 3})
      "flex: 1 0 86px; max-height: 116px"
  """
  @spec line_height([Panel.t(), ...], %{optional(String.t()) => pos_integer()}) :: pos_integer()
  def line_height(line, lanes \\ %{})

  def line_height([%Panel{height: nil, panel: :lanes, vis: vis} | _], lanes) do
    min(count_lanes(vis, lanes), @max_lanes) * @lane + 8
  end

  def line_height(line, _lanes) do
    Enum.find_value(line, & &1.height) || line |> Enum.map(&@heights[&1.panel]) |> Enum.max()
  end

  defp count_lanes(vis, lanes), do: vis |> Enum.map(&lanes_of(&1, lanes)) |> Enum.sum()

  # Message marks always use one lane.
  defp lanes_of(%Visualization{viz: "messages"}, _), do: 1

  defp lanes_of(%Visualization{stream: stream, path: path}, lanes),
    do: Map.get(lanes, stream <> path, 1)

  defp full_error(what, n) do
    {:error, Error.new(:full, "a #{what} holds at most #{n}", fix: "remove something first")}
  end
end
