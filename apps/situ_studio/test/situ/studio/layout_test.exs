defmodule Situ.Studio.LayoutTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Studio.{Layout, Layouts, Link, StreamInfo}
  alias Situ.Studio.Layout.{ImageLook, Places, Sizes, Tree}

  doctest Situ.Studio.Link

  @actions [:add, :remove, :resize, :remove_vis, :threshold, :place, :shift] ++
             [:beside, :tab]
  @panels [:plot, :lanes, :image, :value, :bars]

  property "any edited layout is restored from its file and its link" do
    forall actions <- list({one_of(@actions), integer(1, 12), one_of(@panels)}) do
      layout = Enum.reduce(actions, Layout.new("x"), &edit/2)

      assert Layout.Json.parse_json(Layout.Json.to_json(layout)) == {:ok, renumber(layout)}
      assert Link.decode(Link.encode(layout)) == {:ok, renumber(layout)}
      # Every panel has one place.
      assert Enum.map(layout.panels, & &1.id) == Tree.panel_ids(layout.tree)
      assert simplest?(layout.tree)
      assert layout.tree == nil or layout.tree.size == nil
    end
  end

  # Rows, columns and tabs have unique ids and at least two parts, which are not of the same kind.
  defp simplest?(nil), do: true

  defp simplest?(tree) do
    splits = list_splits(tree)
    ids = Enum.map(splits, & &1.id)

    ids == Enum.uniq(ids) and
      Enum.all?(splits, fn %{way: way, parts: parts} ->
        length(parts) > 1 and Enum.all?(parts, &(&1.way != way)) and
          (way != :tabs or Enum.all?(parts, &(&1.way == :panel)))
      end)
  end

  defp list_splits(nil), do: []
  defp list_splits(%Tree{way: :panel}), do: []
  defp list_splits(tree), do: [tree | Enum.flat_map(tree.parts, &list_splits/1)]

  property "the file keeps the compared recording and its time offset" do
    forall {bytes, offset} <- {binary(), integer()} do
      id = Base.url_encode64(bytes)

      for offset <- [offset, offset * 1_000_000_007, 1_700_000_000_000_000_001] do
        layout = %{Layout.new("x") | compared: {id, offset}}
        assert Layout.Json.parse_json(Layout.Json.to_json(layout)) == {:ok, layout}
      end
    end
  end

  test "ignores an invalid comparison" do
    for compared <- [
          ~s(7),
          ~s({"with": "a"}),
          ~s({"with": 1, "offset": "1"}),
          ~s({"with": "a", "offset": "1e9"})
        ] do
      json = ~s({"version": 1, "name": "x", "panels": [], "compared": #{compared}})
      assert {:ok, %{compared: nil}} = Layout.Json.parse_json(json)
    end
  end

  # The next panel number is derived from the existing panels.
  defp renumber(layout) do
    numbers = for %{id: "p" <> n} <- layout.panels, do: String.to_integer(n)
    %{layout | next: Enum.max(numbers, fn -> 0 end) + 1}
  end

  defp edit({:add, n, panel}, layout) do
    case Layout.add_stream(layout, "S#{n}", "line", panel, "p#{n}") do
      {:ok, layout, _} -> layout
      {:error, %{code: :full}} -> layout
    end
  end

  defp edit({:remove, n, _}, layout), do: Layout.remove_panel(layout, "p#{n}")
  defp edit({:remove_vis, n, _}, layout), do: Layout.remove_vis(layout, "p#{n}", 0)

  defp edit({:threshold, n, _}, layout) do
    side = if rem(n, 2) == 0, do: :below, else: :above
    Layout.update_panel(layout, "p#{n}", &%{&1 | threshold: {side, n / 3}})
  end

  defp edit({:resize, n, _}, layout) do
    layout
    |> Layout.resize_part("p#{n}", n * 100 - 200)
    |> Layout.resize_part("s#{n}", n * 100 - 200)
    |> Layout.resize_row("s#{n}", [n * 7.3, 20])
  end

  defp edit({:beside, _, _}, layout), do: Layout.toggle_side(layout)
  defp edit({:tab, n, _}, layout), do: Layout.select_tab(layout, "p#{n}")

  defp edit({:place, n, panel}, layout) do
    side = Enum.at([:above, :below, :left, :right, :tab], rem(n, 5))
    targets = ["all", "s1", "s#{n}", Atom.to_string(panel), "p#{rem(n * 5, 12) + 1}"]
    target = Enum.at(targets, rem(n * 7 + byte_size(Atom.to_string(panel)), 5))
    same_panels(layout, Layout.move_panel(layout, "p#{n}", {side, target}))
  end

  defp edit({:shift, n, _}, layout),
    do:
      same_panels(
        layout,
        Layout.shift_panel(layout, "p#{n}", Enum.at([:up, :down, :left, :right], rem(n, 4)))
      )

  # Moving neither loses nor creates panels.
  defp same_panels(before, {:ok, layout}) do
    assert Enum.sort(layout.panels) == Enum.sort(before.panels)
    layout
  end

  defp same_panels(before, {:error, %{code: :full}}), do: before

  @tag :tmp_dir
  test "reports files that are not layouts with the reason, and ignores other versions",
       %{tmp_dir: dir} do
    panel = %{"id" => "p1", "panel" => "plot", "vis" => []}
    text = &Situ.JSON.encode(%{"version" => &1, "name" => &2, "panels" => &3})
    File.write!(Path.join(dir, "a.json"), "{ no json")
    File.write!(Path.join(dir, "b.json"), text.(99, "Future", []))
    File.write!(Path.join(dir, "c.json"), text.(1, "Twice", [panel, panel]))
    File.write!(Path.join(dir, "d.json"), text.(1, "Good", [panel]))
    assert Layouts.list_names(dir) == ["Good"]

    assert for({path, error} <- Layouts.list_problems(dir), do: {Path.basename(path), error.what}) ==
             [
               {"a.json", "this file is not a layout: it is not JSON"},
               {"b.json",
                "this file is not a layout: it has version 99, but this studio reads up to 2"},
               {"c.json", "this file is not a layout: two panels have the id p1"}
             ]

    assert {:error, %{code: :bad_layout}} = Layouts.load(dir, "Future")
    assert {:error, %{code: :no_layout}} = Layouts.load(dir, "None")
  end

  describe "moving panels" do
    # The layout is a row of A, B and C above the plots P and Q.
    setup do
      streams = [{"A", :value}, {"B", :value}, {"C", :value}, {"P", :plot}, {"Q", :lanes}]

      layout =
        Enum.reduce(streams, Layout.new(""), fn {stream, panel}, layout ->
          {:ok, layout, _} = Layout.add_stream(layout, stream, "x", panel, "")
          layout
        end)

      {:ok, layout: layout}
    end

    defp id(layout, stream), do: Enum.find(layout.panels, &(hd(&1.vis).stream == stream)).id

    defp streams({:ok, layout}), do: streams(layout)
    defp streams(layout), do: named(Tree.to_list(layout.tree), layout)

    defp named("p" <> _ = id, layout), do: hd(Layout.find_panel(layout, id).vis).stream
    defp named([way | parts], layout), do: [way | Enum.map(parts, &named(&1, layout))]

    defp move(layout, stream, side, "all"),
      do: Layout.move_panel(layout, id(layout, stream), {side, "all"})

    defp move(layout, stream, side, target),
      do: Layout.move_panel(layout, id(layout, stream), {side, id(layout, target)})

    test "splits any panel in both directions", %{layout: l} do
      assert streams(l) == [:column, [:row, "A", "B", "C"], "P", "Q"]

      assert streams(move(l, "Q", :left, "P")) == [
               :column,
               [:row, "A", "B", "C"],
               [:row, "Q", "P"]
             ]

      assert streams(move(l, "A", :below, "C")) ==
               [:column, [:row, "B", [:column, "C", "A"]], "P", "Q"]

      assert streams(move(l, "A", :left, "all")) == [
               :row,
               "A",
               [:column, [:row, "B", "C"], "P", "Q"]
             ]

      assert streams(move(l, "A", :below, "P")) == [:column, [:row, "B", "C"], "P", "A", "Q"]
    end

    test "puts panels in tabs, and takes them out again", %{layout: l} do
      {:ok, l} = move(l, "B", :tab, "A")
      assert streams(l) == [:column, [:row, [:tabs, "A", "B"], "C"], "P", "Q"]

      assert [%Tree{way: :tabs, active: active}] =
               for({t, _} <- Tree.ancestors(l.tree, id(l, "A")), t.way == :tabs, do: t)

      assert active == id(l, "B")
      {:ok, three} = move(l, "P", :tab, "B")
      assert streams(three) == [:column, [:row, [:tabs, "A", "B", "P"], "C"], "Q"]

      # A side of a tab is a side of all tabs.
      assert streams(move(three, "C", :above, "A")) == [:column, "C", [:tabs, "A", "B", "P"], "Q"]

      assert streams(move(l, "A", :right, "P")) == [
               :column,
               [:row, "B", "C"],
               [:row, "P", "A"],
               "Q"
             ]

      assert streams(Layout.remove_panel(l, id(l, "B"))) == [:column, [:row, "A", "C"], "P", "Q"]
    end

    test "moves a panel by keys: past its neighbor, out of its row, and to the side of all", %{
      layout: l
    } do
      shift = &streams(Layout.shift_panel(&1, id(&1, &2), &3))
      assert shift.(l, "A", :right) == [:column, [:row, "B", "A", "C"], "P", "Q"]
      assert shift.(l, "B", :up) == [:column, "B", [:row, "A", "C"], "P", "Q"]
      assert shift.(l, "B", :down) == [:column, [:row, "A", "C"], "B", "P", "Q"]
      assert shift.(l, "P", :up) == [:column, "P", [:row, "A", "B", "C"], "Q"]
      assert shift.(l, "P", :left) == [:row, "P", [:column, [:row, "A", "B", "C"], "Q"]]
      assert shift.(l, "C", :right) == [:row, [:column, [:row, "A", "B"], "P", "Q"], "C"]

      # A row of two is gone without one of them.
      l = Layout.remove_panel(l, id(l, "C"))
      assert shift.(l, "A", :down) == [:column, "B", "A", "P", "Q"]
    end

    test "leaves panels that cannot move", %{layout: l} do
      assert Layout.shift_panel(l, id(l, "Q"), :down) == {:ok, l}
      assert Layout.shift_panel(l, "p99", :up) == {:ok, l}
      assert Layout.move_panel(l, "p99", {:above, "p1"}) == {:ok, l}
      assert Layout.move_panel(l, "p1", {:above, "s99"}) == {:ok, l}
      assert Layout.move_panel(l, "p1", {:above, "p1"}) == {:ok, l}
    end

    test "keeps the sizes that the user set", %{layout: l} do
      [%Tree{way: :row, id: row} | _] = l.tree.parts
      l = l |> Layout.resize_part(row, 500) |> Layout.resize_row(row, [60, 20, 20])
      assert [60.0, 20.0, 20.0] == Sizes.row_shares(l, hd(l.tree.parts))

      # A new part takes half of the width of the one next to it.
      {:ok, l} = move(l, "P", :right, "A")
      assert [30.0, 30.0, 20.0, 20.0] == Sizes.row_shares(l, hd(l.tree.parts))
      assert "flex: 0 0 500px" == Sizes.height_style(l, hd(l.tree.parts), %{})
      l = l |> Layout.resize_part(row, nil) |> Layout.resize_row(row, nil)
      assert Enum.all?(Sizes.row_shares(l, hd(l.tree.parts)), &(&1 in [25.0]))
    end

    test "reports a full row, and too many splits", %{layout: l} do
      {l, _} =
        Enum.reduce(1..6, {l, nil}, fn i, {l, _} ->
          {:ok, l, id} = Layout.add_stream(l, "X#{i}", "x", :plot, "")
          {l, Layout.move_panel(l, id, {:left, id(l, "A")})}

          {:ok, l} =
            with {:error, _} <- Layout.move_panel(l, id, {:left, id(l, "A")}), do: {:ok, l}

          {l, nil}
        end)

      assert {:error, %{code: :full}} = move(l, "Q", :left, "A")
    end
  end

  test "toggles between images next to the timelines and above them" do
    streams = [{"A", :image}, {"B", :space}, {"P", :plot}, {"Q", :plot}]

    layout =
      Enum.reduce(streams, Layout.new(""), fn {stream, panel}, layout ->
        {:ok, layout, _} = Layout.add_stream(layout, stream, "x", panel, "")
        layout
      end)

    beside = Layout.toggle_side(layout)
    assert Tree.to_list(beside.tree) == [:row, [:column, "p1", "p2"], [:column, "p3", "p4"]]
    assert Places.has_side?(beside.tree, Layout.timeline_ids(beside))

    assert Tree.to_list(Layout.toggle_side(beside).tree) == [
             :column,
             [:row, "p1", "p2"],
             "p3",
             "p4"
           ]
  end

  property "reading a layout or a link never raises for any bytes" do
    forall bytes <- binary() do
      assert {:error, %Situ.Error{}} = Layout.Json.parse_json(bytes)
      assert {:error, %Situ.Error{}} = Link.decode(bytes)
    end
  end

  test "a link cannot expand into a large text" do
    bomb = Base.url_encode64(:zlib.zip(:binary.copy("a", 5_000_000)), padding: false)
    assert byte_size(bomb) < 8_000
    assert {:error, %{code: :bad_link}} = Link.decode(bomb)
  end

  describe "files" do
    @describetag :tmp_dir

    test "are saved, listed, loaded and deleted by any name", %{tmp_dir: dir} do
      names = ["Mine", "mine", "../../etc/passwd", "a/b", "Größe 1", "<b>"]
      for name <- names, do: assert({:ok, _} = Layouts.save(dir, Layout.new(name)))
      assert Layouts.list_names(dir) == Enum.sort(names)
      assert dir |> Path.join("*") |> Path.wildcard() |> length() == length(names)
      assert {:ok, %Layout{name: "a/b"}} = Layouts.load(dir, "a/b")
      :ok = Layouts.delete(dir, "a/b")
      assert {:error, %{code: :no_layout}} = Layouts.load(dir, "a/b")
    end

    test "that are not layouts are ignored, and empty names are rejected", %{tmp_dir: dir} do
      File.write!(Path.join(dir, "x.json"), "{}")
      assert Layouts.list_names(dir) == []
      assert {:error, %{code: :bad_name}} = Layouts.save(dir, Layout.new("  "))
      assert {:error, %{code: :not_saved}} = Layouts.save("/proc/nothing", Layout.new("a"))
    end
  end

  test "rejects a layout of another version or with invalid panels, with the reason" do
    assert {:error, %{why: nil, what: what}} =
             Layout.Json.parse_json(~s({"version": 9, "name": "x", "panels": []}))

    assert what =~ "version 9"

    for panel <- [
          ~s({"id": "p1", "panel": "shell", "vis": []}),
          ~s({"id": "../p", "panel": "plot", "vis": []}),
          ~s({"id": "p1", "panel": "plot", "height": -5, "vis": []}),
          ~s({"id": "p1", "panel": "plot", "vis": [{"viz": 1, "stream": "a"}]}),
          "17"
        ] do
      json = ~s({"version": 1, "name": "x", "panels": [#{panel}]})
      assert {:error, %{code: :bad_layout}} = Layout.Json.parse_json(json)
    end
  end

  test "the automatic layout shows any stream, and images with their shapes" do
    shapes =
      [:signal, :boolean, :state, :text, :audio, :image, :depth, :shapes, :bars, :value] ++
        [:signals, :states, :spans]

    for shape <- shapes do
      layout = Layout.Auto.build_layout([%StreamInfo{name: "A.b", shape: shape}])
      assert layout.panels != [], "nothing of a #{shape}"
    end

    layout =
      Layout.Auto.build_layout([
        %StreamInfo{name: "Left.Image", shape: :image},
        %StreamInfo{name: "Right.Image", shape: :image},
        %StreamInfo{name: "Right.Faces", shape: :shapes}
      ])

    assert [["Left.Image"], ["Right.Image", "Right.Faces"]] =
             for(p <- layout.panels, do: Enum.map(p.vis, & &1.stream))

    assert Layout.Auto.build_layout([]).panels == []
  end

  test "puts a wide image in its own row above the timelines, and others side by side" do
    streams = [
      %StreamInfo{name: "Pan", shape: :image},
      %StreamInfo{name: "Left", shape: :image},
      %StreamInfo{name: "Right", shape: :image},
      %StreamInfo{name: "Sound", shape: :audio},
      %StreamInfo{name: "Level", shape: :signal}
    ]

    looks = %{
      "Pan" => %ImageLook{width: 1600, height: 400},
      "Left" => %ImageLook{width: 640, height: 480},
      "Right" => %ImageLook{width: 640, height: 480}
    }

    layout = Layout.Auto.build_layout(streams, looks)
    assert streams(layout) == [:column, "Pan", [:row, "Left", "Right"], "Sound", "Level"]

    # Three images of the usual shape are larger side by side than one below the other.
    layout = Layout.Auto.build_layout(streams, Map.delete(looks, "Pan"))
    assert streams(layout) == [:column, [:row, "Left", "Pan", "Right"], "Sound", "Level"]
  end

  test "puts a tall image next to the timelines" do
    streams = [
      %StreamInfo{name: "Phone", shape: :image},
      %StreamInfo{name: "Sound", shape: :audio},
      %StreamInfo{name: "Level", shape: :signal}
    ]

    looks = %{"Phone" => %ImageLook{width: 720, height: 1280}}
    layout = Layout.Auto.build_layout(streams, looks)
    assert streams(layout) == [:row, "Phone", [:column, "Sound", "Level"]]
    assert hd(layout.panels).aspect == 0.56
  end

  test "cells share the width of a row by their shapes" do
    streams = [
      %StreamInfo{name: "Camera", shape: :image},
      %StreamInfo{name: "Way", shape: :place},
      %StreamInfo{name: "Speed", shape: :signal}
    ]

    looks = %{"Camera" => %ImageLook{width: 1920, height: 1080}}
    layout = Layout.Auto.build_layout(streams, looks)
    assert streams(layout) == [:column, [:row, "Camera", "Way"], "Speed"]
    [cells | _] = layout.tree.parts
    assert Sizes.height_style(layout, cells, %{}) =~ "aspect-ratio: 3.08"
    assert Sizes.row_shares(layout, cells) == [57.8, 42.2]

    assert {:ok, ^layout} = layout |> Layout.Json.to_json() |> Layout.Json.parse_json()
  end

  property "arranging keeps every panel, and gives cells unique rows of at most three" do
    forall ratios <- list(integer(1, 40)) do
      streams =
        for {_, i} <- Enum.with_index(ratios), do: %StreamInfo{name: "I#{i}", shape: :image}

      looks =
        for {r, i} <- Enum.with_index(ratios),
            into: %{},
            do: {"I#{i}", %ImageLook{width: r, height: 10}}

      plots = [%StreamInfo{name: "A", shape: :audio}, %StreamInfo{name: "L", shape: :signal}]
      shown = streams |> Enum.map(& &1.name) |> Enum.take(9)

      for timelines <- [[], tl(plots), plots] do
        layout = Layout.Auto.build_layout(streams ++ timelines, looks)
        drawn = for panel <- layout.panels, do: hd(panel.vis).stream
        assert Enum.sort(drawn) == Enum.sort(shown ++ Enum.map(timelines, & &1.name))
        rows = for %{way: :row} = row <- list_splits(layout.tree), do: length(row.parts)
        assert Enum.all?(rows, &(&1 <= 3))
      end
    end
  end

  test "draws signals of different magnitudes in different panels" do
    streams =
      for n <- ["Arm.Angle", "Arm.Tilt", "Arm.Torque"], do: %StreamInfo{name: n, shape: :signal}

    ranges = %{"Arm.Angle" => {-1, 1}, "Arm.Tilt" => {0, 0.5}, "Arm.Torque" => {0, 1.0e12}}

    assert [["Arm.Angle", "Arm.Tilt"], ["Arm.Torque"]] =
             for(
               p <- Layout.Auto.build_layout(streams, %{}, ranges).panels,
               do: Enum.map(p.vis, & &1.stream)
             )

    # A constant stream is a line anywhere, but it must not flatten the others.
    constant = Map.put(ranges, "Arm.Tilt", {20, 20})
    assert length(Layout.Auto.build_layout(streams, %{}, constant).panels) == 3
  end

  test "colors images of class numbers: over a camera's image, or alone" do
    streams = for n <- ["Cam.Image", "Cam.Classes"], do: %StreamInfo{name: n, shape: :image}
    looks = %{"Cam.Classes" => %ImageLook{width: 640, height: 480, classes: true}}

    assert [%{vis: [%{viz: "image", stream: "Cam.Image"}, %{viz: "masks"}]}] =
             Layout.Auto.build_layout(streams, looks).panels

    alone = for n <- ["A", "B"], do: %StreamInfo{name: n, shape: :image}
    looks = Map.new(["A", "B"], &{&1, %ImageLook{width: 640, height: 480, classes: true}})

    assert [[%{viz: "masks", stream: "A"}], [%{viz: "masks", stream: "B"}]] =
             for(p <- Layout.Auto.build_layout(alone, looks).panels, do: p.vis)
  end

  test "a dark or uniform image is not an image of class numbers" do
    :rand.seed(:exsss, {1, 2, 3})
    noise = for _ <- 1..4_800, into: <<>>, do: <<:rand.uniform(12)>>
    even = :binary.copy(<<7>>, 4_800)
    labels = for y <- 0..59, x <- 0..79, into: <<>>, do: <<div(x, 20) + div(y, 30) * 4>>

    look =
      &ImageLook.detect_look(Situ.Image.new!(width: 80, height: 60, format: :gray8, data: &1))

    assert Enum.map([noise, even, labels], &look.(&1).classes) == [false, false, true]

    assert ImageLook.detect_look("no picture") == nil
  end

  test "decodes an image of unknown size to determine its look" do
    {:ok, jpeg} = Situ.ImageOps.encode_jpeg(Situ.Image.new_filled(64, 32, :rgb24, [9, 9, 9]))
    assert ImageLook.ratio(ImageLook.detect_look(%{jpeg | width: 0, height: 0})) == 2.0
    assert ImageLook.detect_look(%{jpeg | width: 0, height: 0, data: "broken"}) == nil
  end

  test "the automatic layout of a talk puts speakers in lanes and openings in lines" do
    streams = [
      %StreamInfo{name: "Talk.Pictures", shape: :image},
      %StreamInfo{name: "Talk.Faces", shape: :shapes},
      %StreamInfo{name: "Talk.Sound", shape: :audio},
      %StreamInfo{name: "Talk.Speaking", shape: :states, keys: ["0", "1"]},
      %StreamInfo{name: "Talk.Voice.Segments", shape: :spans},
      %StreamInfo{name: "Talk.Mouths.Opening", shape: :signals},
      %StreamInfo{name: "Talk.Voice.Probability", shape: :signal}
    ]

    layout = Layout.Auto.build_layout(streams)

    assert [
             {:image, ["image", "shapes"]},
             {:plot, ["waveform"]},
             {:lanes, ["states", "spans"]},
             {:plot, ["lines"]},
             {:plot, ["line"]}
           ] = for(p <- layout.panels, do: {p.panel, Enum.map(p.vis, & &1.viz)})

    # The page is 720 pixels high, and its bars and the navigator use 118 of them.
    assert Sizes.least_height(layout, layout.tree, %{"Talk.Speaking" => 2}) <= 720 - 118
  end

  describe "more panels than the window holds" do
    test "plots share places as tabs, and none is left out" do
      streams = for i <- 1..40, do: %StreamInfo{name: "Part#{i}.Level", shape: :signal}
      layout = Layout.Auto.build_layout(streams)
      assert %Tree{way: :column, parts: parts} = layout.tree
      assert length(parts) == 5
      assert Enum.all?(parts, &(&1.way == :tabs and &1.active == hd(&1.parts).id))
      # In order, so that neighbors are in the same tabs.
      shown = for panel <- layout.panels, v <- panel.vis, do: v.stream
      assert shown == streams |> Enum.map(& &1.name) |> Enum.take(24)
      assert Tree.panel_ids(layout.tree) == Enum.map(layout.panels, & &1.id)
      least = for part <- parts, do: Sizes.least_height(layout, part, %{})
      assert Enum.sum(least) <= elem(Sizes.usual_size(), 1)
    end

    test "a few plots have a place each" do
      streams = for i <- 1..7, do: %StreamInfo{name: "Part#{i}.Level", shape: :signal}
      assert %Tree{parts: parts} = Layout.Auto.build_layout(streams).tree
      assert Enum.map(parts, & &1.way) == List.duplicate(:panel, 7)
    end

    test "nine images have three places, and lanes keep theirs" do
      images = for i <- 1..9, do: %StreamInfo{name: "Camera#{i}", shape: :image}
      looks = Map.new(images, &{&1.name, %ImageLook{width: 16, height: 10}})
      state = %StreamInfo{name: "State", shape: :state}
      layout = Layout.Auto.build_layout([state | images], looks)
      assert %Tree{way: :column, parts: [%Tree{way: :row} = row, lanes]} = layout.tree

      assert for(tabs <- row.parts, do: {tabs.way, length(tabs.parts)}) ==
               List.duplicate({:tabs, 3}, 3)

      assert Layout.find_panel(layout, lanes.id).panel == :lanes
      # A row with tabs has the shape of the panels in front.
      assert Sizes.height_style(layout, row, %{}) =~ "aspect-ratio: 4.8"
      assert Sizes.row_shares(layout, row) == [33.3, 33.3, 33.3]
    end

    test "a view of space is never in tabs" do
      images = for i <- 1..9, do: %StreamInfo{name: "Camera#{i}", shape: :image}
      layout = Layout.Auto.build_layout([%StreamInfo{name: "Cloud", shape: :space} | images])
      space = Enum.find(layout.panels, &(&1.panel == :space))

      refute Enum.any?(Tree.ancestors(layout.tree, space.id), fn {part, _} ->
               part.way == :tabs
             end)
    end
  end
end
