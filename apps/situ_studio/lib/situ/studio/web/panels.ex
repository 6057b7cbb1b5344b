defmodule Situ.Studio.Web.Panels do
  @moduledoc false
  # Renders the center of the page, the rows, columns and tabs of panels. The page's script renders the inside of each
  # panel.
  use Situ.Live.Component
  import Situ.Studio.Web.Icons
  alias Situ.Studio.Web.{AnnotationPanel, PanelConfig}
  alias Situ.Studio.Layout
  alias Situ.Studio.Layout.{Places, Sizes, Tree}

  attr(:layout, :any, required: true)
  attr(:selected, :any, required: true)

  # `known` holds facts about the streams (shapes, lanes, coverage and colors) and the studio's own visualizers
  # (`:extra`).
  attr(:known, :map, required: true)
  attr(:streams, :integer, required: true)
  attr(:maximised, :any, required: true)
  attr(:annotation, :any, default: nil)
  # The number of streams that the automatic layout leaves out.
  attr(:more, :integer, default: 0)

  @doc false
  def panel_stack(assigns) do
    %{layout: layout} = assigns

    page = %{
      layout: layout,
      times: Layout.timeline_ids(layout),
      home: Places.timeline_part(layout.tree, Layout.timeline_ids(layout)),
      max: maximised_id(assigns),
      rest: Map.take(assigns, [:selected, :known, :streams, :annotation, :more])
    }

    assigns = assign(assigns, page: page)

    ~H"""
    <div class={["stack", Places.has_side?(@layout.tree, @page.times) && "beside", @page.max && "max"]} id="stack"
        phx-hook="Drop" data-part="all">
      <.timeline_column :if={@layout.tree == nil} page={@page} part={nil} style={nil} />
      <.layout_part :if={@layout.tree} page={@page} part={@layout.tree} style="flex: 1" />
    </div>
    """
  end

  defp maximised_id(%{layout: layout, maximised: id}),
    do: if(Layout.find_panel(layout, id), do: id)

  # A part that is maximized, or contains the panel that is.
  defp maxed_class(part, max), do: max && max in Tree.panel_ids(part) && "maxed"

  defp layout_part(%{page: %{home: home}, part: home} = assigns),
    do: ~H"<.timeline_column page={@page} part={@part} style={@style} />"

  defp layout_part(%{part: %Tree{way: :panel}} = assigns), do: panel_box(assigns)

  defp layout_part(%{part: %Tree{way: :tabs}} = assigns), do: tab_box(assigns)

  defp layout_part(%{part: %Tree{way: :column}} = assigns) do
    ~H"""
    <div class={["part part-column", Places.only_cells?(@part, @page.times) && "side", maxed_class(@part, @page.max)]}
        id={"part-" <> @part.id} data-part={@part.id} style={@style}>
      <.column_parts page={@page} parts={@part.parts} />
    </div>
    """
  end

  defp layout_part(%{part: %Tree{way: :row}} = assigns) do
    shares = Sizes.row_shares(assigns.page.layout, assigns.part)
    last = length(shares) - 1

    parts =
      for {{part, share}, i} <- assigns.part.parts |> Enum.zip(shares) |> Enum.with_index(),
          do: {part, share, i == last}

    assigns = assign(assigns, parts: parts)

    ~H"""
    <div class={["part part-row", maxed_class(@part, @page.max)]} id={"part-" <> @part.id} data-part={@part.id}
        style={@style}>
      <.row_part :for={{part, share, last?} <- @parts} :key={part.id} page={@page} part={part} share={share}
          last={last?} row={@part.id} />
    </div>
    """
  end

  defp row_part(assigns) do
    ~H"""
    <.layout_part page={@page} part={@part} style={"flex: #{@share} 1 0%"} />
    <div :if={not @last} class="split" id={"split-" <> @part.id} phx-hook="RowSplit" data-row={@row}
        tabindex="0" role="separator" aria-orientation="vertical"
        aria-label={"Width of " <> names_in(@part, @page.layout)} aria-valuenow={round(@share)} aria-valuemin="1"
        aria-valuemax="100"></div>
    """
  end

  # The column of the timelines, below the time navigator.
  defp timeline_column(assigns) do
    parts =
      case assigns.part do
        nil -> []
        %Tree{way: :column, parts: parts} -> parts
        part -> [part]
      end

    assigns =
      assigns
      |> assign(assigns.page.rest)
      |> assign(parts: parts, page: %{assigns.page | home: nil}, layout: assigns.page.layout)

    ~H"""
    <div class={["times", @part && maxed_class(@part, @page.max)]} id="times" style={@style}
        data-part={@part && @part.id}>
      <div id="navigator" class="navigator" phx-hook="Navigator" phx-update="ignore" role="group"
          aria-label="Time navigator"></div>
      <.column_parts page={@page} parts={@parts} />
      <button :if={@more > 0 and @layout.panels != []} class="more-streams" type="button"
          phx-click="layout_more">Show more streams ({@more})</button>
      <AnnotationPanel.annotation_panel :if={@annotation} stream={@annotation} />
      <div :if={@layout.panels == [] and @streams > 0}
          class="empty"><b>Nothing shown yet</b><span>Double-click a stream on the left, or drag it here.</span></div>
      <div :if={@layout.panels == [] and @streams == 0} class="empty"><b>No streams yet</b><span>{if @known.damaged,
        do: "This recording is damaged, and none of its streams can be read.",
        else: "Nothing was recorded here. New recordings appear automatically."}</span></div>
    </div>
    """
  end

  defp column_parts(assigns) do
    lanes = assigns.page.rest.known.lanes
    assigns = assign(assigns, lanes: lanes, layout: assigns.page.layout)

    ~H"""
    <.column_part :for={part <- @parts} :key={part.id} page={@page} part={part} layout={@layout} lanes={@lanes} />
    """
  end

  defp column_part(assigns) do
    ~H"""
    <.layout_part page={@page} part={@part} style={Sizes.height_style(@layout, @part, @lanes)} />
    <div class="resize" id={"resize-" <> @part.id} phx-hook="Resize" tabindex="0" role="separator"
        aria-orientation="horizontal" aria-label={"Height of " <> names_in(@part, @layout)}
        aria-valuenow={round(@part.size || Sizes.least_height(@layout, @part, @lanes))} aria-valuemin="28"
        aria-valuemax="4000"></div>
    """
  end

  # `tab` is set for a panel in tabs, whose strip shows its name.
  defp panel_box(%{page: %{layout: layout}, part: %{id: id}} = assigns) do
    panel = Layout.find_panel(layout, id)

    assigns =
      assigns
      |> assign_new(:tab, fn -> false end)
      |> assign(panel: panel, max: assigns.page.max, timeline: Layout.timeline?(panel.panel))
      |> assign(assigns.page.rest)
      |> assign(least: Sizes.least_height(layout, assigns.part, assigns.page.rest.known.lanes))

    ~H"""
    <section class={["panel-box", if(@timeline, do: "timeline", else: "cell"),
        @selected == {:panel, @panel.id} && "selected", @max == @panel.id && "maxed"]} id={"panel-" <> @panel.id}
        data-panel={@panel.id} data-part={@panel.id} data-menu="panel"
        style={"#{@style}; --least: #{@least}px; --aspect: #{@panel.aspect || "auto"}"}>
      <div :if={not @timeline and not @tab} class="cell-head">
        <.drag_handle id={@panel.id} />
        <button class="title" type="button" phx-click="select_panel" phx-value-id={@panel.id} draggable="true"
            data-drag={@panel.id} title={stream_names(@panel)}><.panel_title vis={@panel.vis} /></button>
        <.maximise_button panel={@panel} max={@max} />
        <.close_button panel={@panel} />
      </div>
      <div class="cell-body"><div id={body_id(@panel)} class="panel-body" phx-hook="Panel" phx-update="ignore"
          role="group" aria-label={stream_names(@panel)} data-kind={@panel.panel}
          data-config={PanelConfig.encode_config(@panel, @known)}></div></div>
      <div :if={@timeline and not @tab} class="panel-tools" role="toolbar" aria-label={stream_names(@panel)}>
        <.panel_buttons panel={@panel} max={@max} />
      </div>
    </section>
    """
  end

  defp panel_buttons(assigns) do
    ~H"""
    <.drag_handle id={@panel.id} />
    <.maximise_button panel={@panel} max={@max} />
    <button class="mini" type="button" phx-click="select_panel" phx-value-id={@panel.id} title="Properties"
        aria-label={"Properties of " <> stream_names(@panel)}><.icon name={:tune} /></button>
    <.close_button panel={@panel} />
    """
  end

  # Panels in tabs. The page has only the panel in front.
  defp tab_box(%{page: %{layout: layout}, part: part} = assigns) do
    panels = for %{id: id} <- part.parts, do: Layout.find_panel(layout, id)
    # A maximized panel is in front.
    active =
      Enum.find(panels, &(&1.id == assigns.page.max)) ||
        Enum.find(panels, &(&1.id == part.active))

    assigns =
      assign(assigns,
        panels: panels,
        active: active,
        max: assigns.page.max,
        shown: %{Tree.new_panel(active.id) | size: nil}
      )

    ~H"""
    <div class={["part part-tabs", maxed_class(@part, @max)]} id={"part-" <> @part.id} data-part={@part.id}
        style={@style}>
      <div class="tab-strip">
        <div class="tab-list" role="tablist" aria-label="Panels" id={"tabs-" <> @part.id} phx-hook="Tabs">
          <button :for={panel <- @panels} class="tab" type="button" role="tab" id={"tab-" <> panel.id}
              aria-selected={to_string(panel.id == @active.id)}
              tabindex={if panel.id == @active.id, do: "0", else: "-1"}
              aria-controls={panel.id == @active.id && "panel-" <> panel.id} draggable="true" data-drag={panel.id}
              phx-click="select_tab" phx-value-id={panel.id}
              title={stream_names(panel)}><.panel_title vis={panel.vis} /></button>
        </div>
        <.panel_buttons panel={@active} max={@max} />
      </div>
      <.panel_box page={@page} part={@shown} style="flex: 1 1 0" tab />
    </div>
    """
  end

  defp names_in(part, layout) do
    Enum.map_join(Tree.panel_ids(part), ", ", &stream_names(Layout.find_panel(layout, &1)))
  end

  # Shows the full name of a single stream, and short distinct names of several streams.
  defp panel_title(%{vis: [_one]} = assigns), do: ~H"<bdi>{stream_names(%{vis: @vis})}</bdi>"
  defp panel_title(assigns), do: ~H"{@vis |> PanelConfig.short_names() |> Enum.join(\", \")}"

  # The id contains the panel's kind, so that the page creates a new element when the kind changes.
  defp body_id(panel), do: "body-#{panel.id}-#{panel.panel}"

  defp maximise_button(assigns) do
    ~H"""
    <button class="mini" type="button" phx-click="maximise" phx-value-id={@panel.id}
        title={if @max == @panel.id, do: "Back to all panels (m)", else: "Fill the window (m)"}
        aria-label={if(@max == @panel.id, do: "Restore ", else: "Maximize ") <> stream_names(@panel)}
        ><.icon name={if @max == @panel.id, do: :shrink, else: :grow} /></button>
    """
  end

  defp close_button(assigns) do
    ~H"""
    <button class="mini" type="button" phx-click="remove_panel" phx-value-id={@panel.id} title="Remove"
        aria-label={"Remove " <> stream_names(@panel)}><.icon name={:close} /></button>
    """
  end

  defp drag_handle(assigns) do
    ~H"""
    <button id={"grip-" <> @id} class="mini grip" type="button" phx-hook="Grip" draggable="true" data-drag={@id}
        title="Move: drag, or use the arrow keys" aria-label="Move this panel with the arrow keys"
        ><.icon name={:grip} /></button>
    """
  end

  defp stream_names(panel), do: Enum.map_join(panel.vis, ", ", &(&1.stream <> &1.path))
end
