defmodule Situ.Studio.Web.ExperimentViewTest do
  use ExUnit.Case, async: true
  import Situ.Test.Eventually
  alias Situ.{Dataset, Message, Metric, Store}
  alias Situ.Experiment.{Comments, ResultsFile, RunRecord, Runner}
  alias Situ.Live.Test, as: Page
  alias Situ.Live.{Request, Response}
  alias Situ.Studio.{BatchRuns, Catalog, Experiments, Link}
  alias Situ.Studio.Web.{DatasetView, ExperimentReport, ExperimentView}

  @moduletag :tmp_dir
  @moduletag capture_log: true
  @ms 1_000_000

  defmodule Tune do
    @moduledoc false
    use Situ.Experiment

    @impl true
    def parameters, do: [limit: [3, 5, 8], hold: {:time_ns, [0, 200_000_000]}, name: [:a]]

    @impl true
    def build(_p, session, %{limit: limit}) do
      %{
        "Speaking" =>
          session |> Situ.Experiment.stream("Level") |> Situ.map(&(&1 >= limit), type: :boolean)
      }
    end

    @impl true
    def metrics do
      [
        speaking: Metric.intervals(truth: "Speaking.Truth", main: :time_f1),
        count: Metric.function(&Enum.count(Metric.messages(&1, "Speaking")), better: :lower)
      ]
    end
  end

  # The truth is 5 and above; in the session late, the numbers begin later.
  setup %{tmp_dir: root, test: test} do
    root = Path.expand(root)
    studio = to_string(test)

    start_supervised!(
      {DynamicSupervisor, name: Catalog.watch_supervisor(studio), strategy: :one_for_one}
    )

    start_supervised!({Catalog, id: studio, path: root, layouts: Path.join(root, "layouts")})
    start_supervised!({BatchRuns, id: studio})
    file = Path.join(root, "study.json")
    {:ok, dataset} = Dataset.new("Study", file: file, autosave: true)

    dataset =
      for {session, start} <- [{"early", 0}, {"late one", 100}], reduce: dataset do
        dataset ->
          path = record(root, session, start)
          {:ok, dataset} = Dataset.add_session(dataset, session)
          {:ok, dataset} = Dataset.add_partition(dataset, session, "Room", path)
          dataset
      end

    %{studio: studio, root: root, study: file, dataset: dataset}
  end

  defp record(root, name, start) do
    {:ok, writer} = Store.Writer.create(name, root)
    times = for k <- 0..39, do: {(start * 10 + k) * 100 * @ms, rem(k, 10)}

    for {stream, type, value} <- [
          {"Level", :integer, & &1},
          {"Speaking.Truth", :boolean, &(&1 >= 5)}
        ] do
      {:ok, out} = Store.Writer.stream(writer, stream, type: type)

      rows =
        for {{time, n}, i} <- Enum.with_index(times, 1),
            do: %Message{data: value.(n), originating_time: time, sequence_id: i}

      {:ok, out} = Store.Writer.append(out, rows)
      {:ok, _} = Store.Writer.close_stream(out, elem(List.last(times), 0))
    end

    :ok = Store.Writer.close(writer)
    writer.path
  end

  defp run_experiment(dataset) do
    {:ok, result} = Runner.run(Tune, dataset)
    result
  end

  defp open(studio, query \\ "", session \\ %{}) do
    routes = [{:live, "/x/*id", ExperimentView, session: fn _ -> %{"studio" => studio} end}]

    Page.mount(ExperimentView,
      path: "/x/study.json" <> query,
      params: %{"id" => ["study.json"]},
      session: Map.put(session, "studio", studio),
      routes: routes
    )
  end

  defp open_run(studio, query \\ "", session \\ %{}) do
    page = open(studio, query, session)
    assert eventually(fn -> Page.has_element?(page, "#sets") end)
    page
  end

  defp numbers(page) do
    page
    |> Page.render()
    |> then(&Regex.scan(~r/id="set-(\d+)"/, &1))
    |> Enum.map(fn [_, n] -> String.to_integer(n) end)
  end

  test "without a run, it says how to begin; the dataset's page has no link", %{
    studio: studio,
    study: file
  } do
    page = open(studio)
    assert eventually(fn -> Page.render(page) =~ "situ experiment run FILE.exs study.json" end)
    refute Experiments.any?(file)

    dataset =
      Page.mount(DatasetView, params: %{"id" => ["study.json"]}, session: %{"studio" => studio})

    refute Page.has_element?(dataset, "#experiments-link")
  end

  test "shows, sorts and filters the sets", %{studio: studio, dataset: dataset} do
    run_experiment(dataset)
    page = open_run(studio)
    assert Page.render(page) =~ "Finished: 12 of 12 results. 6 sets, 2 sessions, method grid."
    # The limits 5 (sets 3 and 4) are right, and the time of a set has its unit.
    assert [3, 4 | _] = numbers(page)
    assert Page.text(page, "#set-4") =~ "200 ms"
    assert Page.text(page, "#set-3") =~ "best"

    Page.send_event(page, "sort", %{"column" => "set"})
    assert numbers(page) == [1, 2, 3, 4, 5, 6]
    Page.send_event(page, "sort", %{"column" => "set"})
    assert numbers(page) == [6, 5, 4, 3, 2, 1]
    Page.send_event(page, "brush", %{"axis" => "p.limit", "from" => 0.9, "to" => 1.0})
    assert numbers(page) == [6, 5]
    assert Page.text(page, "caption") =~ "2 of 6 sets"
    # Everything that is shown is in the address.
    [{_, to} | _] = Enum.reverse(Page.list_visits(page))

    assert %{"sort" => "-set", "ranges" => _} =
             to |> URI.parse() |> Map.fetch!(:query) |> URI.decode_query()

    Page.send_event(page, "clear", %{"axis" => "p.limit"})
    assert length(numbers(page)) == 6
    Page.send_event(page, "brush", %{"axis" => "nonsense", "from" => 0.9, "to" => 1.0})
    Page.send_event(page, "sort", %{"column" => "m.nonsense"})
    Page.send_event(page, "brush", %{"axis" => ["p.limit"], "from" => "x"})
    Page.send_event(page, "select", %{"set" => %{}})
    Page.send_event(page, "open", %{"set" => [], "session" => 3})
    assert length(numbers(page)) == 6
  end

  test "a value opens the session where the set and the baseline differ", %{
    studio: studio,
    dataset: dataset
  } do
    run_experiment(dataset)
    page = open_run(studio)

    Page.send_event(page, "open", %{"set" => "5", "metric" => "speaking", "session" => "late one"})

    assert eventually(fn ->
             Page.render(page) && Page.take_pushed_events(page, "go") |> keep_address()
           end)

    assert_received {:address, href}

    %{path: "s/" <> id, query: query} = URI.parse(href)
    assert URI.decode(id) =~ ~r"\Astudy.json/late one/\[Tune:[0-9a-f]{32}\]\z"
    {:ok, item, source} = Catalog.open_source(studio, URI.decode(id))
    assert item.title == "late one: set 5 and the baseline, set 3"
    names = for info <- Store.streams(source), do: info.name

    assert Enum.sort(names) ==
             ~w(Difference.Differences Difference.Speaking Room.Level Room.Speaking.Truth)

    params = URI.decode_query(query)
    assert params["snap"] == "Difference.Differences"
    # The first difference is at the number 5.
    assert params["at"] == to_string((100 * 10 + 5) * 100 * @ms)
    {:ok, layout} = Link.decode(params["edit"])

    assert [%{panel: :plot, vis: [%{stream: "Room.Level"}]}, %{panel: :lanes, vis: vis}] =
             layout.panels

    assert Enum.map(vis, & &1.stream) == ["Difference.Speaking", "Difference.Differences"]
  end

  defp keep_address([%{"href" => href} | _]), do: send(self(), {:address, href})
  defp keep_address([]), do: false

  test "names that are not recordings of differences are not found", %{
    studio: studio,
    dataset: dataset
  } do
    run_experiment(dataset)

    for name <- ["[Tune:x]", "[../Tune:" <> String.duplicate("0", 32) <> "]", "[]", "[Tune"],
        do:
          assert(
            {:error, %{code: :not_found}} =
              Catalog.open_source(studio, "study.json/early/" <> name)
          )
  end

  test "sets have comments, and become the baseline", %{studio: studio, dataset: dataset} do
    {folder, run} = run_experiment(dataset)
    page = open_run(studio)
    Page.send_event(page, "select", %{"set" => "5"})
    assert Page.text(page, ".set-details h2") == "Set 5"
    assert Page.text(page, "#worst") =~ "late one"

    Page.send_event(page, "comment", %{
      "set" => "5",
      "by" => "Ada",
      "text" => "Begins <too> late."
    })

    assert eventually(fn -> Page.text(page, ".comments") =~ "Begins <too> late." end)
    assert [%{by: "Ada", set: 5}] = Comments.list_comments(folder, run["run"])

    Page.send_event(page, "promote", %{"set" => "5"})
    assert eventually(fn -> Page.render(page) =~ "Compared with the baseline, set 5." end)
    assert Page.text(page, "#set-5") =~ "baseline"
    assert [%{"text" => "Set 5 is the baseline"}] = Page.take_pushed_events(page, "toast")
    # A later run knows the baseline of the earlier one.
    run_experiment(dataset)
    page = open_run(studio)

    assert eventually(fn ->
             Page.render(page) =~ "Compared with the baseline, set 5 of run #{run["run"]}."
           end)

    assert Page.text(page, "#set-5") =~ "baseline"
  end

  test "a viewer changes nothing", %{studio: studio, dataset: dataset} do
    {folder, run} = run_experiment(dataset)
    page = open_run(studio, "", %{"viewer" => true})
    Page.send_event(page, "comment", %{"set" => "5", "text" => "x"})
    Page.send_event(page, "promote", %{"set" => "5"})
    assert length(Page.take_pushed_events(page, "toast")) == 2
    Page.send_event(page, "open", %{"set" => "5", "metric" => "speaking"})

    assert eventually(fn ->
             page |> Page.take_pushed_events("toast") |> Enum.any?(&(&1["text"] =~ "read-only"))
           end)

    refute File.exists?(Path.join(folder, "differences"))
    assert Comments.list_comments(folder, run["run"]) == []
    refute Page.has_element?(page, ".comment")
  end

  test "a run in another program shows its progress", %{
    studio: studio,
    dataset: dataset,
    study: file
  } do
    {folder, run} = run_experiment(dataset)
    path = ResultsFile.file_path(folder)
    lines = path |> File.read!() |> String.split("\n", trim: true)
    File.write!(path, Enum.map(Enum.take(lines, 5), &["\n", &1, "\n"]))
    :ok = RunRecord.write_run(folder, %{run | "status" => "running"})
    page = open_run(studio)
    assert Page.render(page) =~ "Running: 5 of 12 results, about "
    assert Page.has_element?(page, "progress")
    # The page reads the files again when they change.
    before = Experiments.stamp_files(file)
    File.write!(path, Enum.map(lines, &["\n", &1, "\n"]))
    assert Experiments.stamp_files(file) != before
    Page.send_info(page, :refresh)
    assert eventually(fn -> Page.render(page) =~ "Running: 12 of 12 results" end)
  end

  test "the report is a page, or Markdown", %{studio: studio, dataset: dataset} do
    {_, run} = run_experiment(dataset)
    query = %{"dataset" => "study.json", "run" => run["run"]}

    call = fn query ->
      ExperimentReport.call(%Request{method: "GET", path: "/", query: query}, studio)
    end

    assert %Response{status: 200, body: body} = call.(Map.put(query, "format", "html"))
    assert IO.iodata_to_binary(body) =~ "<svg"
    assert %Response{status: 200, body: body} = call.(Map.put(query, "format", "markdown"))
    assert IO.iodata_to_binary(body) =~ "| * | 3 |"

    for wrong <- [
          %{},
          %{query | "run" => "no"},
          %{query | "dataset" => "early.0000"},
          %{query | "run" => ["x"]}
        ],
        do: assert(%Response{status: 404} = call.(wrong))
  end
end
