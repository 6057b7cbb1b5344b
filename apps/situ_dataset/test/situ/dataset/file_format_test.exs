defmodule Situ.Dataset.FileFormatTest do
  use ExUnit.Case, async: true
  alias Situ.Dataset
  alias Situ.Dataset.FileFormat

  @moduletag :tmp_dir

  defp read(root, text) do
    path = Path.join(root, "d.json")
    File.write!(path, text)
    load_fields(path)
  end

  defp load_fields(path) do
    with {:ok, dataset} <- Dataset.load(path),
         do: {:ok, Map.take(dataset, [:name, :tags, :metadata, :sessions, :extra])}
  end

  test "reads a minimal file written by hand", %{tmp_dir: root} do
    text = ~s({"sessions": [{"name": "a", "partitions": [{"name": "P", "path": "x/y"}]}]})
    assert {:ok, %{name: "Untitled Dataset", sessions: [%{partitions: [p]}]}} = read(root, text)
    assert p.path == Path.join(root, "x/y")
  end

  test "keeps unknown fields", %{tmp_dir: root} do
    text = ~s({"version": 1, "name": "N", "colour": "red", "sessions": [
      {"name": "a", "room": 7, "partitions": [{"name": "P", "path": "p", "who": ["x", null]}]}]})

    {:ok, dataset} = read(root, text)
    rendered = FileFormat.encode(dataset, Path.join(root, "d.json"))
    {:ok, json} = Situ.JSON.decode(rendered)
    assert json["colour"] == "red"
    assert %{"sessions" => [%{"room" => 7, "partitions" => [%{"who" => ["x", nil]}]}]} = json
    assert {:ok, ^dataset} = read(root, rendered)
  end

  test "rejects an invalid dataset with the position", %{tmp_dir: root} do
    for {text, why} <- [
          {"", "not JSON"},
          {"[]", "sessions"},
          {~s({"sessions": 7}), "list of objects"},
          {~s({"sessions": [7]}), "list of objects"},
          {~s({"sessions": [{"name": "a"}, {"name": "a"}]}), "twice"},
          {~s({"sessions": [{"name": 7}]}), "invalid name"},
          {~s({"sessions": [{"name": "a", "tags": "x"}]}), "tags"},
          {~s({"sessions": [{"name": "a", "metadata": []}]}), "metadata"},
          {~s({"sessions": [{"name": "a", "partitions": [{"name": "P"}]}]}), "has no path"},
          {~s({"sessions": [{"name": "a", "partitions": [{"name": "P", "path": 1}]}]}),
           "not a string"},
          {~s({"version": 99, "sessions": []}), "version"}
        ] do
      assert {:error, %{code: :bad_dataset, why: said}} = read(root, text)
      assert said =~ why
    end

    assert {:error, %{code: :not_found}} = load_fields(Path.join(root, "none"))
    assert {:error, %{code: :bad_dataset}} = load_fields(root)
  end

  test "never raises for a truncated file", %{tmp_dir: root} do
    whole =
      ~s({"version":1,"name":"N","sessions":[{"name":"a","partitions":[{"name":"P","path":"p"}]}]})

    for n <- 0..(byte_size(whole) - 1),
        do: assert({:error, %{code: :bad_dataset}} = read(root, binary_part(whole, 0, n)))
  end

  test "reads the reference's .pds, with backslashes too", %{tmp_dir: root} do
    path = Path.join(root, "d.pds")

    File.write!(path, ~S({"Name": "R", "Sessions": [{"Name": "S1", "Partitions": [
      {"$type": "x", "Name": "Robot", "StoreName": "Robot", "StorePath": "S1\\Robot.0000",
       "StreamReaderTypeName": "Microsoft.Psi.Data.PsiStoreStreamReader, Microsoft.Psi"},
      {"Name": "Far", "StoreName": "Far", "StorePath": "D:\\x\\Far"}]}]}))

    {:ok, dataset} = Situ.Dataset.open(path)
    assert dataset.file == nil
    [%{partitions: [robot, far]}] = dataset.sessions
    assert robot.path == Path.join(root, "S1/Robot.0000")
    assert far.path == ~S(D:\x\Far)
    assert {:error, %{code: :no_store, fix: fix}} = Situ.Dataset.Partition.open(far)
    assert fix =~ "relative"
    assert {:error, %{code: :no_file}} = Situ.Dataset.save(dataset)
    {:ok, saved} = Situ.Dataset.save_as(dataset, Path.join(root, "d.json"))
    {:ok, again} = Situ.Dataset.open(saved.file)
    assert [%{partitions: [%{path: path} | _]}] = again.sessions
    assert path == robot.path
  end
end
