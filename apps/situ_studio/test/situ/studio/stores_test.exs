defmodule Situ.Studio.StoresTest do
  use ExUnit.Case, async: true
  import Situ.Test.Eventually
  import Situ.Test.SegmentFiles
  alias Situ.Store.Writer
  alias Situ.Studio.{Recordings, Stores}
  alias Situ.Studio.Datasets.Summary

  defp record(name, folder) do
    File.mkdir_p!(folder)
    {:ok, writer} = Writer.create(name, folder)
    :ok = Writer.close(writer)
  end

  @tag :tmp_dir
  test "lists only the latest version of annotations, and ignores JSON that is not a store", %{
    tmp_dir: tmp
  } do
    for name <-
          ~w(Talk Talk Talk.0000-annotation-A Talk.0000-annotation-A Talk.0000-annotation-B),
        do: record(name, tmp)

    File.write!(Path.join(tmp, "p1.statistics.json"), "{}")
    File.write!(Path.join(tmp, "Notes.Catalog.json"), "[]")
    File.write!(Path.join(tmp, "Notes.Data.json"), "[]")

    assert tmp |> Stores.list_recordings() |> Enum.map(&elem(&1, 0)) |> Enum.sort() == [
             "Notes.Catalog.json",
             "Talk.0000",
             "Talk.0000-annotation-A.0001",
             "Talk.0000-annotation-B.0000",
             "Talk.0001"
           ]

    assert {:ok, _} = Stores.fetch_recording(tmp, "Talk.0000-annotation-A.0000")
  end

  @tag :tmp_dir
  test "shows a recording in segments once, while it grows and loses segments", %{tmp_dir: tmp} do
    second = 1_000_000_000
    write_segment(tmp, "hall", %{"N" => [1 * second, 2 * second]}, run: "a")
    write_segment(tmp, "hall", %{"N" => [60 * second, 90 * second]}, run: "b")
    writer = write_segment(tmp, "hall", %{"N" => [100 * second]}, run: "b", open?: true)
    record("lobby", tmp)
    assert Enum.map(Stores.list_recordings(tmp), &elem(&1, 0)) == ["hall", "lobby.0000"]
    assert {:ok, path} = Stores.fetch_recording(tmp, "hall")
    assert %{segments: 3, pauses: 1, live: true, error: nil} = facts = Summary.of_recording(path)
    assert Summary.format_duration(facts) == "1 min 39 s"
    stamp = Summary.file_stamp(path)
    {:ok, source} = Recordings.Store.open(path)
    :ok = Situ.Store.delete(path <> ".0000")
    write_segment(tmp, "hall", %{"N" => [110 * second], "New" => [111 * second]}, run: "b")
    assert Summary.file_stamp(path) != stamp
    # The studio's cache of the streams expires.
    assert eventually(fn ->
             match?({:ok, %{name: "New"}}, Situ.Store.stream_info(source, "New"))
           end)

    assert {:ok, %{first: first, last: last}} = Situ.Store.stream_info(source, "N")
    assert {first, last} == {60 * second, 110 * second}
    :ok = Writer.close(writer)
    # A segment is still found by its own name.
    assert {:ok, _} = Stores.fetch_recording(tmp, "hall.0001")
  end

  @tag :tmp_dir
  test "lists recordings without following links, and finds only listed names", %{
    tmp_dir: tmp
  } do
    root = Path.join(tmp, "recordings")
    record("Talk", root)
    record("Walk", Path.join(root, "may"))
    record("Secret", Path.join(tmp, "elsewhere"))
    File.ln_s!(".", Path.join(root, "a"))
    File.ln_s!("/", Path.join(root, "root"))
    File.ln_s!("../elsewhere", Path.join(root, "out"))
    File.ln_s!("../elsewhere/Secret.0000", Path.join(root, "Linked.0000"))

    assert [{"Talk.0000", talk}, {"may/Walk.0000", walk}] =
             Enum.sort(Stores.list_recordings(root))

    assert {:ok, ^talk} = Stores.fetch_recording(root, "Talk.0000")
    assert {:ok, ^walk} = Stores.fetch_recording(root, "may/Walk.0000")

    for name <- [
          "out/Secret.0000",
          "a/Talk.0000",
          "Linked.0000",
          "../elsewhere/Secret.0000",
          "may/../Talk.0000",
          "/Talk.0000",
          "",
          ".",
          "root",
          "Talk.0000" <> <<0>>,
          <<255>>,
          "none"
        ] do
      assert {name, Stores.fetch_recording(root, name)} == {name, :error}
    end
  end

  @tag :tmp_dir
  test "a path that is a recording has its own name", %{tmp_dir: tmp} do
    record("Talk", tmp)
    path = Path.join(tmp, "Talk.0000")
    assert Stores.list_recordings(path) == [{"Talk.0000", path}]
    assert Stores.fetch_recording(path, "Talk.0000") == {:ok, path}
    assert Stores.fetch_recording(path, "Other") == :error
  end

  @tag :tmp_dir
  test "lists, finds and draws recordings of another machine", %{tmp_dir: tmp} do
    {:ok, writer} = Writer.create("lobby", tmp)
    {:ok, stream} = Writer.stream(writer, "n", type: :float)

    messages =
      for i <- 1..100 do
        time = i * 1_000_000
        %Situ.Message{data: i * 0.5, originating_time: time, creation_time: time, sequence_id: i}
      end

    {:ok, _} = Writer.append(stream, messages)
    :ok = Writer.close(writer)
    path = Path.join(tmp, "lobby")
    {:ok, server} = Situ.Link.serve(%{"lobby" => path, "hall" => path}, port: 0)
    whole = "situ://127.0.0.1:#{Situ.Link.Server.port(server)}"

    assert Stores.list_all(whole) ==
             {[{"hall", whole <> "/hall"}, {"lobby", whole <> "/lobby"}], []}

    assert Stores.list_all(whole <> "/lobby") == {[{"lobby", whole <> "/lobby"}], []}
    assert Stores.fetch_recording(whole, "lobby") == {:ok, whole <> "/lobby"}
    assert Stores.fetch_recording(whole, "../lobby") == :error

    start_supervised!({Situ.Studio, path: whole, port: 0, id: "elsewhere"})

    assert {:ok, %{kind: :elsewhere}, source} =
             Situ.Studio.Catalog.open_source("elsewhere", "lobby")

    assert {:ok, %{from: 1_000_000, to: 100_000_000, live: false}} =
             Situ.Studio.StreamReader.fetch_extent(source)

    assert {:ok, [%{name: "n", count: 100}]} = Situ.Studio.StreamOverview.list_streams(source)

    assert {:ok, points, _} =
             Situ.Studio.StreamOverview.read_series(source, "n", 0, 100_000_000, 1_000_000)

    assert length(points) > 50
    Situ.Link.Server.close(server)
  end
end
