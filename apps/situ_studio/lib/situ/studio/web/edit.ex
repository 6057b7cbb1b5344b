defmodule Situ.Studio.Web.Edit do
  @moduledoc false
  # The layout changes that the page's buttons and forms make, as pure functions from an event and the assigns to the
  # changed assigns.
  alias Situ.{Error, Studio}
  alias Studio.{Layout, Visualizer, Visualizers}

  @sides %{"above" => :above, "below" => :below, "left" => :left, "right" => :right}
  @ways %{"up" => :up, "down" => :down, "left" => :left, "right" => :right}

  @spec apply(String.t(), map(), map()) :: {:ok, keyword()} | {:error, Error.t()} | :ignore
  def apply("add_stream", %{"stream" => stream} = params, assigns) do
    into = if(is_binary(params["panel"]), do: params["panel"], else: "")

    with {:ok, entries} <- entries(assigns, stream) do
      # a stream that is dropped on a panel uses a visualizer that fits this panel, if there is one
      panel = Layout.panel(assigns.layout, into)
      entry = (panel && Enum.find(entries, &(&1.panel == panel.panel))) || hd(entries)
      add(assigns, stream, entry, into)
    end
  end

  def apply("add_viz", %{"stream" => stream, "viz" => id} = params, assigns) do
    into = if(is_binary(params["panel"]), do: params["panel"], else: "")

    with {:ok, entries} <- entries(assigns, stream) do
      case Enum.find(entries, &(&1.id == id)) do
        nil -> :ignore
        entry -> add(assigns, stream, entry, into)
      end
    end
  end

  def apply("plot_path", %{"stream" => stream, "path" => path} = params, assigns) do
    {viz, panel} =
      case params["kind"] do
        "string" -> {"labels", :lanes}
        kind when kind in ["boolean", "atom"] -> {"states", :lanes}
        _ -> {"line", :plot}
      end

    with {:ok, _} <- entries(assigns, stream),
         {:ok, _} <- Studio.Path.parse(path),
         {:ok, layout, id} <- Layout.add(assigns.layout, stream, viz, panel, "", path: path) do
      {:ok, layout: layout, selected: {:panel, id}}
    end
  end

  def apply("beside", _, assigns), do: {:ok, layout: Layout.beside(assigns.layout)}

  # Maximizes one panel until it is restored.
  def apply("maximise", %{"id" => id}, assigns) do
    cond do
      assigns.maximised == id -> {:ok, maximised: nil}
      Layout.panel(assigns.layout, id) -> {:ok, maximised: id}
      true -> :ignore
    end
  end

  def apply("restore", _, assigns), do: {:ok, maximised: nil, selected: assigns.selected}

  def apply("undo", _, assigns), do: step(assigns, :undo, :redo)
  def apply("redo", _, assigns), do: step(assigns, :redo, :undo)

  # Shows or hides a stream; `only` hides the panel's other streams, or shows them again.
  def apply("show_vis", %{"panel" => id, "all" => all}, assigns) when all in ["true", "false"] do
    shown = fn p -> %{p | vis: Enum.map(p.vis, &visible(&1, all == "true"))} end
    {:ok, layout: Layout.update(assigns.layout, id, shown)}
  end

  def apply("show_vis", %{"panel" => id, "index" => index} = params, assigns) do
    with {:ok, i} <- integer(to_string(index)),
         %{vis: vis} <- Layout.panel(assigns.layout, id),
         {:ok, one} <- fetch(vis, i) do
      layout = Layout.update(assigns.layout, id, &%{&1 | vis: shown(vis, i, one, params["only"])})
      {:ok, layout: layout}
    else
      _ -> :ignore
    end
  end

  def apply("select_panel", %{"id" => id}, assigns) do
    if Layout.panel(assigns.layout, id), do: {:ok, selected: {:panel, id}}, else: :ignore
  end

  def apply("remove_panel", %{"id" => id}, assigns) do
    selected = if assigns.selected == {:panel, id}, do: nil, else: assigns.selected
    {:ok, layout: Layout.remove(assigns.layout, id), selected: selected}
  end

  def apply("remove_vis", %{"panel" => id, "index" => index}, assigns) do
    with {:ok, i} <- integer(index), do: {:ok, layout: Layout.remove_vis(assigns.layout, id, i)}
  end

  def apply("move_row", %{"id" => id, "by" => by}, assigns) when by in ["1", "-1"],
    do: {:ok, layout: Layout.move(assigns.layout, id, String.to_integer(by))}

  # The panel was dropped on a position, or a key moved it one step.
  def apply("place_panel", %{"id" => id, "side" => side, "target" => target}, assigns)
      when is_map_key(@sides, side) and is_binary(id) and is_binary(target) do
    with {:ok, layout} <- Layout.place(assigns.layout, id, {@sides[side], target}),
         do: {:ok, layout: layout}
  end

  def apply("shift_panel", %{"id" => id, "way" => way}, assigns)
      when is_map_key(@ways, way) and is_binary(id) do
    with {:ok, layout} <- Layout.shift(assigns.layout, id, @ways[way]), do: {:ok, layout: layout}
  end

  def apply("resize_row", %{"id" => id, "height" => height}, assigns)
      when is_integer(height) and is_binary(id),
      do: {:ok, layout: Layout.resize(assigns.layout, id, height)}

  # Scales each line to its own minimum and maximum, or all lines to one axis again.
  def apply("axis", %{"panel" => id, "own" => "true"}, assigns), do: axis(assigns, id, :own)

  def apply("axis", %{"panel" => id, "_target" => ["own"]}, assigns), do: axis(assigns, id, nil)

  def apply("axis", %{"panel" => id, "min" => min, "max" => max}, assigns) do
    case {number(min), number(max)} do
      {{:ok, min}, {:ok, max}} when min < max -> axis(assigns, id, {min, max})
      {:empty, :empty} -> axis(assigns, id, nil)
      _ -> :ignore
    end
  end

  def apply("threshold", %{"panel" => id, "side" => side, "value" => value}, assigns) do
    case {Enum.find([:below, :above], &(Atom.to_string(&1) == side)), number(value)} do
      {nil, _} -> threshold(assigns, id, nil)
      {_, :empty} -> threshold(assigns, id, nil)
      {side, {:ok, value}} -> threshold(assigns, id, {side, value})
      _ -> :ignore
    end
  end

  def apply("prop", %{"panel" => id, "index" => index} = params, assigns) do
    with {:ok, i} <- integer(index),
         %{vis: vis} <- Layout.panel(assigns.layout, id),
         {:ok, one} <- fetch(vis, i),
         {:ok, entry} <- visualizer(assigns, one) do
      props = if is_map(params["props"]), do: params["props"], else: %{}
      options = Visualizer.options(entry, one.props)
      props = Enum.reduce(options, one.props, &put(&1, &2, props, params, entry))
      {:ok, layout: put_props(assigns.layout, id, i, props)}
    else
      _ -> :ignore
    end
  end

  def apply("prop_auto", %{"panel" => id, "index" => index, "key" => key}, assigns) do
    with {:ok, i} <- integer(index),
         %{vis: vis} <- Layout.panel(assigns.layout, id),
         {:ok, one} <- fetch(vis, i) do
      {:ok, layout: put_props(assigns.layout, id, i, Map.delete(one.props, key))}
    else
      _ -> :ignore
    end
  end

  def apply(_, _, _), do: :ignore

  defp step(assigns, from, to) do
    case Map.fetch!(assigns, from) do
      [layout | rest] ->
        {:ok, [{:layout, layout}, {from, rest}, {to, [assigns.layout | Map.fetch!(assigns, to)]}]}

      [] ->
        {:error, Error.new(:nothing, "there is nothing to #{from}")}
    end
  end

  defp shown(vis, i, one, "true") do
    alone? = vis |> List.delete_at(i) |> Enum.all?(&hidden?/1) and not hidden?(one)
    for {v, k} <- Enum.with_index(vis), do: visible(v, alone? or k == i)
  end

  defp shown(vis, i, one, _), do: List.replace_at(vis, i, visible(one, hidden?(one)))

  defp hidden?(vis), do: vis.props["visible"] == false
  defp visible(vis, true), do: %{vis | props: Map.delete(vis.props, "visible")}
  defp visible(vis, false), do: %{vis | props: Map.put(vis.props, "visible", false)}

  defp put_props(layout, id, i, props) do
    Layout.update(layout, id, fn p ->
      %{p | vis: List.update_at(p.vis, i, &%{&1 | props: props})}
    end)
  end

  # Only the field that changed is updated. Browsers omit unchecked boxes, so a missing boolean means false.
  defp put({key, option}, props, given, params, entry) do
    name = Atom.to_string(key)

    cond do
      params["_target"] not in [nil, ["props", name]] -> props
      option[:type] == :boolean -> Map.put(props, name, given[name] == "true")
      not is_binary(given[name]) -> props
      given[name] == "" -> Map.delete(props, name)
      true -> cast(props, name, given[name], entry)
    end
  end

  defp cast(props, name, text, entry) do
    case Visualizer.cast(entry, name, text) do
      {:ok, value} -> Map.put(props, name, value)
      :error -> props
    end
  end

  defp add(assigns, stream, entry, into) do
    with {:ok, layout, id} <- Layout.add(assigns.layout, stream, entry.id, entry.panel, into) do
      {:ok, layout: layout, selected: {:panel, id}}
    end
  end

  defp axis(assigns, id, axis),
    do: {:ok, layout: Layout.update(assigns.layout, id, &%{&1 | axis: axis})}

  defp threshold(assigns, id, value),
    do: {:ok, layout: Layout.update(assigns.layout, id, &%{&1 | threshold: value})}

  defp entries(assigns, stream) do
    case assigns.shapes do
      %{^stream => shape} ->
        {:ok, Visualizers.for_shape(shape, assigns.extra)}

      _ ->
        {:error, Error.new(:no_stream, "unknown stream: #{inspect(stream)}")}
    end
  end

  defp visualizer(assigns, vis) do
    shape = Map.get(assigns.shapes, vis.stream, :value)

    Visualizers.of(vis.viz, vis.path, shape, assigns.extra)
  end

  defp fetch(vis, i) when i >= 0, do: Enum.fetch(vis, i)
  defp fetch(_, _), do: :error

  defp integer(text) when is_binary(text) do
    case Integer.parse(text) do
      {i, ""} -> {:ok, i}
      _ -> :ignore
    end
  end

  defp integer(_), do: :ignore

  defp number(text) when is_binary(text) do
    case {String.trim(text), Float.parse(String.trim(text))} do
      {"", _} -> :empty
      {_, {x, ""}} -> {:ok, x}
      _ -> :error
    end
  end

  defp number(_), do: :error
end
