defmodule Situ.Studio.Web.PanelConfig do
  @moduledoc false
  # Describes panels to the page's script: how each stream is drawn, under which name and in which color. Pure.
  alias Situ.Studio.{Layout, StreamColors, Visualizer, Visualizers}
  alias Situ.Studio.Recordings.Comparison

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

  @doc "Shortens each name to its last segment if that distinguishes the panel's streams."
  @spec short_names([Layout.Visualization.t()]) :: [String.t()]
  def short_names(vis), do: Enum.zip_with(vis, unmarked_names(vis), &mark_compared/2)

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
