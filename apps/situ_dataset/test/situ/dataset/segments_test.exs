defmodule Situ.Dataset.SegmentsTest do
  # A recording in segments is one partition.
  use ExUnit.Case, async: true
  import Situ.Test.SegmentFiles
  alias Situ.{Dataset, Store}
  alias Situ.Dataset.{Checksum, Partition}

  @moduletag :tmp_dir

  setup %{tmp_dir: root} do
    root = Path.expand(root)
    for first <- [1, 11, 21], do: write_segment(root, "hall", %{"N" => first..(first + 8)})
    {:ok, writer} = Store.Writer.create("lobby", root)
    :ok = Store.Writer.close(writer)
    {:ok, root: root, hall: Path.join(root, "hall")}
  end

  test "a folder has one session for it, and the partition reads all segments", ctx do
    {:ok, dataset} = Dataset.open(ctx.root)
    assert ["hall", "lobby.0000"] = Enum.map(dataset.sessions, & &1.name)
    [%{partitions: [partition]} | _] = dataset.sessions
    assert partition.path == ctx.hall and partition.name == "hall"
    {:ok, store} = Partition.open(partition)
    assert Store.count(store, "N") == 27
    assert :ok = Partition.check_recording(partition)
    {:ok, summary} = Partition.summary(partition)
    assert summary.messages == 27
  end

  test "is added by its name, sealed, saved and opened again", ctx do
    file = Path.join(ctx.root, "study.json")
    {:ok, dataset} = Dataset.new("study", file: file)
    {:ok, dataset} = Dataset.add_session(dataset, "s")
    {:ok, dataset} = Dataset.add_partition(dataset, "s", "hall", ctx.hall)
    {:ok, sum} = Checksum.compute(ctx.hall)
    {:ok, _} = Dataset.save(dataset)
    {:ok, again} = Dataset.load(file)
    [%{partitions: [found]}] = again.sessions
    assert found.path == ctx.hall
    assert :ok = Checksum.verify(ctx.hall, sum)
    write_segment(ctx.root, "hall", %{"N" => 31..33})
    assert {:error, %{code: :changed}} = Checksum.verify(ctx.hall, sum)
  end
end
