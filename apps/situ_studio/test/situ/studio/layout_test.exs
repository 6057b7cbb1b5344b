defmodule Situ.Studio.LayoutTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Studio.{Layout, Layouts, Link, StreamInfo}
  alias Situ.Studio.Layout.ImageLook

  doctest Situ.Studio.Link

  @actions [:add, :remove, :resize, :move, :remove_vis, :threshold, :place, :shift]
  @panels [:plot, :lanes, :image, :value, :bars]

  property "any edited layout is restored from its file and its link" do
    forall actions <- list({one_of(@actions), integer(1, 12), one_of(@panels)}) do
      layout = Enum.reduce(actions, Layout.new("x"), &edit/2)

      assert Layout.Json.parse_json(Layout.Json.to_json(layout)) == {:ok, renumber(layout)}
      assert Link.decode(Link.encode(layout)) == {:ok, renumber(layout)}
      assert Enum.all?(Layout.panel_lines(layout), &(&1 != []))
      # Every row occurs once, and contains either one timeline or cells.
      names = for [p | _] <- Layout.panel_lines(layout), do: p.row || p.id
      assert names == Enum.uniq(names)
      assert Enum.all?(Layout.panel_lines(layout), &(length(&1) <= 5))
    end
  end

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
    numbers = for %{id: "p" <> n} <- layout.rows, do: String.to_integer(n)
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

  defp edit({:resize, n, _}, layout), do: Layout.resize_row(layout, "p#{n}", n * 100 - 200)

  defp edit({:move, n, _}, layout),
    do: Layout.move_row(layout, "p#{n}", if(rem(n, 2) == 0, do: 1, else: -1))

  defp edit({:place, n, panel}, layout) do
    side = Enum.at([:above, :below, :left, :right], rem(n, 4))
    target = if side in [:left, :right], do: "p#{rem(n * 5, 12) + 1}", else: row(layout, n * 7)

    same_panels(
      layout,
      Layout.move_panel(layout, "p#{n}", {side, target || Atom.to_string(panel)})
    )
  end

  defp edit({:shift, n, _}, layout),
    do:
      same_panels(
        layout,
        Layout.shift_panel(layout, "p#{n}", Enum.at([:up, :down, :left, :right], rem(n, 4)))
      )

  defp row(layout, n) do
    lines = Layout.panel_lines(layout)
    with [p | _] <- Enum.at(lines, rem(n, max(length(lines), 1))), do: p.row || p.id
  end

  # Moving neither loses nor creates panels.
  defp same_panels(before, {:ok, layout}) do
    strip = fn l -> l.rows |> Enum.map(&%{&1 | row: nil, height: nil}) |> Enum.sort() end
    assert strip.(layout) == strip.(before)
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
                "this file is not a layout: it has version 99, but this studio reads 1"},
               {"c.json", "this file is not a layout: two panels have the id p1"}
             ]

    assert {:error, %{code: :bad_layout}} = Layouts.load(dir, "Future")
    assert {:error, %{code: :no_layout}} = Layouts.load(dir, "None")
  end

  describe "moving panels" do
    # The layout is r1: A B | r2: C | plots P, Q.
    setup do
      add = fn layout, stream, panel, row ->
        {:ok, layout, _} = Layout.add_stream(layout, stream, "x", panel, "", row: row)
        layout
      end

      layout =
        Layout.new("")
        |> add.("A", :value, "r1")
        |> add.("B", :value, "r1")
        |> add.("C", :value, "r2")
        |> add.("P", :plot, nil)
        |> add.("Q", :lanes, nil)

      {:ok, layout: layout}
    end

    defp streams({:ok, layout}), do: streams(layout)

    defp streams(l),
      do: for(line <- Layout.panel_lines(l), do: Enum.map(line, &hd(&1.vis).stream))

    defp id(layout, stream), do: Enum.find(layout.rows, &(hd(&1.vis).stream == stream)).id

    test "puts a timeline above or below any row", %{layout: l} do
      assert streams(Layout.move_panel(l, id(l, "Q"), {:above, "r1"})) == [
               ["Q"],
               ["A", "B"],
               ["C"],
               ["P"]
             ]

      assert streams(Layout.move_panel(l, id(l, "P"), {:below, id(l, "Q")})) == [
               ["A", "B"],
               ["C"],
               ["Q"],
               ["P"]
             ]
    end

    test "does not put a timeline next to another panel", %{layout: l} do
      assert Layout.move_panel(l, id(l, "P"), {:left, id(l, "A")}) == {:ok, l}
      assert Layout.move_panel(l, id(l, "A"), {:left, id(l, "P")}) == {:ok, l}
    end

    test "puts a cell next to another one, at the height of its row", %{layout: l} do
      l = Layout.resize_row(l, "r1", 500)
      {:ok, moved} = Layout.move_panel(l, id(l, "C"), {:right, id(l, "A")})
      assert streams(moved) == [["A", "C", "B"], ["P"], ["Q"]]
      assert Layout.find_panel(moved, id(l, "C")).height == 500
    end

    test "puts a cell into its own row", %{layout: l} do
      {:ok, moved} = Layout.move_panel(l, id(l, "A"), {:below, id(l, "P")})
      assert streams(moved) == [["B"], ["C"], ["P"], ["A"], ["Q"]]

      assert streams(Layout.move_panel(l, id(l, "A"), {:below, "r1"})) |> Enum.take(2) == [
               ["B"],
               ["A"]
             ]
    end

    test "moves a cell by keys, also out of its row and into the next", %{layout: l} do
      assert streams(Layout.shift_panel(l, id(l, "A"), :right)) |> hd() == ["B", "A"]

      assert streams(Layout.shift_panel(l, id(l, "B"), :right)) == [
               ["A"],
               ["B", "C"],
               ["P"],
               ["Q"]
             ]

      assert streams(Layout.shift_panel(l, id(l, "C"), :left)) == [["A", "B", "C"], ["P"], ["Q"]]

      assert streams(Layout.shift_panel(l, id(l, "B"), :up)) == [
               ["B"],
               ["A"],
               ["C"],
               ["P"],
               ["Q"]
             ]

      assert streams(Layout.shift_panel(l, id(l, "C"), :down)) == [
               ["A", "B"],
               ["P"],
               ["C"],
               ["Q"]
             ]

      assert streams(Layout.shift_panel(l, id(l, "P"), :up)) == [["A", "B"], ["P"], ["C"], ["Q"]]
    end

    test "leaves panels that cannot move", %{layout: l} do
      for {stream, way} <- [{"A", :left}, {"C", :right}, {"P", :left}, {"Q", :down}],
          do: assert(Layout.shift_panel(l, id(l, stream), way) == {:ok, l})

      assert Layout.shift_panel(l, "p99", :up) == {:ok, l}
      assert Layout.move_panel(l, "p99", {:above, "r1"}) == {:ok, l}
      assert Layout.move_panel(l, id(l, "A"), {:above, "r99"}) == {:ok, l}
    end

    test "reports a full row", %{layout: l} do
      l =
        Enum.reduce(1..3, l, fn i, l ->
          {:ok, l, _} = Layout.add_stream(l, "X#{i}", "x", :value, "", row: "r1")
          l
        end)

      assert {:error, %{code: :full}} = Layout.move_panel(l, id(l, "C"), {:left, id(l, "A")})
    end
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
      assert layout.rows != [], "nothing of a #{shape}"
    end

    layout =
      Layout.Auto.build_layout([
        %StreamInfo{name: "Left.Image", shape: :image},
        %StreamInfo{name: "Right.Image", shape: :image},
        %StreamInfo{name: "Right.Faces", shape: :shapes}
      ])

    assert [["Left.Image"], ["Right.Image", "Right.Faces"]] =
             for(p <- layout.rows, do: Enum.map(p.vis, & &1.stream))

    assert Layout.Auto.build_layout([]).rows == []
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

    assert %{cell_column: false} = layout = Layout.Auto.build_layout(streams, looks)

    assert [["Pan"], ["Left", "Right"], ["Sound"], ["Level"]] =
             for(line <- Layout.panel_lines(layout), do: for(p <- line, do: hd(p.vis).stream))

    # Three images of the usual shape are larger side by side than one below the other.
    assert %{cell_column: false} =
             layout = Layout.Auto.build_layout(streams, Map.delete(looks, "Pan"))

    assert [["Left", "Pan", "Right"], ["Sound"], ["Level"]] = lines(layout)
  end

  test "puts a tall image next to the timelines" do
    streams = [
      %StreamInfo{name: "Phone", shape: :image},
      %StreamInfo{name: "Sound", shape: :audio},
      %StreamInfo{name: "Level", shape: :signal}
    ]

    looks = %{"Phone" => %ImageLook{width: 720, height: 1280}}
    assert %{cell_column: true} = layout = Layout.Auto.build_layout(streams, looks)
    assert hd(layout.rows).aspect == 0.56
  end

  test "cells share the width of a row by their shapes" do
    streams = [
      %StreamInfo{name: "Camera", shape: :image},
      %StreamInfo{name: "Way", shape: :place},
      %StreamInfo{name: "Speed", shape: :signal}
    ]

    looks = %{"Camera" => %ImageLook{width: 1920, height: 1080}}
    layout = Layout.Auto.build_layout(streams, looks)
    assert [["Camera", "Way"], ["Speed"]] = lines(layout)
    [cells | _] = Layout.panel_lines(layout)
    assert Layout.line_style(cells, %{}) =~ "aspect-ratio: 3.08"

    assert Enum.map(cells, &Layout.cell_style/1) == [
             "flex-grow: 1.78",
             "flex-grow: 1.3"
           ]

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
      shown = streams |> Enum.map(& &1.name) |> Enum.take(3)

      for timelines <- [[], tl(plots), plots] do
        layout = Layout.Auto.build_layout(streams ++ timelines, looks)
        drawn = layout |> lines() |> List.flatten()
        assert Enum.sort(drawn) == Enum.sort(shown ++ Enum.map(timelines, & &1.name))
        assert layout |> Layout.panel_lines() |> Enum.all?(&(length(&1) <= 3))
      end
    end
  end

  test "draws signals of different magnitudes in different panels" do
    streams =
      for n <- ["Arm.Angle", "Arm.Tilt", "Arm.Torque"], do: %StreamInfo{name: n, shape: :signal}

    ranges = %{"Arm.Angle" => {-1, 1}, "Arm.Tilt" => {0, 0.5}, "Arm.Torque" => {0, 1.0e12}}

    assert [["Arm.Angle", "Arm.Tilt"], ["Arm.Torque"]] =
             for(
               p <- Layout.Auto.build_layout(streams, %{}, ranges).rows,
               do: Enum.map(p.vis, & &1.stream)
             )

    # A constant stream is a line anywhere, but it must not flatten the others.
    constant = Map.put(ranges, "Arm.Tilt", {20, 20})
    assert length(Layout.Auto.build_layout(streams, %{}, constant).rows) == 3
  end

  defp lines(layout),
    do: for(line <- Layout.panel_lines(layout), do: for(p <- line, do: hd(p.vis).stream))

  test "colors images of class numbers: over a camera's image, or alone" do
    streams = for n <- ["Cam.Image", "Cam.Classes"], do: %StreamInfo{name: n, shape: :image}
    looks = %{"Cam.Classes" => %ImageLook{width: 640, height: 480, classes: true}}

    assert [%{vis: [%{viz: "image", stream: "Cam.Image"}, %{viz: "masks"}]}] =
             Layout.Auto.build_layout(streams, looks).rows

    alone = for n <- ["A", "B"], do: %StreamInfo{name: n, shape: :image}
    looks = Map.new(["A", "B"], &{&1, %ImageLook{width: 640, height: 480, classes: true}})

    assert [[%{viz: "masks", stream: "A"}], [%{viz: "masks", stream: "B"}]] =
             for(p <- Layout.Auto.build_layout(alone, looks).rows, do: p.vis)
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
           ] = for(p <- layout.rows, do: {p.panel, Enum.map(p.vis, & &1.viz)})

    # The page is 720 pixels high, and its bars and the navigator use 118 of them.
    heights =
      for line <- Layout.panel_lines(layout),
          do: Layout.line_height(line, %{"Talk.Speaking" => 2})

    assert Enum.sum(heights) <= 720 - 118
  end
end
