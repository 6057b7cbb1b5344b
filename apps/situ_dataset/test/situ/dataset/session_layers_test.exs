defmodule Situ.Dataset.SessionLayersTest do
  # Creates annotation layers of sessions, from one program and from two at the same time.
  use ExUnit.Case, async: true
  import Situ.Dataset.Test.Study
  import Situ.Annotation.Test.Annotating, only: [schema: 0, layer: 1]

  alias Situ.{Annotation, Dataset, Store}
  alias Situ.Annotation.{Editor, Layer, Recording}
  alias Situ.Dataset.{Checksum, OpenSession, Partition, Session, SessionLayers}

  doctest Situ.Dataset.SessionLayers

  @moduletag :tmp_dir

  setup context do
    case context do
      %{tmp_dir: root} -> {:ok, dataset: study(root)}
      _doctest -> :ok
    end
  end

  defp study(root) do
    room = record(root, "room", %{"Level" => ten(0)})
    {:ok, dataset} = Dataset.new("Study", file: Path.join(root, "study.json"), autosave: true)
    {:ok, dataset} = Dataset.add_session(dataset, "p01")
    {:ok, dataset} = Dataset.add_partition(dataset, "p01", "Room", room)
    # A session may have the name of a recording's folder.
    {:ok, dataset} = Dataset.add_session(dataset, "room.0000")
    dataset
  end

  defp empty do
    {:ok, layer} = Layer.new(schema())
    layer
  end

  defp list(dataset, name) do
    {:ok, session} = Dataset.session(dataset, name)
    session |> OpenSession.open() |> SessionLayers.list_layers()
  end

  test "a session has one layer per annotator, in its own store", %{dataset: dataset} do
    {:ok, dataset} = SessionLayers.create_layer(dataset, "p01", "Speech.Ada", empty())
    {:ok, dataset} = SessionLayers.create_layer(dataset, "p01", "Speech.Ben", empty())
    {:ok, path} = SessionLayers.store_path(dataset, "p01")

    for {name, from} <- [{"Speech.Ada", 0}, {"Speech.Ben", 50}] do
      {:ok, editor} = Editor.start_link(path: path, stream: name)
      {:ok, _} = Editor.edit(editor, &Layer.add(&1, Annotation.new(from, from + 10, "A")))
      {:ok, _} = Editor.save(editor)
    end

    # Another program reads the file and finds the newest version of both layers.
    {:ok, again} = Dataset.load(dataset.file)
    {:ok, session} = Dataset.session(again, "p01")
    open = OpenSession.open(session)
    assert open.troubles == []
    assert Enum.map(SessionLayers.list_layers(open), & &1.stream) == ["Speech.Ada", "Speech.Ben"]
    {:ok, messages} = OpenSession.messages(open, "Speech.Ben")
    assert [[%Annotation{from: 50, to: 60}]] = Enum.map(messages, & &1.data)
    assert Dataset.troubles(again) == []
  end

  test "a layer is created once, and a failed session is not changed", %{dataset: dataset} do
    {:ok, dataset} = SessionLayers.create_layer(dataset, "p01", "Speech", empty())

    assert {:error, %{code: :layer_exists}} =
             SessionLayers.create_layer(dataset, "p01", "Speech", layer([{0, 5, "A", "laughs"}]))

    assert {:error, %{code: :no_session}} =
             SessionLayers.create_layer(dataset, "p02", "Speech", empty())

    assert {:error, %{code: :bad_name}} =
             SessionLayers.create_layer(dataset, "p01", "[x]", empty())

    assert {:error, %{code: :no_file, fix: fix}} =
             SessionLayers.create_layer(%{dataset | file: nil}, "room.0000", "Speech", empty())

    assert fix =~ "save a copy"
  end

  test "the store is never inside a recording, and follows a renamed session",
       %{dataset: dataset, tmp_dir: root} do
    {:ok, dataset} = SessionLayers.create_layer(dataset, "room.0000", "Speech", empty())
    assert File.dir?(Path.join(root, "room%2E0000/annotations.0000"))
    {:ok, dataset} = Dataset.rename_session(dataset, "room.0000", "late")
    {:ok, dataset} = SessionLayers.create_layer(dataset, "late", "Faces", empty())
    assert Enum.map(list(dataset, "late"), & &1.stream) == ["Faces", "Speech"]
  end

  test "layers in other partitions are listed and can be copied", %{
    dataset: dataset,
    tmp_dir: root
  } do
    found = layer([{0, 10, "A", "speaks"}, {20, 10, "B", "laughs"}])
    {:ok, path} = Recording.write(found, Path.join(root, "Detected"), "Speech")
    {:ok, dataset} = Dataset.add_partition(dataset, "p01", "Annotations", path)

    assert list(dataset, "p01") == [
             %{partition: "Annotations", stream: "Speech", editable?: false}
           ]

    {:ok, dataset} = SessionLayers.copy_layer(dataset, "p01", "Speech", "Speech.Ada")
    own = %{partition: "Annotations 2", stream: "Speech.Ada", editable?: true}
    assert own in list(dataset, "p01")
    {:ok, session} = Dataset.session(dataset, "p01")
    {:ok, {_, store, name}} = OpenSession.fetch_stream(OpenSession.open(session), "Speech.Ada")
    {:ok, copy} = Recording.load_layer(store, name)
    assert Layer.annotations(copy) == Layer.annotations(found)
  end

  test "a dataset with layers can be sealed, and a later edit changes the checksum",
       %{dataset: dataset} do
    {:ok, dataset} = SessionLayers.create_layer(dataset, "p01", "Speech", empty())
    {:ok, dataset} = Dataset.seal(dataset)
    {:ok, session} = Dataset.session(dataset, "p01")
    {:ok, %{checksum: checksum, path: path}} = Session.fetch_partition(session, "Annotations")
    assert Checksum.verify(path, checksum) == :ok
    {:ok, editor} = Editor.start_link(path: path, stream: "Speech")
    {:ok, _} = Editor.edit(editor, &Layer.add(&1, Annotation.new(0, 10, "A")))
    {:ok, _} = Editor.save(editor)
    assert {:error, %{code: :changed}} = Checksum.verify(path, checksum)
  end

  test "a folder with layers is read as a dataset with the newest layers",
       %{dataset: dataset, tmp_dir: root} do
    for name <- ["Speech", "Faces"],
        do: {:ok, _} = SessionLayers.create_layer(dataset, "p01", name, empty())

    {:ok, folder} = Dataset.open(root)
    {:ok, session} = Dataset.session(folder, "p01")
    path = Path.join(root, "p01/annotations")
    assert [%Partition{name: "Annotations", path: ^path}] = session.partitions
    assert Enum.map(list(folder, "p01"), & &1.stream) == ["Faces", "Speech"]
  end

  # Each program adds ten layers with one annotation each to the same session.
  @writer """
  [file, who] = System.argv()
  alias Situ.{Annotation, Dataset}
  alias Situ.Annotation.{Layer, Schema}
  {:ok, _} = Application.ensure_all_started(:situ_dataset)
  {:ok, dataset} = Dataset.load(file)

  for n <- 1..10 do
    one = Annotation.new(n, n + 1, who, %{"Speech" => "speaks"})
    {:ok, layer} = Layer.new(Schema.finite("Speech", ["speaks"]), [one])
    {:ok, _} = Dataset.SessionLayers.create_layer(dataset, "p01", who <> " " <> to_string(n), layer)
  end
  """

  test "two programs that add layers at the same time lose none", %{
    dataset: dataset,
    tmp_dir: root
  } do
    script = Path.join(root, "writer.exs")
    File.write!(script, @writer)
    paths = Enum.flat_map(:code.get_path(), &["-pa", to_string(&1)])

    ["ada", "ben"]
    |> Task.async_stream(
      &System.cmd("elixir", paths ++ [script, dataset.file, &1], stderr_to_stdout: true),
      timeout: 120_000
    )
    |> Enum.each(fn {:ok, result} -> assert {"", 0} = result end)

    {:ok, again} = Dataset.load(dataset.file)
    expected = for who <- ["ada", "ben"], n <- 1..10, do: "#{who} #{n}"
    assert Enum.sort(Enum.map(list(again, "p01"), & &1.stream)) == Enum.sort(expected)
    {:ok, path} = SessionLayers.store_path(again, "p01")
    store = Store.open!(path)
    for name <- expected, do: assert({:ok, [_]} = Recording.read_annotations(store, name))
    {:ok, session} = Dataset.session(again, "p01")
    assert Enum.map(session.partitions, & &1.name) == ["Room", "Annotations"]
    assert %Partition{path: ^path} = List.last(session.partitions)
  end
end
