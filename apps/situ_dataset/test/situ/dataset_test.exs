defmodule Situ.DatasetTest do
  use ExUnit.Case, async: true
  import Situ.Dataset.Test.Study
  alias Situ.{Dataset, Interval}
  alias Situ.Dataset.{Partition, Session, Summary}

  doctest Situ.Dataset
  doctest Situ.Dataset.Session
  doctest Situ.Dataset.Partition
  doctest Situ.Dataset.Summary
  doctest Situ.Dataset.Server

  @moduletag :tmp_dir
  @s 1_000_000_000

  test "opens a saved dataset unchanged, even if its folder was moved", %{tmp_dir: root} do
    dataset = dataset(Path.join(root, "here"), 3)
    {:ok, dataset} = Dataset.put_fields(dataset, metadata: %{"lab" => "A", "n" => 3}, tags: ["x"])

    {:ok, dataset} =
      Dataset.update_session(
        dataset,
        "p2",
        &{:ok, %{&1 | tags: ["pilot"], metadata: %{"age" => 31}}}
      )

    assert dataset.unsaved?
    {:ok, saved} = Dataset.save(dataset)
    refute saved.unsaved?
    {:ok, again} = Dataset.open(saved.file)
    assert again == saved

    File.rename!(Path.join(root, "here"), Path.join(root, "there"))
    {:ok, moved} = Dataset.open(Path.join(root, "there/study.json"))
    assert Dataset.troubles(moved) == []
    assert Dataset.summary(moved).messages == 30
    assert Enum.map(Dataset.select_sessions(moved, tags: ["pilot"]), & &1.name) == ["p2"]
    assert Enum.map(Dataset.select_sessions(moved, name: "p[13]"), & &1.name) == []
    assert Enum.map(Dataset.select_sessions(moved, name: "?2"), & &1.name) == ["p2"]
  end

  test "states the size of a file whose format does not state sizes", %{tmp_dir: root} do
    path = Path.join(root, "walk.csv")
    File.write!(path, "time,x\n0,1\n1,2\n")
    {:ok, store} = Situ.Store.open(path)
    assert %{size: 15, messages: 2} = Situ.Dataset.Summary.from_store(store)
  end

  test "summarizes intervals by coverage, and sizes and counts by sum", %{tmp_dir: root} do
    dataset = dataset(root, 2)
    summary = Dataset.summary(dataset)
    assert summary.originating == Interval.closed(100 * @s, 209 * @s)
    assert summary.creation == Interval.closed(100 * @s + 1_000, 209 * @s + 1_000)
    assert {summary.streams, summary.messages, summary.unknown} == {2, 20, 0}
    assert summary.size > 0
    assert [{"p1", one}, {"p2", _}] = Dataset.session_summaries(dataset)
    assert Summary.duration(one) == 9 * @s
    {:ok, empty} = Dataset.new()
    assert Interval.empty?(Dataset.summary(empty).originating)
  end

  test "names are unique, and an append is all or nothing", %{tmp_dir: root} do
    dataset = dataset(root, 2)
    assert {:error, %{code: :duplicate_name}} = Dataset.add_session(dataset, "p1")
    assert {:error, %{code: :duplicate_name}} = Dataset.rename_session(dataset, "p1", "p2")
    {:ok, same} = Dataset.rename_session(dataset, "p1", "p1")
    assert same.sessions == dataset.sessions
    {:ok, other} = Dataset.new("Other")
    {:ok, other} = Dataset.add_session(other, "q")
    {:ok, other} = Dataset.add_session(other, "p2")
    assert {:error, %{code: :duplicate_name}} = Dataset.append_sessions(dataset, other)
    {:ok, other} = Dataset.remove_session(other, "p2")
    {:ok, both} = Dataset.append_sessions(dataset, other)
    assert Enum.map(both.sessions, & &1.name) == ["p1", "p2", "q"]
    assert {:error, %{code: :no_session, fix: fix}} = Dataset.session(both, "p3")
    assert fix =~ "p1" or fix =~ "p2"

    for bad <- ["", "a[b", "x]", " a", "line\nbreak", String.duplicate("x", 201), 7],
        do: assert({:error, %{code: :bad_name}} = Dataset.rename_session(both, "q", bad))
  end

  test "adds, renames and removes partitions, and keeps recordings", %{tmp_dir: root} do
    dataset = dataset(root, 1)
    room = Path.join(root, "p1/room.0000")
    assert {:error, %{code: :duplicate_name}} = Dataset.add_partition(dataset, "p1", "Room", room)
    {:ok, dataset} = Dataset.add_partition(dataset, "p1", "Again", room)

    {:ok, dataset} =
      Dataset.update_session(dataset, "p1", &Session.rename_partition(&1, "Again", "B"))

    assert {:error, %{code: :duplicate_name}} =
             Dataset.update_session(dataset, "p1", &Session.rename_partition(&1, "B", "Room"))

    {:ok, dataset} = Dataset.update_session(dataset, "p1", &Session.remove_partition(&1, "Room"))
    assert [%{partitions: [%{name: "B"}]}] = dataset.sessions
    assert Situ.Store.exists?(room)
  end

  test "autosaves every edit, and keeps the old file if writing fails",
       ctx do
    file = Path.join(ctx.tmp_dir, "a/study.json")
    {:ok, dataset} = Dataset.new("S", file: file, autosave: true)
    {:ok, dataset} = Dataset.add_session(dataset, "one")
    {:ok, %{sessions: [%{name: "one"}]}} = Dataset.load(file)
    assert {:error, %{code: :no_file}} = Dataset.new("S", autosave: true)

    # A file cannot replace a folder of the same name.
    File.rm!(file)
    File.mkdir_p!(Path.join(file, "x"))
    assert {:error, %{code: :not_saved, why: why}} = Dataset.add_session(dataset, "two")
    assert is_binary(why)
    assert Enum.sort(File.ls!(Path.dirname(file))) == ["study.json", "study.json.edits"]
  end

  test "reports missing and damaged recordings, and reads the others", %{tmp_dir: root} do
    dataset = dataset(root, 3)
    File.rm_rf!(Path.join(root, "p1/room.0000"))
    data = Path.join(root, "p2/room.0000/data-000000.situ")
    File.rm!(data)
    assert [{"p1", "Room", %{code: :no_store}}, {"p2", "Room", _}] = Dataset.troubles(dataset)
    assert %{unknown: unknown} = Dataset.summary(dataset)
    assert unknown in 1..2
    {:ok, session} = Dataset.session(dataset, "p3")
    assert Session.troubles(session) == []
  end

  test "a sealed dataset detects a changed recording", %{tmp_dir: root} do
    {:ok, dataset} = root |> dataset(1) |> Dataset.seal(progress: &send(self(), {&1, &2}))
    assert_received {1, 1}
    [%{partitions: [partition]}] = dataset.sessions
    assert :ok = Partition.check_recording(partition)

    {:ok, device} =
      :file.open(Path.join(partition.path, "data-000000.situ"), [:read, :write, :raw])

    {:ok, <<byte>>} =
      :file.pread(device, 100, 1) |> then(fn {:ok, b} -> {:ok, :erlang.iolist_to_binary(b)} end)

    :ok = :file.pwrite(device, 100, <<Bitwise.bxor(byte, 1)>>)
    :ok = :file.close(device)

    assert {:error, %{code: :changed}} =
             Situ.Dataset.Checksum.verify(partition.path, partition.checksum)
  end

  test "opens a folder of recordings, including external files", %{tmp_dir: root} do
    record(root, "alone", %{"A" => ten(1)})
    record(Path.join(root, "p1/raw"), "room", %{"A" => ten(1)})
    record(Path.join(root, "p1/more"), "room", %{"A" => ten(1)})
    File.write!(Path.join(root, "p1/imu.csv"), "time,x\n1.0,2.0\n2.0,3.0\n")
    File.write!(Path.join(root, "p1/package.json"), "{}")
    # The results of an experiment are not sessions.
    record(Path.join(root, "study.json.experiments/Tune/outputs"), "abc", %{"A" => ten(1)})
    File.mkdir_p!(Path.join(root, "empty"))
    File.ln_s!(root, Path.join(root, "p1/loop"))
    {:ok, dataset} = Dataset.open(root)
    assert Enum.map(dataset.sessions, & &1.name) == ["alone.0000", "p1"]
    {:ok, p1} = Dataset.session(dataset, "p1")
    assert Enum.map(p1.partitions, & &1.name) == ["imu", "room", "room 2"]
    assert Dataset.troubles(dataset) == []
    {:ok, one} = Dataset.open(Path.join(root, "p1/imu.csv"))
    assert [%{name: "imu", partitions: [%{name: "imu"}]}] = one.sessions
    assert {:error, %{code: :no_recordings}} = Dataset.open(Path.join(root, "empty"))
    assert {:error, %{code: :not_found}} = Dataset.open(Path.join(root, "nothing"))
  end

  test "opens and lists a thousand sessions without their recordings", %{tmp_dir: root} do
    {:ok, dataset} = Dataset.new("Big", file: Path.join(root, "big.json"))

    sessions =
      for i <- 1..1_000 do
        {:ok, s} =
          Session.add_partition(Session.new("s#{i}"), %Partition{
            name: "P",
            path: Path.join(root, "s#{i}/p.0000")
          })

        s
      end

    {:ok, dataset} = Dataset.save(%{dataset | sessions: sessions})
    {:reductions, before} = Process.info(self(), :reductions)
    {:ok, again} = Dataset.open(dataset.file)
    {:reductions, later} = Process.info(self(), :reductions)
    assert length(again.sessions) == 1_000
    # A session takes about 6,000 reductions, or 5 us. Disk access would take more.
    assert later - before < 20_000_000
  end

  test "notifies subscribers of renamed sessions, and survives a failing edit" do
    {:ok, dataset} = Dataset.new("S")
    {:ok, dataset} = Dataset.add_session(dataset, "a")
    {:ok, server} = Dataset.Server.start_link(dataset: dataset)
    :ok = Dataset.Server.subscribe(server)
    {:ok, _} = Dataset.Server.edit(server, &Dataset.rename_session(&1, "a", "b"))
    assert_receive {:situ_dataset, ^server, changes}
    assert :dataset in changes and {:session, "b"} in changes
    assert {:error, %{code: :edit_failed}} = Dataset.Server.edit(server, fn _ -> raise "no" end)
    assert {:error, %{code: :edit_failed}} = Dataset.Server.edit(server, fn _ -> :what end)
    assert [%{name: "b"}] = Dataset.Server.get_dataset(server).sessions
  end
end
