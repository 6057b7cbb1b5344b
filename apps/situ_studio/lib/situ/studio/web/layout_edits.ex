defmodule Situ.Studio.Web.LayoutEdits do
  @moduledoc false
  # Applies the layout changes that the page's buttons and forms make, as pure functions from an event and the
  # assigns to the changed assigns.
  alias Situ.{Error, Studio}
  alias Studio.{Layout, Visualizer, Visualizers}

  @sides %{
    "above" => :above,
    "below" => :below,
    "left" => :left,
    "right" => :right,
    "tab" => :tab
  }
  @ways %{"up" => :up, "down" => :down, "left" => :left, "right" => :right}

  @spec apply_event(String.t(), map(), map()) :: {:ok, keyword()} | {:error, Error.t()} | :ignore
  def apply_event("add_stream", %{"stream" => stream} = params, assigns) do
    into = if(is_binary(params["panel"]), do: params["panel"], else: "")

    with {:ok, entries} <- fetch_visualizers(assigns, stream) do
      # A stream that is dropped on a panel uses a visualizer that fits this panel, if there is one.
      panel = Layout.find_panel(assigns.layout, into)
      entry = (panel && Enum.find(entries, &(&1.panel == panel.panel))) || hd(entries)
      assigns |> add_to_panel(stream, entry, into) |> place_new_panel(params)
    end
  end

  def apply_event("add_viz", %{"stream" => stream, "viz" => id} = params, assigns) do
    into = if(is_binary(params["panel"]), do: params["panel"], else: "")

    with {:ok, entries} <- fetch_visualizers(assigns, stream) do
      case Enum.find(entries, &(&1.id == id)) do
        nil -> :ignore
        entry -> add_to_panel(assigns, stream, entry, into)
      end
    end
  end

  def apply_event("plot_path", %{"stream" => stream, "path" => path} = params, assigns) do
    {viz, panel} =
      case params["kind"] do
        "string" -> {"labels", :lanes}
        kind when kind in ["boolean", "atom"] -> {"states", :lanes}
        _ -> {"line", :plot}
      end

    with {:ok, _} <- fetch_visualizers(assigns, stream),
         {:ok, _} <- Studio.ValuePath.parse(path),
         {:ok, layout, id} <-
           Layout.add_stream(assigns.layout, stream, viz, panel, "", path: path) do
      {:ok, layout: layout, selected: {:panel, id}}
    end
  end

  def apply_event("beside", _, assigns),
    do: {:ok, layout: Layout.toggle_side(assigns.layout)}

  # Maximizes one panel until it is restored.
  def apply_event("maximise", %{"id" => id}, assigns) do
    cond do
      assigns.maximised == id -> {:ok, maximised: nil}
      Layout.find_panel(assigns.layout, id) -> {:ok, maximised: id}
      true -> :ignore
    end
  end

  def apply_event("restore", _, assigns), do: {:ok, maximised: nil, selected: assigns.selected}

  def apply_event("undo", _, assigns), do: restore_layout(assigns, :undo, :redo)
  def apply_event("redo", _, assigns), do: restore_layout(assigns, :redo, :undo)

  # Shows or hides a stream; `only` hides the panel's other streams, or shows them again.
  def apply_event("show_vis", %{"panel" => id, "all" => all}, assigns)
      when all in ["true", "false"] do
    shown = fn p -> %{p | vis: Enum.map(p.vis, &put_visible(&1, all == "true"))} end
    {:ok, layout: Layout.update_panel(assigns.layout, id, shown)}
  end

  def apply_event("show_vis", %{"panel" => id, "index" => index} = params, assigns) do
    with {:ok, i} <- parse_integer(to_string(index)),
         %{vis: vis} <- Layout.find_panel(assigns.layout, id),
         {:ok, one} <- fetch_at(vis, i) do
      layout =
        Layout.update_panel(
          assigns.layout,
          id,
          &%{&1 | vis: toggle_visible(vis, i, one, params["only"])}
        )

      {:ok, layout: layout}
    else
      _ -> :ignore
    end
  end

  def apply_event("select_panel", %{"id" => id}, assigns) do
    if Layout.find_panel(assigns.layout, id), do: {:ok, selected: {:panel, id}}, else: :ignore
  end

  def apply_event("remove_panel", %{"id" => id}, assigns) do
    selected = if assigns.selected == {:panel, id}, do: nil, else: assigns.selected
    {:ok, layout: Layout.remove_panel(assigns.layout, id), selected: selected}
  end

  def apply_event("remove_vis", %{"panel" => id, "index" => index}, assigns) do
    with {:ok, i} <- parse_integer(index),
         do: {:ok, layout: Layout.remove_vis(assigns.layout, id, i)}
  end

  # The panel was dropped on a position, or a key moved it one step.
  def apply_event("place_panel", %{"id" => id, "side" => side, "target" => target}, assigns)
      when is_map_key(@sides, side) and is_binary(id) and is_binary(target) do
    with {:ok, layout} <- Layout.move_panel(assigns.layout, id, {@sides[side], target}),
         do: {:ok, layout: layout}
  end

  def apply_event("shift_panel", %{"id" => id, "way" => way}, assigns)
      when is_map_key(@ways, way) and is_binary(id) do
    with {:ok, layout} <- Layout.shift_panel(assigns.layout, id, @ways[way]),
         do: {:ok, layout: layout}
  end

  def apply_event("resize_part", %{"id" => id, "height" => height}, assigns)
      when (is_integer(height) or height == nil) and is_binary(id),
      do: {:ok, layout: Layout.resize_part(assigns.layout, id, height)}

  def apply_event("resize_row", %{"id" => id, "shares" => shares}, assigns) when is_binary(id),
    do: {:ok, layout: Layout.resize_row(assigns.layout, id, shares)}

  def apply_event("select_tab", %{"id" => id}, assigns) when is_binary(id),
    do: {:ok, layout: Layout.select_tab(assigns.layout, id)}

  # Scales each line to its own minimum and maximum, or all lines to one axis again.
  def apply_event("axis", %{"panel" => id, "own" => "true"}, assigns),
    do: put_axis(assigns, id, :own)

  def apply_event("axis", %{"panel" => id, "_target" => ["own"]}, assigns),
    do: put_axis(assigns, id, nil)

  def apply_event("axis", %{"panel" => id, "min" => min, "max" => max}, assigns) do
    case {parse_number(min), parse_number(max)} do
      {{:ok, min}, {:ok, max}} when min < max -> put_axis(assigns, id, {min, max})
      {:empty, :empty} -> put_axis(assigns, id, nil)
      _ -> :ignore
    end
  end

  def apply_event("threshold", %{"panel" => id, "side" => side, "value" => value}, assigns) do
    case {Enum.find([:below, :above], &(Atom.to_string(&1) == side)), parse_number(value)} do
      {nil, _} -> put_threshold(assigns, id, nil)
      {_, :empty} -> put_threshold(assigns, id, nil)
      {side, {:ok, value}} -> put_threshold(assigns, id, {side, value})
      _ -> :ignore
    end
  end

  def apply_event("prop", %{"panel" => id, "index" => index} = params, assigns) do
    with {:ok, i} <- parse_integer(index),
         %{vis: vis} <- Layout.find_panel(assigns.layout, id),
         {:ok, one} <- fetch_at(vis, i),
         {:ok, entry} <- fetch_visualizer(assigns, one) do
      props = if is_map(params["props"]), do: params["props"], else: %{}
      options = Visualizer.active_options(entry, one.props)
      props = Enum.reduce(options, one.props, &put_option(&1, &2, props, params, entry))
      {:ok, layout: put_props(assigns.layout, id, i, props)}
    else
      _ -> :ignore
    end
  end

  def apply_event("prop_auto", %{"panel" => id, "index" => index, "key" => key}, assigns) do
    with {:ok, i} <- parse_integer(index),
         %{vis: vis} <- Layout.find_panel(assigns.layout, id),
         {:ok, one} <- fetch_at(vis, i) do
      {:ok, layout: put_props(assigns.layout, id, i, Map.delete(one.props, key))}
    else
      _ -> :ignore
    end
  end

  def apply_event(_, _, _), do: :ignore

  defp restore_layout(assigns, from, to) do
    case Map.fetch!(assigns, from) do
      [layout | rest] ->
        {:ok, [{:layout, layout}, {from, rest}, {to, [assigns.layout | Map.fetch!(assigns, to)]}]}

      [] ->
        {:error, Error.new(:nothing, "there is nothing to #{from}")}
    end
  end

  defp toggle_visible(vis, i, one, "true") do
    alone? = vis |> List.delete_at(i) |> Enum.all?(&hidden?/1) and not hidden?(one)
    for {v, k} <- Enum.with_index(vis), do: put_visible(v, alone? or k == i)
  end

  defp toggle_visible(vis, i, one, _), do: List.replace_at(vis, i, put_visible(one, hidden?(one)))

  defp hidden?(vis), do: vis.props["visible"] == false
  defp put_visible(vis, true), do: %{vis | props: Map.delete(vis.props, "visible")}
  defp put_visible(vis, false), do: %{vis | props: Map.put(vis.props, "visible", false)}

  defp put_props(layout, id, i, props) do
    Layout.update_panel(layout, id, fn p ->
      %{p | vis: List.update_at(p.vis, i, &%{&1 | props: props})}
    end)
  end

  # Only the field that changed is updated. Browsers omit unchecked boxes, so a missing boolean means false.
  defp put_option({key, option}, props, fields, params, entry) do
    name = Atom.to_string(key)

    cond do
      params["_target"] not in [nil, ["props", name]] -> props
      option[:type] == :boolean -> Map.put(props, name, fields[name] == "true")
      not is_binary(fields[name]) -> props
      fields[name] == "" -> Map.delete(props, name)
      true -> put_cast_value(props, name, fields[name], entry)
    end
  end

  defp put_cast_value(props, name, text, entry) do
    case Visualizer.cast_property(entry, name, text) do
      {:ok, value} -> Map.put(props, name, value)
      :error -> props
    end
  end

  defp add_to_panel(assigns, stream, entry, into) do
    with {:ok, layout, id} <-
           Layout.add_stream(assigns.layout, stream, entry.id, entry.panel, into) do
      {:ok, layout: layout, selected: {:panel, id}}
    end
  end

  # A stream that is dropped on the edge of a panel gets a panel there.
  defp place_new_panel({:ok, [layout: layout, selected: {:panel, id}]}, %{
         "side" => side,
         "target" => target
       })
       when is_map_key(@sides, side) and is_binary(target) do
    with {:ok, layout} <- Layout.move_panel(layout, id, {@sides[side], target}),
         do: {:ok, layout: layout, selected: {:panel, id}}
  end

  defp place_new_panel(added, _), do: added

  defp put_axis(assigns, id, axis),
    do: {:ok, layout: Layout.update_panel(assigns.layout, id, &%{&1 | axis: axis})}

  defp put_threshold(assigns, id, value),
    do: {:ok, layout: Layout.update_panel(assigns.layout, id, &%{&1 | threshold: value})}

  defp fetch_visualizers(assigns, stream) do
    case assigns.shapes do
      %{^stream => shape} ->
        {:ok, Visualizers.for_shape(shape, assigns.extra)}

      _ ->
        {:error, Error.new(:no_stream, "unknown stream: #{inspect(stream)}")}
    end
  end

  defp fetch_visualizer(assigns, vis) do
    shape = Map.get(assigns.shapes, vis.stream, :value)

    Visualizers.fetch_for_path(vis.viz, vis.path, shape, assigns.extra)
  end

  defp fetch_at(vis, i) when i >= 0, do: Enum.fetch(vis, i)
  defp fetch_at(_, _), do: :error

  defp parse_integer(text) when is_binary(text) do
    case Integer.parse(text) do
      {i, ""} -> {:ok, i}
      _ -> :ignore
    end
  end

  defp parse_integer(_), do: :ignore

  defp parse_number(text) when is_binary(text) do
    case {String.trim(text), Float.parse(String.trim(text))} do
      {"", _} -> :empty
      {_, {x, ""}} -> {:ok, x}
      _ -> :error
    end
  end

  defp parse_number(_), do: :error
end
