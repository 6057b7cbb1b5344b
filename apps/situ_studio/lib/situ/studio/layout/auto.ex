defmodule Situ.Studio.Layout.Auto do
  @moduledoc false
  # Chooses the layout in which a recording is first shown, by the kinds of its streams. Images
  # with their shapes come first, then audio, then lanes of states, intervals and labels, then
  # maps of numbers as lines, then signals, with one panel per group.
  #
  # `Situ.Studio.Layout.Arrangement` decides where images and other cells are. Images of class
  # numbers (`Situ.Studio.Layout.ImageLook`) are coloured, and are drawn over a camera image if
  # there is one. Signals share an axis if they belong together and have similar ranges
  # (`Situ.Studio.Layout.SignalRange`).
  alias Situ.Studio.{Layout, NaturalOrder, StreamInfo}
  alias Situ.Studio.Layout.{Arrangement, ImageLook, SignalRange}

  @name "Automatic"
  @pictures 9
  @spaces 12
  @plots 24
  @lines 4
  @lanes 10
  @sounds 3
  @maps 3

  @doc "Returns the display name of the layout."
  @spec layout_name() :: String.t()
  def layout_name, do: @name

  @doc """
  Builds the layout of these streams. `looks` describes the images of some streams, and `ranges`
  the values of some signals, by stream name.

      iex> audio = %Situ.Studio.StreamInfo{name: "Mic.Audio", shape: :audio}
      iex> level = %Situ.Studio.StreamInfo{name: "Mic.Level", shape: :signal}
      iex> layout = Situ.Studio.Layout.Auto.build_layout([level, audio])
      iex> for p <- layout.panels, do: {p.panel, Enum.map(p.vis, & &1.stream)}
      [{:plot, ["Mic.Audio"]}, {:plot, ["Mic.Level"]}]
  """
  @spec build_layout(
          [StreamInfo.t()],
          %{optional(String.t()) => ImageLook.t()},
          %{optional(String.t()) => SignalRange.t()}
        ) :: Layout.t()
  def build_layout(streams, looks \\ %{}, ranges \\ %{}) do
    by = Enum.group_by(streams, & &1.shape)
    of = fn shape -> Enum.sort_by(by[shape] || [], &NaturalOrder.sort_key(&1.name)) end
    {classes, images} = Enum.split_with(of.(:image), &match?(%{classes: true}, looks[&1.name]))
    pictures = Enum.take(images ++ of.(:depth), @pictures)

    Layout.new(@name)
    |> add_space_panel(of.(:space), of.(:frames))
    |> add_image_panels(pictures, of.(:shapes))
    |> add_class_masks(classes, images)
    |> add_map_panel(Enum.take(of.(:place), @maps))
    |> add_cell_panels(Enum.take(of.(:bars), 1), "bars", :bars)
    |> add_timeline_panels(Enum.take(of.(:audio), @sounds), "waveform", :plot)
    |> add_lanes_panel(of |> lane_streams() |> Enum.take(@lanes))
    |> add_timeline_panels(Enum.take(of.(:signals), @maps), "lines", :plot)
    |> add_plot_panels(of.(:signal), ranges)
    |> add_fallback_panels(streams)
    |> arrange_panels(looks)
  end

  defp lane_streams(of) do
    kinds = [boolean: "states", state: "states", states: "states", spans: "spans", text: "labels"]
    for {shape, viz} <- kinds, s <- of.(shape), do: {s, viz}
  end

  # The content of a cell is as wide as its first image of a known size.
  defp arrange_panels(layout, looks) do
    ratios =
      for panel <- layout.panels,
          %ImageLook{} = look <- Enum.map(panel.vis, &looks[&1.stream]) |> Enum.take(1),
          into: %{},
          do: {panel.id, ImageLook.ratio(look)}

    Arrangement.arrange(layout, ratios)
  end

  # All spatial streams and their frames of reference share one panel.
  defp add_space_panel(layout, [], _), do: layout

  defp add_space_panel(layout, streams, frames) do
    drawn =
      for(s <- Enum.take(streams, @spaces), do: {s, "space"}) ++
        for(s <- frames, do: {s, "frames"})

    {layout, _} =
      Enum.reduce(Enum.take(drawn, 2 * @spaces), {layout, ""}, fn {s, viz}, {layout, id} ->
        {:ok, layout, id} = Layout.add_stream(layout, s.name, viz, :space, id)
        {layout, id}
      end)

    layout
  end

  # All positions are on one map.
  defp add_map_panel(layout, streams) do
    {layout, _} =
      Enum.reduce(streams, {layout, ""}, fn s, {layout, id} ->
        {:ok, layout, id} = Layout.add_stream(layout, s.name, "map", :map, id)
        {layout, id}
      end)

    layout
  end

  # Shapes are drawn over the image whose name has the longest prefix in common.
  defp add_image_panels(layout, [], _), do: layout

  defp add_image_panels(layout, pictures, shapes) do
    {layout, ids} =
      Enum.reduce(pictures, {layout, %{}}, fn s, {layout, ids} ->
        viz = if s.shape == :depth, do: "depth", else: "image"
        {:ok, layout, id} = Layout.add_stream(layout, s.name, viz, :image, "")
        {layout, Map.put(ids, s.name, id)}
      end)

    Enum.reduce(Enum.take(shapes, 8), layout, fn s, layout ->
      picture = Enum.max_by(pictures, &common_prefix_length(&1.name, s.name))
      {:ok, layout, _} = Layout.add_stream(layout, s.name, "shapes", :image, ids[picture.name])
      layout
    end)
  end

  # Class numbers are drawn over the camera image that they belong to. Without one they are opaque.
  defp add_class_masks(layout, [], _), do: layout

  defp add_class_masks(layout, classes, []) do
    classes
    |> Enum.take(@pictures)
    |> Enum.reduce(layout, fn s, layout ->
      # Added as an image first, because masks would join the previous panel.
      {:ok, layout, id} = Layout.add_stream(layout, s.name, "image", :image, "")

      Layout.update_panel(
        layout,
        id,
        &%{&1 | vis: Enum.map(&1.vis, fn vis -> as_opaque_masks(vis) end)}
      )
    end)
  end

  defp add_class_masks(layout, classes, images) do
    shown = Enum.take(images, @pictures)

    Enum.reduce(Enum.take(classes, @pictures), layout, fn s, layout ->
      over = Enum.max_by(shown, &common_prefix_length(&1.name, s.name))
      panel = Enum.find(layout.panels, &Enum.any?(&1.vis, fn v -> v.stream == over.name end))
      {:ok, layout, _} = Layout.add_stream(layout, s.name, "masks", :image, panel.id)
      layout
    end)
  end

  defp as_opaque_masks(vis), do: %{vis | viz: "masks", props: %{"opacity" => 100}}

  defp add_cell_panels(layout, streams, viz, panel) do
    Enum.reduce(streams, layout, fn s, layout ->
      {:ok, layout, _} = Layout.add_stream(layout, s.name, viz, panel, "")
      layout
    end)
  end

  defp add_timeline_panels(layout, streams, viz, panel) do
    Enum.reduce(streams, layout, fn s, layout ->
      {:ok, layout, _} = Layout.add_stream(layout, s.name, viz, panel, "")
      layout
    end)
  end

  defp add_lanes_panel(layout, streams) do
    {layout, _} =
      Enum.reduce(streams, {layout, ""}, fn {s, viz}, {layout, id} ->
        {:ok, layout, id} = Layout.add_stream(layout, s.name, viz, :lanes, id)
        {layout, id}
      end)

    layout
  end

  defp add_plot_panels(layout, signals, ranges) do
    signals
    |> Enum.chunk_by(&stream_group(&1.name))
    |> Enum.flat_map(&SignalRange.group_similar(&1, ranges, fn s -> s.name end))
    |> Enum.flat_map(&Enum.chunk_every(&1, @lines))
    |> Enum.take(@plots)
    |> Enum.reduce(layout, &add_plot_panel/2)
  end

  defp add_plot_panel(streams, layout) do
    {layout, _} =
      Enum.reduce(streams, {layout, ""}, fn s, {layout, id} ->
        {:ok, layout, id} = Layout.add_stream(layout, s.name, "line", :plot, id)
        {layout, id}
      end)

    layout
  end

  # Shows the first streams if no other panel was added.
  defp add_fallback_panels(%Layout{panels: []} = layout, [_ | _] = streams) do
    first = streams |> Enum.sort_by(& &1.name) |> Enum.take(3)

    layout
    |> add_cell_panels(first, "value", :value)
    |> add_timeline_panels(first, "messages", :lanes)
  end

  defp add_fallback_panels(layout, _), do: layout

  defp stream_group(name) do
    case name |> String.split(".") |> Enum.drop(-1) do
      [] -> name
      parts -> parts
    end
  end

  defp common_prefix_length(a, b),
    do: count_common(String.to_charlist(a), String.to_charlist(b), 0)

  defp count_common([c | a], [c | b], n), do: count_common(a, b, n + 1)
  defp count_common(_, _, n), do: n
end
