defmodule Situ.Studio.Web.MainViewTest do
  use ExUnit.Case, async: true

  alias Situ.Live.Test, as: Page
  alias Situ.Studio.{Catalog, History, Layout, Layouts, Link, Recordings}
  alias Situ.Studio.Web.{HomeView, MainView}

  @moduletag :tmp_dir

  setup %{tmp_dir: dir, test: test} do
    history = History.new(live: false)

    for {name, data} <- [
          {"Mic.Level", 0.5},
          {"Mic.Loud", true},
          {"Camera.Image", Situ.Image.new_filled(2, 2, :gray8, 7)},
          {"<b>x</b>", %{a: 1}}
        ] do
      History.put(history, name, %Situ.Message{data: data, originating_time: 1_000}, 8)
    end

    sources = %{"one" => Recordings.History.wrap(history)}
    id = to_string(test)
    start_supervised!({Catalog, id: id, sources: sources, layouts: dir})
    %{history: history, studio: id}
  end

  defp open(studio, params \\ %{}) do
    params = Map.put(params, "id", ["one"])
    Page.mount(MainView, path: "/s/one", params: params, session: %{"studio" => studio})
  end

  defp edit(page), do: Page.get_attribute(page, "#studio", "data-edit")

  defp layout(page) do
    {:ok, layout} = page |> edit() |> Link.decode()
    layout
  end

  test "lists streams as a tree and opens a layout for their kinds", %{studio: studio} do
    page = open(studio)
    assert Page.count_elements(page, "#tree .node") == 6
    assert Page.has_element?(page, "#body-p1-image")
    assert Page.get_attribute(page, "#body-p1-image", "data-kind") == "image"
    assert edit(page) == ""
  end

  test "redirects to the page of a dataset", %{test: test, tmp_dir: dir} do
    File.write!(Path.join(dir, "level.csv"), "time_s,level\n0,0.5\n1,0.7\n")
    {:ok, dataset} = Situ.Dataset.open(dir)
    path = Path.join(dir, "study.json")
    {:ok, _dataset} = Situ.Dataset.save_as(dataset, path)
    id = "#{test} of a folder"
    start_supervised!({Catalog, id: id, path: path, layouts: dir}, id: :second)
    params = %{"id" => ["study.json"]}

    assert Page.mount(MainView, path: "/s/study.json", params: params, session: %{"studio" => id}) ==
             {:error, {:redirect, "/d/study.json"}}
  end

  test "adds a panel when a stream's kind becomes known, unless the layout was changed",
       %{
         studio: studio,
         history: history
       } do
    History.open_stream(history, "Late", :any)
    [page, changed] = [open(studio), open(studio)]
    Page.send_event(changed, "add_viz", %{"stream" => "Mic.Level", "viz" => "line"})
    plots = Page.count_elements(page, "[data-kind=plot]")
    mine = edit(changed)
    Page.send_event(page, "streams_changed", %{})
    assert Page.count_elements(page, "[data-kind=plot]") == plots
    message = %Situ.Message{data: 1.5, originating_time: 2_000}
    History.put(history, "Late", message, 8)
    Page.send_event(page, "streams_changed", %{})
    Page.send_event(changed, "streams_changed", %{})
    assert Page.count_elements(page, "[data-kind=plot]") == plots + 1
    assert mine != "" and edit(changed) == mine
  end

  test "escapes names", %{studio: studio} do
    html = Page.render(open(studio))
    refute html =~ "<b>x</b>"
    assert html =~ "&lt;b&gt;x&lt;/b&gt;"
  end

  test "searching narrows the tree, and folding hides streams", %{studio: studio} do
    page = open(studio)
    Page.send_event(page, "search", %{"query" => "lev"})
    assert Page.count_elements(page, "#tree .node") == 2
    Page.send_event(page, "search", %{"query" => ""})
    Page.send_event(page, "toggle", %{"path" => "Mic"})
    assert Page.count_elements(page, "#tree .node") == 4
  end

  test "shows a stream, sets its properties, and removes it", %{studio: studio} do
    page = open(studio)
    Page.send_event(page, "add_viz", %{"stream" => "Mic.Level", "viz" => "line"})
    code = edit(page)
    {:ok, layout} = Link.decode(code)
    panel = List.last(layout.panels)
    assert [%{stream: "Mic.Level", viz: "line"}] = panel.vis

    props = %{"width" => "3", "color" => "red; x", "visible" => "true"}
    fields = %{"panel" => panel.id, "index" => "0", "props" => props}
    Page.change(page, "#props-#{panel.id}-0", fields, target: ["props", "width"])

    Page.send_event(page, "axis", %{"panel" => panel.id, "min" => "-1", "max" => "1"})
    {:ok, layout} = Link.decode(edit(page))
    assert %{axis: {-1.0, 1.0}, vis: [vis]} = Layout.find_panel(layout, panel.id)
    assert vis.props == %{"width" => 3.0}

    Page.send_event(page, "remove_panel", %{"id" => panel.id})
    assert edit(page) == ""
  end

  test "sets and resets a color, and shows the fields of the chosen option", %{
    studio: studio,
    history: history
  } do
    depth = Situ.DepthImage.new!(width: 1, height: 1, data: <<500::little-16>>)
    History.put(history, "Depth", %Situ.Message{data: depth, originating_time: 1_000}, 8)
    page = open(studio)
    Page.send_event(page, "add_viz", %{"stream" => "Depth", "viz" => "depth"})

    id = for(%{vis: [%{viz: "depth"}], id: id} <- layout(page).panels, do: id) |> List.last()

    vis = fn -> Layout.find_panel(layout(page), id).vis end

    change = fn key, text ->
      fields = %{"panel" => id, "index" => "0", "props" => %{key => text}}
      Page.change(page, "#props-#{id}-0", fields, target: ["props", key])
    end

    refute Page.has_element?(page, "#f-#{id}-0-min")
    change.("range", "fixed")
    assert Page.has_element?(page, "#f-#{id}-0-min")
    change.("min", "250")
    change.("min", "-3")
    change.("invalid_color", "#ff00ff")

    assert [%{props: %{"range" => "fixed", "min" => 250.0, "invalid_color" => "#ff00ff"}}] =
             vis.()

    Page.send_event(page, "prop_auto", %{"panel" => id, "index" => "0", "key" => "invalid_color"})
    assert [%{props: props}] = vis.()
    refute Map.has_key?(props, "invalid_color")

    for bad <- [%{"index" => "7"}, %{"index" => "x"}, %{"panel" => "p99"}] do
      Page.send_event(
        page,
        "prop_auto",
        Map.merge(%{"panel" => id, "index" => "0", "key" => "range"}, bad)
      )
    end

    assert [%{props: ^props}] = vis.()
  end

  test "plots a part of a message, and rejects an invalid path", %{studio: studio} do
    page = open(studio)
    Page.send_event(page, "plot_path", %{"stream" => "<b>x</b>", "path" => ".a"})
    {:ok, layout} = Link.decode(edit(page))
    assert %{panel: :plot, vis: [%{path: ".a", viz: "line"}]} = List.last(layout.panels)
    Page.send_event(page, "plot_path", %{"stream" => "<b>x</b>", "path" => "nonsense"})
    assert [%{"text" => text}] = Page.take_pushed_events(page, "toast")
    assert text =~ "invalid path"
  end

  test "saves, selects and deletes layouts, and restores one by a link", context do
    page = open(context.studio)
    Page.send_event(page, "remove_panel", %{"id" => "p1"})
    code = edit(page)
    Page.send_event(page, "layout_dialog", %{})
    Page.send_event(page, "layout_save", %{"name" => "Mine"})
    assert Layouts.list_names(context.tmp_dir) == ["Mine"]
    assert edit(page) == ""
    Page.send_event(page, "layout_pick", %{"layout" => "Automatic"})
    assert Page.has_element?(page, "#body-p1-image")

    again = open(context.studio, %{"layout" => "Automatic", "edit" => code})
    refute Page.has_element?(again, "#body-p1-image")
    assert edit(again) != ""

    Page.send_event(page, "layout_pick", %{"layout" => "Mine"})
    Page.send_event(page, "layout_delete", %{})
    assert Layouts.list_names(context.tmp_dir) == []
  end

  test "ignores events that the studio's pages never send", %{studio: studio} do
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
      Page.send_event(page, event, params)
      assert Page.alive?(page), event
      assert edit(page) == "", event
    end
  end

  test "the cursor snaps to an existing stream, also one from the address", %{studio: studio} do
    page = open(studio)
    Page.send_event(page, "snap", %{"stream" => "Mic.Level"})
    assert Page.take_pushed_events(page, "snap") == [%{"stream" => "Mic.Level"}]
    assert Page.text(page, ".status") =~ "snaps to Mic.Level"
    Page.send_event(page, "snap", %{"stream" => "none"})
    assert Page.take_pushed_events(page, "snap") == [%{"stream" => nil}]
    refute Page.text(page, ".status") =~ "snaps"
    assert Page.text(open(studio, %{"snap" => "Mic.Loud"}), ".status") =~ "snaps to Mic.Loud"
    refute Page.text(open(studio, %{"snap" => %{"x" => "y"}}), ".status") =~ "snaps"
  end

  test "shows the chosen number next to the names", %{studio: studio} do
    page = open(studio)

    beside = fn choice ->
      Page.send_event(page, "search", %{"query" => "", "info" => choice})
      Page.text(page, "#tree .node[data-stream='Mic.Level'] .info")
    end

    assert for(c <- ~w(count size average_size latency none), do: beside.(c)) == [
             "1",
             "8 B",
             "8.0 B",
             "",
             ""
           ]

    # For a group, it is the total of its streams.
    beside.("size")
    assert Page.text(page, "#tree .node[data-group='Mic'] .info") =~ ~r/^\(\d+ B\)$/
    Page.send_event(page, "search", %{"query" => "", "info" => "weight"})
    assert Page.text(page, "#tree .node[data-stream='Mic.Level'] .info") == "8 B"
  end

  test "undo restores changes that a selected layout replaced", %{studio: studio} do
    page = open(studio)
    Page.send_event(page, "add_viz", %{"stream" => "Mic.Level", "viz" => "value"})
    n = Page.count_elements(page, "[data-panel]")
    Page.send_event(page, "layout_pick", %{"layout" => "Automatic"})
    assert Page.count_elements(page, "[data-panel]") == n - 1
    Page.send_event(page, "undo", %{})
    assert Page.count_elements(page, "[data-panel]") == n
    Page.send_event(page, "redo", %{})
    assert Page.count_elements(page, "[data-panel]") == n - 1
  end

  test "shows new streams when the page reports them", context do
    page = open(context.studio)
    message = %Situ.Message{data: 1, originating_time: 2_000}
    History.put(context.history, "Late", message, 8)
    Page.send_event(page, "streams_changed", %{})
    assert Page.count_elements(page, "#tree .node") == 7
  end

  test "a threshold covers one side of a value, and is in the link", %{studio: studio} do
    page = open(studio)
    Page.send_event(page, "add_viz", %{"stream" => "Mic.Level", "viz" => "line"})
    %{id: id} = layout(page).panels |> Enum.filter(&(&1.panel == :plot)) |> List.last()
    set = &Page.send_event(page, "threshold", %{"panel" => id, "side" => &1, "value" => &2})
    threshold = fn -> Layout.find_panel(layout(page), id).threshold end
    set.("above", "0.5")
    assert threshold.() == {:above, 0.5}
    assert Page.get_attribute(page, "#body-#{id}-plot", "data-config") =~ ~s("threshold":{)
    for {side, value} <- [{"above", "x"}, {"above", %{}}], do: set.(side, value)
    assert threshold.() == {:above, 0.5}
    set.("sideways", "1")
    assert threshold.() == nil
  end

  test "finds streams by type, and folds all groups", %{studio: studio} do
    page = open(studio)
    Page.send_event(page, "fold_all", %{})
    assert Page.count_elements(page, "#tree .node") == 3
    Page.send_event(page, "unfold_all", %{})
    assert Page.count_elements(page, "#tree .node") == 6
    Page.send_event(page, "search", %{"query" => "image any"})
    assert Page.count_elements(page, "#tree .node") == 2
  end

  test "a panel has room for the known lanes and for those the page reports", context do
    message = %Situ.Message{data: %{"a" => true, "b" => false}, originating_time: 2_000}
    History.put(context.history, "Who", message, 8)
    page = open(context.studio)
    height = fn -> Page.get_attribute(page, "[data-panel=p2]", "style") end
    # One lane for Mic.Loud, and two for Who.
    assert height.() =~ "flex: 1 0 #{3 * 26 + 8}px"
    Page.send_event(page, "lanes", %{"of" => "Who", "count" => 4})
    assert height.() =~ "flex: 1 0 #{5 * 26 + 8}px"

    for {of, n} <- [{"Who", 1}, {"None", 9}, {"Who", 99}, {"Who", "x"}, {7, 1}] do
      Page.send_event(page, "lanes", %{"of" => of, "count" => n})
      assert height.() =~ "flex: 1 0 #{5 * 26 + 8}px"
    end

    assert edit(page) == ""
  end

  test "read only does not save", %{tmp_dir: dir} = context do
    id = context.studio <> " read only"

    start_supervised!(
      {Catalog,
       id: id,
       sources: %{"one" => Recordings.History.wrap(context.history)},
       layouts: dir,
       read_only: true},
      id: :read_only
    )

    page = open(id)
    Page.send_event(page, "layout_save", %{"name" => "Mine"})
    assert Layouts.list_names(dir) == []
  end

  test "names a missing recording, and the list shows the existing ones", %{studio: studio} do
    session = %{"studio" => studio}
    page = Page.mount(MainView, path: "/s/none", params: %{"id" => ["none"]}, session: session)
    assert Page.text(page, ".message h1") =~ "There is no recording named"
    assert Page.text(Page.mount(HomeView, session: session), ".item b") == "one"
  end

  test "the list shows the duration and number of streams in memory",
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
