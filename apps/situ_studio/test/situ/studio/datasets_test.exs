defmodule Situ.Studio.DatasetsTest do
  use ExUnit.Case, async: false
  import Situ.Test.Eventually

  alias Situ.Live.Test, as: Page
  alias Situ.{Dataset, Message, Store}
  alias Situ.Studio.{BatchRuns, Catalog, Datasets, StreamOverview, StreamReader}
  alias Situ.Studio.Web.{DatasetView, HomeView}

  @moduletag :tmp_dir
  @s 1_000_000_000

  defmodule Doubled do
    @behaviour Situ.Dataset.Task
    @impl true
    def task do
      %{
        name: "doubled",
        about: "twice",
        output: "Doubled",
        options: [by: [type: :integer, default: 2, doc: "By how much."]]
      }
    end

    @impl true
    def build(_p, opts) do
      if opts[:session].name == "bad", do: raise("no such session")
      "Level" |> opts[:open].() |> Situ.map(&(&1 * opts[:by])) |> opts[:write].("Level")
    end
  end

  # The task stays in the application's list. Tests in this file run in sequence, and other tests
  # use no tasks.
  setup_all do
    tasks = Application.get_env(:situ_dataset, :dataset_tasks)
    Application.put_env(:situ_dataset, :dataset_tasks, [Doubled | tasks])
    on_exit(fn -> Application.put_env(:situ_dataset, :dataset_tasks, tasks) end)
  end

  setup %{tmp_dir: dir, test: test} do
    dir = Path.expand(dir)
    studio = to_string(test)

    start_supervised!(
      {DynamicSupervisor, name: Catalog.watch_supervisor(studio), strategy: :one_for_one}
    )

    start_supervised!({Catalog, id: studio, path: dir, layouts: Path.join(dir, "layouts")})
    start_supervised!({BatchRuns, id: studio})
    file = Path.join(dir, "study.json")
    {:ok, dataset} = Dataset.new("Study", file: file, autosave: true)

    for {session, start} <- [{"a/b", 10}, {"bad", 20}, {"c", 30}], reduce: dataset do
      dataset ->
        path = record(dir, "room-#{start}", start)
        {:ok, dataset} = Dataset.add_session(dataset, session, tags: ["t#{start}"])
        {:ok, dataset} = Dataset.add_partition(dataset, session, "Room", path)
        dataset
    end

    %{dir: dir, studio: studio, study: file}
  end

  defp record(dir, name, start) do
    {:ok, writer} = Store.Writer.create(name, dir)
    {:ok, out} = Store.Writer.stream(writer, "Level", type: :integer)

    rows =
      for i <- 0..9,
          do: %Message{data: i, originating_time: (start + i) * @s, sequence_id: i + 1}

    {:ok, out} = Store.Writer.append(out, rows)
    {:ok, _} = Store.Writer.close_stream(out, (start + 10) * @s)
    :ok = Store.Writer.close(writer)
    writer.path
  end

  test "returns the number of sessions of a dataset, or an error", %{
    study: study,
    dir: dir
  } do
    assert %{sessions: 3, error: nil} = Datasets.Summary.of_dataset(study)
    broken = Path.join(dir, "broken.json")
    File.write!(broken, "{")
    assert %{sessions: nil, error: %Situ.Error{}} = Datasets.Summary.of_dataset(broken)
  end

  test "the catalog lists a dataset and opens its sessions and recordings", %{studio: studio} do
    assert %{kind: :dataset} = Enum.find(Catalog.list(studio), &(&1.id == "study.json"))
    assert {:error, %{code: :is_dataset}} = Catalog.open_source(studio, "study.json")

    for id <- ["study.json/a%2Fb", "study.json/a%2Fb/Room"] do
      assert {:ok, item, source} = Catalog.open_source(studio, id)
      assert item.dataset == "study.json"
      assert {:ok, %{from: from}} = StreamReader.fetch_extent(source)
      assert from == 10 * @s
    end

    for id <- ["study.json/none", "study.json/c/none", "none.json/c", "study.json/../c"],
        do: assert({:error, %{code: :not_found}} = Catalog.open_source(studio, id))
  end

  test "opening a dataset that is already open reads its file", %{studio: studio, study: file} do
    {:ok, server} = Datasets.open_server(studio, file)
    {:ok, other} = Dataset.load(file, autosave: true)
    {:ok, _} = Dataset.add_session(other, "from elsewhere")
    assert {:ok, ^server} = Datasets.open_server(studio, file)
    assert {:ok, _} = Dataset.session(Dataset.Server.get_dataset(server), "from elsewhere")
  end

  test "a session of two recordings has the streams of both on one time axis", context do
    %{studio: studio, study: file, dir: dir} = context
    {:ok, server} = Datasets.open_server(studio, file)
    path = record(dir, "late", 100)
    {:ok, _} = Datasets.edit(server, &Dataset.add_partition(&1, "c", "Late", path))
    assert_receive {:situ_dataset, ^server, _}, 30_000
    {:ok, item, source} = Catalog.open_source(studio, "study.json/c")
    assert item.kind == :session
    assert {:ok, %{from: from, to: to, live: false}} = StreamReader.fetch_extent(source)
    assert {from, to} == {30 * @s, 109 * @s}
    {:ok, streams} = StreamOverview.list_streams(source)
    assert Enum.map(streams, & &1.name) == ["Late.Level", "Room.Level"]
    {:ok, message} = StreamReader.latest_at(source, "Late.Level", 103 * @s)
    assert message.data == 3
    assert {:error, %{code: :no_stream}} = StreamReader.latest_at(source, "Level", 103 * @s)
    # A missing recording is reported, and the rest remains.
    Store.delete(path)
    {:ok, _, source} = Catalog.open_source(studio, "study.json/c/Room")
    assert {:ok, [%{name: "Level"}]} = StreamOverview.list_streams(source)
    assert {:error, %{code: :no_store}} = Catalog.open_source(studio, "study.json/c/Late")
  end

  test "an edit starts from the current content of the file", %{studio: studio, study: file} do
    {:ok, server} = Datasets.open_server(studio, file)
    {:ok, other} = Dataset.load(file, autosave: true)
    {:ok, _} = Dataset.add_session(other, "from elsewhere")
    {:ok, dataset} = Datasets.edit(server, &Dataset.add_session(&1, "mine"))
    assert ["from elsewhere", "mine"] = dataset.sessions |> Enum.map(& &1.name) |> Enum.take(-2)
  end

  test "a batch run adds its output, reports failures, and notifies subscribers", context do
    %{studio: studio, study: file} = context
    {:ok, server} = Datasets.open_server(studio, file)
    assert BatchRuns.subscribe(studio, file) == []
    all = ["a/b", "bad", "c"]
    assert {:ok, 1} = BatchRuns.start_run(studio, {server, file}, "doubled", all, %{"by" => 3})
    assert_receive {:batch, ^file, [%{status: :failed} = run]}, 60_000
    assert [{"bad", _}] = Situ.Dataset.Derivation.Report.failures(run.report)
    {:ok, saved} = Situ.Dataset.load(file)
    {:ok, c} = Situ.Dataset.session(saved, "c")
    {:ok, made} = Situ.Dataset.Session.fetch_partition(c, "Doubled")

    assert %{"task" => "doubled", "options" => %{"by" => 3}, "code" => code} =
             made.extra["provenance"]

    assert code =~ ~r/\A[0-9a-f]{64}\z/
    {:ok, _, source} = Catalog.open_source(studio, "study.json/c/Doubled")
    {:ok, message} = StreamReader.latest_at(source, "Level", 35 * @s)
    assert message.data == 15

    for {config, sessions, code} <- [
          {%{"by" => "x"}, all, :bad_option},
          {%{"bye" => 1}, all, :unknown_option},
          {%{}, [], :no_session},
          {%{}, ["c"], nil}
        ] do
      case BatchRuns.start_run(studio, {server, file}, "doubled", sessions, config) do
        {:error, error} -> assert error.code == code
        {:ok, _} -> assert code == nil
      end
    end

    # The first run had failures, so this run keeps its results. The next run starts over and
    # finds the output there.
    assert_receive {:batch, _,
                    [%{id: 2, status: :done, report: %{results: [%{status: :kept}]}} | _]},
                   60_000

    {:ok, 3} = BatchRuns.start_run(studio, {server, file}, "doubled", ["c"], %{})
    assert_receive {:batch, _, [%{id: 3, error: %{code: :partition_exists}} | _]}, 60_000
  end

  test "offers to continue an interrupted run, and completes the remaining sessions", context do
    %{studio: studio, study: file, dir: dir} = context
    sessions = ["a/b", "c"]
    done = Path.join(dir, "Doubled.0007")
    # A killed studio leaves these files.
    File.rename!(record(dir, "Doubled", 10), done)

    File.write!(
      file <> ".Doubled.batch",
      Situ.JSON.encode(%{
        task: "doubled",
        output: "Doubled",
        sessions: sessions,
        config: %{by: 5},
        pid: "999999999"
      })
    )

    File.write!(file <> ".Doubled.run", Situ.JSON.encode(%{done: "a/b", path: done}) <> "\n")
    page = mount(studio)
    assert Page.text(page, ".runs") =~ "Interrupted when its studio stopped, with 2"
    BatchRuns.subscribe(studio, file)
    Page.send_event(page, "run_continue", %{"output" => "Doubled"})
    assert_receive {:batch, ^file, [%{status: :done, report: %{results: results}}]}, 60_000
    assert Enum.map(results, &{&1.session, &1.status}) == [{"a/b", :kept}, {"c", :done}]
    {:ok, _, source} = Catalog.open_source(studio, "study.json/c/Doubled")
    assert {:ok, %{data: 25}} = StreamReader.latest_at(source, "Level", 35 * @s)
    refute File.exists?(file <> ".Doubled.batch")
    assert Page.count_elements(page, ".run.left") == 0
  end

  test "the page edits the tree and ignores invalid events", %{studio: studio, study: file} do
    page = mount(studio)
    assert Page.count_elements(page, "#tree .session") == 3
    Page.send_event(page, "search", %{"query" => "t20"})
    assert Page.count_elements(page, "#tree .session") == 1
    Page.send_event(page, "search", %{"query" => ""})
    Page.send_event(page, "ask", %{"what" => "session", "path" => []})
    Page.send_event(page, "answer", %{"text" => " new "})
    assert Page.count_elements(page, "#tree .session") == 4
    Page.send_event(page, "remove", %{"path" => ["new"]})
    assert Page.count_elements(page, "#tree .session") == 3
    Page.send_event(page, "select", %{"path" => ~s(["c"])})
    Page.send_event(page, "save_properties", %{"tags" => "x, y", "metadata" => "age: 7"})
    {:ok, saved} = Dataset.load(file)
    assert %{tags: ["x", "y"], metadata: %{"age" => 7}} = List.last(saved.sessions)

    assert eventually(fn -> Page.count_elements(page, "#tree .session img") == 3 end)

    # Events that the studio's pages never send change nothing and stop nothing.
    for {event, params} <- [
          {"answer", %{}},
          {"answer", %{"text" => "x"}},
          {"remove", %{"path" => [1, nil]}},
          {"toggle", %{"path" => %{}}},
          {"task", %{"task" => "none", "path" => []}},
          {"run_start", %{}},
          {"run_cancel", %{"run" => "x"}},
          {"delete", %{"path" => ["c", "none"]}},
          {"nothing", %{}}
        ] do
      Page.send_event(page, event, params)
    end

    assert Page.count_elements(page, "#tree .session") == 3
  end

  test "turns folders into sessions, and reports existing ones", context do
    %{studio: studio, study: file, dir: dir} = context
    record(Path.join(dir, "day 1/am"), "x", 100)
    record(Path.join(dir, "day 1/pm"), "y", 200)
    record(Path.join(dir, "day 1/c"), "z", 300)
    Catalog.invalidate_recordings(studio)
    page = mount(studio)

    add = fn what, path, folder ->
      Page.send_event(page, "folders", %{"what" => what, "path" => path})
      Page.send_event(page, "add_folder", %{"folder" => folder})
      {:ok, dataset} = Dataset.load(file)
      {List.last(Page.take_pushed_events(page, "toast"))["text"], dataset}
    end

    assert {"2 sessions added; already present: c", dataset} = add.("sessions", [], "day 1")
    assert Enum.map(dataset.sessions, & &1.name) == ["a/b", "bad", "c", "am", "pm"]
    assert {"1 recording added", dataset} = add.("recordings", ["c"], "day 1/c")
    assert Enum.map(Enum.at(dataset.sessions, 2).partitions, & &1.name) == ["Room", "z"]
    assert {"0 sessions added; already present: " <> _, ^dataset} = add.("session", [], "day 1")
    # The folder is not below the studio's folder.
    assert {_, ^dataset} = add.("session", [], "../..")
  end

  test "deletes recordings with their session or everywhere, unless other sessions use them",
       context do
    %{studio: studio, study: file, dir: dir} = context
    {:ok, server} = Datasets.open_server(studio, file)
    shared = Path.join(dir, "room-30.0000")
    {:ok, _} = Datasets.edit(server, &Dataset.add_partition(&1, "a/b", "Shared", shared))
    page = mount(studio)
    Page.send_event(page, "delete", %{"path" => ["c"]})

    assert List.last(Page.take_pushed_events(page, "toast"))["text"] =~
             "other sessions use its recording"

    assert Store.exists?(shared)
    Page.send_event(page, "delete", %{"path" => ["bad", "Room"]})
    refute Store.exists?(Path.join(dir, "room-20.0000"))
    Page.send_event(page, "delete", %{"path" => ["a/b"]})
    assert List.last(Page.take_pushed_events(page, "toast"))["text"] =~ "other sessions"
    Page.send_event(page, "remove", %{"path" => ["a/b", "Shared"]})
    Page.send_event(page, "delete_all", %{"path" => ["c", "Room"]})
    refute Store.exists?(shared)
    refute Store.exists?(Path.join(dir, "room-10.0000"))
    {:ok, dataset} = Dataset.load(file)

    assert for(s <- dataset.sessions, do: {s.name, s.partitions}) == [
             {"a/b", []},
             {"bad", []},
             {"c", []}
           ]
  end

  test "does not delete a file that is not a recording", context do
    %{studio: studio, study: file, dir: dir} = context
    letter = Path.join(dir, "letter.txt")
    File.write!(letter, "dear")
    {:ok, server} = Datasets.open_server(studio, file)
    {:ok, _} = Datasets.edit(server, &Dataset.add_partition(&1, "c", "Letter", letter))
    page = mount(studio)
    Page.send_event(page, "delete", %{"path" => ["c", "Letter"]})
    assert List.last(Page.take_pushed_events(page, "toast"))["text"] =~ "letter.txt"
    assert File.read!(letter) == "dear"
    Page.send_event(page, "delete", %{"path" => ["c"]})
    assert File.exists?(letter) and Store.exists?(Path.join(dir, "room-30.0000"))
  end

  test "replaces a moved recording, and saves a copy once", context do
    %{studio: studio, study: file, dir: dir} = context
    Store.rename(Path.join(dir, "room-30.0000"), "moved")
    Catalog.invalidate_recordings(studio)
    page = mount(studio)
    Page.send_event(page, "relocate", %{"path" => ["c", "Room"]})
    Page.send_event(page, "take", %{"chosen" => "moved.0000"})
    {:ok, dataset} = Dataset.load(file)
    assert [%{name: "Room", path: path}] = List.last(dataset.sessions).partitions
    assert path == Path.join(dir, "moved.0000")

    for {name, said} <- [
          {"../escaped", "not a valid file name"},
          {"copy", nil},
          {"copy.json", "already"}
        ] do
      Page.send_event(page, "ask", %{"what" => "copy", "path" => []})
      Page.send_event(page, "answer", %{"text" => name})
      if said, do: assert(List.last(Page.take_pushed_events(page, "toast"))["text"] =~ said)
    end

    assert Page.take_pushed_events(page, "go") == [%{"href" => "d/copy.json"}]
    assert {:ok, %{sessions: [_, _, _]}} = Dataset.load(Path.join(dir, "copy.json"))
  end

  test "the list creates a dataset, and shows what each entry is", context do
    %{studio: studio, dir: dir} = context
    File.write!(Path.join(dir, "broken.wav"), "no sound")
    record(dir, "room-10.0000-annotation-Speech", 10)

    home = fn session ->
      Page.mount(HomeView, path: "/", session: Map.put(session, "studio", studio))
    end

    page = home.(%{})
    assert eventually(fn -> Page.text(page, ".list") =~ "cannot be opened" end)
    assert Page.text(page, ".item[href='s/broken.wav'] .dim") =~ ~r/^recording\d{4}-/
    assert Page.text(page, ".list") =~ "annotations of room-10.0000"
    Page.send_event(page, "new_dataset", %{"name" => "Second/study"})
    assert Page.take_pushed_events(page, "go") == []
    Page.send_event(page, "new_dataset", %{"name" => "Second study"})
    assert Page.take_pushed_events(page, "go") == [%{"href" => "d/Second%20study.json"}]

    assert {:ok, %{name: "Second study", sessions: []}} =
             Dataset.load(Path.join(dir, "Second study.json"))

    # Viewers cannot create a dataset.
    viewer = home.(%{"viewer" => true})
    assert Page.count_elements(viewer, "#new-dataset") == 0
    Page.send_event(viewer, "new_dataset", %{"name" => "Third"})
    refute File.exists?(Path.join(dir, "Third.json"))
  end

  defp mount(studio) do
    Page.mount(DatasetView,
      path: "/d/study.json",
      params: %{"id" => ["study.json"]},
      session: %{"studio" => studio}
    )
  end
end
