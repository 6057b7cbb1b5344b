defmodule Situ.Studio.Web.Panels do
  @moduledoc false
  # Renders the center of the page, the rows of panels. The page's script renders the inside of each panel.
  use Situ.Live.Component
  import Situ.Studio.Web.Icons
  alias Situ.Studio.Web.AnnotationPanel
  alias Situ.Studio.{StreamColors, Layout, Visualizer, Visualizers}
  alias Situ.Studio.Recordings.Comparison

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
    {cells, times} = assigns.layout |> Layout.panel_lines() |> Enum.split_with(&hd(&1).row)

    {side, main} =
      if assigns.layout.cell_column,
        do: {cells, times},
        else: {[], Layout.panel_lines(assigns.layout)}

    assigns = assign(assigns, side: side, main: main, max: maximised_id(assigns))

    ~H"""
    <div class={["stack", @side != [] && "beside", @max && "max"]} id="stack" phx-hook="Drop">
      <div class={["side", contains_panel?(@side, @max) && "maxed"]} id="side" :if={@side != []}
          style={Layout.column_style(@side)}>
        <.panel_row :for={line <- @side} :key={row_id(line)} line={line} selected={@selected} max={@max}
            known={@known} />
        <div class="split" id="split-side" phx-hook="Split" data-var="--side" data-edge="right" tabindex="0"
            role="separator" aria-orientation="vertical" aria-label="Width of the images" aria-valuenow="40"
            aria-valuemin="10" aria-valuemax="80"></div>
      </div>
      <div class={["times", contains_panel?(@main, @max) && "maxed"]} id="times">
        <div id="navigator" class="navigator" phx-hook="Navigator" phx-update="ignore" role="group"
            aria-label="Time navigator"></div>
        <.panel_row :for={line <- @main} :key={row_id(line)} line={line} selected={@selected} max={@max}
            known={@known} />
        <button :if={@more > 0 and @layout.rows != []} class="more-streams" type="button"
            phx-click="layout_more">Show more streams ({@more})</button>
        <AnnotationPanel.annotation_panel :if={@annotation} stream={@annotation} />
        <div :if={@layout.rows == [] and @streams > 0}
            class="empty"><b>Nothing shown yet</b><span>Double-click a stream on the left, or drag it here.</span></div>
        <div :if={@layout.rows == [] and @streams == 0} class="empty"><b>No streams yet</b><span>{if @known.damaged,
          do: "This recording is damaged, and none of its streams can be read.",
          else: "Nothing was recorded here. New recordings appear automatically."}</span></div>
      </div>
    </div>
    """
  end

  defp maximised_id(%{layout: layout, maximised: id}),
    do: if(Layout.find_panel(layout, id), do: id)

  defp contains_panel?(lines, max),
    do: max != nil and Enum.any?(List.flatten(lines), &(&1.id == max))

  defp panel_row(%{line: [%{row: nil} = panel]} = assigns) do
    assigns = assign(assigns, :panel, panel)

    ~H"""
    <section class={["row-box timeline", @selected == {:panel, @panel.id} && "selected", @max == @panel.id && "maxed"]}
        id={"row-" <> @panel.id} data-row={@panel.id} data-panel={@panel.id} data-menu="panel"
        style={Layout.line_style(@line, @known.lanes)}>
      <div id={body_id(@panel)} class="panel-body" phx-hook="Panel" phx-update="ignore" role="group"
          aria-label={stream_names(@panel)} data-kind={@panel.panel} data-config={encode_config(@panel, @known)}></div>
      <.panel_tools panel={@panel} row={@panel.id} max={@max} />
      <.resize_handle row={@panel.id} line={@line} known={@known} />
    </section>
    """
  end

  defp panel_row(assigns) do
    ~H"""
    <section class={["row-box cells", contains_panel?([@line], @max) && "maxed"]} id={"row-" <> row_id(@line)}
        data-row={row_id(@line)} style={Layout.line_style(@line, @known.lanes)}>
      <div :for={panel <- @line} :key={panel.id} id={"cell-" <> panel.id} data-panel={panel.id} data-menu="panel"
          class={["cell", @selected == {:panel, panel.id} && "selected", @max == panel.id && "maxed"]}
          style={Layout.cell_style(panel)}>
        <div class="cell-head">
          <.drag_handle id={panel.id} kind="cell" />
          <button class="title" type="button" phx-click="select_panel" phx-value-id={panel.id}
              title={stream_names(panel)}><.panel_title vis={panel.vis} /></button>
          <.maximise_button panel={panel} max={@max} />
          <button class="mini" type="button" phx-click="remove_panel" phx-value-id={panel.id} title="Remove"
              aria-label={"Remove " <> stream_names(panel)}><.icon name={:close} /></button>
        </div>
        <div class="cell-body"><div id={body_id(panel)} class="panel-body" phx-hook="Panel" phx-update="ignore"
            role="group" aria-label={stream_names(panel)} data-kind={panel.panel}
            data-config={encode_config(panel, @known)}></div></div>
      </div>
      <.resize_handle row={row_id(@line)} line={@line} known={@known} />
    </section>
    """
  end

  # Shows the full name of a single stream, and short distinct names of several streams.
  defp panel_title(%{vis: [_one]} = assigns), do: ~H"<bdi>{stream_names(%{vis: @vis})}</bdi>"
  defp panel_title(assigns), do: ~H"{@vis |> short_names() |> Enum.join(\", \")}"

  # The id contains the panel's kind, so that the page creates a new element when the kind changes.
  defp body_id(panel), do: "body-#{panel.id}-#{panel.panel}"

  # Renders the lower edge of a row. Dragging it sets the row's height.
  defp resize_handle(assigns) do
    ~H"""
    <div class="resize" id={"resize-" <> @row} phx-hook="Resize" tabindex="0" role="separator"
        aria-orientation="horizontal" aria-label={"Height of " <> Enum.map_join(@line, ", ", &stream_names/1)}
        aria-valuenow={Layout.line_height(@line, @known.lanes)} aria-valuemin="28" aria-valuemax="2000"></div>
    """
  end

  defp maximise_button(assigns) do
    ~H"""
    <button class="mini" type="button" phx-click="maximise" phx-value-id={@panel.id}
        title={if @max == @panel.id, do: "Back to all panels (m)", else: "Fill the window (m)"}
        aria-label={if(@max == @panel.id, do: "Restore ", else: "Maximize ") <> stream_names(@panel)}
        ><.icon name={if @max == @panel.id, do: :shrink, else: :grow} /></button>
    """
  end

  defp panel_tools(assigns) do
    ~H"""
    <div class="panel-tools" role="toolbar" aria-label={stream_names(@panel)}>
      <.drag_handle id={@panel.id} kind="line" />
      <.maximise_button panel={@panel} max={@max} />
      <button class="mini" type="button" phx-click="select_panel" phx-value-id={@panel.id} title="Properties"
          aria-label={"Properties of " <> stream_names(@panel)}><.icon name={:tune} /></button>
      <button class="mini" type="button" phx-click="remove_panel" phx-value-id={@panel.id} title="Remove"
          aria-label={"Remove " <> stream_names(@panel)}><.icon name={:close} /></button>
    </div>
    """
  end

  defp drag_handle(assigns) do
    ~H"""
    <button id={"grip-" <> @id} class="mini grip" type="button" phx-hook="Grip" draggable="true" data-id={@id}
        data-grip={@kind}
        title={"Move: drag, or use the " <> if(@kind == "cell", do: "arrow keys", else: "up and down keys")}
        aria-label="Move this panel with the arrow keys"><.icon name={:grip} /></button>
    """
  end

  defp row_id([panel | _]), do: panel.row || panel.id

  defp stream_names(panel), do: Enum.map_join(panel.vis, ", ", &(&1.stream <> &1.path))

  @doc "Returns the panel's configuration for the page's script, as JSON."
  @spec encode_config(Layout.Panel.t(), map()) :: String.t()
  def encode_config(panel, known) do
    short = short_names(panel.vis)
    colors = StreamColors.assign_colors(Enum.map(panel.vis, & &1.stream), known.colors)

    vis =
      for {v, index} <- Enum.with_index(panel.vis) do
        viz = find_visualizer(v, known)

        %{
          "viz" => v.viz,
          "draw" => drawer_id(viz),
          "script" => script_config(viz),
          "asked" => server_props(viz, v.props),
          "stream" => v.stream,
          "path" => v.path,
          "name" => v.stream <> v.path,
          "short" => Enum.at(short, index),
          "props" => v.props,
          "ends" => known.coverage[v.stream],
          "color" => Enum.at(colors, index)
        }
      end

    axis =
      case panel.axis do
        {min, max} -> %{"mode" => "fixed", "min" => min, "max" => max}
        :own -> %{"mode" => "own"}
        nil -> nil
      end

    threshold = with {side, value} <- panel.threshold, do: %{"side" => side, "value" => value}

    Situ.JSON.encode(%{"vis" => vis, "axis" => axis, "threshold" => threshold})
  end

  # Shortens each name to its last segment if that distinguishes the panel's streams.
  defp short_names(vis), do: Enum.zip_with(vis, unmarked_names(vis), &mark_compared/2)

  # A stream of the compared recording has the same name as its counterpart, with a mark.
  defp mark_compared(%{stream: stream}, name),
    do: if(Comparison.compared_stream?(stream), do: "⇄ " <> name, else: name)

  defp unmarked_names(vis) do
    {own, compared} = Enum.split_with(vis, &(not Comparison.compared_stream?(&1.stream)))
    short = Map.merge(index_short_names(own), index_short_names(compared))
    Enum.map(vis, &short[{&1.stream, &1.path}])
  end

  defp index_short_names(vis),
    do: vis |> Enum.map(&{&1.stream, &1.path}) |> Enum.zip(unique_suffixes(vis)) |> Map.new()

  defp unique_suffixes(vis) do
    last = Enum.map(vis, &((&1.stream |> split_name() |> List.last()) <> &1.path))

    for {v, name} <- Enum.zip(vis, last) do
      if Enum.count(last, &(&1 == name)) == 1,
        do: name,
        else: (v.stream |> split_name() |> Enum.take(-2) |> Enum.join(".")) <> v.path
    end
  end

  # A "." in an expression does not separate segments of a name.
  defp split_name("= " <> _ = stream), do: [stream]
  defp split_name(stream), do: String.split(stream, ".")

  # A stream that does not exist (yet) is drawn as its layout specifies, because it may appear later.
  defp find_visualizer(vis, %{shapes: shapes, extra: extra}) do
    with :error <-
           Visualizers.fetch_for_path(
             vis.viz,
             vis.path,
             Map.get(shapes, vis.stream, :value),
             extra
           ),
         :error <- Visualizers.fetch_by_id(vis.viz, extra),
         do: vis.viz,
         else: ({:ok, viz} -> viz)
  end

  defp drawer_id(%Visualizer{drawer: drawer}), do: drawer
  defp drawer_id(id), do: id

  # Returns the URL and the options of a plug-in's script.
  defp script_config(%Visualizer{script: url} = viz) when url != nil,
    do: %{"url" => url, "plugin" => viz.plugin, "options" => option_defaults(viz)}

  defp script_config(_), do: nil

  defp option_defaults(viz),
    do: for({key, option} <- viz.options, into: %{}, do: {key, option[:default]})

  # Returns the properties that affect the data that the server sends.
  defp server_props(%Visualizer{asks: [_ | _] = asks}, props) do
    keys = Enum.map(asks, &Atom.to_string/1)
    Map.take(props, keys)
  end

  defp server_props(_, _), do: nil
end
