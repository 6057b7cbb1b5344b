defmodule Situ.Studio.DatasetsTest do
  use ExUnit.Case, async: false
  import Situ.Test.Eventually

  alias Situ.Live.Test, as: Page
  alias Situ.{Dataset, Message, Store}
  alias Situ.Studio.{Batch, Catalog, Datasets, Source}
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

  # Stays in the application's list: tests of this file run one after another, others need no tasks.
  setup_all do
    tasks = Application.get_env(:situ_dataset, :dataset_tasks)
    Application.put_env(:situ_dataset, :dataset_tasks, [Doubled | tasks])
    on_exit(fn -> Application.put_env(:situ_dataset, :dataset_tasks, tasks) end)
  end

  setup %{tmp_dir: dir, test: test} do
    dir = Path.expand(dir)
    studio = to_string(test)

    start_supervised!({DynamicSupervisor, name: Catalog.watches(studio), strategy: :one_for_one})

    start_supervised!({Catalog, id: studio, path: dir, layouts: Path.join(dir, "layouts")})
    start_supervised!({Batch, id: studio})
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

  test "a list tells how many sessions a dataset has, or why it cannot be read", %{
    study: study,
    dir: dir
  } do
    assert %{sessions: 3, error: nil} = Datasets.Facts.of_dataset(study)
    broken = Path.join(dir, "broken.json")
    File.write!(broken, "{")
    assert %{sessions: nil, error: %Situ.Error{}} = Datasets.Facts.of_dataset(broken)
  end

  test "the catalog lists a dataset and opens its sessions and recordings", %{studio: studio} do
    assert %{kind: :dataset} = Enum.find(Catalog.list(studio), &(&1.id == "study.json"))
    assert {:error, %{code: :is_dataset}} = Catalog.open(studio, "study.json")

    for id <- ["study.json/a%2Fb", "study.json/a%2Fb/Room"] do
      assert {:ok, item, source} = Catalog.open(studio, id)
      assert item.dataset == "study.json"
      assert {:ok, %{from: from}} = Source.call(source, :extent, [])
      assert from == 10 * @s
    end

    for id <- ["study.json/none", "study.json/c/none", "none.json/c", "study.json/../c"],
        do: assert({:error, %{code: :not_found}} = Catalog.open(studio, id))
  end

  test "a session of two recordings has the streams of both on one axis", context do
    %{studio: studio, study: file, dir: dir} = context
    {:ok, server} = Datasets.open(studio, file)
    path = record(dir, "late", 100)
    {:ok, _} = Datasets.edit(server, file, &Dataset.add_partition(&1, "c", "Late", path))
    assert_receive {:situ_dataset, ^server, _}, 30_000
    {:ok, item, source} = Catalog.open(studio, "study.json/c")
    assert item.kind == :session
    assert {:ok, %{from: from, to: to, live: false}} = Source.call(source, :extent, [])
    assert {from, to} == {30 * @s, 109 * @s}
    {:ok, streams} = Source.call(source, :streams, [])
    assert Enum.map(streams, & &1.name) == ["Late.Level", "Room.Level"]
    {:ok, message} = Source.call(source, :latest_at, ["Late.Level", 103 * @s])
    assert message.data == 3
    assert {:error, %{code: :no_stream}} = Source.call(source, :latest_at, ["Level", 103 * @s])
    # one that goes missing is said, the rest stays
    Store.delete(path)
    {:ok, _, source} = Catalog.open(studio, "study.json/c/Room")
    assert {:ok, [%{name: "Level"}]} = Source.call(source, :streams, [])
    assert {:error, %{code: :no_store}} = Catalog.open(studio, "study.json/c/Late")
  end

  test "an edit begins with what stands in the file", %{studio: studio, study: file} do
    {:ok, server} = Datasets.open(studio, file)
    {:ok, other} = Dataset.load(file, autosave: true)
    {:ok, _} = Dataset.add_session(other, "from elsewhere")
    {:ok, dataset} = Datasets.edit(server, file, &Dataset.add_session(&1, "mine"))
    assert ["from elsewhere", "mine"] = dataset.sessions |> Enum.map(& &1.name) |> Enum.take(-2)
  end

  test "a batch run adds its output, names what failed, and is told of", context do
    %{studio: studio, study: file} = context
    {:ok, server} = Datasets.open(studio, file)
    assert Batch.subscribe(studio, file) == []
    all = ["a/b", "bad", "c"]
    assert {:ok, 1} = Batch.start(studio, {server, file}, "doubled", all, %{"by" => 3})
    assert_receive {:batch, ^file, [%{status: :failed} = run]}, 60_000
    assert [{"bad", _}] = Situ.Dataset.Derivation.Report.failures(run.report)
    {:ok, _, source} = Catalog.open(studio, "study.json/c/Doubled")
    {:ok, message} = Source.call(source, :latest_at, ["Level", 35 * @s])
    assert message.data == 15

    for {config, sessions, code} <- [
          {%{"by" => "x"}, all, :bad_option},
          {%{"bye" => 1}, all, :unknown_option},
          {%{}, [], :no_session},
          {%{}, ["c"], nil}
        ] do
      case Batch.start(studio, {server, file}, "doubled", sessions, config) do
        {:error, error} -> assert error.code == code
        {:ok, _} -> assert code == nil
      end
    end

    # the earlier run had failures: this one keeps what that did; the next begins anew, and finds it there
    assert_receive {:batch, _,
                    [%{id: 2, status: :done, report: %{results: [%{status: :kept}]}} | _]},
                   60_000

    {:ok, 3} = Batch.start(studio, {server, file}, "doubled", ["c"], %{})
    assert_receive {:batch, _, [%{id: 3, error: %{code: :partition_exists}} | _]}, 60_000
  end

  test "a run that ended with its studio is offered again, and does what is not done", context do
    %{studio: studio, study: file, dir: dir} = context
    sessions = ["a/b", "c"]
    done = Path.join(dir, "Doubled.0007")
    # as a studio that was killed leaves it
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
    assert Page.text(page, ".runs") =~ "Ended with the studio that ran it, over 2"
    Batch.subscribe(studio, file)
    Page.event(page, "run_continue", %{"output" => "Doubled"})
    assert_receive {:batch, ^file, [%{status: :done, report: %{results: results}}]}, 60_000
    assert Enum.map(results, &{&1.session, &1.status}) == [{"a/b", :kept}, {"c", :done}]
    {:ok, _, source} = Catalog.open(studio, "study.json/c/Doubled")
    assert {:ok, %{data: 25}} = Source.call(source, :latest_at, ["Level", 35 * @s])
    refute File.exists?(file <> ".Doubled.batch")
    assert Page.count(page, ".run.left") == 0
  end

  test "the page: tree, search, edits, and what may not be", %{studio: studio, study: file} do
    page = mount(studio)
    assert Page.count(page, "#tree .session") == 3
    Page.event(page, "search", %{"query" => "t20"})
    assert Page.count(page, "#tree .session") == 1
    Page.event(page, "search", %{"query" => ""})
    Page.event(page, "ask", %{"what" => "session", "path" => []})
    Page.event(page, "answer", %{"text" => " new "})
    assert Page.count(page, "#tree .session") == 4
    Page.event(page, "remove", %{"path" => ["new"]})
    assert Page.count(page, "#tree .session") == 3
    Page.event(page, "select", %{"path" => ~s(["c"])})
    Page.event(page, "save_properties", %{"tags" => "x, y", "metadata" => "age: 7"})
    {:ok, saved} = Dataset.load(file)
    assert %{tags: ["x", "y"], metadata: %{"age" => 7}} = List.last(saved.sessions)

    assert eventually(fn -> Page.count(page, "#tree .session img") == 3 end)

    # what no page of ours sends changes nothing and ends nothing
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
      Page.event(page, event, params)
    end

    assert Page.count(page, "#tree .session") == 3
  end

  test "folders become sessions; what is there already is passed over and told", context do
    %{studio: studio, study: file, dir: dir} = context
    record(Path.join(dir, "day 1/am"), "x", 100)
    record(Path.join(dir, "day 1/pm"), "y", 200)
    record(Path.join(dir, "day 1/c"), "z", 300)
    Catalog.look_again(studio)
    page = mount(studio)

    add = fn what, path, folder ->
      Page.event(page, "folders", %{"what" => what, "path" => path})
      Page.event(page, "add_folder", %{"folder" => folder})
      {:ok, dataset} = Dataset.load(file)
      {List.last(Page.pushed(page, "toast"))["text"], dataset}
    end

    assert {"2 sessions added; there already: c", dataset} = add.("sessions", [], "day 1")
    assert Enum.map(dataset.sessions, & &1.name) == ["a/b", "bad", "c", "am", "pm"]
    assert {"1 recording added", dataset} = add.("recordings", ["c"], "day 1/c")
    assert Enum.map(Enum.at(dataset.sessions, 2).partitions, & &1.name) == ["Room", "z"]
    assert {"0 sessions added; there already: " <> _, ^dataset} = add.("session", [], "day 1")
    # a folder that is none of the studio's
    assert {_, ^dataset} = add.("session", [], "../..")
  end

  test "recordings are deleted with their session, in all sessions, and not while others use them",
       context do
    %{studio: studio, study: file, dir: dir} = context
    {:ok, server} = Datasets.open(studio, file)
    shared = Path.join(dir, "room-30.0000")
    {:ok, _} = Datasets.edit(server, file, &Dataset.add_partition(&1, "a/b", "Shared", shared))
    page = mount(studio)
    Page.event(page, "delete", %{"path" => ["c"]})
    assert List.last(Page.pushed(page, "toast"))["text"] =~ "other sessions use its recording"
    assert Store.exists?(shared)
    Page.event(page, "delete", %{"path" => ["bad", "Room"]})
    refute Store.exists?(Path.join(dir, "room-20.0000"))
    Page.event(page, "delete", %{"path" => ["a/b"]})
    assert List.last(Page.pushed(page, "toast"))["text"] =~ "other sessions"
    Page.event(page, "remove", %{"path" => ["a/b", "Shared"]})
    Page.event(page, "delete_all", %{"path" => ["c", "Room"]})
    refute Store.exists?(shared)
    refute Store.exists?(Path.join(dir, "room-10.0000"))
    {:ok, dataset} = Dataset.load(file)

    assert for(s <- dataset.sessions, do: {s.name, s.partitions}) == [
             {"a/b", []},
             {"bad", []},
             {"c", []}
           ]
  end

  test "a dataset's page deletes no file that is no recording", context do
    %{studio: studio, study: file, dir: dir} = context
    letter = Path.join(dir, "letter.txt")
    File.write!(letter, "dear")
    {:ok, server} = Datasets.open(studio, file)
    {:ok, _} = Datasets.edit(server, file, &Dataset.add_partition(&1, "c", "Letter", letter))
    page = mount(studio)
    Page.event(page, "delete", %{"path" => ["c", "Letter"]})
    assert List.last(Page.pushed(page, "toast"))["text"] =~ "letter.txt"
    assert File.read!(letter) == "dear"
    Page.event(page, "delete", %{"path" => ["c"]})
    assert File.exists?(letter) and Store.exists?(Path.join(dir, "room-30.0000"))
  end

  test "another recording is taken for one that was moved; a copy is saved once", context do
    %{studio: studio, study: file, dir: dir} = context
    Store.rename(Path.join(dir, "room-30.0000"), "moved")
    Catalog.look_again(studio)
    page = mount(studio)
    Page.event(page, "relocate", %{"path" => ["c", "Room"]})
    Page.event(page, "take", %{"chosen" => "moved.0000"})
    {:ok, dataset} = Dataset.load(file)
    assert [%{name: "Room", path: path}] = List.last(dataset.sessions).partitions
    assert path == Path.join(dir, "moved.0000")

    for {name, said} <- [{"../escaped", "cannot be"}, {"copy", nil}, {"copy.json", "already"}] do
      Page.event(page, "ask", %{"what" => "copy", "path" => []})
      Page.event(page, "answer", %{"text" => name})
      if said, do: assert(List.last(Page.pushed(page, "toast"))["text"] =~ said)
    end

    assert Page.pushed(page, "go") == [%{"href" => "d/copy.json"}]
    assert {:ok, %{sessions: [_, _, _]}} = Dataset.load(Path.join(dir, "copy.json"))
  end

  test "the list makes a dataset, and tells what lies there for what it is", context do
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
    Page.event(page, "new_dataset", %{"name" => "Second/study"})
    assert Page.pushed(page, "go") == []
    Page.event(page, "new_dataset", %{"name" => "Second study"})
    assert Page.pushed(page, "go") == [%{"href" => "d/Second%20study.json"}]

    assert {:ok, %{name: "Second study", sessions: []}} =
             Dataset.load(Path.join(dir, "Second study.json"))

    # those who may only look make none
    viewer = home.(%{"viewer" => true})
    assert Page.count(viewer, "#new-dataset") == 0
    Page.event(viewer, "new_dataset", %{"name" => "Third"})
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
