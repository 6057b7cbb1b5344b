defmodule Situ.Studio.Layout do
  @moduledoc false
  # Describes the layout of a page: its panels, and the tree of rows, columns and tabs that arranges them
  # (`Situ.Studio.Layout.Tree`). A layout is pure data with a JSON form (`Situ.Studio.Layout.Json`), so it can be saved
  # to a file or written by hand.
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
    # Represents a panel. `:plot` and `:lanes` have a time axis; other panels show the messages at the cursor. With
    # `axis: :own`, each line of a plot is scaled to its own minimum and maximum within the view. `threshold` covers the
    # values below or above a limit, so that the other values stand out. `aspect` is the ratio of width to height of its
    # content.
    @enforce_keys [:id, :panel]
    defstruct [:id, :panel, :aspect, vis: [], axis: nil, threshold: nil]

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
            aspect: float() | nil,
            vis: [Visualization.t()],
            axis: {number(), number()} | :own | nil,
            threshold: {:below | :above, number()} | nil
          }
  end

  alias Situ.Studio.Layout.{Places, Tree}

  @enforce_keys [:name]
  defstruct [:name, :tree, panels: [], next: 1, compared: nil]

  @typedoc """
  `panels` are in the order in which `tree` arranges them. `compared` contains the id of the compared recording and the
  shift of its times in ns, from which `Situ.Studio.Comparison` restores the comparison.
  """
  @type t :: %__MODULE__{
          name: String.t(),
          panels: [Panel.t()],
          tree: Tree.t() | nil,
          next: pos_integer(),
          compared: {id :: String.t(), Situ.Time.duration()} | nil
        }

  @timeline [:plot, :lanes]
  @panels [:plot, :lanes, :image, :space, :map, :value, :bars, :text, :log, :table, :xy, :own]
  @max_panels 64
  @max_vis 32
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
      iex> {again == layout, id, hd(layout.panels).panel}
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

    target = Enum.find(layout.panels, &(&1.id == into and shares_panel?(&1.panel, panel)))

    target =
      target || if(overlay?(viz, panel), do: Enum.find(layout.panels, &(&1.panel == :image)))

    cond do
      target != nil and length(target.vis) >= @max_vis ->
        full_error("panel", @max_vis)

      target != nil ->
        {:ok, update_panel(layout, target.id, &%{&1 | vis: &1.vis ++ [vis]}), target.id}

      length(layout.panels) >= @max_panels ->
        full_error("layout", @max_panels)

      true ->
        add_panel(layout, panel, vis)
    end
  end

  # Visualizers of image panels other than images and depth images are drawn as overlays.
  defp overlay?(viz, panel), do: panel == :image and viz not in ["image", "depth"]

  # Values and charts show one stream per panel; lines, lanes, images and tables show several.
  defp shares_panel?(panel, panel),
    do: panel in [:plot, :lanes, :image, :space, :map, :table, :xy]

  defp shares_panel?(_, _), do: false

  defp add_panel(layout, panel, vis) do
    id = "p#{layout.next}"
    new = %Panel{id: id, panel: panel, vis: [vis]}
    {:ok, insert_panel(layout, new), id}
  end

  # The panel has the next id.
  defp insert_panel(layout, panel) do
    layout = %{layout | panels: layout.panels ++ [panel], next: layout.next + 1}
    put_tree(layout, Places.add_panel(layout.tree, panel.id, timeline_ids(layout)))
  end

  @doc "Replaces the tree, which contains the same panels, and orders the panels accordingly."
  @spec put_tree(t(), Tree.t() | nil) :: t()
  def put_tree(%__MODULE__{panels: panels} = layout, tree) do
    place = tree |> Tree.panel_ids() |> Enum.with_index() |> Map.new()
    %{layout | tree: tree, panels: Enum.sort_by(panels, &place[&1.id])}
  end

  @doc "Returns the ids of the panels with a time axis."
  @spec timeline_ids(t()) :: MapSet.t(String.t())
  def timeline_ids(%__MODULE__{panels: panels}),
    do: for(p <- panels, timeline?(p.panel), into: MapSet.new(), do: p.id)

  @doc "Returns the streams that no panel shows."
  @spec left_out(t(), [stream]) :: [stream] when stream: %{name: String.t()}
  def left_out(%__MODULE__{panels: panels}, streams) do
    shown = for panel <- panels, vis <- panel.vis, into: MapSet.new(), do: vis.stream
    Enum.reject(streams, &(&1.name in shown))
  end

  @doc """
  Appends the panels of another layout, with new ids.

      iex> [a, b] = for stream <- ["A", "B"] do
      ...>   {:ok, layout, "p1"} = Situ.Studio.Layout.add_stream(Situ.Studio.Layout.new(""), stream, "line", :plot, "")
      ...>   layout
      ...> end
      iex> for p <- Situ.Studio.Layout.append(a, b).panels, do: {p.id, hd(p.vis).stream}
      [{"p1", "A"}, {"p2", "B"}]
  """
  @spec append(t(), t()) :: t()
  def append(%__MODULE__{} = layout, %__MODULE__{panels: panels}) do
    panels
    |> Enum.take(max(@max_panels - length(layout.panels), 0))
    |> Enum.reduce(layout, &insert_panel(&2, %{&1 | id: "p#{&2.next}"}))
  end

  @doc "Returns whether two layouts have the same panels in the same places."
  @spec same_panels?(t(), t()) :: boolean()
  def same_panels?(a, b), do: {a.panels, a.tree} == {b.panels, b.tree}

  @doc "Applies `fun` to one panel."
  @spec update_panel(t(), String.t(), (Panel.t() -> Panel.t())) :: t()
  def update_panel(%__MODULE__{panels: panels} = layout, id, fun),
    do: %{layout | panels: Enum.map(panels, fn p -> if p.id == id, do: fun.(p), else: p end)}

  @doc "Returns the panel `id`, or `nil`."
  @spec find_panel(t(), String.t() | nil) :: Panel.t() | nil
  def find_panel(%__MODULE__{panels: panels}, id), do: Enum.find(panels, &(&1.id == id))

  @doc "Removes a panel."
  @spec remove_panel(t(), String.t()) :: t()
  def remove_panel(%__MODULE__{panels: panels, tree: tree} = layout, id),
    do: %{layout | panels: Enum.reject(panels, &(&1.id == id)), tree: Tree.remove(tree, id)}

  @doc "Removes one stream from a panel, and the panel if it was the last stream."
  @spec remove_vis(t(), String.t(), non_neg_integer()) :: t()
  def remove_vis(layout, id, index) do
    case find_panel(layout, id) do
      %Panel{vis: [_]} when index == 0 -> remove_panel(layout, id)
      _ -> update_panel(layout, id, &%{&1 | vis: List.delete_at(&1.vis, index)})
    end
  end

  @doc "Sets the height of a part of a column in pixels, or lets its content choose it."
  @spec resize_part(t(), String.t(), integer() | nil) :: t()
  def resize_part(%__MODULE__{} = layout, part_id, height) do
    height = height && height |> max(28) |> min(2_000)

    case Tree.ancestors(layout.tree, part_id) do
      [{%Tree{way: :column}, _} | _] ->
        %{layout | tree: Tree.update(layout.tree, part_id, &%{&1 | size: height})}

      _ ->
        layout
    end
  end

  @doc "Sets the shares of the width of a row's parts, or lets their contents choose them."
  @spec resize_row(t(), String.t(), [number()] | nil) :: t()
  def resize_row(%__MODULE__{} = layout, row_id, shares) do
    with %Tree{way: :row, parts: parts} <- Tree.find(layout.tree, row_id),
         {:ok, shares} <- check_shares(shares, length(parts)) do
      parts = Enum.zip_with(parts, shares, &%{&1 | size: &2})
      %{layout | tree: Tree.update(layout.tree, row_id, &%{&1 | parts: parts})}
    else
      _ -> layout
    end
  end

  defp check_shares(nil, n), do: {:ok, List.duplicate(nil, n)}

  defp check_shares(shares, n) do
    if is_list(shares) and length(shares) == n and Enum.all?(shares, &(is_number(&1) and &1 > 0)),
      do:
        {:ok,
         Enum.map(shares, &(&1 |> max(1) |> min(100) |> then(fn x -> Float.round(x / 1, 1) end)))},
      else: :error
  end

  @doc """
  Moves a panel to a side of a part of the layout, such as another panel, or as a tab in front of it. An unknown id
  changes nothing; a full row is an error.

      iex> layout = Situ.Studio.Layout.new("")
      iex> {:ok, layout, a} = Situ.Studio.Layout.add_stream(layout, "A", "line", :plot, "")
      iex> {:ok, layout, b} = Situ.Studio.Layout.add_stream(layout, "B", "line", :plot, "")
      iex> {:ok, layout} = Situ.Studio.Layout.move_panel(layout, b, {:left, a})
      iex> for p <- layout.panels, do: hd(p.vis).stream
      ["B", "A"]
  """
  @spec move_panel(t(), String.t(), {Tree.side(), String.t()}) :: {:ok, t()} | {:error, Error.t()}
  def move_panel(%__MODULE__{} = layout, id, where) do
    with {:ok, tree} <- Tree.move(layout.tree, id, where),
         do: {:ok, put_tree(layout, tree)}
  end

  @doc "Adds a panel, with a new id, to the right of another one."
  @spec add_beside(t(), Panel.t(), String.t()) :: t()
  def add_beside(%__MODULE__{} = layout, %Panel{} = panel, next_to) do
    panel = %{panel | id: "p#{layout.next}"}
    layout = insert_panel(layout, panel)

    case Tree.move(layout.tree, panel.id, {:right, next_to}) do
      {:ok, tree} -> put_tree(layout, tree)
      {:error, _} -> layout
    end
  end

  @doc "Moves a panel one step: past its neighbor, out of its row or column, or to this side of all others."
  @spec shift_panel(t(), String.t(), :up | :down | :left | :right) ::
          {:ok, t()} | {:error, Error.t()}
  def shift_panel(%__MODULE__{} = layout, id, way) do
    with {:ok, tree} <- Tree.shift(layout.tree, id, way), do: {:ok, put_tree(layout, tree)}
  end

  @doc "Moves the cells to a column next to the timelines, or back above them."
  @spec toggle_side(t()) :: t()
  def toggle_side(%__MODULE__{} = layout),
    do: put_tree(layout, Places.toggle_side(layout.tree, timeline_ids(layout)))

  @doc "Shows the tab of a panel."
  @spec select_tab(t(), String.t()) :: t()
  def select_tab(%__MODULE__{} = layout, id) do
    case Tree.ancestors(layout.tree, id) do
      [{%Tree{way: :tabs, id: tabs}, _} | _] ->
        %{layout | tree: Tree.update(layout.tree, tabs, &%{&1 | active: id})}

      _ ->
        layout
    end
  end

  defp full_error(what, n) do
    {:error, Error.new(:full, "a #{what} holds at most #{n}", fix: "remove something first")}
  end
end
