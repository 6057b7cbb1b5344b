defmodule Situ.Studio.Layout.Auto do
  @moduledoc """
  The layout a recording is first shown with, chosen by the kinds of its streams: pictures with their shapes, then
  sound, states, intervals and labels in lanes, maps of numbers as lines, then signals, those of one group in one panel.
  Pictures stand beside the timelines; where one is much wider than high, all are above them, the wide one in a row of
  its own. Pictures of class numbers (`Situ.Studio.Layout.Look`) are coloured, over a camera's picture if there is one.

      iex> audio = %Situ.Studio.StreamInfo{name: "Mic.Audio", shape: :audio}
      iex> level = %Situ.Studio.StreamInfo{name: "Mic.Level", shape: :signal}
      iex> layout = Situ.Studio.Layout.Auto.layout([level, audio])
      iex> for p <- layout.rows, do: {p.panel, Enum.map(p.vis, & &1.stream)}
      [{:plot, ["Mic.Audio"]}, {:plot, ["Mic.Level"]}]
  """
  alias Situ.Studio.{Layout, NaturalOrder, StreamInfo}
  alias Situ.Studio.Layout.Look

  @name "Automatic"
  @pictures 3
  @spaces 12
  @plots 8
  @lines 4
  @lanes 10
  @sounds 3
  @maps 3
  @many 2

  @doc "The name under which it is offered."
  @spec name() :: String.t()
  def name, do: @name

  @doc "The layout of these streams; `looks` tells, by their names, what the pictures of some look like."
  @spec layout([StreamInfo.t()], %{optional(String.t()) => Look.t()}) :: Layout.t()
  def layout(streams, looks \\ %{}) do
    by = Enum.group_by(streams, & &1.shape)
    of = fn shape -> Enum.sort_by(by[shape] || [], &NaturalOrder.key(&1.name)) end
    {classes, images} = Enum.split_with(of.(:image), &match?(%{classes: true}, looks[&1.name]))
    pictures = Enum.take(images ++ of.(:depth), @pictures)

    Layout.new(@name)
    |> space(of.(:space), of.(:frames))
    |> pictures(pictures, of.(:shapes))
    |> classes(classes, images)
    |> map(Enum.take(of.(:place), @maps))
    |> cells(Enum.take(of.(:bars), 1), "bars", :bars)
    |> each(Enum.take(of.(:audio), @sounds), "waveform", :plot)
    |> lanes(of |> laned() |> Enum.take(@lanes))
    |> each(Enum.take(of.(:signals), @maps), "lines", :plot)
    |> plots(of.(:signal))
    |> fallback(streams)
    |> fit(looks)
  end

  defp laned(of) do
    kinds = [boolean: "states", state: "states", states: "states", spans: "spans", text: "labels"]
    for {shape, viz} <- kinds, s <- of.(shape), do: {s, viz}
  end

  # Where there are timelines, too, pictures stand beside them, unless one needs the whole width.
  defp fit(layout, looks) do
    {cells, timelines} = Enum.split_with(layout.rows, & &1.row)
    wide? = fn cell -> Enum.any?(cell.vis, &Look.wide?(looks[&1.stream])) end

    cond do
      cells == [] or timelines == [] -> layout
      Enum.any?(cells, wide?) -> %{layout | rows: above(cells, wide?) ++ timelines}
      length(timelines) >= @many -> %{layout | beside: true}
      true -> %{layout | rows: above(cells, wide?) ++ timelines}
    end
  end

  # Wide ones in rows of their own, the others side by side.
  defp above(cells, wide?) do
    {wide, others} = Enum.split_with(cells, wide?)

    (Enum.map(wide, &[&1]) ++ Enum.chunk_every(others, @pictures))
    |> Enum.with_index(1)
    |> Enum.flat_map(fn {line, i} -> Enum.map(line, &%{&1 | row: "r#{i}"}) end)
  end

  # Everything in space in one panel, and the frames it is given in.
  defp space(layout, [], _), do: layout

  defp space(layout, streams, frames) do
    drawn =
      for(s <- Enum.take(streams, @spaces), do: {s, "space"}) ++
        for(s <- frames, do: {s, "frames"})

    {layout, _} =
      Enum.reduce(Enum.take(drawn, 2 * @spaces), {layout, ""}, fn {s, viz}, {layout, id} ->
        {:ok, layout, id} = Layout.add(layout, s.name, viz, :space, id, row: "r1")
        {layout, id}
      end)

    layout
  end

  # All places on one map.
  defp map(layout, streams) do
    {layout, _} =
      Enum.reduce(streams, {layout, ""}, fn s, {layout, id} ->
        {:ok, layout, id} = Layout.add(layout, s.name, "map", :map, id, row: "r1")
        {layout, id}
      end)

    layout
  end

  # Shapes go over the picture whose name shares most of its beginning.
  defp pictures(layout, [], _), do: layout

  defp pictures(layout, pictures, shapes) do
    {layout, ids} =
      Enum.reduce(pictures, {layout, %{}}, fn s, {layout, ids} ->
        viz = if s.shape == :depth, do: "depth", else: "image"
        row = "r#{map_size(ids) + 1}"
        {:ok, layout, id} = Layout.add(layout, s.name, viz, :image, "", row: row)
        {layout, Map.put(ids, s.name, id)}
      end)

    Enum.reduce(Enum.take(shapes, 8), layout, fn s, layout ->
      picture = Enum.max_by(pictures, &common(&1.name, s.name))
      {:ok, layout, _} = Layout.add(layout, s.name, "shapes", :image, ids[picture.name])
      layout
    end)
  end

  # Numbers of classes go over the camera's picture they belong to; alone they hide nothing.
  defp classes(layout, [], _), do: layout

  defp classes(layout, classes, []) do
    classes
    |> Enum.take(@pictures)
    |> Enum.with_index(1)
    |> Enum.reduce(layout, fn {s, i}, layout ->
      # as a picture, since masks would join the panel before
      {:ok, layout, id} = Layout.add(layout, s.name, "image", :image, "", row: "r#{i}")
      Layout.update(layout, id, &%{&1 | vis: Enum.map(&1.vis, fn vis -> colored(vis) end)})
    end)
  end

  defp classes(layout, classes, images) do
    shown = Enum.take(images, @pictures)

    Enum.reduce(Enum.take(classes, @pictures), layout, fn s, layout ->
      over = Enum.max_by(shown, &common(&1.name, s.name))
      panel = Enum.find(layout.rows, &Enum.any?(&1.vis, fn v -> v.stream == over.name end))
      {:ok, layout, _} = Layout.add(layout, s.name, "masks", :image, panel.id)
      layout
    end)
  end

  defp colored(vis), do: %{vis | viz: "masks", props: %{"opacity" => 100}}

  defp cells(layout, streams, viz, panel) do
    Enum.reduce(streams, layout, fn s, layout ->
      {:ok, layout, _} = Layout.add(layout, s.name, viz, panel, "", row: "r1")
      layout
    end)
  end

  defp each(layout, streams, viz, panel) do
    Enum.reduce(streams, layout, fn s, layout ->
      {:ok, layout, _} = Layout.add(layout, s.name, viz, panel, "")
      layout
    end)
  end

  defp lanes(layout, streams) do
    {layout, _} =
      Enum.reduce(streams, {layout, ""}, fn {s, viz}, {layout, id} ->
        {:ok, layout, id} = Layout.add(layout, s.name, viz, :lanes, id)
        {layout, id}
      end)

    layout
  end

  defp plots(layout, signals) do
    signals
    |> Enum.chunk_by(&group(&1.name))
    |> Enum.flat_map(&Enum.chunk_every(&1, @lines))
    |> Enum.take(@plots)
    |> Enum.reduce(layout, &plot/2)
  end

  defp plot(streams, layout) do
    {layout, _} =
      Enum.reduce(streams, {layout, ""}, fn s, {layout, id} ->
        {:ok, layout, id} = Layout.add(layout, s.name, "line", :plot, id)
        {layout, id}
      end)

    layout
  end

  # Something is shown of whatever there is.
  defp fallback(%Layout{rows: []} = layout, [_ | _] = streams) do
    first = streams |> Enum.sort_by(& &1.name) |> Enum.take(3)
    layout |> cells(first, "value", :value) |> each(first, "messages", :lanes)
  end

  defp fallback(layout, _), do: layout

  defp group(name) do
    case name |> String.split(".") |> Enum.drop(-1) do
      [] -> name
      parts -> parts
    end
  end

  defp common(a, b), do: common(String.to_charlist(a), String.to_charlist(b), 0)
  defp common([c | a], [c | b], n), do: common(a, b, n + 1)
  defp common(_, _, n), do: n
end
