defmodule Situ.Store.QueryTest do
  use ExUnit.Case, async: true
  import Situ.Store.Test.Record
  alias Situ.Store
  alias Situ.Store.Writer

  @moduletag :tmp_dir

  test "reads by time, index and range", %{tmp_dir: root} do
    store = Store.open!(store(root, [{"S", messages(Enum.to_list(0..4_999)), []}]))
    assert {:ok, %{data: 17}} = Store.at(store, "S", 17)
    assert {:ok, %{data: 4_999}} = Store.at(store, "S", -1)
    assert {:ok, nil} = Store.at(store, "S", 5_000)
    assert {:ok, nil} = Store.at(store, "S", -5_001)
    assert {:ok, %{data: 17}} = Store.latest_at(store, "S", 17_999)
    assert {:ok, %{data: 17}} = Store.latest_at(store, "S", 17_000)
    assert {:ok, nil} = Store.latest_at(store, "S", -1)
    assert {:ok, %{data: 18}} = Store.first_at(store, "S", 17_001)
    assert {:ok, nil} = Store.first_at(store, "S", 5_000_000)
    {:ok, range} = Store.read(store, "S", from: 1_500, to: 4_000)
    assert Enum.map(range, & &1.data) == [2, 3, 4]
    {:ok, range} = Store.read(store, "S", index: 4_990, limit: 3)
    assert Enum.map(range, & &1.data) == [4_990, 4_991, 4_992]
    assert {:error, %{code: :no_stream, fix: fix}} = Store.read(store, "s")
    assert fix =~ "S"
  end

  test "reads from the end and refuses unknown options", %{tmp_dir: root} do
    store = Store.open!(store(root, [{"N", messages(Enum.to_list(0..9)), []}]))
    data = fn opts -> store |> Store.messages("N", opts) |> Enum.map(& &1.data) end
    assert data.(index: -2) == [8, 9]
    assert data.(index: -20) == Enum.to_list(0..9)
    assert {:error, %{code: :unknown_option, fix: fix}} = Store.read(store, "N", form: 3)
    assert fix =~ ":from"
    assert_raise Situ.Error, fn -> Store.messages(store, "N", limit: 3) end
  end

  test "notifies a waiting process of commits without polling", %{tmp_dir: root} do
    {:ok, writer} = Writer.create("tail", root)
    {:ok, stream} = Writer.stream(writer, "S", type: :integer)
    store = Store.open!(writer.path)
    %{entries: known} = Store.info(store)
    :ok = Store.notify(store, known, 7)
    refute_received {:situ_store, _, _}
    {:ok, _} = Writer.append(stream, [message(1, 1)])
    assert_receive {:situ_store, 7, {:published, n}} when n > known
    assert Store.count(store, hd(Store.streams(store))) == 1
    :ok = Writer.close(writer)
    # Closing publishes the rest of the pyramid.
    :ok = Store.notify(store, n, 8)
    assert_receive {:situ_store, 8, {:published, n}}
    :ok = Store.notify(store, n, 8)
    assert_receive {:situ_store, 8, {:ended, _}}
  end

  test "reports the same gaps between messages, however they were written", %{tmp_dir: root} do
    seconds = Enum.to_list(0..99) ++ Enum.to_list(160..259)
    messages = for t <- seconds, do: message(t, t * 1_000_000_000)
    path = store(root, [{"S", messages, []}])
    {:ok, copy} = Store.copy(path, {"copy", root})
    {:ok, compact} = Store.copy(path, {"packed", root}, compression: :zstd)
    pause = [{99_000_000_000, 160_000_000_000}]

    for path <- [path, copy, compact] do
      store = Store.open!(path)
      assert Store.gaps(store, "S", 2_000_000_000) == pause
      assert Store.gaps(store, "S", 61_000_000_000) == pause
      assert Store.gaps(store, "S", 61_000_000_001) == []
      assert length(Store.gaps(store, "S", 1_000_000_000)) == 199
      assert Store.gaps(store, "S", 10_000_000_000_000_000_000) == []
    end
  end
end
