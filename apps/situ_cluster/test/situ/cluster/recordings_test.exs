defmodule Situ.Cluster.RecordingsTest do
  # The recordings of a node as others find and open them; test/nodes tests this between real nodes.
  use ExUnit.Case, async: false
  import Situ.Test.LinkRecordings, only: [folder: 0, begin: 3, finish: 1, messages: 1]
  alias Situ.{Cluster, Store}
  alias Situ.Cluster.Recordings

  @moduletag :tmp_dir
  @moduletag capture_log: true

  test "are listed and open from anywhere", %{tmp_dir: log} do
    root = folder()
    finish(begin(root, "door", %{"Open" => messages([10, 20])}))
    {writer, streams} = begin(root, "hall", %{"Light" => messages([5])})
    start_supervised!({Cluster, log: log, recordings: root})

    door = "#{node()}/door.0000"
    assert [%{id: ^door, live?: false}, %{name: "hall.0000", live?: true}] = sorted()
    assert Cluster.overview().recordings |> Enum.map(& &1.name) |> Enum.sort() == names()

    {:ok, "situ://127.0.0.1" <> _ = address, opts} = Recordings.fetch_address(door)
    {:ok, store} = Store.open(address, reader_opts: opts)
    assert for(m <- Store.messages(store, "Open"), do: m.data) == [10, 20]
    # A second request returns the same server; without the token it is closed.
    assert {:ok, ^address, ^opts} = Recordings.fetch_address(door)
    assert {:error, %{code: :wrong_token}} = Store.open(address)

    # A recording in progress is followed.
    {:ok, address, opts} = Recordings.fetch_address("#{node()}/hall.0000")
    {:ok, live} = Store.open(address, reader_opts: opts)
    assert Store.live?(live)
    finish({writer, streams})
  end

  test "are found by their listed id, and not by a path", %{tmp_dir: log} do
    root = folder()
    finish(begin(root, "door", %{"Open" => messages([1])}))
    inside = Path.join(root, "inside")
    File.mkdir_p!(inside)
    start_supervised!({Cluster, log: log, recordings: inside})

    for id <- ["#{node()}/../door.0000", "#{node()}/door.0000", "#{node()}/#{root}/door.0000"],
        do: assert({:error, %{code: :not_found}} = Recordings.fetch_address(id))

    for id <- ["nobody@nowhere/door.0000", "", "/", "door.0000"],
        do: assert({:error, %{code: :not_found}} = Recordings.fetch_address(id))
  end

  test "a node without a folder or outside the cluster has none", %{tmp_dir: log} do
    assert Recordings.list_all() == []
    assert {:error, %{code: :unreachable}} = Recordings.fetch_address("#{node()}/door.0000")
    start_supervised!({Cluster, log: log})
    assert Recordings.list_all() == []
    assert {:error, %{code: :not_found}} = Recordings.fetch_address("#{node()}/door.0000")
  end

  defp sorted, do: Enum.sort_by(Recordings.list_all(), & &1.name)
  defp names, do: ["door.0000", "hall.0000"]
end
