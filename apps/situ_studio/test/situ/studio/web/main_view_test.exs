defmodule Situ.Studio.Web.MainViewTest do
  use ExUnit.Case, async: true

  alias Situ.Live.Test, as: Page
  alias Situ.Studio.{Catalog, History, Layout, Layouts, Link, Source}
  alias Situ.Studio.Web.{HomeView, MainView}

  @moduletag :tmp_dir

  setup %{tmp_dir: dir, test: test} do
    history = History.new(live: false)

    for {name, data} <- [
          {"Mic.Level", 0.5},
          {"Mic.Loud", true},
          {"Camera.Image", Situ.Image.filled(2, 2, :gray8, 7)},
          {"<b>x</b>", %{a: 1}}
        ] do
      History.put(history, name, %Situ.Message{data: data, originating_time: 1_000}, 8)
    end

    sources = %{"one" => {Source.History, history}}
    id = to_string(test)
    start_supervised!({Catalog, id: id, sources: sources, layouts: dir})
    %{history: history, studio: id}
  end

  defp open(studio, params \\ %{}) do
    params = Map.put(params, "id", ["one"])
    Page.mount(MainView, path: "/s/one", params: params, session: %{"studio" => studio})
  end

  defp edit(page), do: Page.attribute(page, "#studio", "data-edit")

  defp layout(page) do
    {:ok, layout} = page |> edit() |> Link.decode()
    layout
  end

  test "lists streams as a tree and opens with a layout by their kinds", %{studio: studio} do
    page = open(studio)
    assert Page.count(page, "#tree .node") == 6
    assert Page.has?(page, "#body-p1-image")
    assert Page.attribute(page, "#body-p1-image", "data-kind") == "image"
    assert edit(page) == ""
  end

  test "a stream that tells later what it is gets its panel, unless somebody has changed the layout",
       %{
         studio: studio,
         history: history
       } do
    History.open(history, "Late", :any)
    [page, changed] = [open(studio), open(studio)]
    Page.event(changed, "add_viz", %{"stream" => "Mic.Level", "viz" => "line"})
    plots = Page.count(page, "[data-kind=plot]")
    mine = edit(changed)
    Page.event(page, "streams_changed", %{})
    assert Page.count(page, "[data-kind=plot]") == plots
    message = %Situ.Message{data: 1.5, originating_time: 2_000}
    History.put(history, "Late", message, 8)
    Page.event(page, "streams_changed", %{})
    Page.event(changed, "streams_changed", %{})
    assert Page.count(page, "[data-kind=plot]") == plots + 1
    assert mine != "" and edit(changed) == mine
  end

  test "names are escaped", %{studio: studio} do
    html = Page.render(open(studio))
    refute html =~ "<b>x</b>"
    assert html =~ "&lt;b&gt;x&lt;/b&gt;"
  end

  test "searching narrows, folding hides", %{studio: studio} do
    page = open(studio)
    Page.event(page, "search", %{"query" => "lev"})
    assert Page.count(page, "#tree .node") == 2
    Page.event(page, "search", %{"query" => ""})
    Page.event(page, "toggle", %{"path" => "Mic"})
    assert Page.count(page, "#tree .node") == 4
  end

  test "a stream is shown, its properties are set, and it is taken out again", %{studio: studio} do
    page = open(studio)
    Page.event(page, "add_viz", %{"stream" => "Mic.Level", "viz" => "line"})
    code = edit(page)
    {:ok, layout} = Link.decode(code)
    panel = List.last(layout.rows)
    assert [%{stream: "Mic.Level", viz: "line"}] = panel.vis

    props = %{"width" => "3", "color" => "red; x", "visible" => "true"}
    fields = %{"panel" => panel.id, "index" => "0", "props" => props}
    Page.change(page, "#props-#{panel.id}-0", fields, target: ["props", "width"])

    Page.event(page, "axis", %{"panel" => panel.id, "min" => "-1", "max" => "1"})
    {:ok, layout} = Link.decode(edit(page))
    assert %{axis: {-1.0, 1.0}, vis: [vis]} = Layout.panel(layout, panel.id)
    assert vis.props == %{"width" => 3.0}

    Page.event(page, "remove_panel", %{"id" => panel.id})
    assert edit(page) == ""
  end

  test "a colour is chosen and given back; what belongs to another choice is shown with it", %{
    studio: studio,
    history: history
  } do
    depth = Situ.DepthImage.new!(width: 1, height: 1, data: <<500::little-16>>)
    History.put(history, "Depth", %Situ.Message{data: depth, originating_time: 1_000}, 8)
    page = open(studio)
    Page.event(page, "add_viz", %{"stream" => "Depth", "viz" => "depth"})

    id = for(%{vis: [%{viz: "depth"}], id: id} <- layout(page).rows, do: id) |> List.last()

    vis = fn -> Layout.panel(layout(page), id).vis end

    change = fn key, text ->
      fields = %{"panel" => id, "index" => "0", "props" => %{key => text}}
      Page.change(page, "#props-#{id}-0", fields, target: ["props", key])
    end

    refute Page.has?(page, "#f-#{id}-0-min")
    change.("range", "fixed")
    assert Page.has?(page, "#f-#{id}-0-min")
    change.("min", "250")
    change.("min", "-3")
    change.("invalid_color", "#ff00ff")

    assert [%{props: %{"range" => "fixed", "min" => 250.0, "invalid_color" => "#ff00ff"}}] =
             vis.()

    Page.event(page, "prop_auto", %{"panel" => id, "index" => "0", "key" => "invalid_color"})
    assert [%{props: props}] = vis.()
    refute Map.has_key?(props, "invalid_color")

    for bad <- [%{"index" => "7"}, %{"index" => "x"}, %{"panel" => "p99"}] do
      Page.event(
        page,
        "prop_auto",
        Map.merge(%{"panel" => id, "index" => "0", "key" => "range"}, bad)
      )
    end

    assert [%{props: ^props}] = vis.()
  end

  test "a part of a message is plotted; a path that is none is refused", %{studio: studio} do
    page = open(studio)
    Page.event(page, "plot_path", %{"stream" => "<b>x</b>", "path" => ".a"})
    {:ok, layout} = Link.decode(edit(page))
    assert %{panel: :plot, vis: [%{path: ".a", viz: "line"}]} = List.last(layout.rows)
    Page.event(page, "plot_path", %{"stream" => "<b>x</b>", "path" => "nonsense"})
    assert [%{"text" => text}] = Page.pushed(page, "toast")
    assert text =~ "not a path"
  end

  test "layouts are saved, chosen, brought back by a link and deleted", context do
    page = open(context.studio)
    Page.event(page, "remove_panel", %{"id" => "p1"})
    code = edit(page)
    Page.event(page, "layout_dialog", %{})
    Page.event(page, "layout_save", %{"name" => "Mine"})
    assert Layouts.names(context.tmp_dir) == ["Mine"]
    assert edit(page) == ""
    Page.event(page, "layout_pick", %{"layout" => "Automatic"})
    assert Page.has?(page, "#body-p1-image")

    again = open(context.studio, %{"layout" => "Automatic", "edit" => code})
    refute Page.has?(again, "#body-p1-image")
    assert edit(again) != ""

    Page.event(page, "layout_pick", %{"layout" => "Mine"})
    Page.event(page, "layout_delete", %{})
    assert Layouts.names(context.tmp_dir) == []
  end

  test "events that no page of ours sends change nothing", %{studio: studio} do
    page = open(studio)

    for {event, params} <- [
          {"nonsense", %{}},
          {"add_stream", %{"stream" => "none"}},
          {"add_stream", %{"stream" => %{"a" => 1}}},
          {"resize_row", %{"id" => "p1", "height" => "x"}},
          {"remove_vis", %{"panel" => "p1", "index" => "-7"}},
          {"remove_vis", %{"panel" => "zzz", "index" => "0"}},
          {"prop", %{"panel" => "p1", "index" => "99", "props" => "x"}},
          {"move_row", %{"id" => "zzz", "by" => "1"}},
          {"axis", %{"panel" => "p1", "min" => "1", "max" => "0"}},
          {"layout_pick", %{"layout" => "none"}}
        ] do
      Page.event(page, event, params)
      assert Page.alive?(page), event
      assert edit(page) == "", event
    end
  end

  test "the cursor snaps to a stream that there is, also one an address names", %{studio: studio} do
    page = open(studio)
    Page.event(page, "snap", %{"stream" => "Mic.Level"})
    assert Page.pushed(page, "snap") == [%{"stream" => "Mic.Level"}]
    assert Page.text(page, ".status") =~ "snaps to Mic.Level"
    Page.event(page, "snap", %{"stream" => "none"})
    assert Page.pushed(page, "snap") == [%{"stream" => nil}]
    refute Page.text(page, ".status") =~ "snaps"
    assert Page.text(open(studio, %{"snap" => "Mic.Loud"}), ".status") =~ "snaps to Mic.Loud"
    refute Page.text(open(studio, %{"snap" => %{"x" => "y"}}), ".status") =~ "snaps"
  end

  test "beside the names stands what is asked for", %{studio: studio} do
    page = open(studio)

    beside = fn choice ->
      Page.event(page, "search", %{"query" => "", "info" => choice})
      Page.text(page, "#tree .node[data-stream='Mic.Level'] .info")
    end

    assert for(c <- ~w(count size average_size latency none), do: beside.(c)) == [
             "1",
             "8 B",
             "8.0 B",
             "",
             ""
           ]

    # of a group: all that it holds
    beside.("size")
    assert Page.text(page, "#tree .node[data-group='Mic'] .info") =~ ~r/^\(\d+ B\)$/
    Page.event(page, "search", %{"query" => "", "info" => "weight"})
    assert Page.text(page, "#tree .node[data-stream='Mic.Level'] .info") == "8 B"
  end

  test "a layout that is picked in place of changes is taken back by undo", %{studio: studio} do
    page = open(studio)
    Page.event(page, "add_viz", %{"stream" => "Mic.Level", "viz" => "value"})
    n = Page.count(page, "[data-panel]")
    Page.event(page, "layout_pick", %{"layout" => "Automatic"})
    assert Page.count(page, "[data-panel]") == n - 1
    Page.event(page, "undo", %{})
    assert Page.count(page, "[data-panel]") == n
    Page.event(page, "redo", %{})
    assert Page.count(page, "[data-panel]") == n - 1
  end

  test "new streams appear when the page says that there are some", context do
    page = open(context.studio)
    message = %Situ.Message{data: 1, originating_time: 2_000}
    History.put(context.history, "Late", message, 8)
    Page.event(page, "streams_changed", %{})
    assert Page.count(page, "#tree .node") == 7
  end

  test "a threshold covers one side of a value, and is in the link", %{studio: studio} do
    page = open(studio)
    Page.event(page, "add_viz", %{"stream" => "Mic.Level", "viz" => "line"})
    %{id: id} = layout(page).rows |> Enum.filter(&(&1.panel == :plot)) |> List.last()
    set = &Page.event(page, "threshold", %{"panel" => id, "side" => &1, "value" => &2})
    threshold = fn -> Layout.panel(layout(page), id).threshold end
    set.("above", "0.5")
    assert threshold.() == {:above, 0.5}
    assert Page.attribute(page, "#body-#{id}-plot", "data-config") =~ ~s("threshold":{)
    for {side, value} <- [{"above", "x"}, {"above", %{}}], do: set.(side, value)
    assert threshold.() == {:above, 0.5}
    set.("sideways", "1")
    assert threshold.() == nil
  end

  test "streams are found by type too, and groups folded at once", %{studio: studio} do
    page = open(studio)
    Page.event(page, "fold_all", %{})
    assert Page.count(page, "#tree .node") == 3
    Page.event(page, "unfold_all", %{})
    assert Page.count(page, "#tree .node") == 6
    Page.event(page, "search", %{"query" => "image any"})
    assert Page.count(page, "#tree .node") == 2
  end

  test "a panel has room for the lanes that are known, and for those the page meets", context do
    message = %Situ.Message{data: %{"a" => true, "b" => false}, originating_time: 2_000}
    History.put(context.history, "Who", message, 8)
    page = open(context.studio)
    height = fn -> Page.attribute(page, "[data-panel=p2]", "style") end
    # a lane for Mic.Loud, two for Who
    assert height.() =~ "flex: 1 0 #{3 * 26 + 8}px"
    Page.event(page, "lanes", %{"of" => "Who", "count" => 4})
    assert height.() =~ "flex: 1 0 #{5 * 26 + 8}px"

    for {of, n} <- [{"Who", 1}, {"None", 9}, {"Who", 99}, {"Who", "x"}, {7, 1}] do
      Page.event(page, "lanes", %{"of" => of, "count" => n})
      assert height.() =~ "flex: 1 0 #{5 * 26 + 8}px"
    end

    assert edit(page) == ""
  end

  test "read only refuses to write", %{tmp_dir: dir} = context do
    id = context.studio <> " read only"

    start_supervised!(
      {Catalog,
       id: id,
       sources: %{"one" => {Source.History, context.history}},
       layouts: dir,
       read_only: true},
      id: :read_only
    )

    page = open(id)
    Page.event(page, "layout_save", %{"name" => "Mine"})
    assert Layouts.names(dir) == []
  end

  test "what is not there is named, and the list shows what is", %{studio: studio} do
    session = %{"studio" => studio}
    page = Page.mount(MainView, path: "/s/none", params: %{"id" => ["none"]}, session: session)
    assert Page.text(page, ".message h1") =~ "There is no recording called"
    assert Page.text(Page.mount(HomeView, session: session), ".item b") == "one"
  end

  test "the list says how long streams in memory are, and how many",
       %{history: history} = context do
    later = %Situ.Message{data: 0.7, originating_time: 90_000_001_000}
    History.put(history, "Mic.Level", later, 8)
    page = Page.mount(HomeView, session: %{"studio" => context.studio})

    for looking <- Task.Supervisor.children(Situ.Studio.Tasks) do
      ref = Process.monitor(looking)
      assert_receive {:DOWN, ^ref, :process, ^looking, _}
    end

    assert Page.text(page, ".item .dim") =~ "in memory1 min 30 s4 streams"
  end
end
