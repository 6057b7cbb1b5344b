defmodule Situ.Studio.Web.Sidebars do
  @moduledoc false
  # Renders the sidebars: recordings and the stream tree on the left, and properties of the selection on the right.
  use Situ.Live.Component
  import Situ.Studio.Web.Icons
  import Situ.Studio.Web.TimeLabels
  alias Situ.Studio.{StreamColors, StreamTotals, Visualizer, Visualizers}
  alias Situ.Studio.Web.StreamProps

  attr(:sources, :list, required: true)
  attr(:current, :string, required: true)
  attr(:rows, :list, required: true)
  attr(:more, :integer, required: true)
  attr(:query, :string, required: true)
  attr(:count, :integer, required: true)
  attr(:info, :atom, required: true)
  attr(:snap, :any, required: true)
  attr(:selected, :any, required: true)
  attr(:parts, :list, default: [])
  attr(:names, :string, required: true)
  attr(:kinds, :string, required: true)

  @doc false
  def streams_sidebar(assigns) do
    ~H"""
    <aside class="left" aria-label="Streams">
      <div :if={length(@sources) > 1} class="side-title">Recordings</div>
      <nav :if={length(@sources) > 1} class="stores">
        <a :for={s <- @sources} :key={s.id} id={"source-" <> s.id}
            class={["store", s.id == @current && "current"]} href={s.href}
            title={s.title} data-session={if s.kind == :session, do: s.id}><.icon
            name={if s.kind == :pipeline, do: :pipeline, else: :store} /><span>{s.title}</span></a>
      </nav>
      <form class="search" phx-change="search" phx-submit="search" id="search-form">
        <input id="search" name="query" value={@query} placeholder="Search streams  /" autocomplete="off"
            phx-debounce="80" aria-label="Search streams by name and type">
        <.info_select info={@info} />
        <button class="mini" type="button" phx-click="fold_all" title="Fold all" aria-label="Fold all">⊟</button>
        <button class="mini" type="button" phx-click="unfold_all" title="Unfold all"
            aria-label="Unfold all">⊞</button>
      </form>
      <div id="stream-names" data-names={@names} data-kinds={@kinds} hidden></div>
      <p :if={@query != ""} class="hint found" role="status">{count_found(@rows, @more)} of {@count} streams</p>
      <div id="tree" class="tree" role="tree" phx-hook="Tree">
        <div :for={row <- @rows} :key={row.path}
            class={["node", row.item == nil && "group", row_selected?(row, @selected) && "selected"]}
            id={"node-" <> row.path} role="treeitem" tabindex="0" aria-expanded={aria_expanded(row)}
            aria-level={row.depth + 1} data-group={row.open? != nil && row.path}
            data-stream={row.item && row.item.name} data-shape={row.item && row.item.shape}
            data-type={row.item && row.item.type} data-path={row.item && row.item.path}
            data-address={row.item && stream_address(row.item.name, @parts)}
            draggable={if row.item, do: "true"}
            style={"padding-left: #{row.depth * 14}px"}>
          <button :if={row.open? != nil} class="fold" type="button" tabindex="-1" phx-click="toggle"
              phx-value-path={row.path} aria-label="fold">{if row.open?, do: "▾", else: "▸"}</button>
          <span :if={row.open? == nil} class="fold"></span>
          <i :if={row.item} class={["type", shape_class(row.item.shape)]}></i>
          <button class="name" type="button" tabindex="-1" phx-click="select" phx-value-path={row.path}
              title={row.path}>{row.label}</button>
          <span :if={row.item && row.item.name == @snap} class="snap" title="The cursor snaps to it">◎</span>
          <.figure_label :if={not (@info == :streams and row.item != nil)} choice={@info}
              figures={StreamTotals.sum_streams(row_streams(row))} of={if row.item, do: "one", else: "group"} />
          <button :if={row.item} class="add" type="button" tabindex="-1" phx-click="add_stream"
              phx-value-stream={row.item.name} title="Show this stream (Enter)" aria-label="show">+</button>
        </div>
        <p :if={@more > 0} class="hint" style="padding: 6px 12px">{@more} more: use the search to find them</p>
        <p :if={@rows == []} class="hint"
            style="padding: 6px 12px">{if @query == "", do: "No streams yet", else: "No matching streams"}</p>
      </div>
      <div class="split" id="split-left" phx-hook="Split" data-var="--left" data-edge="right" tabindex="0"
          role="separator" aria-orientation="vertical" aria-label="Width of the streams" aria-valuenow="15"
          aria-valuemin="5" aria-valuemax="70"></div>
    </aside>
    """
  end

  defp row_selected?(%{item: %{name: name}}, {:stream, name}), do: true
  defp row_selected?(%{item: nil, path: path}, {:group, path}), do: true
  defp row_selected?(_, _), do: false

  # In a session of a dataset, a stream can also be addressed by its recording within the session.
  defp stream_address("= " <> _, _), do: nil
  defp stream_address(_, []), do: nil
  defp stream_address(name, [part]), do: "[#{part}]:#{name}"

  defp stream_address(name, parts) do
    case Enum.find(parts, &String.starts_with?(name, &1 <> ".")) do
      nil -> nil
      part -> "[#{part}]:" <> String.replace_prefix(name, part <> ".", "")
    end
  end

  defp aria_expanded(%{open?: nil}), do: nil
  defp aria_expanded(%{open?: open?}), do: to_string(open?)

  defp shape_class(:signal), do: "signal"
  defp shape_class(:audio), do: "audio"
  defp shape_class(shape) when shape in [:image, :depth], do: "image"
  defp shape_class(:shapes), do: "shape"
  defp shape_class(shape) when shape in [:signals, :bars], do: "signal"
  defp shape_class(shape) when shape in [:boolean, :state, :states], do: "state"
  defp shape_class(shape) when shape in [:text, :spans], do: "text"
  defp shape_class(_), do: ""

  attr(:info, :atom, required: true)

  @doc "Renders the select box for the statistic shown next to the names; it belongs in the search form."
  def info_select(assigns) do
    assigns = assign(assigns, choices: StreamTotals.list_choices())

    ~H"""
    <label class="mini pick" title={"Show next to names: " <> @choices[@info]}><.icon name={:info} /><select name="info"
        aria-label="Show next to names"><option :for={{name, title} <- @choices} value={name}
        selected={name == @info}>{title}</option></select></label>
    """
  end

  # A group's statistics summarize all of its streams.
  defp row_streams(%{item: nil, under: under}), do: under
  defp row_streams(%{item: stream}), do: [stream]

  defp count_found(rows, more), do: Enum.count(rows, & &1.item) + more

  attr(:stream, :any, required: true)
  attr(:group, :any, default: nil)
  attr(:panel, :any, required: true)
  attr(:known, :map, required: true)
  attr(:snap, :any, required: true)

  @doc false
  def properties_sidebar(assigns) do
    ~H"""
    <aside class="right" aria-label="Properties">
      <div class="side-title">Properties<button class="mini" type="button" data-act="right" title="Hide (p)"
          aria-label="Hide the properties"><.icon name={:close} /></button></div>
      <div class="props">
        <StreamProps.stream_properties :if={@stream} stream={@stream} extra={@known.extra} snap={@snap} />
        <StreamProps.group_properties :if={@group} group={@group} />
        <.panel_props :if={@panel} panel={@panel} known={@known} />
        <p :if={@stream == nil and @panel == nil and @group == nil} class="hint">Select a stream or a panel.
          Double-click or drag a stream to show it. Right-click for more actions.</p>
      </div>
      <div class="split left-edge" id="split-right" phx-hook="Split" data-var="--right" data-edge="left" tabindex="0"
          role="separator" aria-orientation="vertical" aria-label="Width of the properties" aria-valuenow="15"
          aria-valuemin="5" aria-valuemax="70"></div>
    </aside>
    """
  end

  defp panel_props(assigns) do
    streams = Enum.map(assigns.panel.vis, & &1.stream)
    assigns = assign(assigns, colors: StreamColors.assign_colors(streams, assigns.known.colors))

    ~H"""
    <h2>{panel_title(@panel)}</h2>
    <div class="sub">{length(@panel.vis)} {if length(@panel.vis) == 1, do: "stream", else: "streams"}</div>
    <form :if={@panel.panel == :plot} id={"axis-" <> @panel.id} phx-change="axis">
      <input type="hidden" name="panel" value={@panel.id}>
      <div class="field"><label for="axis-own">Separate axis for each line</label><input id="axis-own" name="own"
          type="checkbox" value="true" checked={@panel.axis == :own}></div>
      <div class="field"><label for="axis-min">Axis minimum</label><input id="axis-min" name="min"
          value={range_limit(@panel.axis, 0)} disabled={@panel.axis == :own} placeholder="automatic"
          inputmode="decimal" phx-debounce="400"></div>
      <div class="field"><label for="axis-max">Axis maximum</label><input id="axis-max" name="max"
          value={range_limit(@panel.axis, 1)} disabled={@panel.axis == :own} placeholder="automatic"
          inputmode="decimal" phx-debounce="400"></div>
    </form>
    <form :if={@panel.panel == :plot} id={"threshold-" <> @panel.id} phx-change="threshold">
      <input type="hidden" name="panel" value={@panel.id}>
      <div class="field"><label for="threshold-side">Cover values</label>
        <select id="threshold-side" name="side">
          <option value="">never</option>
          <option value="below" selected={threshold_side(@panel) == :below}>below the threshold</option>
          <option value="above" selected={threshold_side(@panel) == :above}>above the threshold</option>
        </select>
      </div>
      <div class="field"><label for="threshold-value">Threshold</label><input id="threshold-value"
          name="value" value={range_limit(@panel.threshold, 1)} inputmode="decimal" phx-debounce="400"></div>
    </form>
    <div :for={{vis, index} <- Enum.with_index(@panel.vis)} class="viz">
      <div class="head"><span title={vis.stream}>{vis.stream}{vis.path}</span>
        <button class="mini" type="button" phx-click="remove_vis" phx-value-panel={@panel.id}
            phx-value-index={index} title="Remove from the panel" aria-label="Remove from the panel"><.icon
            name={:close} /></button>
      </div>
      <div class="kind">{kind_title(vis, @known)}</div>
      <form id={"props-#{@panel.id}-#{index}"} phx-change="prop">
        <input type="hidden" name="panel" value={@panel.id}><input type="hidden" name="index" value={index}>
        <div :for={{key, option} <- visualizer_options(vis, @known)} class="field">
          <label for={"f-#{@panel.id}-#{index}-#{key}"}>{option[:title]}</label>
          <.option_input id={"f-#{@panel.id}-#{index}-#{key}"} key={key} name={"props[#{key}]"} option={option}
              value={Map.get(vis.props, to_string(key), option[:default])} panel={@panel.id} index={index}
              color={Enum.at(@colors, index)} />
        </div>
      </form>
    </div>
    <div class="choices"><button class="btn" type="button" phx-click="remove_panel"
        phx-value-id={@panel.id}>Remove panel</button></div>
    """
  end

  defp option_input(%{option: option} = assigns) do
    assigns = assign(assigns, type: option[:type])

    ~H"""
    <input :if={@type == :boolean} id={@id} type="checkbox" name={@name} value="true" checked={@value == true}>
    <span :if={@type == :color} class="color">
      <input id={@id} type="color" name={@name} value={@value} phx-hook="Swatch" class={unset_class(@value, @option)}
          data-auto={@value == nil && @option[:auto] == nil && @color}>
      <span :if={@value == nil} class="hint">{@option[:auto] || "automatic"}</span>
      <button :if={@value != nil} class="mini" type="button" phx-click="prop_auto" phx-value-panel={@panel}
          phx-value-index={@index} phx-value-key={@key} title={"Back to " <> (@option[:auto] || "automatic")}
          aria-label={"Back to " <> (@option[:auto] || "automatic")}><.icon name={:close} /></button>
    </span>
    <select :if={match?({:in, _}, @type)} id={@id} name={@name}><option :for={{v, title} <- input_choices(@type)}
        value={v} selected={v == @value}>{title}</option></select>
    <input :if={match?({:range, _, _}, @type) or @type == :text} id={@id} name={@name} value={format_number(@value)}
        placeholder={@option[:auto]} phx-debounce="400">
    """
  end

  # A color input always shows a color. A class marks inputs without a value, because black would be misleading.
  defp unset_class(nil, option), do: (option[:several] && "several") || (option[:auto] && "none")
  defp unset_class(_, _), do: nil

  # Writes 3.0 as 3, as a person would.
  defp format_number(x) when is_float(x) and abs(x) < 1.0e15 and trunc(x) == x, do: trunc(x)
  defp format_number(x), do: x

  defp input_choices({:in, values}), do: Visualizer.choice_pairs(values)
  defp input_choices(_), do: []

  defp visualizer_options(vis, %{shapes: shapes, extra: extra}) do
    case Visualizers.fetch_for_path(vis.viz, vis.path, Map.get(shapes, vis.stream, :value), extra) do
      {:ok, entry} -> Visualizer.active_options(entry, vis.props)
      :error -> []
    end
  end

  defp kind_title(vis, %{shapes: shapes, extra: extra}) do
    case Visualizers.fetch_for_path(vis.viz, vis.path, Map.get(shapes, vis.stream, :value), extra) do
      {:ok, entry} -> entry.title
      :error -> vis.viz
    end
  end

  defp panel_title(%{panel: panel}) do
    %{plot: "Plot", lanes: "Lanes", image: "Image", value: "Value", bars: "Bars", text: "Text"}
    |> Map.merge(%{
      space: "In space",
      map: "Map",
      log: "List",
      table: "Table",
      xy: "XY plot",
      own: "Panel"
    })
    |> Map.fetch!(panel)
  end

  defp threshold_side(%{threshold: {side, _}}), do: side
  defp threshold_side(_), do: nil

  defp range_limit(none, _) when none in [nil, :own], do: ""
  defp range_limit(range, i), do: range |> elem(i) |> format_number()
end
