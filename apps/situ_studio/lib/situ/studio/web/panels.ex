defmodule Situ.Studio.Web.Panels do
  @moduledoc false
  # The center of the page: rows of panels. The page's script renders the inside of each panel.
  use Situ.Live.Component
  import Situ.Studio.Web.Icons
  alias Situ.Studio.Web.Annotation
  alias Situ.Studio.{Color, Layout, Visualizer, Visualizers}
  alias Situ.Studio.Source.Beside

  attr(:layout, :any, required: true)
  attr(:selected, :any, required: true)

  # facts about the streams: shapes, lanes, coverage and colors, and the studio's own visualizers (`:extra`)
  attr(:known, :map, required: true)
  attr(:streams, :integer, required: true)
  attr(:maximised, :any, required: true)
  attr(:annotation, :any, default: nil)

  @doc false
  def stack(assigns) do
    {cells, times} = assigns.layout |> Layout.lines() |> Enum.split_with(&hd(&1).row)

    {side, main} =
      if assigns.layout.beside, do: {cells, times}, else: {[], Layout.lines(assigns.layout)}

    assigns = assign(assigns, side: side, main: main, max: maximised(assigns))

    ~H"""
    <div class={["stack", @side != [] && "beside", @max && "max"]} id="stack" phx-hook="Drop">
      <div class={["side", holds?(@side, @max) && "maxed"]} id="side" :if={@side != []}>
        <.line :for={line <- @side} :key={row_id(line)} line={line} selected={@selected} max={@max} known={@known} />
        <div class="split" id="split-side" phx-hook="Split" data-var="--side" data-edge="right" tabindex="0"
            role="separator" aria-orientation="vertical" aria-label="Width of the images" aria-valuenow="40"
            aria-valuemin="10" aria-valuemax="80"></div>
      </div>
      <div class={["times", holds?(@main, @max) && "maxed"]} id="times">
        <div id="navigator" class="navigator" phx-hook="Navigator" phx-update="ignore" role="group"
            aria-label="Time navigator"></div>
        <.line :for={line <- @main} :key={row_id(line)} line={line} selected={@selected} max={@max} known={@known} />
        <Annotation.panel :if={@annotation} stream={@annotation} />
        <div :if={@layout.rows == [] and @streams > 0}
            class="empty"><b>Nothing shown yet</b><span>Double-click a stream on the left, or drag it here.</span></div>
        <div :if={@layout.rows == [] and @streams == 0} class="empty"><b>No streams yet</b><span>{if @known.damaged,
          do: "This recording is damaged, and none of its streams can be read.",
          else: "Nothing was recorded here. New recordings appear automatically."}</span></div>
      </div>
    </div>
    """
  end

  defp maximised(%{layout: layout, maximised: id}), do: if(Layout.panel(layout, id), do: id)

  defp holds?(lines, max), do: max != nil and Enum.any?(List.flatten(lines), &(&1.id == max))

  defp line(%{line: [%{row: nil} = panel]} = assigns) do
    assigns = assign(assigns, :panel, panel)

    ~H"""
    <section class={["row-box timeline", @selected == {:panel, @panel.id} && "selected", @max == @panel.id && "maxed"]}
        id={"row-" <> @panel.id} data-row={@panel.id} data-panel={@panel.id} data-menu="panel"
        style={Layout.style(@line, @known.lanes)}>
      <div id={body(@panel)} class="panel-body" phx-hook="Panel" phx-update="ignore" role="group"
          aria-label={names(@panel)} data-kind={@panel.panel} data-config={config(@panel, @known)}></div>
      <.tools panel={@panel} row={@panel.id} max={@max} />
      <.edge row={@panel.id} line={@line} known={@known} />
    </section>
    """
  end

  defp line(assigns) do
    ~H"""
    <section class={["row-box cells", holds?([@line], @max) && "maxed"]} id={"row-" <> row_id(@line)}
        data-row={row_id(@line)} style={Layout.style(@line, @known.lanes)}>
      <div :for={panel <- @line} :key={panel.id} id={"cell-" <> panel.id} data-panel={panel.id} data-menu="panel"
          class={["cell", @selected == {:panel, panel.id} && "selected", @max == panel.id && "maxed"]}>
        <div class="cell-head">
          <.grip id={panel.id} kind="cell" />
          <button class="title" type="button" phx-click="select_panel" phx-value-id={panel.id}
              title={names(panel)}><.called vis={panel.vis} /></button>
          <.maximise panel={panel} max={@max} />
          <button class="mini" type="button" phx-click="remove_panel" phx-value-id={panel.id} title="Remove"
              aria-label={"Remove " <> names(panel)}><.icon name={:close} /></button>
        </div>
        <div class="cell-body"><div id={body(panel)} class="panel-body" phx-hook="Panel" phx-update="ignore"
            role="group" aria-label={names(panel)} data-kind={panel.panel}
            data-config={config(panel, @known)}></div></div>
      </div>
      <.edge row={row_id(@line)} line={@line} known={@known} />
    </section>
    """
  end

  # Shows the full name of a single stream, and short distinct names of several streams.
  defp called(%{vis: [_one]} = assigns), do: ~H"<bdi>{names(%{vis: @vis})}</bdi>"
  defp called(assigns), do: ~H"{@vis |> short_names() |> Enum.join(\", \")}"

  # The id contains the panel's kind, so that the page creates a new element when the kind changes.
  defp body(panel), do: "body-#{panel.id}-#{panel.panel}"

  # The lower edge of a row; dragging it sets the row's height.
  defp edge(assigns) do
    ~H"""
    <div class="resize" id={"resize-" <> @row} phx-hook="Resize" tabindex="0" role="separator"
        aria-orientation="horizontal" aria-label={"Height of " <> Enum.map_join(@line, ", ", &names/1)}
        aria-valuenow={Layout.height(@line, @known.lanes)} aria-valuemin="28" aria-valuemax="2000"></div>
    """
  end

  defp maximise(assigns) do
    ~H"""
    <button class="mini" type="button" phx-click="maximise" phx-value-id={@panel.id}
        title={if @max == @panel.id, do: "Back to all panels (m)", else: "Fill the window (m)"}
        aria-label={if(@max == @panel.id, do: "Restore ", else: "Maximize ") <> names(@panel)}
        ><.icon name={if @max == @panel.id, do: :shrink, else: :grow} /></button>
    """
  end

  defp tools(assigns) do
    ~H"""
    <div class="panel-tools" role="toolbar" aria-label={names(@panel)}>
      <.grip id={@panel.id} kind="line" />
      <.maximise panel={@panel} max={@max} />
      <button class="mini" type="button" phx-click="select_panel" phx-value-id={@panel.id} title="Properties"
          aria-label={"Properties of " <> names(@panel)}><.icon name={:tune} /></button>
      <button class="mini" type="button" phx-click="remove_panel" phx-value-id={@panel.id} title="Remove"
          aria-label={"Remove " <> names(@panel)}><.icon name={:close} /></button>
    </div>
    """
  end

  defp grip(assigns) do
    ~H"""
    <button id={"grip-" <> @id} class="mini grip" type="button" phx-hook="Grip" draggable="true" data-id={@id}
        data-grip={@kind}
        title={"Move: drag, or use the " <> if(@kind == "cell", do: "arrow keys", else: "up and down keys")}
        aria-label="Move this panel with the arrow keys"><.icon name={:grip} /></button>
    """
  end

  defp row_id([panel | _]), do: panel.row || panel.id

  defp names(panel), do: Enum.map_join(panel.vis, ", ", &(&1.stream <> &1.path))

  @doc "Returns the panel's configuration for the page's script, as JSON."
  @spec config(Layout.Panel.t(), map()) :: String.t()
  def config(panel, known) do
    short = short_names(panel.vis)
    colors = Color.of(Enum.map(panel.vis, & &1.stream), known.colors)

    vis =
      for {v, index} <- Enum.with_index(panel.vis) do
        viz = visualizer(v, known)

        %{
          "viz" => v.viz,
          "draw" => drawer(viz),
          "script" => script(viz),
          "asked" => asked(viz, v.props),
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
  defp short_names(vis), do: Enum.zip_with(vis, names_of(vis), &marked/2)

  # A stream of the compared recording has the same name as its counterpart, with a mark.
  defp marked(%{stream: stream}, name),
    do: if(Beside.second?(stream), do: "⇄ " <> name, else: name)

  defp names_of(vis) do
    {own, compared} = Enum.split_with(vis, &(not Beside.second?(&1.stream)))
    short = Map.merge(shortened(own), shortened(compared))
    Enum.map(vis, &short[{&1.stream, &1.path}])
  end

  defp shortened(vis),
    do: vis |> Enum.map(&{&1.stream, &1.path}) |> Enum.zip(cut(vis)) |> Map.new()

  defp cut(vis) do
    last = Enum.map(vis, &((&1.stream |> parts() |> List.last()) <> &1.path))

    for {v, name} <- Enum.zip(vis, last) do
      if Enum.count(last, &(&1 == name)) == 1,
        do: name,
        else: (v.stream |> parts() |> Enum.take(-2) |> Enum.join(".")) <> v.path
    end
  end

  # A "." in an expression does not separate segments of a name.
  defp parts("= " <> _ = stream), do: [stream]
  defp parts(stream), do: String.split(stream, ".")

  # A stream that does not exist (yet) is drawn as its layout specifies, because it may appear later.
  defp visualizer(vis, %{shapes: shapes, extra: extra}) do
    with :error <- Visualizers.of(vis.viz, vis.path, Map.get(shapes, vis.stream, :value), extra),
         :error <- Visualizers.named(vis.viz, extra),
         do: vis.viz,
         else: ({:ok, viz} -> viz)
  end

  defp drawer(%Visualizer{drawer: drawer}), do: drawer
  defp drawer(id), do: id

  # Returns the URL and the options of a plug-in's script.
  defp script(%Visualizer{script: url} = viz) when url != nil,
    do: %{"url" => url, "plugin" => viz.plugin, "options" => defaults(viz)}

  defp script(_), do: nil

  defp defaults(viz),
    do: for({key, option} <- viz.options, into: %{}, do: {key, option[:default]})

  # Returns the properties that affect the data that the server sends.
  defp asked(%Visualizer{asks: [_ | _] = asks}, props) do
    keys = Enum.map(asks, &Atom.to_string/1)
    Map.take(props, keys)
  end

  defp asked(_, _), do: nil
end
