defmodule Situ.Studio.Annotations.LayersTest do
  # Annotates sessions of a dataset in pages: layers in the tree, edits of other pages, copies, and the next session.
  use ExUnit.Case, async: true

  alias Situ.{Annotation, Dataset, Store}
  alias Situ.Annotation.{Edit, Layer, Recording, Schema}
  alias Situ.Dataset.{OpenSession, SessionLayers}
  alias Situ.Live.Test, as: Page
  alias Situ.Studio.Annotations.{Home, Layers}
  alias Situ.Studio.{Catalog, StreamReader}
  alias Situ.Studio.Datasets.{Deletion, Summary}
  alias Situ.Studio.Web.MainView

  @moduletag :tmp_dir

  setup %{tmp_dir: dir, test: test} do
    room = record(dir, "room", "Level")
    watch = record(dir, "watch", "Pulse")
    file = Path.join(dir, "study.json")
    {:ok, dataset} = Dataset.new("Study", file: file, autosave: true)

    for name <- ["p1", "p2"], reduce: dataset do
      dataset ->
        {:ok, dataset} = Dataset.add_session(dataset, name)
        {:ok, dataset} = Dataset.add_partition(dataset, name, "Room", room)
        {:ok, dataset} = Dataset.add_partition(dataset, name, "Watch", watch)
        dataset
    end

    {:ok, dataset} = Dataset.load(file)
    {:ok, dataset} = Dataset.add_session(dataset, "single")
    {:ok, dataset} = Dataset.add_partition(dataset, "single", "Room", room)
    {:ok, _} = Dataset.save(dataset)

    id = to_string(test)
    supervisor = {DynamicSupervisor, name: Catalog.watch_supervisor(id), strategy: :one_for_one}
    start_supervised!(supervisor)
    start_supervised!({Catalog, id: id, path: dir, layouts: Path.join(dir, "layouts")})
    {:ok, studio: id, study: file}
  end

  defp record(dir, name, stream) do
    {:ok, writer} = Store.Writer.create(name, dir)
    {:ok, out} = Store.Writer.stream(writer, stream, type: :float)
    messages = for t <- 0..9, do: %Situ.Message{data: t / 1, originating_time: t * 1_000}
    {:ok, _} = Store.Writer.append(out, messages)
    :ok = Store.Writer.close(writer)
    Path.join(dir, name <> ".0000")
  end

  defp open(studio, session, params \\ %{}) do
    params = Map.put(params, "id", ["study.json", session])
    path = "/s/study.json/#{session}"
    Page.mount(MainView, path: path, params: params, session: %{"studio" => studio})
  end

  defp create(page, name) do
    Page.send_event(page, "layer_dialog", %{})
    Page.send_event(page, "layer_new", %{"name" => name, "values" => "speaks 1\nlaughs 2"})
  end

  defp add(page, from, to, track) do
    edit = %{"do" => "add", "from" => "#{from}", "to" => "#{to}", "track" => track}
    Page.send_event(page, "annotation_edit", edit)
  end

  defp stored(file, session) do
    {:ok, dataset} = Dataset.load(file)
    {:ok, session} = Dataset.session(dataset, session)
    open = OpenSession.open(session)

    for %{partition: partition, stream: name, editable?: true} <- SessionLayers.list_layers(open),
        into: %{} do
      {:ok, store} = OpenSession.fetch_store(open, partition)
      {:ok, layer} = Recording.load_layer(store, name)
      {name, for(a <- Layer.annotations(layer), do: {a.track, a.from, a.to})}
    end
  end

  test "a session of several recordings is annotated, and other pages see it",
       %{studio: studio, study: file} do
    [page, other] = [open(studio, "p1"), open(studio, "p1")]
    create(page, "Speech")
    add(page, 1_000, 2_000, "Ada")
    add(page, 3_000, 4_000, "Ben")
    node = "#tree .node[data-stream='Annotations.Speech']"
    assert Page.has_element?(other, node)
    # The edits are in the stream before they are saved.
    {:ok, _, source} = Catalog.open_source(studio, "study.json/p1")
    {:ok, messages, :all} = StreamReader.read_messages(source, "Annotations.Speech", 0, 9_000, 10)
    assert [[%{track: "Ada"}], [%{track: "Ben"}]] = Enum.map(messages, & &1.data)
    # The names of the recordings' streams are unchanged.
    assert Page.has_element?(other, "#tree .node[data-stream='Room.Level']")
    Page.send_event(page, "annotation_edit", %{"do" => "save"})
    assert stored(file, "p1") == %{"Speech" => [{"Ada", 1_000, 2_000}, {"Ben", 3_000, 4_000}]}
    assert stored(file, "p2") == %{}
  end

  test "the history of a layer lists its edits and restores a version", %{
    studio: studio,
    study: file
  } do
    page = open(studio, "p1")
    create(page, "Speech")
    add(page, 1_000, 2_000, "Ada")
    add(page, 3_000, 4_000, "Ben")
    Page.send_event(page, "annotation_history", %{})
    assert Page.has_element?(page, "#history button[phx-value-version='1']")
    Page.send_event(page, "annotation_history_restore", %{"version" => "1"})
    refute Page.has_element?(page, "#history")
    Page.send_event(page, "annotation_edit", %{"do" => "save"})
    assert stored(file, "p1") == %{"Speech" => [{"Ada", 1_000, 2_000}]}
    Page.send_event(page, "annotation_edit", %{"do" => "undo"})
    Page.send_event(page, "annotation_edit", %{"do" => "save"})
    assert stored(file, "p1") == %{"Speech" => [{"Ada", 1_000, 2_000}, {"Ben", 3_000, 4_000}]}
  end

  test "a session of one recording keeps the names of its streams", %{studio: studio, study: file} do
    page = open(studio, "single")
    create(page, "Speech")
    add(page, 1_000, 2_000, "Ada")
    Page.send_event(page, "annotation_edit", %{"do" => "save"})
    assert %{"Speech" => [_]} = stored(file, "single")
    again = open(studio, "single")
    assert Page.has_element?(again, "#tree .node[data-stream='Level']")
    assert Page.has_element?(again, "#tree .node[data-stream='Annotations.Speech']")
  end

  test "a session of one recording includes the layers next to the recording",
       %{studio: studio, study: file} do
    params = %{"id" => ["room.0000"]}
    session = %{"studio" => studio}
    page = Page.mount(MainView, path: "/s/room.0000", params: params, session: session)
    create(page, "Earlier")
    {:ok, item} = Catalog.fetch_item(studio, "study.json/single")
    assert Layers.list_names(item) == ["Earlier"]
    page = open(studio, "single", %{"annotate" => "Earlier"})
    add(page, 1_000, 2_000, "Ada")
    {:ok, layer} = Layers.read_layer(studio, item, "Earlier")
    assert [%{track: "Ada"}] = Layer.annotations(layer)
    assert stored(file, "single") == %{}
    create(page, "Speech")
    assert Layers.list_names(item) == ["Earlier", "Speech"]
    assert stored(file, "single") == %{"Speech" => []}
  end

  test "each annotator has a layer", %{studio: studio, study: file} do
    page = open(studio, "p1")
    Page.send_event(page, "layer_new", %{"name" => "Turns", "values" => "a 1", "by" => "Ada"})
    other = open(studio, "p1")
    Page.send_event(other, "layer_own", %{"stream" => "Turns.Ada", "by" => "Ben"})
    assert Page.get_attribute(other, "#studio", "data-annotate") == "Turns.Ben"
    assert Map.keys(stored(file, "p1")) == ["Turns.Ada", "Turns.Ben"]
    Page.send_event(other, "layer_own", %{"stream" => "Turns.Ben", "by" => "Ben"})
    assert Map.keys(stored(file, "p1")) == ["Turns.Ada", "Turns.Ben"]
  end

  test "a layer of another partition is copied", %{studio: studio, study: file, tmp_dir: dir} do
    {:ok, empty} = Layer.new(Schema.finite("Speech", ["speaks"]))
    {:ok, found, _} = Edit.add_proposals(empty, [Annotation.new(0, 5_000, "Ada")])
    {:ok, path} = Recording.write(found, Path.join(dir, "Detected"), "Speech")
    {:ok, dataset} = Dataset.load(file)
    {:ok, dataset} = Dataset.add_partition(dataset, "p1", "Detected", path)
    {:ok, _} = Dataset.save(dataset)
    {:ok, item} = Catalog.fetch_item(studio, "study.json/p1")
    assert Layers.list_foreign(item) == [{"Detected", "Speech"}]
    page = open(studio, "p1")
    Page.send_event(page, "layer_dialog", %{})
    assert Page.has_element?(page, "#annotation-dialog .foreign button")
    Page.send_event(page, "layer_copy", %{"partition" => "Detected", "stream" => "Speech"})
    Page.send_event(page, "annotation_edit", %{"do" => "accept", "id" => 1, "by" => "Ada"})
    {:ok, item} = Catalog.fetch_item(studio, "study.json/p1")
    {:ok, layer} = Layers.read_layer(studio, item, "Speech")
    assert [%{proposed?: false, by: "Ada"}] = Layer.annotations(layer)
    assert %{total: 1, accepted: 1} = Layer.review_progress(layer)
    {:ok, original} = Recording.load_layer(Store.open!(path), "Speech")
    assert [%{proposed?: true}] = Layer.annotations(original)
  end

  test "the next session offers the same layer", %{studio: studio, study: file} do
    create(open(studio, "p1"), "Speech")
    params = %{"annotate" => "Speech", "previous" => "study.json/p1"}
    page = open(studio, "p2", params)
    assert Page.has_element?(page, "#annotation-dialog")
    Page.send_event(page, "layer_continue", %{})
    refute Page.has_element?(page, "#annotation-dialog")
    assert Page.get_attribute(page, "#studio", "data-annotate") == "Speech"
    assert Map.keys(stored(file, "p2")) == ["Speech"]
    # The address is untrusted.
    for bad <- ["study.json/p3", "../x", %{}, "study.json"] do
      page = open(studio, "p2", %{"annotate" => "Other", "previous" => bad})
      refute Page.has_element?(page, "#annotation-dialog")
    end
  end

  test "a session is deleted with all versions of its layers", %{studio: studio, study: file} do
    page = open(studio, "p1")
    create(page, "Speech")
    add(page, 1_000, 2_000, "Ada")
    Page.send_event(page, "annotation_edit", %{"do" => "save"})
    {:ok, dataset} = Dataset.load(file)
    {:ok, session} = Dataset.session(dataset, "p1")
    {:ok, partition} = Dataset.Session.fetch_partition(session, "Annotations")
    folder = Path.dirname(partition.path)
    assert Enum.sort(Store.list(folder)) == for(n <- 0..1, do: "#{partition.path}.000#{n}")
    # The facts about the newest version change with every save.
    stamp = Summary.file_stamp(partition.path)
    assert is_tuple(stamp)

    assert %{error: nil, streams: [%{name: "Speech", count: 1}]} =
             Summary.of_recording(partition.path)

    assert :ok = Deletion.delete_partitions(dataset, [{"p1", partition}])
    assert Store.list(folder) == []
  end

  test "a read-only dataset is refused with a reason", %{studio: studio, tmp_dir: dir} do
    {:ok, dataset} = Dataset.load(Path.join(dir, "study.json"))
    assert Home.session_home(%{dataset | file: nil}, "p1") == nil
    {:ok, item} = Catalog.fetch_item(studio, "study.json/p1")
    refute Situ.Studio.Web.AnnotationPanel.available?(%{read_only: true, item: item})
    assert Layers.list_names(%{item | layers: nil}) == []
  end
end
