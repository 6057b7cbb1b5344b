defmodule Situ.Studio.PipelineViewTest do
  # Tests the page with a running pipeline, without a browser.
  use ExUnit.Case, async: true
  import Situ.Test.Eventually
  alias Situ.Live.Test, as: Page
  alias Situ.Studio.{Catalog, History, PipelineView, Recordings}

  defmodule Steps do
    use Situ.Pipeline

    @impl true
    def build(p, _opts) do
      Situ.composite(p, "Front", fn p ->
        p
        |> Situ.from_enumerable(0..999, every: Situ.Time.ms(20), name: "Numbers")
        |> Situ.map(&(&1 * 2), name: "Double")
      end)
      |> Situ.map(&"<b>#{&1}", name: "Plus", policy: Situ.Delivery.latest())
      |> Situ.each(fn _ -> :ok end, name: "End")
    end
  end

  setup do
    history = History.new(live: true)
    pipeline = start_supervised!({Steps, []})
    id = "studio-#{System.unique_integer([:positive])}"

    sources = %{"none" => Recordings.History.wrap(history)}

    start_supervised!(
      {DynamicSupervisor, name: Catalog.watch_supervisor(id), strategy: :one_for_one}
    )

    start_supervised!({Catalog, id: id, sources: sources, pipelines: [{"steps", pipeline}]})
    {:ok, id: id, pipeline: pipeline}
  end

  defp page(id, path \\ "/p/steps") do
    Page.mount(PipelineView,
      path: "/p/x",
      params: params(path),
      session: %{"studio" => id},
      routes: [{:live, "/p/*id", PipelineView}]
    )
  end

  defp params(path) do
    uri = URI.parse(path)
    "/p/" <> id = uri.path
    uri.query |> to_string() |> URI.decode_query() |> Map.put("id", String.split(id, "/"))
  end

  test "sends the graph, then numbers at each tick", %{id: id} do
    page = page(id)
    assert [graph] = Page.take_pushed_events(page, "pipeline:graph")
    assert Enum.map(graph["boxes"], & &1["key"]) == ["s:Front"]

    assert graph["nodes"] |> Enum.map(& &1["label"]) |> Enum.sort() |> Enum.take(2) == [
             "Double",
             "End"
           ]

    # On a busy machine, the page may have had more than one tick.
    assert [%{"edges" => edges, "nodes" => nodes} | _] =
             Page.take_pushed_events(page, "pipeline:stats")

    assert map_size(edges) == length(graph["edges"])
    assert Enum.all?(nodes, fn {_, n} -> n["state"] == "running" end)
    Page.send_info(page, :tick)
    # The shape is unchanged, so only numbers are sent.
    assert Page.take_pushed_events(page, "pipeline:graph") == []
    assert [_ | _] = Page.take_pushed_events(page, "pipeline:stats")
    assert Page.text(page, ".status") =~ "running now"
  end

  test "shows the time before the page was opened, at decreasing density", context do
    %{id: id, pipeline: pipeline} = context
    assert PipelineView.History.list_samples(id, "steps") == []
    opts = [id: id, pipelines: [{"steps", pipeline}], tick: false]
    past = start_supervised!({PipelineView.History, opts})
    now = System.monotonic_time(:nanosecond)

    # An hour and a half with a moment every ten seconds, then the last six minutes second by
    # second.
    for at <- Enum.to_list(5400..361//-10) ++ Enum.to_list(360..1),
        do: send(past, {:tick, now - at * 1_000_000_000})

    :sys.get_state(past, 60_000)

    ages =
      for s <- PipelineView.History.list_samples(id, "steps"), do: div(now - s.at, 1_000_000_000)

    assert Enum.take(ages, 300) == Enum.to_list(1..300)
    assert length(ages) in 330..400
    assert List.last(ages) in 3_400..3_600

    page = page(id, "/p/steps?sel=e1")
    Page.send_event(page, "ready", %{})
    [series | _] = Page.take_pushed_events(page, "pipeline:series") |> Enum.reverse()
    times = Enum.map(series["rows"], &hd/1)
    # The series contains the earlier moments, and at least the moment of opening.
    assert Enum.count(times, &(&1 <= div(now, 1_000_000))) == length(ages)
    assert length(times) > length(ages)
    assert times == Enum.sort(times)
  end

  test "folds a composite, and writes it into the address", %{id: id} do
    page = page(id)
    Page.take_pushed_events(page, "pipeline:graph")
    Page.send_event(page, "fold", %{path: "Front"})
    assert [{:live_patch, to}] = Page.list_visits(page)
    assert to =~ "fold=Front"
  end

  test "shows the numbers of a component and of a connection", %{id: id} do
    page = page(id, "/p/steps?sel=n2&heat=memory")
    assert Page.text(page, ".right .side-title") == "Component"
    assert Page.text(page, ".numbers") =~ "Mailbox"
    assert Page.count_elements(page, ".spark") == 3
    page = page(id, "/p/steps?sel=e1&plots=dropped,queue")
    assert Page.text(page, ".right .side-title") == "Connection"
    assert Page.count_elements(page, ".spark") == 2
    assert Page.has_element?(page, "#plot-dropped")
    page = page(id, "/p/steps?sel=e99")
    assert Page.text(page, ".right .side-title") == "Gone"
    page = page(id, "/p/steps?sel=%3Cscript%3E&heat=nope&plots=,,&fold=%7C%7Cx&at=z")
    assert Page.text(page, ".right .side-title") == "Pipeline"
  end

  test "shows the last messages of a connection, escaped, without its own tap", %{
    id: id
  } do
    page = page(id)
    [graph] = Page.take_pushed_events(page, "pipeline:graph")
    last = List.last(graph["edges"])
    page = page(id, "/p/steps?sel=#{last["key"]}")

    assert eventually(fn ->
             Page.send_info(page, :tick) && Page.count_elements(page, ".messages li") == 8
           end)

    assert Page.text(page, ".messages li code") =~ ~s("<b>)
    refute Page.render(page) =~ "<b>1"
    assert [same] = Page.take_pushed_events(page, "pipeline:graph")
    assert length(same["nodes"]) == length(graph["nodes"])
  end

  test "keeps the last graph after the pipeline ends", %{id: id, pipeline: pipeline} do
    page = page(id)
    ref = Process.monitor(pipeline)
    Situ.Pipeline.stop(pipeline)
    assert_receive {:DOWN, ^ref, _, _, _}
    Page.send_info(page, :tick)
    assert Page.alive?(page)
    assert Page.text(page, ".status") =~ "ended"
  end

  test "shows a recording's snapshots moment by moment", %{pipeline: pipeline} do
    history = History.new(live: false)
    snapshot = Situ.Pipeline.info(pipeline)

    for i <- 1..30 do
      edges = Enum.map(snapshot.edges, &%{&1 | emitted: i * 10, processed: i * 10})
      data = %{snapshot | edges: edges, state: if(i == 30, do: :completed, else: :running)}
      time = i * 1_000_000_000

      History.put(
        history,
        "Diagnostics",
        %Situ.Message{data: data, originating_time: time, creation_time: time, sequence_id: i},
        100
      )
    end

    id = "studio-#{System.unique_integer([:positive])}"

    start_supervised!({Catalog, id: id, sources: %{"old" => Recordings.History.wrap(history)}},
      id: :old
    )

    page = page(id, "/p/old?sel=e1")
    Page.render(page)
    assert Page.text(page, ".topbar .state") == "completed"
    assert Page.get_attribute(page, "#moments input", "max") == "29"
    [series | _] = Page.take_pushed_events(page, "pipeline:series") |> Enum.reverse()
    assert series["stats"] == ["queue", "processed_rate", "latency_mean"]
    assert length(series["rows"]) == 30
    assert Enum.map(Enum.drop(series["rows"], 1), &Enum.at(&1, 2)) |> Enum.uniq() == [10.0]
    page = page(id, "/p/old?at=5000000000")
    assert Page.text(page, ".topbar .state") == "running"
    assert Page.text(page, "#moments .dim") == "00:00:05.000"
  end

  test "says how to record diagnostics if there are none", %{id: id} do
    page = page(id, "/p/none")
    assert Page.text(page, ".message") =~ "diagnostics: true"
    page = page(id, "/p/nothing")
    assert Page.text(page, ".message h1") =~ "There is no recording"
  end

  test "traces a typed time, and reports an invalid one", %{id: id} do
    page = page(id)
    Page.submit(page, "#trace-time", %{"time" => "2200-01-01T00:00:00Z"})
    assert Page.text(page, "#trace h2") =~ "00:00:00.000"
    assert Page.has_element?(page, "#trace .hops li.coming")
    Page.submit(page, "#trace-time", %{"time" => "00:00:00.001"})
    assert Page.text(page, "#trace h2") =~ "00:00:00.001"
    Page.submit(page, "#trace-time", %{"time" => "soon"})
    refute Page.has_element?(page, "#trace")
    assert Page.text(page, "#trace-time [role=alert]") =~ ~s(not a time: "soon")
  end
end
